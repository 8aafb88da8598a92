"""All Hall sensors of a linkage at once, by arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.hall_sensor import HallSensor, VoltageTable


class HallBank:
    """Vectors over h sensors.

    Attributes:
        sign, offset, variance: (h,) of each sensor, variance in V^2.
        low, high: (h,) V, ends of its range; `gate_low`, `gate_high`: of what is certainly not clipped.
    """

    def __init__(self, sensors: Sequence[HallSensor]) -> None:
        self.sign = np.array([s.sign for s in sensors])
        self.offset = np.array([s.offset for s in sensors])
        self.variance = np.array([s.variance for s in sensors])
        self.low, self.high = np.array([s.hall_range for s in sensors]).reshape(-1, 2).T
        margin = np.array([s.gate_margin for s in sensors])
        self.gate_low, self.gate_high = self.low + margin, self.high - margin
        tables: dict[VoltageTable, list[int]] = {}
        for number, sensor in enumerate(sensors):
            tables.setdefault(sensor.table, []).append(number)
        self._tables = [(table, np.array(numbers)) for table, numbers in tables.items()]

    def angles(self, volts: FloatArray) -> FloatArray:
        """Joint angles, rad, that readings (..., h) stand for."""
        shifted = volts - self.offset
        if len(self._tables) == 1:
            return np.asarray(self.sign * self._tables[0][0].angles(shifted))
        angles = np.empty_like(shifted)
        for table, numbers in self._tables:
            angles[..., numbers] = table.angles(shifted[..., numbers])
        return self.sign * angles

    def voltages(self, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(V, dV / d angle), each (h,), expected at the joint angle of each sensor (h,), rad."""
        signed = self.sign * angles
        if len(self._tables) == 1:
            volts, slopes = self._tables[0][0].voltages(signed)
        else:
            volts, slopes = np.empty_like(signed), np.empty_like(signed)
            for table, numbers in self._tables:
                volts[numbers], slopes[numbers] = table.voltages(signed[numbers])
        return volts + self.offset, self.sign * slopes

    def usable(self, volts: FloatArray, gated: bool) -> NDArray[np.bool_]:
        """Which readings (..., h) may be used: inside the range, and `gated`: certainly not clipped."""
        low, high = (self.gate_low, self.gate_high) if gated else (self.low, self.high)
        return (volts >= low) & (volts <= high)
