"""One insertion with an arm under ros2_control: the watchdog (relay.launch.py), and the program behind
it. The arm's own nodes (controllers, joint states, robot_status) run already."""
import os

from launch import LaunchDescription
from launch.actions import (DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription,
                            OpaqueFunction, Shutdown)
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

HERE = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
ARGUMENTS = [
    ('relay', 'true', 'start the watchdog here; false where it runs beside the controllers'),
    ('velocities', 'needle_steer/velocities', 'topic between program and watchdog'),
    ('output', 'forward_velocity_controller/commands', 'topic of the controllers'),
    ('config', '', 'configuration file; empty: the built-in experiment'),
    ('law', 'hybrid', 'steering law'),
    ('seed', '1', 'seed of everything random'),
    ('autostart', 'false', 'start at once, else with ~/start'),
    ('out', '', 'folder of the results; empty: the next free one under out/'),
]


def program():
    """The wrapper: where the sources have it, or installed as `ros2 run` finds it."""
    sources = os.path.join(HERE, 'scripts', 'needle_steer')
    installed = os.path.join(HERE, '..', '..', 'lib', 'needle_steer', 'needle_steer')
    return sources if os.path.exists(sources) else os.path.normpath(installed)


def run(context):
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    command = [program(), 'run']
    command += [given['config']] if given['config'] else []
    command += ['--backend', 'ros', '--law', given['law'], '--seed', given['seed'],
                '--set', 'ros.version=2', '--set', 'ros.publish=true',
                '--set', 'ros.autostart=' + given['autostart']]
    command += ['--out', given['out']] if given['out'] else []
    command += ['--ros-args', '-r',
                'joint_group_velocity_controller/command:=' + given['velocities']]
    return [ExecuteProcess(cmd=command, output='screen', on_exit=Shutdown())]


def generate_launch_description():
    declared = [DeclareLaunchArgument(name, default_value=default, description=meaning)
                for name, default, meaning in ARGUMENTS]
    relay = PythonLaunchDescriptionSource(os.path.join(HERE, 'launch', 'relay.launch.py'))
    return LaunchDescription(declared + [
        IncludeLaunchDescription(
            relay, condition=IfCondition(LaunchConfiguration('relay')),
            launch_arguments={'input': LaunchConfiguration('velocities'),
                              'output': LaunchConfiguration('output')}.items()),
        OpaqueFunction(function=run),
    ])
