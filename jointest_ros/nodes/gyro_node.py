"""`ros2 run jointest_ros gyro_node --ros-args -p config:=robot.yaml`.

Joint angles by integrating link gyros (a baseline).
"""

from __future__ import annotations

from jointest_ros.nodes.estimator_node import run


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable."""
    return run("gyro", __doc__, args)


if __name__ == "__main__":
    raise SystemExit(main())
