"""Does the gyro of a sensor say how its accelerometer sees gravity turn? Units, signs and order of axes of both.

Gravity g in the frame of a sensor that turns with the rate w changes by dg/dt = g x w. The gyro reads W, so that
w = M (W - bias) with M = 1 where all is well. Over a step of some tenths of a second, where what accelerates the sensor
back and forth hardly counts,

    a(end) - a(start) = sum of a x M W dt            a: accelerometer, mean over 20 ms

which is linear in M: the sums C_jl of a_j W_l dt are all that is needed to try every M that a mistake makes: signed
permutations of the axes (48; those that are no rotation belong to left-handed frames) times the factor of a unit.
Factors of accelerometers cancel.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.measures import rms_length

_STEP = 0.3  # s
_FEWEST = 10  # steps
_TURNING = math.radians(4.0)  # rad, rms in a step by the gyro: less says nothing (5 deg/s of bias are 1.5)
_PART = 0.02  # of the squares: two hypotheses that differ by less are the same
_EXPLAINED = 0.5  # of the squares: a hypothesis that explains less is none
_ABSURD, _UNLIKE_NOISE = -20.0, 0.1  # of a shaken sensor: as it is, and with another unit
_BETTER = 0.3  # of the squares that the usual one leaves, which another one must stay below
_UNITS = {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rad/s, divided by 57.3 once too often": 180.0 / math.pi}

_EPSILON = np.zeros((3, 3, 3))
for _i, _j, _k in itertools.permutations(range(3)):
    _EPSILON[_i, _j, _k] = np.linalg.det(np.eye(3)[[_i, _j, _k]])


@dataclass(frozen=True)
class Agreement:
    """What the best hypothesis says.

    Attributes:
        explained: share of the changes of the accelerometer that the gyro as it is explains; 1 - residual squares.
        best: the same of the best hypothesis.
        matrix: (3, 3) signed permutation of the best hypothesis: turns readings of the gyro into rates.
        factor: of its unit.
        unit: its name.
        scale: by least squares, rate over reading under the best hypothesis.
        scaled: share that it explains with that scale.
        turned: rms of the turn in a step, rad, under the best hypothesis.
        steps: that it rests on.
    """

    explained: float
    best: float
    matrix: FloatArray
    factor: float
    unit: str
    scale: float
    scaled: float
    turned: float
    steps: int

    @property
    def judged(self) -> bool:
        """The motion was enough to say anything."""
        if self.steps < _FEWEST or self.turned < _TURNING:
            return False
        absurd = self.factor != 1.0 and self.explained < _ABSURD and self.best > _UNLIKE_NOISE
        return self.best > _EXPLAINED or absurd

    @property
    def usual(self) -> bool:
        """Nothing explains the readings better than that all is well."""
        return self.factor == 1.0 and bool((self.matrix == np.eye(3)).all())


def agreement(means: WindowMeans, sensor: str, bias: FloatArray) -> Agreement | None:
    """The hypotheses compared; None where the sensor gave too little.

    Args:
        bias: (3,) of the gyro where it is known, else zeros, in its unit.
    """
    products, changes = _steps(means, means.gyro[sensor] - bias, means.accel[sensor])
    if len(changes) < _FEWEST:
        return None
    weights = _weights(changes)
    total = float(np.sum(weights * np.sum(changes**2, axis=1)))
    if total == 0.0:
        return None
    turns = np.einsum("ijm,njl->niml", _EPSILON, products)  # (n, 3, 3, 3): change i by element m, l of M
    best: tuple[float, int, FloatArray, str, float] | None = None
    usual = 1.0
    for unit, factor in _UNITS.items():
        for matrix in signed_permutations():
            left = changes - factor * np.einsum("niml,ml->ni", turns, matrix)
            share = float(np.sum(weights * np.sum(left**2, axis=1))) / total
            changed = int(np.sum(np.diag(matrix) != 1.0)) + (factor != 1.0)
            if not changed:
                usual = share
            # a simpler one that is as good is the better one
            if best is None or share < best[0] - _PART or (abs(share - best[0]) <= _PART and changed < best[1]):
                best = (share, changed, matrix, unit, factor)
    assert best is not None
    share, _, matrix, unit, factor = best
    if share > _BETTER * usual:  # as it is, it is not much worse
        share, matrix, unit, factor = usual, np.eye(3), "rad/s", 1.0
    predicted = factor * np.einsum("niml,ml->ni", turns, matrix)
    power = float(np.sum(weights * np.sum(predicted**2, axis=1)))
    together = float(np.sum(weights * np.sum(predicted * changes, axis=1)))
    scale, scaled = (together / power, together**2 / (power * total)) if power else (math.nan, 0.0)
    turned = factor * _turned(means, sensor, bias)
    return Agreement(1.0 - usual, 1.0 - share, matrix, factor, unit, scale, scaled, turned, len(changes))


def _steps(means: WindowMeans, gyro: FloatArray, accel: FloatArray) -> tuple[FloatArray, FloatArray]:
    """((n, 3, 3) sums of a_j W_l dt, (n, 3) changes of a) over the steps without a gap, a of length 1 in the mean."""
    whole = np.isfinite(gyro).all(axis=1) & np.isfinite(accel).all(axis=1)
    start, rate, force = means.start[whole], gyro[whole], accel[whole]
    if len(start) < 2:
        return np.empty((0, 3, 3)), np.empty((0, 3))
    force = force / float(np.median(np.linalg.norm(force, axis=1)) or 1.0)
    follows = np.diff(start) == round(means.length * 1e9)
    middle, turn = 0.5 * (force[1:] + force[:-1]), 0.5 * (rate[1:] + rate[:-1]) * means.length
    products = middle[:, :, None] * turn[:, None, :]
    windows = max(2, round(_STEP / means.length))
    number = len(follows) // windows
    whole_steps = follows[: number * windows].reshape(number, windows).all(axis=1)
    sums = products[: number * windows].reshape(number, windows, 3, 3).sum(axis=1)
    ends = force[: number * windows + 1 : windows]
    return sums[whole_steps], np.diff(ends, axis=0)[whole_steps]


def _weights(changes: FloatArray) -> FloatArray:
    """(n,) less for steps in which the sensor was knocked."""
    length = np.linalg.norm(changes, axis=1)
    return np.asarray(1.0 / np.maximum(1.0, length / 2.0) ** 2)  # gravity alone changes by 2 at most


def _turned(means: WindowMeans, sensor: str, bias: FloatArray) -> float:
    rate = means.gyro[sensor] - bias
    rate = rate[np.isfinite(rate).all(axis=1)]
    return rms_length(rate) * _STEP if len(rate) else 0.0


def signed_permutations() -> list[FloatArray]:
    """The 48 matrices (3, 3) that exchange and reverse axes, the identity first."""
    return [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
