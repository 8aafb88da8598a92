"""The analytical angle of one joint over a window of samples: see analytical.py for what it computes."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.accel.array import JointArrays
from jointest_ros.core.accel.pair_filter import UNKNOWN, UNOBSERVABLE, first_branch
from jointest_ros.core.accel.paper.model import relative_noise, relative_vector
from jointest_ros.core.accel.reader import Reader
from jointest_ros.core.frame import FloatArray, Status

ACCELERATION = 1e2  # rad/s^2, standard deviation of what the joint may do while samples are missing
_CLOCK = 1e3  # s, after which times are counted anew, so that their sums stay exact
_STARTING, _UNOBSERVABLE = int(Status.STARTING), int(Status.UNOBSERVABLE)


class AnalyticalPair:
    """One joint; a `PairFilter`, but that `rates` are those of a joint whose link a is at rest."""

    def __init__(self, arrays: JointArrays, window: int, max_gap: float) -> None:
        self._joint, self._window, self._max_gap = arrays.joint, window, max_gap
        self._reader = Reader(arrays)
        limits = arrays.joint.limits
        self._length = max(window, 2)  # samples that are kept
        self._follows = arrays.joint.continuous or (limits is not None and limits[0][1] - limits[0][0] > math.tau)
        self.restart()

    def restart(self) -> None:
        """Before the first sample."""
        self.angle, self.rates, self.variance = 0.0, (0.0, 0.0), UNKNOWN
        self.status = _STARTING
        self._known = UNKNOWN  # rad^2, variance at the newest sample
        self._elapsed = 0.0  # s since then
        self._clear()

    def _clear(self) -> None:
        self._vectors: list[complex] = []  # (m/s^2)^2, of the newest samples, the oldest first; the direction is th_ab
        self._noise: list[float] = []  # (m/s^2)^4, variance of these in any direction
        self._times: list[float] = []  # s

    # ------------------------------------------------------------- steps

    def step(self, dt: float, channels: FloatArray, variances: FloatArray) -> bool:
        """See `PairFilter`."""
        self._elapsed += dt
        read = self._reader.read(channels, variances)
        if read is None:
            self.rates = (0.0, 0.0)
            self.variance = min(self._known + (0.5 * ACCELERATION * self._elapsed**2) ** 2, UNKNOWN)
            return False
        reading, noise = read
        if self._elapsed > self._max_gap:
            self._clear()
        sine, cosine = relative_vector(reading[2:4], reading[6:8])
        self._vectors.append(complex(cosine, sine))
        self._noise.append(relative_noise(reading[2:4], reading[6:8], noise))
        self._times.append(self._times[-1] + self._elapsed if self._times else 0.0)
        self._elapsed = 0.0
        if len(self._vectors) > self._length:
            del self._vectors[0], self._noise[0], self._times[0]
        if self._times[-1] > _CLOCK:
            self._times = [time - self._times[0] for time in self._times]
        self._publish()
        return True

    def _publish(self) -> None:
        vectors, noise, times, window = self._vectors, self._noise, self._times, self._window
        total = sum(vectors[-window:])
        angle, variance = cmath.phase(total), _ratio(sum(noise[-window:]), total)
        half, rate = len(vectors) // 2, 0.0
        if half:
            older, newer = sum(vectors[:half]), sum(vectors[-half:])
            spacing = (sum(times[-half:]) - sum(times[:half])) / half
            turned = cmath.phase(newer * older.conjugate())
            turned_variance = _ratio(sum(noise[:half]), older) + _ratio(sum(noise[-half:]), newer)
            lag = times[-1] - sum(times[-window:]) / len(times[-window:])
            rate = turned / spacing
            variance += max(turned * turned - turned_variance, 0.0) * (lag / spacing) ** 2
        if self._follows and not self.status & _STARTING:
            self.angle += math.remainder(angle - self.angle, math.tau)
        else:
            self.angle = first_branch(angle, self._joint)
        self.rates = (0.0, -rate)
        self.variance = self._known = min(variance, UNKNOWN)
        self.status = _UNOBSERVABLE if variance > UNOBSERVABLE else 0

    def run(
        self, intervals: FloatArray, channels: FloatArray, variances: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64]]:
        """`step` over T samples of all sensors with no gap between them.

        Args:
            intervals: (T) s since the sample before.
            channels: (T, C) m/s^2, finite.
            variances: (C).

        Returns:
            position, velocity and variance of the joint and `Status` flags, each (T).
        """
        model = self._reader.model(variances)
        assert model is not None  # joint_arrays has made sure
        reading = model.reading @ channels.T
        sine, cosine = relative_vector(reading[2:4], reading[6:8])
        vectors = np.concatenate([self._vectors, cosine + 1j * sine])
        noise = np.concatenate([self._noise, relative_noise(reading[2:4], reading[6:8], model.noise)])
        times = np.concatenate([self._times, np.cumsum(intervals) + self._elapsed + sum(self._times[-1:])])
        times -= times[0]
        stop = np.arange(len(self._vectors), len(vectors)) + 1
        first, start = np.maximum(stop - self._window, 0), np.maximum(stop - self._length, 0)
        half = (stop - start) // 2
        sums = [np.concatenate([[0.0], np.cumsum(one)]) for one in (vectors, noise, times)]
        total, total_noise, total_time = (one[stop] - one[first] for one in sums)
        older, older_noise, older_time = (one[start + half] - one[start] for one in sums)
        newer, newer_noise, newer_time = (one[stop] - one[stop - half] for one in sums)
        with np.errstate(divide="ignore", invalid="ignore"):
            spacing = (newer_time - older_time) / half
            turned = np.angle(newer * older.conj())
            excess = turned**2 - older_noise / np.abs(older) ** 2 - newer_noise / np.abs(newer) ** 2
            lag = times[stop - 1] - total_time / (stop - first)
            shift = np.maximum(excess, 0.0) * (lag / spacing) ** 2
            variance = total_noise / np.abs(total) ** 2 + np.where(half, shift, 0.0)
            rate = np.where(half, turned / spacing, 0.0)
        angle = self._branches(np.angle(total))
        status = np.where(variance > UNOBSERVABLE, _UNOBSERVABLE, 0).astype(np.int64)
        variance = np.minimum(variance, UNKNOWN)
        kept = slice(start[-1], None)
        self._vectors, self._noise = vectors[kept].tolist(), noise[kept].tolist()
        self._times = (times[kept] - times[start[-1]]).tolist()
        self._elapsed, self._known = 0.0, float(variance[-1])
        self.angle, self.rates = float(angle[-1]), (0.0, -float(rate[-1]))
        self.variance, self.status = self._known, int(status[-1])
        return -angle, -rate, variance, status

    def _branches(self, angles: FloatArray) -> FloatArray:
        """Branches of (T) successive angles."""
        if not self._follows:
            middle = 0.0 if self._joint.limits is None else -0.5 * sum(self._joint.limits[0])
            return middle - np.mod(middle - angles + math.pi, math.tau) + math.pi
        first = first_branch(float(angles[0]), self._joint) if self.status & _STARTING else self.angle
        steps = np.diff(angles, prepend=first)
        return first + np.cumsum(np.mod(steps + math.pi, math.tau) - math.pi)

    # ------------------------------------------------------------- what else is known

    def innovations(self) -> Sequence[float]:
        """None: nothing is predicted."""
        return ()

    def biases(self) -> Sequence[float]:
        """None are estimated."""
        return ()

    def get_state(self) -> dict[str, Any]:
        """All that changes."""
        return {
            "output": [self.angle, *self.rates, self.variance, self.status],
            "newest": [self._known, self._elapsed],
            "window": [
                [v.real, v.imag, noise, time]
                for v, noise, time in zip(self._vectors, self._noise, self._times, strict=True)
            ],
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`."""
        self.angle, w_a, w_b, self.variance, self.status = state["output"]
        self.rates = w_a, w_b
        self._known, self._elapsed = state["newest"]
        self._clear()
        for x, y, noise, time in state["window"]:
            self._vectors.append(complex(x, y))
            self._noise.append(noise)
            self._times.append(time)


def _ratio(noise: float, vector: complex) -> float:
    """Variance of the direction of a vector with this noise, to first order."""
    length2 = vector.real * vector.real + vector.imag * vector.imag
    return noise / length2 if length2 else math.inf
