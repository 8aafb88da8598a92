"""Scales of gyros from motion about hinges and gravity: no encoder, no turntable.

Each hinge tells of the gyros on either side (gyro_problem.py), and two hinges that share a sensor both tell of its
scale: all are put together. What a motion does not tell stays as it was: the scale of an axis that is not that of a
hinge, or of a link that does not turn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import Sensor
from jointest_ros.evaluation.gyro_problem import PRIOR, GyroProblem
from jointest_ros.evaluation.hinge_equations import enough_data
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.joint_pairs import Pair

KNOWN = 0.01  # standard deviation of a scale that is worth writing down
_ALONG = 0.9  # of a hinge; what shows through the other axes of the gyro hangs on the mountings
LEAST_TRAVEL = math.radians(30.0)  # of a joint, from one end to the other
_MOST = 40_000  # windows
_FEWEST = 100
_GRAVITY_CONE = math.radians(10.0)


@dataclass(frozen=True)
class Scale:
    """What was found of one axis of a gyro: true rate = `scale` times reading.

    Attributes:
        std: standard deviation of `scale`.
        hinge: share of the hinge's axis that lies along this one, 0 to 1 (of the hinge where it is largest).
    """

    sensor: str
    axis: int
    scale: float
    std: float
    hinge: float

    @property
    def known(self) -> bool:
        """It is worth writing down."""
        return self.std < KNOWN and self.hinge > _ALONG

    @property
    def corrected(self) -> float:
        """The scale to use: 1 where the error that was found is not more than its standard deviation."""
        return self.scale if abs(self.scale - 1.0) > self.std else 1.0


@dataclass(frozen=True)
class HingeInformation:
    """What one hinge tells of the scales of its two gyros, parent's x, y, z, then child's.

    Attributes:
        matrix, vector: (6, 6), (6,) information matrix, and the same times the errors of the scales.
        travel: of the joint, rad, from one end to the other, outliers left out.
        turned: rms of what each sensor turned about the axis within 5 s, rad.
        tilt: median angle between axis and gravity, rad.
        residual: scatter of what is left over, m/s^2.
    """

    pair: Pair
    matrix: FloatArray
    vector: FloatArray
    travel: float
    turned: tuple[float, float]
    tilt: float
    residual: float


def hinge_information(means: WindowMeans, pair: Pair) -> HingeInformation:
    """Fit one hinge.

    Args:
        means: of the recording, uncalibrated gyros; both sensors of the pair are among its `given`.

    Raises:
        CalibrationError: the sensors gave too little together.
    """
    problem = GyroProblem(enough_data(means, pair, _FEWEST).part(_MOST), pair, means.length)
    parameters = problem.solve()
    matrix, vector = problem.information(parameters)
    return HingeInformation(pair, matrix, vector, *problem.motion(parameters), problem.scatter)


def combine(hinges: Sequence[HingeInformation]) -> list[Scale]:
    """The scales of all axes of the sensors of these hinges; what no hinge tells is 1 with the prior's spread."""
    sensors = list(dict.fromkeys(sensor.name for hinge in hinges for sensor in hinge.pair.sensors))
    matrix, vector = np.eye(3 * len(sensors)) / PRIOR**2, np.zeros(3 * len(sensors))
    along = np.zeros(3 * len(sensors))
    for hinge in hinges:
        rows = np.concatenate([3 * sensors.index(sensor.name) + np.arange(3) for sensor in hinge.pair.sensors])
        matrix[np.ix_(rows, rows)] += hinge.matrix
        vector[rows] += hinge.vector
        along[rows] = np.maximum(along[rows], abs(np.concatenate(hinge.pair.configured())))
    covariance = np.linalg.inv(matrix)
    errors, stds = (covariance @ vector).tolist(), np.sqrt(np.diag(covariance)).tolist()
    return [Scale(sensors[k // 3], k % 3, 1.0 + errors[k], stds[k], float(along[k])) for k in range(3 * len(sensors))]


def calibrated(sensors: Sequence[Sensor], scales: Sequence[Scale]) -> list[Sensor]:
    """Those of the sensors of which an axis is known, with its scale; their other axes keep theirs."""
    result = []
    for sensor in sensors:
        known = {one.axis: one.corrected for one in scales if one.sensor == sensor.name and one.known}
        if known:
            x, y, z = (known.get(axis, before) for axis, before in enumerate(sensor.gyro_scale))
            result.append(replace(sensor, gyro_scale=(x, y, z)))
    return result


def why_unknown(sensor: str, scales: Sequence[Scale], hinges: Sequence[HingeInformation]) -> str:
    """Why no axis of this gyro is known: what is to be done."""
    mine = [(hinge, hinge.turned[k]) for hinge in hinges for k, s in enumerate(hinge.pair.sensors) if s.name == sensor]
    turned = max(angle for _, angle in mine)
    if 2.0 * math.sqrt(2.0) * turned < LEAST_TRAVEL:  # peak to peak of a sine
        return "its link hardly turns about the axis of a hinge; turn it to and fro by 90 deg and more"
    if all(hinge.travel < LEAST_TRAVEL for hinge, _ in mine):
        return (
            f"its joints move by {math.degrees(max(hinge.travel for hinge, _ in mine)):.0f} deg only; "
            "move them by 90 deg and more"
        )
    if all(hinge.tilt < _GRAVITY_CONE for hinge, _ in mine):
        return "the axis is near gravity, where accelerometers tell nothing; tilt the robot"
    best = max((one for one in scales if one.sensor == sensor), key=lambda one: one.hinge)
    if best.hinge < _ALONG:
        return "no hinge is along one of its axes, so that none of the three can be told from the others"
    return f"the motion tells it to {best.std:.1%} only; move its joints further, and for longer"
