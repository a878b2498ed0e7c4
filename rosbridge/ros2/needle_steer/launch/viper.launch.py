"""One insertion with the Viper S650: a real one at `host`, or its emulated controller with the
phantom."""
import os

from launch import LaunchDescription
from launch.actions import (DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription,
                            OpaqueFunction, Shutdown)
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

HERE = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
ARGUMENTS = [
    ('host', '', "address of the arm's controller; empty: an emulated one"),
    ('rviz', 'true', 'show it'),
    ('config', '', 'configuration file; empty: the built-in experiment'),
    ('law', 'hybrid', 'steering law'),
    ('seed', '1', 'seed of everything random'),
    ('autostart', '', 'start at once, else with ~/start; empty: a real arm waits'),
    ('out', '', 'folder of the results; empty: the next free one under out/'),
]


def program():
    """The wrapper: where the sources have it, or installed as `ros2 run` finds it."""
    sources = os.path.join(HERE, 'scripts', 'needle_steer')
    installed = os.path.join(HERE, '..', '..', 'lib', 'needle_steer', 'needle_steer')
    return sources if os.path.exists(sources) else os.path.normpath(installed)


def run(context):
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    emulated = 'false' if given['host'] else 'true'
    command = [program(), 'run']
    command += [given['config']] if given['config'] else []
    command += ['--backend', 'viper', '--law', given['law'], '--seed', given['seed'],
                '--set', 'viper.emulate=' + emulated,
                '--set', 'viper.host=' + (given['host'] or '127.0.0.1'),
                '--set', 'ros.version=2', '--set', 'ros.publish=true',
                '--set', 'ros.autostart=' + (given['autostart'] or emulated)]
    command += ['--out', given['out']] if given['out'] else []
    return [ExecuteProcess(cmd=command, output='screen', on_exit=Shutdown())]


def include(name, **more):
    source = PythonLaunchDescriptionSource(os.path.join(HERE, 'launch', name))
    return IncludeLaunchDescription(source, **more)


def generate_launch_description():
    declared = [DeclareLaunchArgument(name, default_value=default, description=meaning)
                for name, default, meaning in ARGUMENTS]
    return LaunchDescription(declared + [
        include('description.launch.py'),
        OpaqueFunction(function=run),
        include('rviz.launch.py', condition=IfCondition(LaunchConfiguration('rviz'))),
    ])
