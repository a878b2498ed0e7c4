"""The watchdog in front of ros2_control's velocity controllers, which hold the last velocity that they
heard for ever. Start it where the controllers run, before anything that moves the arm; it is started
anew when it dies, and then stops the arm first."""
import os

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration

HERE = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
ARGUMENTS = [
    ('input', 'needle_steer/velocities', "topic of the program's velocities"),
    ('output', 'forward_velocity_controller/commands', 'topic of the controllers'),
    ('joints', '6', 'joints of the arm'),
    ('timeout_ms', '100', 'silence after which the arm is stopped'),
]


def program():
    """The wrapper: where the sources have it, or installed as `ros2 run` finds it."""
    sources = os.path.join(HERE, 'scripts', 'needle_steer')
    installed = os.path.join(HERE, '..', '..', 'lib', 'needle_steer', 'needle_steer')
    return sources if os.path.exists(sources) else os.path.normpath(installed)


def generate_launch_description():
    declared = [DeclareLaunchArgument(name, default_value=default, description=meaning)
                for name, default, meaning in ARGUMENTS]
    given = {name: LaunchConfiguration(name) for name, _, _ in ARGUMENTS}
    return LaunchDescription(declared + [
        ExecuteProcess(
            cmd=[program(), 'relay', '--ros2', '--input', given['input'], '--output',
                 given['output'], '--joints', given['joints'], '--timeout-ms',
                 given['timeout_ms']],
            output='screen', respawn=True),
    ])
