"""`ros2 run jointest_ros hall_node --ros-args -p config:=robot.yaml`.

Joint angles from Hall sensors alone (a baseline).
"""

from __future__ import annotations

from jointest_ros.nodes.estimator_node import run


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable."""
    return run("hall", __doc__, args)


if __name__ == "__main__":
    raise SystemExit(main())
