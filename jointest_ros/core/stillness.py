"""Finds when the robot stands still, and averages its sensors meanwhile: for gyro bias and zero pose."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray, Frame, Recording, Vec3

_FEWEST = 5  # samples in a window
_CONSISTENT = 4.0  # standard errors that the mean of a window may differ from the mean before it


@dataclass
class Stillness:
    """Judges windows of frames; a window is still when every listed sensor is.

    Still means: gyro and accelerometer scatter less than the thresholds, the mean rate could be a bias, and gyro and
    accelerometer means agree with those of the still windows before (so slow motion is no bias, however smooth it is).
    The first window alone cannot tell a constant slow turn about the vertical from a bias of the same size.

    Attributes:
        gyro_std: largest standard deviation of a gyro axis in a still window, rad/s.
        accel_std: the same of an accelerometer axis, m/s^2.
        gyro_bias: largest mean rate of an axis that may be a bias, rad/s.
        window: length of a window, s.
        accel: judge by the accelerometers too.
    """

    sensors: tuple[str, ...]
    gyro_std: float
    accel_std: float
    gyro_bias: float
    window: float = 0.5
    accel: bool = True
    duration: float = 0.0  # s, still without interruption until the newest window
    gyro_mean: dict[str, FloatArray] = field(default_factory=dict)  # (3,) rad/s over `duration`
    accel_mean: dict[str, FloatArray] = field(default_factory=dict)  # (3,) m/s^2 over `duration`
    _frames: list[Frame] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._length = round(self.window * 1e9)

    def update(self, frame: Frame) -> bool | None:
        """Add a frame. True or False at the end of a window: it was still or not; None in between."""
        if frame.reset:
            self.clear()
        self._frames.append(frame)
        if frame.stamp - self._frames[0].stamp < self._length:
            return None
        still = self._judge(self._frames)
        self._frames = [frame]
        return still

    def run(self, recording: Recording) -> Iterator[tuple[int, bool]]:
        """`update` by arrays: at the end of each window, how many rows were taken and whether it was still."""
        resets = [] if recording.reset is None else np.flatnonzero(recording.reset).tolist()
        for start, stop in itertools.pairwise((0, *resets, len(recording))):
            if start in resets:
                self.clear()
            yield from self._run_stretch(recording, start, stop)

    def _run_stretch(self, recording: Recording, start: int, stop: int) -> Iterator[tuple[int, bool]]:
        held = self._frames
        while start < stop:
            stamps = recording.stamps[start:stop]
            first = held[0].stamp if held else stamps[0]
            end = start + int(np.searchsorted(stamps, first + self._length))  # the frame that closes the window
            if end == stop:
                break
            still = self._judge(held, recording.part(start, end + 1))
            yield end + 1, still
            held, start = [], end
        self._frames = [*held, *recording.part(start, stop).frames()]

    def means(self) -> tuple[dict[str, Vec3], dict[str, Vec3]]:
        """(gyro rad/s, accelerometer m/s^2) by sensor, over the present still phase."""
        return tuple(  # type: ignore[return-value]
            {sensor: tuple(mean.tolist()) for sensor, mean in table.items()}
            for table in (self.gyro_mean, self.accel_mean)
        )

    def clear(self) -> None:
        """Forget everything."""
        self._frames = []
        self._moved()

    def get_state(self) -> dict[str, Any]:
        """All that changes, as plain numbers, lists and dicts."""
        return {
            "duration": self.duration,
            "gyro_mean": {sensor: mean.tolist() for sensor, mean in self.gyro_mean.items()},
            "accel_mean": {sensor: mean.tolist() for sensor, mean in self.accel_mean.items()},
            "frames": [[frame.stamp, frame.gyro, frame.accel] for frame in self._frames],
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`."""
        self.duration = state["duration"]
        self.gyro_mean = {sensor: np.array(mean) for sensor, mean in state["gyro_mean"].items()}
        self.accel_mean = {sensor: np.array(mean) for sensor, mean in state["accel_mean"].items()}
        self._frames = [Frame(stamp, gyro, accel) for stamp, gyro, accel in state["frames"]]

    def _moved(self) -> None:
        self.duration = 0.0
        self.gyro_mean.clear()
        self.accel_mean.clear()

    def _judge(self, frames: list[Frame], rest: Recording | None = None) -> bool:
        """Judge frames and the rows that follow them, which are one window; take it into the means if it was still."""
        first = frames[0].stamp if frames else int(rest.stamps[0])  # type: ignore[union-attr]
        last = frames[-1].stamp if rest is None else int(rest.stamps[-1])
        span = (last - first) * 1e-9
        means = None if span > 2.0 * self.window else self._still_means(frames, rest)  # who knows what happened there
        if means is None:
            self._moved()
            return False
        share = span / (self.duration + span)
        for table, new in zip((self.gyro_mean, self.accel_mean), means, strict=True):
            for sensor, mean in new.items():
                table[sensor] = table[sensor] + share * (mean - table[sensor]) if sensor in table else mean
        self.duration += span
        return True

    def _still_means(self, frames: list[Frame], rest: Recording | None) -> tuple[dict[str, FloatArray], ...] | None:
        """Means of gyros and accelerometers over a window; None where one moved. Gyros tell of most motion: first."""
        gyro_means: dict[str, FloatArray] = {}
        accel_means: dict[str, FloatArray] = {}
        for sensor in self.sensors:
            gyro = _rows("gyro", sensor, frames, rest)
            if len(gyro) < _FEWEST:
                return None
            mean, deviation = _moments(gyro)
            if not ((deviation < self.gyro_std).all() and (abs(mean) < self.gyro_bias).all()):
                return None
            if not _consistent(mean, self.gyro_mean.get(sensor), deviation, self.gyro_std, len(gyro)):
                return None
            gyro_means[sensor] = mean
        for sensor in self.sensors:
            accel = _rows("accel", sensor, frames, rest) if self.accel else np.zeros((_FEWEST, 3))
            if len(accel) < _FEWEST:
                return None
            mean, deviation = _moments(accel)
            if not (deviation < self.accel_std).all():
                return None
            if not _consistent(mean, self.accel_mean.get(sensor), deviation, self.accel_std, len(accel)):
                return None
            accel_means[sensor] = mean
        return gyro_means, accel_means


def _consistent(mean: FloatArray, before: FloatArray | None, deviation: FloatArray, limit: float, count: int) -> bool:
    """Whether the mean of a window of `count` rows is that of the windows before."""
    if before is None:
        return True
    return bool((abs(mean - before) < _CONSISTENT * deviation / np.sqrt(count) + 0.02 * limit).all())


def _rows(what: str, sensor: str, frames: list[Frame], rest: Recording | None) -> FloatArray:
    """The whole rows (n, 3) of a sensor in frames, then in a recording; only what is looked at is stacked."""
    tables = [table.get(sensor) for table in map(attrgetter(what), frames)]
    present = itertools.chain.from_iterable([row for row in tables if row is not None])
    rows: FloatArray = np.fromiter(present, dtype=np.float64).reshape(-1, 3)
    if rest is not None and sensor in getattr(rest, what):
        table = getattr(rest, what)[sensor]
        rows = np.vstack([rows, table]) if len(rows) else table
    finite: Any = np.isfinite(rows)
    return rows if finite.all() else np.asarray(rows[finite.all(axis=1)])


def _moments(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of the columns, which numpy's own functions take twice as long for."""
    mean = np.add.reduce(rows) / len(rows)
    centred = rows - mean
    return mean, np.sqrt(np.einsum("ij,ij->j", centred, centred) / len(rows))
