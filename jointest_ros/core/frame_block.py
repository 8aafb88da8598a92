"""Many frames at once out of a stream in which nothing is amiss: what `FrameAssembler` would give, to the bit.

It reads the state of the frame assembler and carries it on, so that single samples and blocks may follow one another in
any order. It takes a block only where none of the assembler's rules has anything to decide; otherwise it leaves
everything untouched, and the samples of the block must be added one by one.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.assembler import FrameAssembler
from jointest_ros.core.assembler_inputs import (
    FROZEN_AFTER,
    FROZEN_TURNS,
    IMPLAUSIBLE_VOLTAGE,
    INTERVALS,
    QUICK,
    HallQueue,
    Source,
)
from jointest_ros.core.channel import Channel, calibrated
from jointest_ros.core.frame import FloatArray, Recording, vec3
from jointest_ros.core.pace import GONE, Pace

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


def add_block(assembler: FrameAssembler, block: Block) -> Recording | None:
    """The frames of a block, taken by the assembler as if sample after sample; None: not taken, nothing has changed."""
    samples, arrivals, channels = block.samples, block.arrivals, assembler.channels
    if not assembler.is_between_frames or samples.keys() != assembler.sources.keys():
        return None
    if not (all(_sound(channels[name], samples[name]) for name in samples) and _sound_hall(assembler.hall, block)):
        return None
    pace, sources = copy.copy(assembler.pace), {}  # what they will be
    for name in samples:
        sources[name] = copy.copy(assembler.sources[name])
        sources[name].intervals = [*sources[name].intervals]
    stamps = np.array([samples[name].stamps - channels[name].delay for name in samples])
    intervals = np.diff(stamps, prepend=[[sources[name].last] for name in samples])
    first, last = stamps.min(axis=0), stamps.max(axis=0)
    spread, lag = (last - first).max(), (arrivals[:, -1] - arrivals[:, 0]).max()
    if (
        first[0] <= pace.newest
        or (first[1:] <= last[:-1]).any()
        or np.diff(last, prepend=pace.newest).max() > pace.max_gap
        or np.diff(arrivals.ravel(), prepend=assembler.arrival).min() < 0
        or spread > pace.reset_jump
    ):
        return None
    course = _Course(pace, list(sources.values()), stamps.tolist(), intervals.tolist())
    if (
        course.longest > 1.5 * course.shortest  # a slower sensor
        or spread > min(course.tolerance, course.wait)
        or (block.hall is not None and lag > course.tolerance)
        or intervals.max() > course.wait + 2 * course.shortest  # a silent sensor
        or intervals.max() + spread > GONE * course.shortest
        or intervals.min() < QUICK * course.longest  # perhaps of two publishers
        or not all(
            _note_readings(sources[name], channels[name], samples[name], row)
            for row, name in zip(stamps, samples, strict=True)
        )
    ):
        return None
    pace.newest = int(last[-1])
    recording = _recording(channels, block, first, np.array(course.periods))
    assembler.carry_on(pace, sources, len(recording), int(first[-1]), int(arrivals[-1, -1]))
    if block.hall is not None:
        before = np.flatnonzero(block.hall[1] < block.first)
        assembler.hall.pass_by(len(first), len(first) - 1 - int(before[-1]) if before.size else len(first))
    assembler.quality.add_recording(recording)
    return recording


def _sound(channel: Channel, samples: Samples) -> bool:
    """Whether all values in use are finite, plausible, and far from the full scale."""
    return (not channel.gyro or _below(samples.gyro, channel.gyro_limit)) and (
        not channel.accel or _below(samples.accel, channel.accel_limit)
    )


def _below(rows: FloatArray, limit: float) -> bool:
    x, y, z = np.abs(rows.T)
    return bool((x + y + z < limit).all())


def _sound_hall(queue: HallQueue, block: Block) -> bool:
    if block.hall is None or not queue.width:
        return block.hall is None and not queue.width
    voltages, _ = block.hall
    return (
        queue.per_frame
        and voltages.shape[1] == queue.width
        and not (np.abs(voltages) > IMPLAUSIBLE_VOLTAGE).any()
        and not np.isnan(voltages).all(axis=1).any()  # in a `Recording` that is no message at all
    )


class _Course:
    """Carries the pace of the stream and its sensors through a block.

    Attributes:
        periods: of the stream, s, at each frame.
        shortest, longest: period of any sensor meanwhile, ns.
        tolerance, wait: the smallest that there were meanwhile, ns.
    """

    def __init__(self, pace: Pace, sources: list[Source], stamps: list[list[int]], intervals: list[list[int]]) -> None:
        count = len(stamps[0])
        self.periods: list[float] = []
        self.shortest = self.longest = pace.period
        self.tolerance, self.wait = pace.tolerance, pace.wait
        self._note(pace, sources)
        found_anew: dict[int, list[int]] = {}  # row -> number of the sensors whose period is found anew with it
        for number, source in enumerate(sources):
            for row in range(INTERVALS - 1 - len(source.intervals), count, INTERVALS):
                found_anew.setdefault(row, []).append(number)
        taken = [0] * len(sources)
        for row in sorted(found_anew):
            self.periods += [pace.period * 1e-9] * (row - len(self.periods))
            for number in found_anew[row]:
                source, source_stamps, source_intervals = sources[number], stamps[number], intervals[number]
                source.intervals += source_intervals[taken[number] : row]
                taken[number] = row + 1
                source.last = source_stamps[row] - source_intervals[row]
                source.accept(source_stamps[row])
            for source, source_stamps in zip(sources, stamps, strict=True):
                source.last = pace.newest = source_stamps[row]
            pace.follow(sources)
            self._note(pace, sources)
        self.periods += [pace.period * 1e-9] * (count - len(self.periods))
        for number, source in enumerate(sources):
            source.intervals += intervals[number][taken[number] :]
            source.last = stamps[number][-1]
            source.received += count
            source.used += count

    def _note(self, pace: Pace, sources: list[Source]) -> None:
        periods = [source.period for source in sources]
        self.shortest, self.longest = min(self.shortest, *periods), max(self.longest, *periods)
        self.tolerance, self.wait = min(self.tolerance, pace.tolerance), min(self.wait, pace.wait)


def _note_readings(source: Source, channel: Channel, samples: Samples, stamps: IntArray) -> bool:
    """`Source.repeats` for all samples; False where one of them may be frozen."""
    if not channel.gyro or source.reading is None:
        return not channel.gyro
    gyro, accel = source.reading
    readings = np.vstack([gyro, samples.gyro])
    if accel is not None:
        readings = np.hstack([readings, np.vstack([accel, samples.accel])])
    new = np.flatnonzero((readings[1:] != readings[:-1]).any(axis=1)) + 1
    since = np.append(source.held_from, stamps)
    starts, ends = since[np.append(0, new)], since[np.append(new, len(readings)) - 1]
    if (ends - starts).max() >= FROZEN_AFTER and np.abs(samples.gyro).max() > FROZEN_TURNS:
        return False
    if not new.size:
        source.held += len(stamps)
        return True
    row = int(new[-1]) - 1
    source.reading = vec3(samples.gyro[row]), vec3(samples.accel[row]) if channel.accel else None
    source.held_from, source.held = int(stamps[row]), len(stamps) - 1 - row
    return True


def _recording(channels: Mapping[str, Channel], block: Block, stamps: IntArray, period: FloatArray) -> Recording:
    gyro, accel = {}, {}
    for name, samples in block.samples.items():
        channel = channels[name]
        if channel.gyro:
            gyro[name] = samples.gyro if channel.gyro_scale is None else samples.gyro * channel.gyro_scale
        if channel.accel:
            calibration, columns = channel.accel_calibration, tuple(samples.accel.T)
            accel[name] = samples.accel if calibration is None else np.array(calibrated(columns, *calibration)).T
    hall = None if block.hall is None else block.hall[0]
    return Recording(stamps, gyro, accel, {}, hall, period, np.zeros(len(stamps), dtype=bool))
