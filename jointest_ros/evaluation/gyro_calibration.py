"""Scales of gyros from motion about hinges and gravity: no encoder, no turntable.

A gyro that reads too little lets the angle of its joint fall behind what the accelerometers show:

    f1 = exp(i q) f2                                f: specific force across the axis, as a complex number
    q = q0 + j2 . (S2 T2) - j1 . (S1 T1) - b t      T integrals of the gyros, S = diag(scale), j the axis in each sensor
    f = p - offset - skew conj(p) - arm             p the accelerometer; offset, skew and arm of each sensor are unknown

1 is the parent's sensor, 2 the child's; q0 is free every 5 s and b every minute, so that no drift matters. The errors
of the accelerometers are in it because they look like a wrong scale where a joint moves by less than half a turn: an
offset of 30 mg shifts the angle by 1.7 deg from one end to the other. Where the circle that p2 moves on is long enough,
they are found; where it is not, the uncertainty of the scale says so.

Robust least squares for each hinge, then all hinges together: two that share a sensor both tell its scale. What a
motion does not tell stays 1: the scale of an axis that is not that of a hinge, or of a link that does not turn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.robot import STANDARD_GRAVITY
from jointest_ros.core.rotation import rotate_inverse
from jointest_ros.evaluation.hinge_equations import HingeData, frame_of, hinge_data
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.joint_pairs import Pair

PRIOR = 0.03  # of a scale: what data sheets allow (MPU6050: 3 %)
KNOWN = 0.005  # standard deviation of a scale that is worth writing down
LEAST_TRAVEL = math.radians(30.0)  # of a joint, from one end to the other
_OFFSET = 0.3  # m/s^2, 30 mg
_SKEW = 0.02  # of an accelerometer's scales and axes
_ARM = 0.1  # m, about the configured place
_BIAS = math.radians(5.0)  # rad/s
_BIAS_TIME = 60.0  # s
_MOST = 40_000  # windows
_FEWEST = 100
_ROUNDS = 12
_SETTLED = 1e-6
_OUTLIER = 2.0  # standard deviations
_GRAVITY_CONE = math.radians(10.0)
_SCALES = slice(0, 6)  # of the parent's x, y, z, then of the child's

ComplexArray = NDArray[np.complex128]


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
        return self.std < KNOWN


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
    data = hinge_data(means, pair.parent.name, pair.child.name).part(_MOST)
    if len(data) < _FEWEST:
        raise CalibrationError(
            f"'{pair.parent.name}' and '{pair.child.name}' gave readings together for {len(data) * means.length:.1f} s; "
            f"at least {_FEWEST * means.length:.0f} s are needed"
        )
    problem = _Problem(data, pair, math.hypot(pair.parent.accel_noise, pair.child.accel_noise) / means.length**0.5)
    parameters = problem.solve()
    matrix, vector = problem.information(parameters)
    return HingeInformation(pair, matrix, vector, *problem.motion(parameters), problem.scatter)


def combine(hinges: Sequence[HingeInformation]) -> list[Scale]:
    """The scales of all axes of the sensors of these hinges; those that no hinge tells are 1 with the prior's spread."""
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


def found(scales: Sequence[Scale]) -> dict[str, Vec3]:
    """Sensor -> scale of x, y, z, for sensors of which an axis is known; axes that are not known are 1."""
    table: dict[str, list[float]] = {}
    for one in scales:
        if one.known:
            table.setdefault(one.sensor, [1.0, 1.0, 1.0])[one.axis] = one.scale
    return {sensor: (x, y, z) for sensor, (x, y, z) in table.items()}


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
    best = min((one for one in scales if one.sensor == sensor), key=lambda one: one.std)
    if best.hinge < 0.9:
        return "no hinge is along one of its axes, so that none of the three can be told from the others"
    return f"the motion tells it to {best.std:.1%} only; move its joints further, and for longer"


class _Problem:
    """The least squares of one hinge: parameters are scale errors (6), accelerometer errors (9), arms (6), biases."""

    def __init__(self, data: HingeData, pair: Pair, least_scatter: float) -> None:
        self._data, self._axes = data, tuple(frame_of(axis) for axis in pair.configured())
        self._p1, self._p2 = (_flat(f, a) for f, a in zip(self._axes, data.accel, strict=True))
        arms = np.array(pair.parent.position) - np.array(pair.joint.origin), np.array(pair.child.position)
        places = (rotate_inverse(s.mounting, tuple(r.tolist())) for s, r in zip(pair.sensors, arms, strict=True))
        minute = np.unique((data.time // _BIAS_TIME).astype(int), return_inverse=True)[1]
        self._bias_rows = (minute[:, None] == np.arange(minute.max() + 1)) * data.elapsed[:, None]
        self._begin = np.flatnonzero(np.append(True, np.diff(data.stretch) > 0))
        biases = self._bias_rows.shape[1]
        self._prior = np.concatenate([np.zeros(15), *map(np.array, places), np.zeros(biases)])
        stds = ((PRIOR, 6), (_OFFSET, 4), (_SKEW, 5), (_ARM, 6), (_BIAS, biases))
        self._prior_information = np.diag(np.concatenate([np.full(count, std**-2) for std, count in stds]))
        self._least_scatter = max(least_scatter, 1e-9)
        self.scatter = math.inf

    def solve(self) -> FloatArray:
        """Gauss-Newton, the scatter and the weights of outliers renewed in every round."""
        p = self._prior.copy()
        for _ in range(_ROUNDS):
            residual, columns, weights = self._linear(p)
            matrix = self._prior_information + (columns * weights) @ columns.T
            step = np.linalg.solve(matrix, self._prior_information @ (self._prior - p) - (columns * weights) @ residual)
            p = p + step
            if abs(step[_SCALES]).max() < _SETTLED:
                break
        return p

    def information(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Matrix and vector of the scales alone, all else eliminated.

        Less than the residuals' scatter alone would give: what follows the motion does not average out over a stretch
        as noise does, so that the scores of whole stretches are compared with what white noise would make of them.
        """
        residual, columns, weights = self._linear(p)
        matrix = (columns * weights) @ columns.T
        others = slice(_SCALES.stop, None)
        eliminating = np.linalg.solve(
            matrix[others, others] + self._prior_information[others, others], matrix[others, _SCALES]
        ).T
        scales = matrix[_SCALES, _SCALES] - eliminating @ matrix[others, _SCALES]
        own = (columns[_SCALES] - eliminating @ columns[others]) * (weights * residual)
        scores = np.add.reduceat(own[:, : len(self._data)] + own[:, len(self._data) :], self._begin, axis=1)
        told = np.diag(scales) > PRIOR**-2
        inflation = max(1.0, *((scores**2).sum(axis=1)[told] / np.diag(scales)[told]))
        vector = (scales + self._prior_information[_SCALES, _SCALES]) @ p[_SCALES]
        return scales / inflation, vector / inflation

    def motion(self, p: FloatArray) -> tuple[float, tuple[float, float], float]:
        """(travel, turned by parent and child, tilt) of `HingeInformation`."""
        turn = np.unwrap(np.angle(self._turn(p)))
        low, high = np.quantile(turn, (0.02, 0.98))
        one, two = (
            float(np.std(t @ axes[2] - np.mean(t @ axes[2])))
            for t, axes in zip(self._data.turned, self._axes, strict=True)
        )
        tilt = math.asin(min(1.0, float(np.median(abs(self._p2))) / STANDARD_GRAVITY))
        return float(high - low), (one, two), tilt

    def _turn(self, p: FloatArray) -> ComplexArray:
        """(n,) exp(i q) with the best q0 in every stretch."""
        (one, two), (axes1, axes2) = self._data.turned, self._axes
        angle = two @ (axes2[2] * (1.0 + p[3:6])) - one @ (axes1[2] * (1.0 + p[:3])) - self._bias_rows @ p[21:]
        turn = np.exp(1j * angle)
        f1, f2 = self._forces(p)
        products = f1 * np.conj(turn * f2)
        weights = 1.0 / np.hypot(1.0, abs(f1 - turn * np.exp(1j * self._phase(products)) * f2) / self.scatter)
        return np.asarray(turn * np.exp(1j * self._phase(weights * products)))

    def _phase(self, products: ComplexArray) -> FloatArray:
        return np.asarray(np.angle(np.add.reduceat(products, self._begin))[self._data.stretch])

    def _forces(self, p: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """f of parent and child; p[6:15]: offsets, skews, and how much more the child's accelerometer reads."""
        offset1, offset2, skew1, skew2 = p[6:14:2] + 1j * p[7:14:2]
        arm1, arm2 = (
            _flat(f, g @ r) for f, g, r in zip(self._axes, self._data.arms, (p[15:18], p[18:21]), strict=True)
        )
        return (
            self._p1 - offset1 - skew1 * np.conj(self._p1) - arm1,
            (1.0 + p[14]) * self._p2 - offset2 - skew2 * np.conj(self._p2) - arm2,
        )

    def _linear(self, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals (2 n,), their derivatives (P, 2 n), and weights (2 n,); q0 follows the parameters."""
        data, (axes1, axes2) = self._data, self._axes
        turn = self._turn(p)
        f1, f2 = self._forces(p)
        residual = f1 - turn * f2
        self.scatter = max(1.4826 * float(np.median(abs(np.append(residual.real, residual.imag)))), self._least_scatter)
        weights = 1.0 / (self.scatter**2 * np.hypot(1.0, abs(residual) / (_OUTLIER * self.scatter)))
        by_q = -1j * turn * f2
        both = np.array([[1.0], [1j]])
        columns = np.vstack(
            [
                -by_q * (data.turned[0] * axes1[2]).T,
                by_q * (data.turned[1] * axes2[2]).T,
                -both * np.ones(len(data)),
                both * turn,
                -both * np.conj(self._p1),
                both * turn * np.conj(self._p2),
                -turn * self._p2,
                -((axes1[0] + 1j * axes1[1]) @ data.arms[0]).T,
                turn * ((axes2[0] + 1j * axes2[1]) @ data.arms[1]).T,
                -by_q * self._bias_rows.T,
            ]
        )
        shares = np.add.reduceat(weights * (np.conj(by_q) * columns).real, self._begin, axis=1)
        shares /= np.add.reduceat(weights * abs(by_q) ** 2, self._begin)
        columns -= by_q * shares[:, data.stretch]
        return _both(residual), _both(columns), np.tile(weights, 2)


def _flat(frame: FloatArray, vectors: FloatArray) -> ComplexArray:
    """(n,) the components u + i v of (n, 3) vectors, `frame` with rows u, v, j."""
    return np.asarray(vectors @ (frame[0] + 1j * frame[1]))


def _both(values: ComplexArray) -> FloatArray:
    return np.concatenate([values.real, values.imag], axis=-1)
