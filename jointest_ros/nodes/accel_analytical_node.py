"""`ros2 run jointest_ros accel_analytical_node --ros-args -p config:=robot.yaml`.

Joint angles from two or more accelerometers on each link, by the paper's equation (12) at every sample.
"""

from __future__ import annotations

from jointest_ros.nodes.estimator_node import run


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable."""
    return run("accel_analytical", __doc__, args)


if __name__ == "__main__":
    raise SystemExit(main())
