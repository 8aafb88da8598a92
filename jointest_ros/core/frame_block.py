"""Many frames at once out of a stream in which nothing is amiss: what `FrameAssembler` would give, to the bit.

It is a part of the frame assembler, whose state it reads and carries on, so that single samples and blocks may follow
one another in any order. It takes a block only where none of the assembler's rules has anything to decide; otherwise
it leaves everything untouched, and the samples of the block must be added one by one.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.assembler import _GONE, _STARTED, FrameAssembler, calibrated
from jointest_ros.core.assembler_inputs import (
    _FROZEN_AFTER,
    _FROZEN_TURNS,
    _IMPLAUSIBLE_VOLTAGE,
    _INTERVALS,
    QUICK,
    Source,
)
from jointest_ros.core.frame import FloatArray, Frame, Recording, Vec3

IntArray = NDArray[np.int64]


@dataclass
class Samples:
    """Samples of one sensor as they came: stamps (n,) ns, gyro (n, 3) rad/s, accel (n, 3) m/s^2."""

    stamps: IntArray
    gyro: FloatArray
    accel: FloatArray


@dataclass
class Block:
    """What came for n frames: for each one the samples of all sensors and a Hall message, in any order.

    Attributes:
        samples: by sensor.
        arrivals: (n, m) ns of the messages of each frame in the order in which they came.
        first: (n,) which of them was the first inertial sample.
        hall: voltages (n, h), and (n,) which of the messages it was; None where the robot has no Hall sensors.
    """

    samples: Mapping[str, Samples]
    arrivals: IntArray
    first: IntArray
    hall: tuple[FloatArray, IntArray] | None


def is_between_frames(assembler: FrameAssembler) -> bool:
    """Whether a block may begin: everything was emitted, nothing is doubtful, the period of all sensors is known."""
    return (
        assembler.frames >= _STARTED
        and not assembler._pending
        and not assembler._suspects
        and not assembler._mag
        and not assembler._hall.waits
        and not assembler._reset_next
        and not assembler._mixed
        and all(source.period and source.mixture is None for source in assembler.sources.values())
    )


def add_block(assembler: FrameAssembler, block: Block) -> Recording | None:
    """The frames of a block, taken by the assembler as if sample after sample; None: not taken, nothing has changed."""
    samples, arrivals = block.samples, block.arrivals
    if not is_between_frames(assembler) or samples.keys() != assembler.sources.keys():
        return None
    if not (all(_sound(assembler, name, samples[name]) for name in samples) and _sound_hall(assembler, block)):
        return None
    stamps = np.array([samples[name].stamps - assembler._in_use[name][2] for name in samples])
    intervals = np.diff(stamps, prepend=[[assembler.sources[name].last] for name in samples])
    first, last = stamps.min(axis=0), stamps.max(axis=0)
    spread, lag = (last - first).max(), (arrivals[:, -1] - arrivals[:, 0]).max()
    if (
        first[0] <= assembler._newest
        or (first[1:] <= last[:-1]).any()
        or np.diff(last, prepend=assembler._newest).max() > assembler._max_gap
        or np.diff(arrivals.ravel(), prepend=assembler._arrival).min() < 0
        or spread > assembler._reset_jump
    ):
        return None
    after = copy.copy(assembler)  # what the state will be
    after.sources = {name: copy.copy(assembler.sources[name]) for name in samples}
    for source in after.sources.values():
        source.intervals = [*source.intervals]
    pace = _Pace(after, stamps.tolist(), intervals.tolist())
    if (
        pace.longest > 1.5 * pace.shortest  # a slower sensor
        or spread > min(pace.tolerance, pace.wait)
        or (block.hall is not None and lag > pace.tolerance)
        or intervals.max() > pace.wait + 2 * pace.shortest  # a silent sensor
        or intervals.max() + spread > _GONE * pace.shortest
        or intervals.min() < QUICK * pace.longest  # perhaps of two publishers
        or not all(_note_readings(after, name, samples[name], row) for row, name in zip(stamps, samples, strict=True))
    ):
        return None
    recording = _recording(assembler, block, first, np.array(pace.periods))
    _commit(assembler, after, block, recording, int(last[-1]))
    return recording


def _sound(assembler: FrameAssembler, name: str, samples: Samples) -> bool:
    """Whether all values in use are finite, plausible, and far from the full scale."""
    uses_gyro, uses_accel, _ = assembler._in_use[name]
    return (not uses_gyro or _below(samples.gyro, assembler._conspicuous_gyro[name])) and (
        not uses_accel or _below(samples.accel, assembler._conspicuous[name])
    )


def _below(rows: FloatArray, limit: float) -> bool:
    x, y, z = np.abs(rows.T)
    return bool((x + y + z < limit).all())


def _sound_hall(assembler: FrameAssembler, block: Block) -> bool:
    queue = assembler._hall
    if block.hall is None or not queue.width:
        return block.hall is None and not queue.width
    voltages, _ = block.hall
    return (
        queue.per_frame
        and voltages.shape[1] == queue.width
        and not (np.abs(voltages) > _IMPLAUSIBLE_VOLTAGE).any()
        and not np.isnan(voltages).all(axis=1).any()  # in a `Recording` that is no message at all
    )


class _Pace:
    """Carries the periods of the sensors and of the stream through a block, in the assembler's copy `after`.

    Attributes:
        periods: of the stream, s, at each frame.
        shortest, longest: period of any sensor meanwhile, ns.
        tolerance, wait: the smallest that the assembler had meanwhile, ns.
    """

    def __init__(self, after: FrameAssembler, stamps: list[list[int]], intervals: list[list[int]]) -> None:
        self._after, sources = after, list(after.sources.values())
        count = len(stamps[0])
        self.periods: list[float] = []
        self.shortest = self.longest = after._period
        self.tolerance, self.wait = after._tolerance, after._wait
        self._note()
        found_anew: dict[int, list[int]] = {}  # row -> number of the sensors whose period is found anew with it
        for number, source in enumerate(sources):
            for row in range(_INTERVALS - 1 - len(source.intervals), count, _INTERVALS):
                found_anew.setdefault(row, []).append(number)
        taken = [0] * len(sources)
        for row in sorted(found_anew):
            self.periods += [after._period * 1e-9] * (row - len(self.periods))
            for number in found_anew[row]:
                source, source_stamps, source_intervals = sources[number], stamps[number], intervals[number]
                source.intervals += source_intervals[taken[number] : row]
                taken[number] = row + 1
                source.last = source_stamps[row] - source_intervals[row]
                source.accept(source_stamps[row])
            for source, source_stamps in zip(sources, stamps, strict=True):
                source.last = after._newest = source_stamps[row]
            after._set_tolerances()
            self._note()
        self.periods += [after._period * 1e-9] * (count - len(self.periods))
        for number, source in enumerate(sources):
            source.intervals += intervals[number][taken[number] :]
            source.last = stamps[number][-1]
            source.received += count
            source.used += count

    def _note(self) -> None:
        periods = [source.period for source in self._after.sources.values()]
        self.shortest, self.longest = min(self.shortest, *periods), max(self.longest, *periods)
        self.tolerance, self.wait = min(self.tolerance, self._after._tolerance), min(self.wait, self._after._wait)


def _note_readings(after: FrameAssembler, name: str, samples: Samples, stamps: IntArray) -> bool:
    """`Source.repeats` for all samples; False where one of them may be frozen."""
    uses_gyro, uses_accel, _ = after._in_use[name]
    source = after.sources[name]
    if not uses_gyro or source.reading is None:
        return not uses_gyro
    gyro, accel = source.reading
    readings = np.vstack([gyro, samples.gyro])
    if accel is not None:
        readings = np.hstack([readings, np.vstack([accel, samples.accel])])
    new = np.flatnonzero((readings[1:] != readings[:-1]).any(axis=1)) + 1
    since = np.append(source.held_from, stamps)
    starts, ends = since[np.append(0, new)], since[np.append(new, len(readings)) - 1]
    if (ends - starts).max() >= _FROZEN_AFTER and np.abs(samples.gyro).max() > _FROZEN_TURNS:
        return False
    if not new.size:
        source.held += len(stamps)
        return True
    row = int(new[-1]) - 1
    source.reading = (_vec3(samples.gyro[row]), _vec3(samples.accel[row]) if uses_accel else None)
    source.held_from, source.held = int(stamps[row]), len(stamps) - 1 - row
    return True


def _recording(assembler: FrameAssembler, block: Block, stamps: IntArray, period: FloatArray) -> Recording:
    gyro, accel = {}, {}
    for name, samples in block.samples.items():
        uses_gyro, uses_accel, _ = assembler._in_use[name]
        if uses_gyro:
            scale = assembler._gyro_scales.get(name)
            gyro[name] = samples.gyro if scale is None else samples.gyro * scale
        if uses_accel:
            calibration, columns = assembler._accel_calibrations.get(name), tuple(samples.accel.T)
            accel[name] = samples.accel if calibration is None else np.array(calibrated(columns, *calibration)).T
    hall = None if block.hall is None else block.hall[0]
    return Recording(stamps, gyro, accel, {}, hall, period, np.zeros(len(stamps), dtype=bool))


def _commit(assembler: FrameAssembler, after: FrameAssembler, block: Block, recording: Recording, newest: int) -> None:
    """Make the assembler's state what it is after the block."""
    count, sources = len(recording), assembler.sources
    for name, source in after.sources.items():  # others hold them
        for field in fields(Source):
            setattr(sources[name], field.name, getattr(source, field.name))
    after.sources = sources
    after.frames += count
    after._newest, after._emitted, after._arrival = newest, int(recording.stamps[-1]), int(block.arrivals[-1, -1])
    vars(assembler).update(vars(after))
    if block.hall is not None:
        queue = assembler._hall
        before = np.flatnonzero(block.hall[1] < block.first)
        queue._after = count - 1 - int(before[-1]) if before.size else queue._after + count
        queue.added += count
        queue.source.received += count
        queue.source.used += count
    quality = assembler.quality
    row = int(np.searchsorted(recording.stamps, quality._next))
    while row < count:
        gyro, accel = (
            {name: _vec3(table[row]) for name, table in tables.items()} for tables in (recording.gyro, recording.accel)
        )
        quality.add(Frame(int(recording.stamps[row]), gyro, accel))
        row = int(np.searchsorted(recording.stamps, quality._next))


def _vec3(row: FloatArray) -> Vec3:
    x, y, z = row.tolist()
    return x, y, z
