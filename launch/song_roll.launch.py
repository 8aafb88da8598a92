"""The rig of Song, raw_roll: `ros2 launch jointest_ros song_roll.launch.py bag:=BAG`; --show-args tells more."""

from launch import LaunchDescription

from jointest_ros.view.description import launch_description


def generate_launch_description() -> LaunchDescription:
    """Called by `ros2 launch`."""
    return launch_description("song_roll")
