"""What the frame assembler keeps of its inputs: counters and period of each, and waiting Hall messages."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median

from jointest_ros.core.frame import Vec3

NEVER = -(1 << 62)  # ns, before every stamp
INTERVALS = 31  # intervals behind one estimate of the period
_FIRST_INTERVALS = 5
_REGULAR = 20  # frames in a row
FROZEN_AFTER = 100_000_000  # ns; drivers that send faster than their sensor measures repeat a reading for less
_FROZEN_FEWEST = 5  # samples
FROZEN_TURNS = 0.2  # rad/s: a link at rest may repeat its reading for hours
IMPLAUSIBLE_VOLTAGE = 1e3  # V
QUICK = 0.6  # of a period: of two streams of one rate, in whatever phase, some samples follow so soon
_MIXED_WINDOW = 10  # samples
_MIXED_SPAN = 0.75  # of the time that so many samples of one stream take; two streams take half
_ALTERNATES = 3.0  # noise gives 1, a smooth motion .5
_MIXED_LONGEST = 1_000_000_000  # ns after which a stream that does not alternate is one of another rate


class Mixture:
    """Whether the samples of an IMU are those of two, by turns: somebody else sends on its topic.

    That is: they come about twice as often as they used to, and they alternate, so that each is nearer to the last but
    one than to the last. Nobody can tell then which of them are right. One stream again: they come as they used to.

    Args:
        period: of the stream until now, ns.

    Attributes:
        mixed: two streams.
        over: it is one stream (again).
    """

    def __init__(self, period: int) -> None:
        self.period = period
        self.mixed = self.over = False
        self._samples: deque[tuple[int, Vec3, Vec3]] = deque(maxlen=_MIXED_WINDOW)
        self._alternated: int | None = None  # ns, stamp when it was last found to, or of the first sample
        self._looked_so = False  # it was found to at the look before: once is chance
        self._new = 0

    def add(self, stamp: int, gyro: Vec3, accel: Vec3) -> None:
        """Take every sample."""
        samples = self._samples
        samples.append((stamp, gyro, accel))
        self._new += 1
        if self._alternated is None:
            self._alternated = stamp
        if len(samples) < _MIXED_WINDOW:
            return
        if stamp - samples[0][0] > _MIXED_SPAN * (_MIXED_WINDOW - 1) * self.period:
            self.over = True
        elif self._new >= _MIXED_WINDOW // 2:
            self._new = 0
            _, gyro_readings, accel_readings = zip(*samples, strict=True)
            if _alternate(gyro_readings) or _alternate(accel_readings):
                self.mixed, self._alternated = self.mixed or self._looked_so, stamp
                self._looked_so = True
            else:
                self._looked_so = False
                self.over = stamp - self._alternated > _MIXED_LONGEST


def _alternate(readings: Sequence[Vec3]) -> bool:
    steps = sum(map(math.dist, readings[1:], readings)) / (len(readings) - 1)
    return steps > _ALTERNATES * sum(map(math.dist, readings[2:], readings)) / (len(readings) - 2)


@dataclass(slots=True)
class Source:
    """What one input delivered: `received == used + sum(refused.values()) +` samples that still wait."""

    received: int = 0
    used: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    last: int = NEVER  # ns, newest stamp
    period: int = 0  # ns; 0: not known yet
    gaps: int = 0  # intervals of more than 1.5 periods; counted when the period is found
    intervals: list[int] = field(default_factory=list)
    reading: tuple[Vec3, Vec3 | None] | None = None  # newest one of an IMU
    held_from: int = 0  # ns, stamp with which it came first
    held: int = 0  # how often it has come again
    mixture: Mixture | None = None  # since samples have come too soon after one another

    def repeats(self, stamp: int, gyro: Vec3, accel: Vec3 | None) -> bool:
        """Whether an IMU is frozen: it repeats a turning reading to the last bit, for longer than drivers do."""
        reading = (gyro, accel)
        if reading != self.reading:
            self.reading, self.held_from, self.held = reading, stamp, 0
            return False
        self.held += 1
        return (
            self.held >= _FROZEN_FEWEST
            and stamp - self.held_from >= FROZEN_AFTER
            and max(map(abs, gyro)) > FROZEN_TURNS
        )

    def become(self, other: Source) -> None:
        """Take over all that the other one has."""
        for name in self.__slots__:
            setattr(self, name, getattr(other, name))

    def accept(self, stamp: int) -> bool:
        """Note a newer stamp. True when the period was found anew."""
        intervals = self.intervals
        if self.last != NEVER:
            intervals.append(stamp - self.last)
        self.last = stamp
        if len(intervals) < (INTERVALS if self.period else _FIRST_INTERVALS):
            return False
        # Lost samples make intervals of two periods and more: the median of those that are near the shorter ones.
        shorter = sorted(intervals)[len(intervals) // 4]
        self.period = round(median([one for one in intervals if one < 1.5 * shorter]))
        self.gaps += sum([one > 1.5 * self.period for one in intervals])
        intervals.clear()
        return True


class HallQueue:
    """Hall messages by arrival, ns: they have no stamp of their own.

    Attributes:
        width: voltages in a message; 0 where the robot has no Hall sensors.
        per_frame: every frame takes the message that arrived within a tolerance of its own first sample, and waits for
            it. Without it the newest message is used, once.
        added: messages that came so far.
    """

    def __init__(self, width: int, per_frame: bool) -> None:
        self.width, self.per_frame = width, per_frame
        self.source = Source()
        self.added = 0
        self._after = 0  # frames in a row whose message came after their first sample
        self._waiting: deque[tuple[int, tuple[float, ...]]] = deque()

    def add(self, voltages: tuple[float, ...], arrival: int, oldest: int) -> bool:
        """Take a message; False where it is refused. Waiting ones that arrived before `oldest` are dropped."""
        source = self.source
        source.received += 1
        if len(voltages) != self.width:
            source.refused["wrong length"] += 1
            return False
        if [v for v in voltages if abs(v) > IMPLAUSIBLE_VOLTAGE]:
            source.refused["not finite" if any(map(math.isinf, voltages)) else "implausible"] += 1
            return False
        self.drop_before(oldest if self.per_frame else None)
        self._waiting.append((arrival, voltages))
        self.added += 1
        return True

    def pass_by(self, count: int, follow: int) -> None:
        """After so many messages, one a frame, that did not wait here; of the last ones `follow` followed in a row."""
        self._after = follow if follow < count else self._after + count
        self.added += count
        self.source.received += count
        self.source.used += count

    def refuse(self, cause: str) -> None:
        """A message that is not looked at."""
        self.source.received += 1
        self.source.refused[cause] += 1

    @property
    def follows(self) -> bool:
        """Messages regularly come after the first sample of their frame.

        Then that order tells of which frame one is, until the next frame begins, however late a busy machine takes it.
        """
        return self._after >= _REGULAR

    def take(self, arrival: int, tolerance: int, added: int, before_next: int | None) -> tuple[float, ...] | None:
        """The message for a frame whose first sample came at `arrival`, after `added` messages; too old ones go.

        `before_next`: how many messages had come when the next frame began; None: it has not begun.
        """
        waiting = self._waiting
        if self.per_frame:
            self.drop_before(arrival - tolerance)
            while len(waiting) > 1 and abs(waiting[1][0] - arrival) <= abs(waiting[0][0] - arrival):
                self._drop()  # the next one is nearer
            ours = self.follows and (before_next is None or self.added - len(waiting) < before_next)
            if waiting and waiting[0][0] > arrival + tolerance and not ours:
                return None
        if not waiting:
            return None
        self._after = self._after + 1 if self.added - len(waiting) >= added else 0
        self.source.used += 1
        return waiting.popleft()[1]

    @property
    def waits(self) -> bool:
        """There is a message for a frame."""
        return bool(self._waiting)

    @property
    def awaited(self) -> bool:
        """A frame without its message should wait for it: none is here."""
        return self.width > 0 and self.per_frame and not self._waiting

    def drop_before(self, arrival: int | None) -> None:
        """Give up the messages that arrived before `arrival`; None: all."""
        while self._waiting and (arrival is None or self._waiting[0][0] < arrival):
            self._drop()

    def _drop(self) -> None:
        self._waiting.popleft()
        self.source.refused["unpaired"] += 1
