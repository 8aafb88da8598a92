"""`ros2 launch` itself, by launch_testing. These packages come with a ROS installation; there are no wheels of them."""

# ruff: noqa: E402 - imported once it is known that they are there
from __future__ import annotations

import unittest
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("launch_ros")
pytest.importorskip("launch_testing")
packages = pytest.importorskip("ament_index_python.packages")

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_testing import post_shutdown_test
from launch_testing.actions import ReadyToTest
from launch_testing.asserts import assertExitCodes
from listener import Listener
from tf2_msgs.msg import TFMessage

LAUNCH = Path(__file__).resolve().parents[2] / "launch"
ARGUMENTS = {"rviz": "false", "estimators": "kckf,gyro", "namespace": "rig"}

for package in ("jointest_ros", "robot_state_publisher", "tf2_ros"):
    try:
        packages.get_package_prefix(package)
    except packages.PackageNotFoundError:
        pytest.skip(f"{package} is in no sourced workspace", allow_module_level=True)


@pytest.mark.launch_test
def generate_test_description() -> LaunchDescription:
    """The exoshell without a window."""
    source = PythonLaunchDescriptionSource(str(LAUNCH / "exoshell.launch.py"))
    return LaunchDescription(
        [IncludeLaunchDescription(source, launch_arguments=ARGUMENTS.items()), ReadyToTest()],
    )


class TestExoshell(unittest.TestCase):
    """While it runs."""

    def test_estimates_truth_and_frames_are_published(self) -> None:
        listener, frames = Listener(), set()

        def note(message: TFMessage) -> None:
            frames.update(one.child_frame_id for one in message.transforms)

        try:
            listener.node.create_subscription(TFMessage, "/rig/tf", note, 100)
            heard = [listener.hear(f"/rig/{name}/joint_states") for name in ("kckf", "gyro", "ground_truth")]
            listener.until(lambda: all(len(states) > 100 for states in heard), "joint states")
            listener.until(lambda: {"link_5", "truth/link_5"} <= frames, "the frames of both robots")
        finally:
            listener.close()


@post_shutdown_test()
class TestEnd(unittest.TestCase):
    """After SIGINT to all."""

    def test_all_ended_well(self, proc_info: Any) -> None:
        assertExitCodes(proc_info)
