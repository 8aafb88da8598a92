"""The least squares of one hinge: what motion and gravity tell of the scales of its two gyros.

A gyro that reads too little lets the angle of its joint fall behind what the accelerometers show:

    f1 = exp(i q) f2                                f: specific force across the axis, as a complex number
    q = q0 + j2 . (S2 T2) - j1 . (S1 T1) - b t      T integrals of the gyros, S = diag(scale), j the axis in each sensor
    f = p - offset - skew conj(p) - arm             p the accelerometer; offset, skew and arm of each sensor are unknown

1 is the parent's sensor, 2 the child's; q0 is free every 5 s and b every minute, so that no drift matters. The errors
of the accelerometers are in it because they look like a wrong scale where a joint moves by less than a whole turn: an
offset of 30 mg shifts the angle by up to 3.4 deg from one end to the other. The circles on which p1 and p2 move show
them, the better the longer they are; as far as they do not, the uncertainty of the scale says so.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import STANDARD_GRAVITY
from jointest_ros.core.rotation import rotate_inverse
from jointest_ros.evaluation.hinge_equations import HingeData, frame_of
from jointest_ros.evaluation.joint_pairs import Pair

PRIOR = 0.03  # of a scale: what data sheets allow (MPU6050: 3 %)
# Standard deviations of an accelerometer's errors: offset, m/s^2, and those of scales and axes; the same calibrated.
_OFFSET, _CALIBRATED_OFFSET = 0.3, 0.03
_SKEW, _CALIBRATED_SKEW = 0.02, 0.003
# What the model leaves out (nonlinear accelerometers, play), m/s^2. It is the same in the same pose: thousands of
# windows in one cell of this many rad tell no more of it than one. Most of it is taken up by the parameters (by the
# scale too); what is left over in the means of the cells, times this factor, stands for it.
_LEAST_SYSTEMATIC, _FIRST_SYSTEMATIC, _TAKEN_UP = 0.01, 0.05, 4.0
_CELL = math.radians(15.0)
_CELL_LEAST = 20  # windows in a cell whose mean counts
_SMOOTH = 1.0  # s
_ARM = 0.1  # m, about the configured place
_LAG = 0.01  # s, of the accelerometers behind the gyros
_BIAS = math.radians(5.0)  # rad/s
_BIAS_TIME = 60.0  # s
_ROUNDS = 12
_SETTLED = 1e-6
_OUTLIER = 2.0  # standard deviations
_SCALES = slice(0, 6)  # of the parent's x, y, z, then of the child's

ComplexArray = NDArray[np.complex128]


class GyroProblem:
    """The least squares of one hinge.

    Parameters: scale errors (0 to 5), accelerometer errors (6 to 14), lag (15), arms (16 to 21), a bias a minute.
    """

    def __init__(self, data: HingeData, pair: Pair, length: float) -> None:
        self._data, self._axes = data, tuple(frame_of(axis) for axis in pair.configured())
        rates = [w @ axes[2] for w, axes in zip(data.gyro, self._axes, strict=True)]
        self._joint_rate = rates[1] - rates[0]
        self._p1, self._p2 = (  # the mean of a vector that turns is shorter than it
            _flat(axes, accel) / np.sinc(rate * length / (2.0 * math.pi))
            for axes, accel, rate in zip(self._axes, data.accel, rates, strict=True)
        )
        # What errors depend on must not bear the noise itself: they would be chosen so as to cancel it.
        self._mean1, self._mean2 = (
            self._smooth(p, turned @ axes[2])
            for axes, p, turned in zip(self._axes, (self._p1, self._p2), data.turned, strict=True)
        )
        cells = np.column_stack([np.angle(p) // _CELL for p in (self._mean1, self._mean2)])
        _, cell, self._count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        self._cell = cell.ravel()
        self._begin = np.flatnonzero(np.append(True, np.diff(data.stretch) > 0))
        minute = np.unique(data.time // _BIAS_TIME, return_inverse=True)[1]
        self._bias_rows = (minute[:, None] == np.arange(minute.max() + 1)) * data.elapsed[:, None]
        offsets, skews = np.array(
            [(_CALIBRATED_OFFSET, _CALIBRATED_SKEW) if s.accel_calibrated else (_OFFSET, _SKEW) for s in pair.sensors]
        ).T
        stds = (np.full(6, PRIOR), offsets.repeat(2), skews.repeat(2), [np.hypot(*skews), _LAG], np.full(6, _ARM))
        biases = self._bias_rows.shape[1]
        self._information = np.diag(np.concatenate([*stds, np.full(biases, _BIAS)]) ** -2.0)
        arms = np.array(pair.parent.position) - np.array(pair.joint.origin), np.array(pair.child.position)
        places = (rotate_inverse(s.mounting, tuple(r.tolist())) for s, r in zip(pair.sensors, arms, strict=True))
        self._prior = np.concatenate([np.zeros(16), *map(np.array, places), np.zeros(biases)])
        noise = math.hypot(pair.parent.accel_noise, pair.child.accel_noise) / math.sqrt(length)
        self._least_scatter = max(noise, 1e-9)
        self.scatter, self.systematic = math.inf, _FIRST_SYSTEMATIC

    def solve(self) -> FloatArray:
        """Gauss-Newton, the scatter and the weights of outliers renewed in every round."""
        p = self._prior.copy()
        for _ in range(_ROUNDS):
            residual, columns, weights = self._linear(p)
            matrix = self._information + (columns * weights) @ columns.T
            step = np.linalg.solve(matrix, self._information @ (self._prior - p) - (columns * weights) @ residual)
            p = p + step
            self.systematic = self._left_over(residual)
            if abs(step[_SCALES]).max() < _SETTLED:
                break
        return p

    def information(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Matrix and vector of the scales alone, all else eliminated."""
        _, columns, weights = self._linear(p)
        matrix = (columns * weights) @ columns.T
        others = slice(_SCALES.stop, None)
        eliminated = np.linalg.solve(
            matrix[others, others] + self._information[others, others], matrix[others, _SCALES]
        )
        scales = matrix[_SCALES, _SCALES] - matrix[_SCALES, others] @ eliminated
        return scales, (scales + self._information[_SCALES, _SCALES]) @ p[_SCALES]

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

    def _smooth(self, p: ComplexArray, angle: FloatArray) -> ComplexArray:
        """(n,) accelerometer with the noise of the mean over a second, carried along by the gyro."""
        _, block = np.unique(self._data.stretch * 1000 + self._data.elapsed // _SMOOTH, return_inverse=True)
        carried, count = p * np.exp(1j * angle), np.bincount(block)
        mean = (np.bincount(block, carried.real) + 1j * np.bincount(block, carried.imag)) / count
        return np.asarray(mean[block] * np.exp(-1j * angle))

    def _left_over(self, residual: FloatArray) -> float:
        """What is left over in the mean of a cell, m/s^2, noise taken off."""
        x, y = (np.bincount(self._cell, part) / self._count for part in residual.reshape(2, -1))
        excess = (0.5 * (x**2 + y**2) - self.scatter**2 / self._count)[self._count >= _CELL_LEAST]
        if not len(excess):
            return _FIRST_SYSTEMATIC
        return max(_TAKEN_UP * math.sqrt(max(float(np.mean(excess)), 0.0)), _LEAST_SYSTEMATIC)

    def _turn(self, p: FloatArray) -> ComplexArray:
        """(n,) exp(i q) with the best q0 in every stretch."""
        (one, two), (axes1, axes2) = self._data.turned, self._axes
        angle = (
            two @ (axes2[2] * (1.0 + p[3:6]))
            - one @ (axes1[2] * (1.0 + p[:3]))
            - self._bias_rows @ p[22:]
            + self._joint_rate * p[15]
        )
        turn = np.exp(1j * angle)
        f1, f2 = self._forces(p)
        products = f1 * np.conj(turn * f2)
        weights = 1.0 / np.hypot(1.0, abs(f1 - turn * np.exp(1j * self._phase(products)) * f2) / self.scatter)
        return np.asarray(turn * np.exp(1j * self._phase(weights * products)))

    def _phase(self, products: ComplexArray) -> FloatArray:
        return np.asarray(np.angle(np.add.reduceat(products, self._begin))[self._data.stretch])

    def _forces(self, p: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """f of parent and child; p[6:15]: offsets, skews, and how much less the parent's accelerometer reads."""
        offset1, offset2, skew1, skew2 = p[6:14:2] + 1j * p[7:14:2]
        arm1, arm2 = (
            _flat(f, g @ r) for f, g, r in zip(self._axes, self._data.arms, (p[16:19], p[19:22]), strict=True)
        )
        return (
            self._p1 + p[14] * self._mean1 - offset1 - skew1 * np.conj(self._mean1) - arm1,
            self._p2 - offset2 - skew2 * np.conj(self._mean2) - arm2,
        )

    def _linear(self, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals (2 n,), their derivatives (P, 2 n), and weights (2 n,); q0 follows the parameters."""
        data, (axes1, axes2) = self._data, self._axes
        turn = self._turn(p)
        f1, f2 = self._forces(p)
        residual = f1 - turn * f2
        self.scatter = max(1.4826 * float(np.median(abs(np.append(residual.real, residual.imag)))), self._least_scatter)
        outlying = np.hypot(1.0, abs(residual) / (_OUTLIER * self.scatter))
        weights = 1.0 / (self.scatter**2 * outlying + self.systematic**2 * self._count[self._cell])
        by_q = -1j * turn * f2
        both = np.array([[1.0], [1j]])
        columns = np.vstack(
            [
                -by_q * (data.turned[0] * axes1[2]).T,
                by_q * (data.turned[1] * axes2[2]).T,
                -both * np.ones(len(data)),
                both * turn,
                -both * np.conj(self._mean1),
                both * turn * np.conj(self._mean2),
                self._mean1,
                by_q * self._joint_rate[None],
                -((axes1[0] + 1j * axes1[1]) @ data.arms[0]).T,
                turn * ((axes2[0] + 1j * axes2[1]) @ data.arms[1]).T,
                -by_q * self._bias_rows.T,
            ]
        )
        shares = np.add.reduceat(weights * (np.conj(by_q) * columns).real, self._begin, axis=1)
        shares /= np.maximum(np.add.reduceat(weights * abs(by_q) ** 2, self._begin), np.finfo(float).tiny)
        columns -= by_q * shares[:, data.stretch]
        return _both(residual), _both(columns), np.tile(weights, 2)


def _flat(frame: FloatArray, vectors: FloatArray) -> ComplexArray:
    """(n,) the components u + i v of (n, 3) vectors, `frame` with rows u, v, j."""
    return np.asarray(vectors @ (frame[0] + 1j * frame[1]))


def _both(values: ComplexArray) -> FloatArray:
    return np.concatenate([values.real, values.imag], axis=-1)
