"""Gyros at the end of their range: what a joint between two of them must not hide.

Such a sample says only that the link turns at least so fast. It is used, since nothing is known better, but what it
hides is a rate that nobody measured, as in a gap: after T s of it without interruption the angle has the variance

    (gap_rate T)^2

more than before, and the joint is DISTURBED meanwhile.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.input_quality import gyro_saturation_limit
from jointest_ros.core.robot import Sensor


class SaturatedGyros:
    """The gyros of one joint. False where the full scale of none is known: then there is nothing to look at.

    Args:
        sensors: of both links.
        gap_rate: standard deviation of a rate that nobody measured, rad/s.

    Attributes:
        time: s, since a gyro is saturated.
    """

    def __init__(self, sensors: Iterable[Sensor], gap_rate: float) -> None:
        self._limits = [
            (sensor.name, gyro_saturation_limit(sensor) * min(sensor.gyro_scale), sensor)
            for sensor in sensors
            if sensor.gyro and np.isfinite(sensor.gyro_range)
        ]
        self._gap_rate2 = gap_rate**2
        self.time = 0.0

    def __bool__(self) -> bool:
        return bool(self._limits)

    def any(self, gyro: Mapping[str, Vec3]) -> bool:
        """Whether one is saturated, by the gyros of a frame, rad/s."""
        for name, least, sensor in self._limits:
            rate = gyro.get(name)
            if rate is None:
                continue
            x, y, z = rate
            if abs(x) + abs(y) + abs(z) >= least and _at_the_end(sensor, np.array(rate)):
                return True
        return False

    def rows(self, gyro: Mapping[str, FloatArray], length: int) -> NDArray[np.bool_]:
        """(length,) `any` by arrays (length, 3)."""
        found = np.zeros(length, dtype=bool)
        for name, _, sensor in self._limits:
            if name in gyro:
                found |= _at_the_end(sensor, gyro[name])
        return found

    def spread(self, elapsed: float) -> float:
        """Variance, rad^2, that one more saturated sample adds, `elapsed` s after the one before."""
        before, self.time = self.time, self.time + elapsed
        return self._gap_rate2 * (self.time * self.time - before * before)


def _at_the_end(sensor: Sensor, rates: FloatArray) -> Any:
    """Of rates (..., 3) as they are in frames, calibrated: (...,)."""
    return (np.abs(rates) >= gyro_saturation_limit(sensor) * np.abs(sensor.gyro_scale)).any(axis=-1)
