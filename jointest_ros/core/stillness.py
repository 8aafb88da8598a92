"""Finds when the robot stands still, and averages its sensors meanwhile: for gyro bias and zero pose."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
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
        still = self._judge([Recording.from_frames(self._frames)])
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
        held = [Recording.from_frames(self._frames)] if self._frames else []
        while start < stop:
            stamps = recording.stamps[start:stop]
            first = held[0].stamps[0] if held else stamps[0]
            end = start + int(np.searchsorted(stamps, first + self._length))  # the frame that closes the window
            if end == stop:
                break
            still = self._judge([*held, recording.part(start, end + 1)])
            yield end + 1, still
            held, start = [], end
        self._frames = [frame for part in (*held, recording.part(start, stop)) for frame in part.frames()]

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

    def _judge(self, window: list[Recording]) -> bool:
        """Judge consecutive stretches which are one window, and take it into the means if it was still."""
        means: list[tuple[str, FloatArray, FloatArray]] = []
        span = float(window[-1].stamps[-1] - window[0].stamps[0]) * 1e-9
        if span > 2.0 * self.window:  # nobody knows what happened in between
            self._moved()
            return False
        for sensor in self.sensors:
            gyro = _rows([part.gyro.get(sensor) for part in window])
            if len(gyro) < _FEWEST:
                self._moved()
                return False
            gyro_mean, gyro_std = _moments(gyro)
            still = (gyro_std < self.gyro_std).all() and (abs(gyro_mean) < self.gyro_bias).all()
            if not still:  # the accelerometer need not be looked at
                self._moved()
                return False
            accel = _rows([part.accel.get(sensor) for part in window]) if self.accel else np.zeros_like(gyro)
            if len(accel) < _FEWEST:
                self._moved()
                return False
            accel_mean, accel_std = _moments(accel)
            still = (accel_std < self.accel_std).all()
            if still and sensor in self.gyro_mean:
                scatter = _CONSISTENT * gyro_std / np.sqrt(len(gyro)) + 0.02 * self.gyro_std
                still = (abs(gyro_mean - self.gyro_mean[sensor]) < scatter).all()
                scatter = _CONSISTENT * accel_std / np.sqrt(len(accel)) + 0.02 * self.accel_std
                still = still and (abs(accel_mean - self.accel_mean[sensor]) < scatter).all()
            if not still:
                self._moved()
                return False
            means.append((sensor, gyro_mean, accel_mean))
        share = span / (self.duration + span)
        for sensor, gyro_mean, accel_mean in means:
            for table, mean in ((self.gyro_mean, gyro_mean), (self.accel_mean, accel_mean)):
                table[sensor] = table[sensor] + share * (mean - table[sensor]) if sensor in table else mean
        self.duration += span
        return True


def _rows(tables: list[FloatArray | None]) -> FloatArray:
    """The rows of all tables that are whole."""
    present = [table for table in tables if table is not None] or [np.empty((0, 3))]
    rows = present[0] if len(present) == 1 else np.vstack(present)
    finite: Any = np.isfinite(rows)
    return rows if finite.all() else np.asarray(rows[finite.all(axis=1)])


def _moments(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of the columns, which numpy's own functions take twice as long for."""
    mean = np.add.reduce(rows) / len(rows)
    centred = rows - mean
    return mean, np.sqrt(np.einsum("ij,ij->j", centred, centred) / len(rows))
