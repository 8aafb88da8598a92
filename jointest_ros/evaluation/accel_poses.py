"""The still phases of a recording as poses for the calibration of accelerometers, and which direction is up in each.

A phase is still when every accelerometer scatters little in each of its windows and the windows agree with each other:
what drifts is no pose, however smoothly it moves. Readings are compared as multiples of each sensor's own median
length, so that sensors in other units are found still as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.robot import Sensor
from jointest_ros.core.rotation import rotate, rotate_inverse, unit

AXES: dict[str, Vec3] = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}

_WINDOW = 0.2  # s, at least
_SAMPLES = 10  # in a window, about
_FEWEST = 3  # windows of a phase: fewer tell nothing about the error of their mean
_SCATTER = 0.03  # of g: largest standard deviation in a window; noise of 400 ug/sqrt(Hz) at 1 kHz is a third of it
_DRIFT = 0.01  # of g, half a degree: a window may differ so much from the median of its phase, neighbours half of it
_MOST = 0.7  # share of a phase that must agree with its median: it may have settled first
_SAME = 0.05  # of g: phases that differ less are one pose, in which somebody bumped the bench
_CERTAIN = 4.0  # standard errors of a mean


@dataclass(frozen=True)
class Pose:
    """A still phase.

    Attributes:
        start, stop: s after the first sample of the recording.
        mean, error: sensor -> (3,) mean reading and its standard error, by the scatter of its windows.
    """

    start: float
    stop: float
    mean: dict[str, FloatArray]
    error: dict[str, FloatArray]


@dataclass(frozen=True)
class StillPhases:
    """The poses of a recording, and how many still phases were none: too short, or drifting."""

    poses: list[Pose]
    short: int
    drifting: int

    def __str__(self) -> str:
        number = len(self.poses)
        at = f" (at {', '.join(f'{pose.start:.1f}' for pose in self.poses)} s)" if number else ""
        others = ((self.short, "too short"), (self.drifting, "drifting"))
        more = "".join(f", {count} {what}" for count, what in others if count)
        return f"{number} still phase{'' if number == 1 else 's'}{at}{more}"


def find_poses(stamps: NDArray[np.int64], accel: Mapping[str, FloatArray], shortest: float) -> StillPhases:
    """The phases in which every sensor is still, for `shortest` (s) or longer.

    Args:
        stamps: (T,) ns, rising.
        accel: sensor -> (T, 3) readings, NaN where missing.
    """
    if len(stamps) < 2 * _SAMPLES:
        return StillPhases([], 0, 0)
    time = (stamps - stamps[0]) * 1e-9
    windows = _Windows(time, accel)
    poses: list[Pose] = []
    phases: list[list[NDArray[np.intp]]] = []  # each of one stretch, or of several with a bump in between
    for stretch in windows.stretches():
        if phases and windows.same(phases[-1][-1], stretch):
            phases[-1].append(stretch)
        else:
            phases.append([stretch])
    short = drifting = 0
    for phase in phases:
        whole = np.concatenate(phase)
        chosen = windows.agreeing(whole)
        if len(chosen) < _MOST * len(whole):
            drifting += 1
        elif len(chosen) < max(_FEWEST, shortest / windows.length - 1e-6):
            short += 1
        else:
            poses.append(windows.pose(chosen))
    return StillPhases(poses, short, drifting)


class _Windows:
    """W windows of a recording with the readings of n sensors, as multiples of the median length of each.

    Attributes:
        length: s.
        mean: (W, n, 3); noise: (W, n), largest standard deviation of an axis.
        certain: (W, n), by how much a mean may be off by noise.
    """

    def __init__(self, time: FloatArray, accel: Mapping[str, FloatArray]) -> None:
        self.length = max(_WINDOW, _SAMPLES * float(np.median(np.diff(time))))
        self._sensors = tuple(accel)
        numbers = np.floor(time / self.length).astype(np.int64)
        starts = np.flatnonzero(np.diff(numbers, prepend=-1))
        self._numbers = numbers[starts]
        self._start, self._stop = time[starts], time[np.append(starts[1:], len(time)) - 1]
        tables = [_moments(rows, starts) for rows in accel.values()]
        count = np.stack([table[0] for table in tables], axis=1)
        mean = np.stack([table[1] for table in tables], axis=1)
        std = np.stack([table[2] for table in tables], axis=1)
        lengths = np.linalg.norm(mean, axis=2)
        self._size = np.array([np.median(column[column > 0.0]) if column.any() else 1.0 for column in lengths.T])
        self.mean = mean / self._size[:, None]
        self.noise = std.max(axis=2) / self._size
        with np.errstate(divide="ignore", invalid="ignore"):
            self.certain = _CERTAIN * self.noise / np.sqrt(count)
        self._sound = (2 * count >= np.median(count, axis=0)).all(axis=1) & (count > 1).all(axis=1)

    def stretches(self) -> list[NDArray[np.intp]]:
        """Consecutive windows that agree with their neighbours; those beside a motion are left out."""
        still = np.asarray(self._sound & (self.noise <= _SCATTER).all(axis=1))
        step = np.abs(np.diff(self.mean, axis=0)).max(axis=2)
        alike = (step <= 0.5 * _DRIFT + self.certain[1:] + self.certain[:-1]).all(axis=1)
        agree = alike & still[1:] & still[:-1] & (np.diff(self._numbers) == 1)
        inside = still & np.append(True, agree) & np.append(agree, True)
        rows = np.flatnonzero(inside)
        return [part for part in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(part)]

    def same(self, one: NDArray[np.intp], other: NDArray[np.intp]) -> bool:
        """Two stretches are of one pose."""
        return bool((np.abs(self.mean[one].mean(axis=0) - self.mean[other].mean(axis=0)) < _SAME).all())

    def agreeing(self, rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """The windows of a phase that agree with its median."""
        off = np.abs(self.mean[rows] - np.median(self.mean[rows], axis=0)).max(axis=2)
        return rows[(off <= _DRIFT + self.certain[rows]).all(axis=1)]

    def pose(self, rows: NDArray[np.intp]) -> Pose:
        """The pose of such windows."""
        mean = self.mean[rows].mean(axis=0) * self._size[:, None]
        error = self.mean[rows].std(axis=0, ddof=1) / math.sqrt(len(rows)) * self._size[:, None]
        start, stop = float(self._start[rows[0]]), float(self._stop[rows[-1]])
        return Pose(
            start,
            stop,
            dict(zip(self._sensors, mean, strict=True)),
            dict(zip(self._sensors, error, strict=True)),
        )


def _moments(rows: FloatArray, starts: NDArray[np.intp]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Count (W,), mean (W, 3) and standard deviation (W, 3) of the whole rows (T, 3) of each window."""
    whole = np.asarray(np.isfinite(rows).all(axis=1))
    kept = np.where(whole[:, None], rows, 0.0)
    count = np.add.reduceat(whole.astype(float), starts)
    number = np.maximum(count, 1.0)[:, None]
    mean = np.add.reduceat(kept, starts) / number
    repeated = np.repeat(mean, np.diff(np.append(starts, len(rows))), axis=0)
    square = np.add.reduceat(np.where(whole[:, None], rows - repeated, 0.0) ** 2, starts) / number
    return count, mean, np.sqrt(square)


# ---------------------------------------------------------------- directions


def read_directions(text: str) -> list[Vec3 | None]:
    """The directions of a list such as "+x,-x,0/3/4,?", of length 1; None for "?", a phase that is not to be used.

    Raises:
        CalibrationError: a direction that is none: which, and what is allowed.
    """
    return [_read_direction(part.strip()) for part in text.split(",")]


def _read_direction(text: str) -> Vec3 | None:
    if text == "?":
        return None
    if text in AXES:
        return AXES[text]
    try:
        x, y, z = map(float, text.split("/"))
        if math.isfinite(x + y + z):
            return unit((x, y, z))
    except (ValueError, ZeroDivisionError):
        pass
    raise CalibrationError(f"'{text}' is no direction; give {', '.join(AXES)}, three numbers as 0/0.6/0.8, or ?")


def axes_up(poses: Sequence[Pose], sensors: Sequence[Sensor], cone: float) -> list[Vec3 | None]:
    """The axis of a link that points up in each pose, as its sensors say; None: none within `cone`, rad.

    Raises:
        CalibrationError: sensors of the link do not agree: a mounting is wrong.
    """
    return [_axis_up(pose, sensors, cone) for pose in poses]


def _axis_up(pose: Pose, sensors: Sequence[Sensor], cone: float) -> Vec3 | None:
    found: dict[str, str] = {}  # axis -> first sensor that says so
    for sensor in sensors:
        x, y, z = rotate(sensor.mounting, tuple(pose.mean[sensor.name].tolist()))
        length = math.hypot(x, y, z)
        for name, axis in AXES.items():
            if length and (x * axis[0] + y * axis[1] + z * axis[2]) / length >= math.cos(cone):
                found.setdefault(name, sensor.name)
    if len(found) > 1:
        (one, first), (other, second), *_ = found.items()
        raise CalibrationError(
            f"at {pose.start:.1f} s {one} points up by '{first}', {other} by '{second}' of the same link; "
            "is a mounting wrong?"
        )
    return AXES[next(iter(found))] if found else None


def in_sensor_frame(directions: Sequence[Vec3], sensor: Sensor) -> FloatArray:
    """(N, 3), of directions in the frame of the sensor's link."""
    return np.array([rotate_inverse(sensor.mounting, direction) for direction in directions]).reshape(-1, 3)


def name_of(direction: Vec3 | None) -> str:
    """As `read_directions` reads it."""
    names = {axis: name for name, axis in AXES.items()}
    if direction is None:
        return "?"
    return names.get(direction) or "/".join(f"{value:.3g}" for value in direction)
