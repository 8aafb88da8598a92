"""`ros2 run jointest_ros accel_ukf_node --ros-args -p config:=robot.yaml`.

Joint angles and link rates from two or more accelerometers on each link, by the paper's model in a UKF.
"""

from __future__ import annotations

from jointest_ros.nodes.estimator_node import run


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable."""
    return run("accel_ukf", __doc__, args)


if __name__ == "__main__":
    raise SystemExit(main())
