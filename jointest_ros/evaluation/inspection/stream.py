"""The messages of one inertial sensor as they were recorded: rate, gaps, order, clock, values that are none."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.errors import counted
from jointest_ros.core.frame import FloatArray, Recording
from jointest_ros.core.timing import GAP, Timing, jitter, rising
from jointest_ros.evaluation.inspection.findings import LOOK, WRONG, Finding, at

_LOST = 0.01  # share of samples, worth a word
_SEVERE = 0.2  # share: estimates suffer
_JITTER = 0.2  # share of the period
_CLOCK_RATE = 0.02  # by which stamps and record times may run apart: more than any crystal, and a start-up burst
_CLOCK_OFFSET = 1.0  # s
_LATER = 1.0  # s, that a sensor may begin later or end earlier than the recording
_FEW = 10  # samples that say anything


@dataclass(frozen=True)
class Stream:
    """T messages of one topic with one frame id, in the order in which they were recorded.

    Attributes:
        stamps, recorded: (T,) ns, by the sensor's clock and by the recorder's.
        gyro, accel: (T, 3) as sent.
        has_orientation: the driver sends an orientation too, which is not used.
    """

    topic: str
    frame_id: str
    stamps: NDArray[np.int64]
    recorded: NDArray[np.int64]
    gyro: FloatArray
    accel: FloatArray
    has_orientation: bool = False

    def __len__(self) -> int:
        return len(self.stamps)

    @cached_property
    def rising(self) -> NDArray[np.bool_]:
        """(T,) stamps that are newer than all before."""
        return rising(self.stamps)

    @cached_property
    def intervals(self) -> FloatArray:
        """Between rising stamps, s."""
        return np.asarray(np.diff(self.stamps[self.rising]) * 1e-9)

    @cached_property
    def period(self) -> float:
        """Without losses, s; NaN where there are too few samples."""
        return float(np.median(self.intervals)) if len(self.intervals) >= _FEW else math.nan

    @cached_property
    def jitter(self) -> float:
        """Of the intervals without losses, s; see `jitter`."""
        return jitter(self.intervals, self.period)

    def sound(self, gyro: bool, accel: bool) -> Stream:
        """Only the messages with rising stamps and finite values in the fields that are in use."""
        kept = self.rising.copy()
        for used, table in ((gyro, self.gyro), (accel, self.accel)):
            if used:
                kept &= np.isfinite(table).all(axis=1)
        return self._rows(kept)

    def _rows(self, kept: NDArray[np.bool_]) -> Stream:
        return replace(
            self, stamps=self.stamps[kept], recorded=self.recorded[kept], gyro=self.gyro[kept], accel=self.accel[kept]
        )

    def without(self, runs: Sequence[tuple[int, int]]) -> Stream:
        """Without these rows, first and last of each run."""
        kept = np.ones(len(self), dtype=bool)
        for first, last in runs:
            kept[first : last + 1] = False
        return self._rows(kept)

    def as_recording(self, sensor: str) -> Recording:
        """Of this sensor alone; the stamps must be rising."""
        return Recording(self.stamps, {sensor: self.gyro}, {sensor: self.accel})


def timing_findings(stream: Stream, subject: str, timing: Timing, span: tuple[int, int]) -> Iterator[Finding]:
    """What is wrong with when the messages came.

    Args:
        timing: of the configuration, or the defaults.
        span: record times of the first and of the last message of the recording, ns.
    """
    if not len(stream):
        yield Finding(WRONG, subject, "rate", "no message", "start its driver before recording")
        return
    if len(stream) > 1 and (stream.stamps == stream.stamps[0]).all():
        text = f"all stamps are {stream.stamps[0] * 1e-9:g} s"
        yield Finding(
            WRONG, subject, "clock", text, "let the driver fill header.stamp; nothing can be estimated without"
        )
        return
    if math.isnan(stream.period):
        yield Finding(WRONG, subject, "rate", f"{counted(len(stream), 'message')} only", "record longer")
        return
    yield from _order(stream, subject)
    yield from _gaps(stream, subject, timing, span)
    yield from _clock(stream, subject)
    if stream.jitter > _JITTER * stream.period:
        text = f"stamps jitter by {stream.jitter * 1e3:.2f} ms at {1.0 / stream.period:.4g} Hz"
        action = "stamp samples when they are taken (data-ready interrupt), not when they are sent"
        yield Finding(LOOK, subject, "jitter", text, action)


def _order(stream: Stream, subject: str) -> Iterator[Finding]:
    steps = np.diff(stream.stamps)
    repeated, back = int(np.sum(steps == 0)), int(np.sum(steps < 0))
    for count, what, action in (
        (
            repeated,
            "repeat the stamp before",
            "two publishers on one topic, or a driver that sends twice? They are refused",
        ),
        (back, "have an older stamp than the one before", "two publishers on one topic, or a clock that was set?"),
    ):
        if count:
            share = count / len(stream)
            level = WRONG if share > _SEVERE else LOOK
            yield Finding(level, subject, "order", f"{counted(count, 'message')} ({share:.1%}) {what}", action)


def _gaps(stream: Stream, subject: str, timing: Timing, span: tuple[int, int]) -> Iterator[Finding]:
    times = stream.stamps[stream.rising]
    longest = max(timing.max_gap, GAP * stream.period)  # that is no gap
    long = np.flatnonzero(stream.intervals > longest)
    if len(long):
        worst = int(long[np.argmax(stream.intervals[long])])
        when = at((times[worst] - stream.stamps[0]) * 1e-9)
        more = f", {len(long)} gaps longer than {longest:.3g} s" if len(long) > 1 else ""
        text = f"silent for {stream.intervals[worst]:.2f} s at {when}{more}"
        action = "cable, bus or driver? The angle is extrapolated there and flagged GAP"
        level = WRONG if stream.intervals[long].sum() > _SEVERE * (times[-1] - times[0]) * 1e-9 else LOOK
        yield Finding(level, subject, "gap", text, action)
    short = stream.intervals[stream.intervals <= timing.max_gap]
    lost = int(np.sum(np.maximum(np.round(short / stream.period) - 1.0, 0.0)))
    if lost > _LOST * len(stream):
        share = lost / (lost + len(stream))
        text = f"{lost} samples ({share:.1%}) are missing in between"
        action = "a busy bus or a best-effort link? Record on the machine that the sensors are connected to"
        yield Finding(WRONG if share > _SEVERE else LOOK, subject, "loss", text, action)
    late, early = ((stream.recorded[0] - span[0]) * 1e-9, (span[1] - stream.recorded[-1]) * 1e-9)
    for seconds, what in ((late, "begins {} after the recording"), (early, "ends {} before the recording")):
        if seconds > _LATER + 2.0 * stream.period:
            yield Finding(LOOK, subject, "gap", what.format(at(seconds)), "was its driver running all the time?")


def _clock(stream: Stream, subject: str) -> Iterator[Finding]:
    kept = stream.rising
    stamps, recorded = stream.stamps[kept], stream.recorded[kept]
    lag = (recorded - stamps) * 1e-9
    ran = (recorded[-1] - recorded[0]) * 1e-9
    edge = max(1, len(lag) // 20)
    apart = float(np.median(lag[-edge:]) - np.median(lag[:edge]))
    if ran > 2.0 and abs(apart) > max(_CLOCK_RATE * ran, 0.05):
        ratio = (stamps[-1] - stamps[0]) * 1e-9 / ran
        text = f"stamps advance {ratio:.3f} s in a second of recording"
        action = (
            "a driver that counts samples at another rate than it has, or a clock that was set? Rates are divided by "
            "these stamps. (All is well when a simulation was recorded at another speed.)"
        )
        yield Finding(WRONG if not 0.8 < ratio < 1.25 else LOOK, subject, "clock", text, action)
    elif abs(float(np.median(lag))) > _CLOCK_OFFSET:
        where = "behind" if np.median(lag) > 0 else "ahead of"
        text = f"stamps are {abs(float(np.median(lag))):.1f} s {where} the recorder's clock"
        action = "a clock of the sensor's own does no harm, as long as all sensors have it"
        yield Finding(LOOK, subject, "clock", text, action)


def lags(stream: Stream) -> float:
    """Median of record time less stamp, s."""
    return float(np.median(stream.recorded - stream.stamps)) * 1e-9
