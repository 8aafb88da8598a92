"""Hall sensors on joints: from the angles that they see to the voltages that a converter reads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.hall_sensor import HallSensor


class HallReadout:
    """V(theta) + offset + noise, limited to the sensor's range, then rounded; consecutive calls continue each other.

    Args:
        sensors: in the order of the voltages.
        offsets: (sensors) V, errors of the voltages.
        gain: error of the angles, as a share of them.
        play: width of the loop of angle seen over angle, rad.
        seed: of the noise.
        noise: with the noise of the sensors; they are rounded in any case.
    """

    def __init__(
        self,
        sensors: Sequence[HallSensor],
        offsets: FloatArray,
        gain: float,
        play: float,
        seed: np.random.SeedSequence,
        noise: bool = True,
    ) -> None:
        self._sensors, self._offsets, self._gain, self._half = tuple(sensors), offsets, gain, 0.5 * play
        self._noisy = noise
        self._noise = np.random.default_rng(seed)
        self._seen: FloatArray | None = None  # newest, for the play

    def read(self, angles: FloatArray) -> FloatArray:
        """(n, sensors) V for the joint angles (n, sensors) at them, rad."""
        seen = self._follow(angles * (1.0 + self._gain))
        volts = np.column_stack([sensor.voltage(seen[:, k]) for k, sensor in enumerate(self._sensors)])
        sigma, step = (
            np.array([getattr(sensor, name) for sensor in self._sensors]) for name in ("noise", "resolution")
        )
        volts += self._offsets
        if self._noisy:
            volts += sigma * self._noise.standard_normal(volts.shape)
        low, high = np.array([sensor.hall_range for sensor in self._sensors]).T
        volts = np.clip(volts, low, high)
        return np.where(step > 0.0, np.round(volts / np.where(step > 0.0, step, 1.0)) * step, volts)

    def _follow(self, angles: FloatArray) -> FloatArray:
        """The play operator: what is seen follows the angle when that is half the width away."""
        if not self._half:
            return angles
        seen, at = np.empty_like(angles), angles[0] if self._seen is None else self._seen
        for k, row in enumerate(angles):
            seen[k] = at = np.clip(at, row - self._half, row + self._half)
        self._seen = at
        return seen
