"""The hinges of a robot with the inertial sensors on either side, as far as a calibration can use them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from jointest_ros.core.errors import ConfigurationError, did_you_mean
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import rotate_inverse


@dataclass(frozen=True)
class Pair:
    """A joint and the sensors on its parent and its child."""

    joint: Joint
    parent: Sensor
    child: Sensor

    @property
    def sensors(self) -> tuple[Sensor, Sensor]:
        """Parent's and child's."""
        return self.parent, self.child

    @property
    def axis(self) -> FloatArray:
        """(3,) unit vector in the link frames, of a hinge."""
        return np.array(self.joint.axes[0])

    @property
    def link_axes(self) -> tuple[FloatArray, FloatArray]:
        """(3,) each: the axis that stands still in the parent, and the one that does in the child; a hinge has one."""
        return np.array(self.joint.axes[0]), np.array(self.joint.axes[-1])

    def configured(self) -> tuple[FloatArray, FloatArray]:
        """(3,) each: the axes of `link_axes` in both sensors by their mountings."""
        one, two = (
            np.array(rotate_inverse(sensor.mounting, axis))
            for sensor, axis in zip(self.sensors, (self.joint.axes[0], self.joint.axes[-1]), strict=True)
        )
        return one, two


def hinge_pairs(robot: Robot, chosen: Sequence[str] = (), most_axes: int = 1) -> tuple[list[Pair], list[str]]:
    """(the hinges that have an IMU on either side, why others are left out, one line each), in the order of the tree.

    Args:
        chosen: names of joints; none: all.
        most_axes: 2: joints of two axes too.

    Raises:
        ConfigurationError: one of `chosen` is unknown or cannot be used, or there is none that can.
    """
    names = [joint.name for joint in robot.joints]
    for name in chosen:
        if name not in names:
            hint = did_you_mean(name, names, f"known: {', '.join(names) or 'none'}")
            raise ConfigurationError(f"joint '{name}': unknown; {hint}")
    pairs, left_out = [], []
    for joint in robot.ordered_joints:
        if chosen and joint.name not in chosen:
            continue
        parent, child = (imu_on(robot, link) for link in (joint.parent, joint.child))
        if reasons := list(_reasons(joint, parent, child, most_axes)):
            left_out.append(f"joint '{joint.name}': {reasons[0]}")
        elif parent and child:
            pairs.append(Pair(joint, parent, child))
    if chosen and left_out:
        raise ConfigurationError(left_out[0])
    if not pairs:
        raise ConfigurationError(left_out[0] if left_out else "robot.joints: none")
    return pairs, left_out


def _reasons(joint: Joint, parent: Sensor | None, child: Sensor | None, most_axes: int) -> Iterator[str]:
    if len(joint.axes) > most_axes:
        which = "one axis" if most_axes == 1 else "one or two axes"
        yield f"it has {len(joint.axes)} axes; only joints of {which} can be calibrated"
    for link, sensor in ((joint.parent, parent), (joint.child, child)):
        if sensor is None:
            yield f"link '{link}' carries no sensor with gyro and accelerometer; one on either side is needed"


def imu_on(robot: Robot, link: str) -> Sensor | None:
    """The first sensor that the PCF would take too."""
    return next((sensor for sensor in robot.sensors_on(link) if sensor.gyro and sensor.accel), None)
