"""A recording of inertial sensors in the memory of its window means, and when the robot stood still meanwhile.

What is fitted to minutes of motion needs no single samples: means over 20 ms keep all that a robot's motion holds, are
fifty times fewer at 1 kHz, and have the noise of the mean.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray, Recording, Vec3
from jointest_ros.core.stillness import Stillness

_SHORTEST = 0.02  # s, of a window
_SAMPLES = 3  # in a window, where samples are far apart


@dataclass(frozen=True)
class StillPhase:
    """A phase without motion: start and end of the time that was averaged, ns, and the means by sensor, SI."""

    start: int
    end: int
    gyro: dict[str, Vec3]
    accel: dict[str, Vec3]

    @property
    def duration(self) -> float:
        """Seconds."""
        return (self.end - self.start) * 1e-9


@dataclass(frozen=True)
class WindowMeans:
    """K windows in the order of the recording.

    Attributes:
        start: (K,) ns, of each window; a whole number of lengths. The next one need not follow at once.
        length: of a window, s.
        gyro, accel: sensor -> (K, 3) mean, rad/s and m/s^2, sensor frame; NaN where there is none.
        still: the phases in which all sensors were still.
        first: stamp of the first frame, ns.
    """

    start: NDArray[np.int64]
    length: float
    gyro: dict[str, FloatArray]
    accel: dict[str, FloatArray]
    still: list[StillPhase]
    first: int

    @property
    def given(self) -> set[str]:
        """The sensors that gave readings of gyro and accelerometer."""
        tables = self.gyro, self.accel
        return {sensor for sensor in self.gyro if all(np.isfinite(table[sensor]).any() for table in tables)}

    def between(self, start: float, end: float) -> WindowMeans:
        """The windows that begin from `start` to before `end`, s after the first frame; `still` and `first` stay."""
        time = (self.start - self.first) * 1e-9
        rows = (time >= start) & (time < end)
        gyro, accel = ({s: table[rows] for s, table in tables.items()} for tables in (self.gyro, self.accel))
        return replace(self, start=self.start[rows], gyro=gyro, accel=accel)


@dataclass
class Windows:
    """Takes consecutive stretches of frames, gives their `WindowMeans`."""

    sensors: tuple[str, ...]
    stillness: Stillness
    _length: int = 0  # ns; 0: not known yet
    _first: int | None = None
    _numbers: list[NDArray[np.int64]] = field(default_factory=list)
    _sums: list[FloatArray] = field(default_factory=list)  # (k, sensors, 2, 4): sum of three components and number
    _still: list[StillPhase] = field(default_factory=list)
    _newest: StillPhase | None = None

    def add(self, recording: Recording) -> None:
        """The next stretch."""
        stamps = recording.stamps
        if not len(stamps):
            return
        if not self._length:
            steps = np.diff(stamps)
            period = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
            self._length = round(max(_SHORTEST * 1e9, _SAMPLES * period))
        if self._first is None:
            self._first = int(stamps[0])
        numbers = stamps // self._length
        starts = _changes(numbers)
        nothing = np.full((len(stamps), 3), np.nan)
        samples = np.empty((len(stamps), len(self.sensors), 2, 4))
        for k, sensor in enumerate(self.sensors):
            for which, table in enumerate((recording.gyro, recording.accel)):
                rows = table.get(sensor, nothing)
                whole: Any = np.isfinite(rows).all(axis=1)
                samples[:, k, which, :3] = np.where(whole[:, None], rows, 0.0)
                samples[:, k, which, 3] = whole
        self._numbers.append(numbers[starts])
        self._sums.append(np.add.reduceat(samples, starts, axis=0))
        for rows_taken, still in self.stillness.run(recording):
            self._take_still(int(stamps[rows_taken - 1]), still)

    def _take_still(self, end: int, still: bool) -> None:
        """At the end of a window of `stillness`."""
        before, self._newest = self._newest, None
        if still:
            gyro, accel = self.stillness.means()
            self._newest = StillPhase(end - round(self.stillness.duration * 1e9), end, gyro, accel)
            if before is not None and self._newest.start >= before.end:  # the clock was set between them
                self._still.append(before)
        elif before is not None:
            self._still.append(before)

    def means(self) -> WindowMeans:
        """All of it."""
        if self._newest is not None:
            self._take_still(self._newest.end, False)
        numbers = np.concatenate([np.empty(0, dtype=np.int64), *self._numbers])
        sums = np.concatenate([np.empty((0, len(self.sensors), 2, 4)), *self._sums])
        starts = _changes(numbers)
        if len(starts):  # a window may have been cut in two between calls
            numbers, sums = numbers[starts], np.add.reduceat(sums, starts, axis=0)
        count = sums[..., 3:]
        usual = np.median(count, axis=0) if len(count) else 0.0
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(count >= np.maximum(0.5 * usual, 1.0), sums[..., :3] / count, np.nan)
        return WindowMeans(
            numbers * self._length,
            self._length * 1e-9,
            {sensor: mean[:, k, 0] for k, sensor in enumerate(self.sensors)},
            {sensor: mean[:, k, 1] for k, sensor in enumerate(self.sensors)},
            self._still,
            self._first or 0,
        )


def _changes(numbers: NDArray[np.int64]) -> NDArray[np.intp]:
    """Rows whose number is not that of the row before."""
    return np.flatnonzero(np.append(True, np.diff(numbers) != 0)[: len(numbers)])
