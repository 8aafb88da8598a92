"""What an estimator found out that holds beyond one run: sensor biases and zero poses, for a warm start.

Biases differ from one power-up to the next and drift with temperature. A value of an earlier run is therefore a prior
with the variance

    its own, when it was saved + the square of GYRO_DRIFT, ACCEL_DRIFT or HALL_DRIFT

which the filter then refines; never wider than the filter's own start without it. The figures are for consumer MEMS
parts and a temperature other by some 10 degrees: zero rates of the MPU-6050 move by up to .16, of the ICM-20948 by .05,
of the BMI270 by .015 deg/s for a degree; accelerometers by about .5 mg.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from jointest_ros.core.frame import Vec3

if TYPE_CHECKING:
    from jointest_ros.core.robot import Robot

GYRO_DRIFT = math.radians(0.3)  # rad/s, of one gyro axis
ACCEL_DRIFT = 0.05  # m/s^2
HALL_DRIFT = 0.01  # V

Bias = tuple[float, float]  # value, standard deviation


@dataclass(frozen=True)
class Learned:
    """What one estimator found out.

    Attributes:
        robot: `fingerprint` of the robot that it holds for.
        biases: by the estimator's own names: rad/s of gyros, V of Hall sensors, m/s^2 of accelerometers.
        zero: joint -> zero pose by the estimator's own numbers; none where none was taken.
        saved: when.
    """

    robot: str
    biases: Mapping[str, Bias]
    zero: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    saved: str = ""


def fingerprint(robot: Robot) -> str:
    """The same text as long as links, joints, mountings and calibrations of sensors are: what biases and zeros rest on.

    Noise, topics and limits do not count.
    """
    joints = [(j.name, j.parent, j.child, _short(*j.axes)) for j in robot.joints]
    sensors = [
        (s.name, s.link, _short(s.mounting, *s.accel_matrix, s.accel_offset, s.gyro_scale)) for s in robot.sensors
    ]
    hall = [(h.joint, h.mirrored, repr(h.curve), h.offset) for h in robot.hall]
    return "robot-" + hashlib.sha256(repr((robot.world, joints, sensors, hall)).encode()).hexdigest()[:12]


def by_axis(name: str, vector: Vec3, deviation: float) -> dict[str, Bias]:
    """The biases `<name>.x`, `.y`, `.z` of one sensor, with a standard deviation in common."""
    return {f"{name}.{axis}": (value, deviation) for axis, value in zip("xyz", vector, strict=True)}


def of_axes(name: str, biases: Mapping[str, Bias]) -> Vec3:
    """The way back from `by_axis`."""
    return biases[f"{name}.x"][0], biases[f"{name}.y"][0], biases[f"{name}.z"][0]


def _short(*vectors: tuple[float, ...]) -> str:
    """Without the last digits, in which processors differ."""
    return " ".join(f"{value + 0.0:.9f}" for vector in vectors for value in vector)
