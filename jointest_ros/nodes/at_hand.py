"""What is said where ROS 2 is not installed. Needs no ROS itself."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from jointest_ros.core.errors import JointestError


class NoRosError(JointestError):
    """rclpy, or a package of messages, is not there."""


@contextmanager
def ros_at_hand() -> Iterator[None]:
    """Around the import of what uses ROS 2.

    Raises:
        NoRosError: it is not there.
    """
    try:
        yield
    except ImportError as error:
        if (error.name or "").startswith("jointest_ros"):
            raise  # a fault of ours
        raise NoRosError(
            f"ROS 2 is not at hand ({error}): source your ROS 2 installation, or pip install 'jointest_ros[ros]'"
        ) from None
