"""One's own robot: `ros2 launch jointest_ros robot.launch.py config:=robot.yaml`; `--show-args` lists the arguments."""

from launch import LaunchDescription

from jointest_ros.view.description import launch_description


def generate_launch_description() -> LaunchDescription:
    """Called by `ros2 launch`."""
    return launch_description("robot")
