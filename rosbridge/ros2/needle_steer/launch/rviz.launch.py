"""rviz2 with the displays of needle steering."""
import os

from launch import LaunchDescription
from launch_ros.actions import Node

HERE = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))


def generate_launch_description():
    displays = os.path.join(HERE, 'rviz', 'needle_steer.rviz')
    return LaunchDescription([
        Node(package='rviz2', executable='rviz2', name='rviz', arguments=['-d', displays]),
    ])
