"""Streams as window means on one grid of time, and when their sensors stood still: from arrays, without frames."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.stillness import Stillness
from jointest_ros.evaluation.inertial_windows import StillPhase, WindowMeans
from jointest_ros.evaluation.inspection.stream import Stream

_SHORTEST = 0.02  # s, of a window
_SAMPLES = 3  # in a window, where samples are far apart

Phase = tuple[int, int]  # start and end, ns


def window_length(streams: Mapping[str, Stream]) -> float:
    """Of windows in which the slowest of these has some samples, s."""
    periods = [stream.period for stream in streams.values() if not math.isnan(stream.period)]
    return max(_SHORTEST, _SAMPLES * max(periods, default=0.0))


def window_means(streams: Mapping[str, Stream], length: float) -> WindowMeans:
    """Means by sensor on a common grid, where all of `streams` are sound; `still` is empty.

    Args:
        length: of a window, s.
    """
    step = round(length * 1e9)
    numbers = {sensor: stream.stamps // step for sensor, stream in streams.items()}
    grid = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *numbers.values()]))
    gyro, accel = {}, {}
    for sensor, stream in streams.items():
        gyro[sensor], accel[sensor] = (_means(grid, numbers[sensor], rows) for rows in (stream.gyro, stream.accel))
    first = min((int(stream.stamps[0]) for stream in streams.values() if len(stream)), default=0)
    return WindowMeans(grid * step, length, gyro, accel, [], first)


def _means(grid: NDArray[np.int64], numbers: NDArray[np.int64], rows: FloatArray) -> FloatArray:
    """(K, 3) of the rows in each window of the grid; NaN where a window has less than half of the usual number."""
    means = np.full((len(grid), 3), np.nan)
    if not len(numbers):
        return means
    starts = np.flatnonzero(np.append(True, np.diff(numbers) != 0))
    count = np.diff(np.append(starts, len(numbers)))
    enough = count >= 0.5 * np.median(count)
    values = np.add.reduceat(rows, starts, axis=0) / count[:, None]
    means[np.searchsorted(grid, numbers[starts[enough]])] = values[enough]
    return means


def rate_time(stream: Stream, length: float) -> float:
    """From the start of a window to the middle of the time that its mean rate stands for, s.

    A gyro sample is the mean rate over the interval that ends at its stamp.
    """
    step = round(length * 1e9)
    return float(np.median(stream.stamps % step)) * 1e-9 - 0.5 * stream.period


def still_phases(stream: Stream, sensor: str, stillness: Stillness) -> list[StillPhase]:
    """When this sensor stood still.

    Args:
        stillness: with the thresholds to use; a copy is made.
    """
    judge = replace(stillness, sensors=(sensor,), gyro_mean={}, accel_mean={}, _frames=[])
    phases: list[StillPhase] = []
    newest: StillPhase | None = None
    for rows, still in judge.run(stream.as_recording(sensor)):
        if not still:
            phases += [newest] if newest is not None else []
            newest = None
            continue
        end = int(stream.stamps[rows - 1])
        gyro, accel = judge.means()
        phase = StillPhase(end - round(judge.duration * 1e9), end, gyro, accel)
        if newest is not None and phase.start >= newest.end:
            phases.append(newest)
        newest = phase
    return phases + ([newest] if newest is not None else [])


def common_phases(phases: Mapping[str, list[StillPhase]], shortest: float) -> list[Phase]:
    """When all of them stood still at once, for `shortest` s or longer."""
    common: list[Phase] | None = None
    for own in phases.values():
        spans = [(phase.start, phase.end) for phase in own]
        if common is None:
            common = spans
        else:
            both = ((max(a, c), min(b, d)) for a, b in common for c, d in spans)
            common = [(start, end) for start, end in both if end > start]
    return [(start, end) for start, end in common or [] if (end - start) * 1e-9 >= shortest]


def rows_of(stream: Stream, phase: Phase) -> slice:
    """The samples of a stream with rising stamps that are in a phase."""
    start, end = np.searchsorted(stream.stamps, [phase[0], phase[1] + 1])
    return slice(int(start), int(end))
