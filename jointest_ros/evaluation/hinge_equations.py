"""What two inertial sensors measure when a hinge joins their links: the equations by which its axis is identified.

Unknown are the unit vectors j1, j2 of the axis in the parent's and the child's sensor. With (u, v, j) right-handed,
z = (u + i v) . W the part of a gyro W across the axis, p the same of an accelerometer a, and q the joint's angle:

    z1 = exp(i q) z2                    one motion, seen from both sides; |W1 x j1| = |W2 x j2| is its absolute value
    j1 . f1 = j2 . f2                   f = a - G r: at the joint, G = [dW/dt]x + [W]x [W]x, r from joint to sensor
    p1 = exp(i q) p2                    gravity; it is what tells q where the parent does not turn
    q = q0 + integral of j2 . W2 - j1 . W1

The first line is used as it stands, not only its absolute value (Seel, Schauer, Raisch 2012): its phase holds as much
as its length, and it stays informative where links turn about the axis alone. q0 is free in every stretch of a few
seconds and solved for in closed form, so that no drift matters. Gyro biases, lever arms r and the difference of the
accelerometer biases along the axis are unknown as well, about what is known of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.frame import FloatArray, vec3
from jointest_ros.core.rotation import perpendicular
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.joint_pairs import Pair

TILT_1, TILT_2 = slice(0, 2), slice(2, 4)  # rad, of the axis about u and v of its start
BIAS_1, BIAS_2 = slice(4, 7), slice(7, 10)  # rad/s
ARM_1, ARM_2 = slice(10, 13), slice(13, 16)  # m
OFFSET = 16  # m/s^2
PARAMETERS = 17

STRETCH = 5.0  # s
_SHORTEST = 10  # windows
_ACCEL_BIAS = 0.3  # m/s^2: 30 mg; it is the same throughout a stretch
_TWICE = 2  # solutions for q0: the second one with less weight for what does not fit the first
_OUTLIER = 3.0  # sigma

Frames = tuple[FloatArray, FloatArray]  # (3, 3) each: rows u, v, j in the parent's and in the child's sensor


@dataclass(frozen=True)
class Scatter:
    """Standard deviation of the difference of two window means: of the gyros, rad/s, and of the accelerometers."""

    gyro: float
    accel: float


@dataclass(frozen=True)
class HingeData:
    """n windows of a pair of sensors in which both gave everything.

    Attributes:
        time: (n,) s, since the first stamp of the recording.
        gyro, accel: ((n, 3), (n, 3)) of parent and child, rad/s and m/s^2.
        beside: ((n, 3), (n, 3)) rad/s, mean gyros of the windows before and after: nearly the rates, with other noise.
        turned: integrals of the gyros since the start of the stretch, rad; `elapsed` (n,) s since then.
        arms: ((n, 3, 3), (n, 3, 3)) the matrices G.
        stretch: (n,) number of the stretch.
        windows: in a whole stretch.
    """

    time: FloatArray
    gyro: tuple[FloatArray, FloatArray]
    accel: tuple[FloatArray, FloatArray]
    beside: tuple[FloatArray, FloatArray]
    turned: tuple[FloatArray, FloatArray]
    elapsed: FloatArray
    arms: tuple[FloatArray, FloatArray]
    stretch: NDArray[np.intp]
    windows: int

    def __len__(self) -> int:
        return len(self.elapsed)

    def part(self, most: int) -> HingeData:
        """At most so many of the windows, evenly chosen."""
        return self.rows(slice(None, None, max(1, math.ceil(len(self) / most))))

    def rows(self, rows: slice | NDArray[np.bool_]) -> HingeData:
        """Some of the windows."""

        def of(pair: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
            return pair[0][rows], pair[1][rows]

        numbers = np.unique(self.stretch[rows], return_inverse=True)[1]
        return HingeData(
            self.time[rows],
            of(self.gyro),
            of(self.accel),
            of(self.beside),
            of(self.turned),
            self.elapsed[rows],
            of(self.arms),
            numbers,
            self.windows,
        )


def hinge_data(means: WindowMeans, parent: str, child: str) -> HingeData:
    """The windows in which both sensors gave everything, in stretches without a gap."""
    length = means.length
    gyro, accel = (means.gyro[parent], means.gyro[child]), (means.accel[parent], means.accel[child])
    whole = np.isfinite(np.hstack([*gyro, *accel])).all(axis=1)
    start = means.start[whole]
    broken = np.append(True, np.diff(start) != round(length * 1e9))[: len(start)]
    run = np.cumsum(broken) - 1
    first = np.flatnonzero(broken)
    place = np.arange(len(start)) - first[run] if len(start) else run
    windows = max(_SHORTEST, round(STRETCH / length))
    label = run * (len(start) + 1) + place // windows
    numbers, count = np.unique(label, return_inverse=True, return_counts=True)[1:]
    kept = count[numbers] >= _SHORTEST
    numbers = np.unique(numbers[kept], return_inverse=True)[1]
    place = (place % windows)[kept]

    def rows(pair: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
        return pair[0][whole][kept], pair[1][whole][kept]

    rates, forces = rows(gyro), rows(accel)
    begin = np.flatnonzero(place == 0)
    return HingeData(
        np.asarray((start[kept] - means.first) * 1e-9, dtype=np.float64),
        rates,
        forces,
        (_beside(rates[0], begin), _beside(rates[1], begin)),
        (_integral(rates[0], length, begin, numbers), _integral(rates[1], length, begin, numbers)),
        place * length,
        (_arm(rates[0], length, begin), _arm(rates[1], length, begin)),
        numbers,
        windows,
    )


def enough_data(means: WindowMeans, pair: Pair, fewest: int) -> HingeData:
    """`hinge_data` of a pair. Raises CalibrationError where these are fewer windows."""
    one, two = (sensor.name for sensor in pair.sensors)
    data = hinge_data(means, one, two)
    if len(data) < fewest:
        raise CalibrationError(
            f"'{one}' and '{two}' gave readings together for {len(data) * means.length:.1f} s; "
            f"at least {fewest * means.length:.0f} s are needed"
        )
    return data


def _integral(rate: FloatArray, length: float, begin: NDArray[np.intp], stretch: NDArray[np.intp]) -> FloatArray:
    """(n, 3) rad, to the middle of each window, from the middle of the first one of its stretch."""
    middle = (np.cumsum(rate, axis=0) - 0.5 * rate) * length
    return np.asarray(middle - middle[begin][stretch])


def _beside(rate: FloatArray, begin: NDArray[np.intp]) -> FloatArray:
    """(n, 3) mean of the rows before and after; at the ends of a stretch there is but one."""
    rows, last = np.arange(len(rate)), np.append(begin[1:], len(rate)) - 1
    before, after = np.maximum(rows - 1, 0), np.minimum(rows + 1, len(rate) - 1)
    before[begin], after[last] = begin + 1, last - 1
    return np.asarray(0.5 * (rate[before] + rate[after]))


def _arm(rate: FloatArray, length: float, begin: NDArray[np.intp]) -> FloatArray:
    """(n, 3, 3) the matrices G, 1/s^2."""
    parts = np.split(rate, begin[1:])
    slope = np.concatenate([np.gradient(part, length, axis=0) for part in parts]) if len(rate) else rate
    cross = _cross(rate)
    return np.asarray(_cross(slope) + cross @ cross)


def _cross(vectors: FloatArray) -> FloatArray:
    """(n, 3, 3) the matrices [v]x."""
    x, y, z = vectors.T
    o = np.zeros_like(x)
    return np.array([[o, -z, y], [z, o, -x], [-y, x, o]]).transpose(2, 0, 1)


def frame_of(axis: FloatArray) -> FloatArray:
    """(3, 3) rows u, v, axis."""
    return np.array([*perpendicular(vec3(axis)), axis])


def tilted(frame: FloatArray, tilt: FloatArray) -> FloatArray:
    """`frame` (rows u, v, j) turned by the rotation vector with the components `tilt` (2,) along its u and v, rad."""
    return np.asarray(Rotation.from_rotvec(tilt @ frame[:2]).apply(frame))


def _tilt_rates(frame: FloatArray, tilt: FloatArray) -> FloatArray:
    """(2, 3, 3) derivatives of `tilted` by the two components of `tilt`."""
    vector = tilt @ frame[:2]
    angle, cross = float(np.linalg.norm(vector)), _cross(vector[None])[0]
    first = 0.5 * np.sinc(0.5 * angle / math.pi) ** 2
    second = (1.0 - np.sinc(angle / math.pi)) / angle**2 if angle > 1e-4 else 1.0 / 6.0
    rates = frame[:2] @ (np.eye(3) + first * cross + second * cross @ cross).T
    return np.cross(rates[:, None], tilted(frame, tilt)[None])


class Hinge:
    """The windows of `data` under parameters `p` (17,) about the axes of `frames` ((3, 3), (3, 3)).

    Attributes:
        across, gravity: (n,) z1 - exp(i q) z2 and p1 - exp(i q) p2 over their scatter.
        along: (n,) j1 . f1 - j2 . f2 over its scatter.
        turn: (n,) exp(i q).
    """

    def __init__(self, data: HingeData, frames: Frames, p: FloatArray, scatter: Scatter) -> None:
        self._data, self._frames, self._p = data, frames, p
        self._axes = one, two = tilted(frames[0], p[TILT_1]), tilted(frames[1], p[TILT_2])
        # Divided by their scatter here, so that the residuals and their derivatives are.
        self._rates = (data.gyro[0] - p[BIAS_1]) / scatter.gyro, (data.gyro[1] - p[BIAS_2]) / scatter.gyro
        self._forces = data.accel[0] - data.arms[0] @ p[ARM_1], data.accel[1] - data.arms[1] @ p[ARM_2]
        self._turned = (
            data.turned[0] - data.elapsed[:, None] * p[BIAS_1],
            data.turned[1] - data.elapsed[:, None] * p[BIAS_2],
        )
        self._scatter = scatter
        self._gravity_scatter = math.hypot(scatter.accel, _ACCEL_BIAS * math.sqrt(data.windows))
        z1, z2 = (_flat(axes, rates) for axes, rates in zip(self._axes, self._rates, strict=True))
        p1, p2 = (_flat(axes, f) / self._gravity_scatter for axes, f in zip(self._axes, self._forces, strict=True))
        turn = np.exp(1j * (self._turned[1] @ two[2] - self._turned[0] @ one[2]))
        self._begin = np.flatnonzero(np.append(True, np.diff(data.stretch) > 0))
        self._weights: Any = np.ones((2, 1))
        for _ in range(_TWICE):
            products = self._weights[0] * z1 * np.conj(z2 * turn) + self._weights[1] * p1 * np.conj(p2 * turn)
            turn = turn * np.exp(1j * np.angle(np.add.reduceat(products, self._begin)))[data.stretch]
            self.across, self.gravity = z1 - turn * z2, p1 - turn * p2
            self._weights = 1.0 / np.hypot(1.0, abs(np.array([self.across, self.gravity])) / _OUTLIER)
        self.turn = turn
        forces = (f @ axes[2] for axes, f in zip(self._axes, self._forces, strict=True))
        self.along = (next(forces) - next(forces) - p[OFFSET]) / scatter.accel
        self._turned_child = turn * z2, turn * p2

    def residuals(self) -> FloatArray:
        """All of them as (5 n,) numbers."""
        return _stacked(self.across, self.gravity, self.along)

    def derivatives(self) -> FloatArray:
        """(5 n, 17) derivatives of `residuals`."""
        data, n = self._data, len(self._data)
        across, gravity = np.zeros((PARAMETERS, n), dtype=complex), np.zeros((PARAMETERS, n), dtype=complex)
        along, angle = np.zeros((PARAMETERS, n)), np.zeros((PARAMETERS, n))
        sides = ((TILT_1, BIAS_1, ARM_1, 1.0, 1.0), (TILT_2, BIAS_2, ARM_2, -1.0, -self.turn))
        for k, (tilt, bias, arm, sign, factor) in enumerate(sides):
            axes, rates, forces, arms = self._axes[k], self._rates[k], self._forces[k], data.arms[k]
            for row, change in zip(
                range(tilt.start, tilt.stop), _tilt_rates(self._frames[k], self._p[tilt]), strict=True
            ):
                across[row] = factor * _flat(change, rates)
                gravity[row] = factor * _flat(change, forces)
                along[row] = sign * (forces @ change[2])
                angle[row] = -sign * (self._turned[k] @ change[2])
            flat = axes[0] + 1j * axes[1]
            across[bias] = np.multiply.outer(-flat / self._scatter.gyro, np.broadcast_to(factor, n))
            angle[bias] = sign * np.multiply.outer(axes[2], data.elapsed)
            gravity[arm] = -factor * (flat @ arms).T
            along[arm] = -sign * (axes[2] @ arms).T
        along[OFFSET] = -1.0
        y, g = (-1j * part for part in self._turned_child)  # by q
        gravity = gravity / self._gravity_scatter + g * angle
        across += y * angle
        # q0 of each stretch follows the others so that the squares stay least
        w = self._weights

        def summed(values: NDArray[Any]) -> FloatArray:
            return np.asarray(np.add.reduceat(values.real, self._begin, axis=-1))

        by_q = summed(w[0] * abs(y) ** 2 + w[1] * abs(g) ** 2)
        follows = -summed(w[0] * np.conj(y) * across + w[1] * np.conj(g) * gravity) / by_q
        follows = follows[:, data.stretch]
        return _stacked(across + y * follows, gravity + g * follows, along / self._scatter.accel).T


def _flat(axes: FloatArray, vectors: FloatArray) -> NDArray[np.complex128]:
    """(n,) the components u + i v of (n, 3) vectors, `axes` with rows u, v, ..."""
    return np.asarray(vectors @ (axes[0] + 1j * axes[1]))


def _stacked(across: NDArray[np.complex128], gravity: NDArray[np.complex128], along: FloatArray) -> FloatArray:
    return np.concatenate([across.real, across.imag, gravity.real, gravity.imag, along], axis=-1)
