"""The arm's description, and its links on /tf."""
import os

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

HERE = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))


def default_urdf():
    """Installed beside the launch files, or where the sources have it."""
    installed = os.path.join(HERE, 'urdf', 'viper_s650.urdf')
    sources = os.path.join(HERE, '..', '..', '..', 'robots', 'urdf', 'viper_s650.urdf')
    return installed if os.path.exists(installed) else os.path.normpath(sources)


def publisher(context):
    with open(LaunchConfiguration('urdf').perform(context)) as file:
        description = file.read()
    return [Node(package='robot_state_publisher', executable='robot_state_publisher',
                 parameters=[{'robot_description': description, 'publish_frequency': 50.0}])]


def generate_launch_description():
    return LaunchDescription([
        DeclareLaunchArgument('urdf', default_value=default_urdf(), description="the arm's URDF"),
        OpaqueFunction(function=publisher),
    ])
