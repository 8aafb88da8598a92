"""What the frame assembler keeps of its inputs: counters and period of each, and waiting Hall messages."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field
from statistics import median

NEVER = -(1 << 62)  # ns, before every stamp
_INTERVALS = 31  # intervals behind one estimate of the period
_FIRST_INTERVALS = 5
_REGULAR = 20  # frames in a row
_IMPLAUSIBLE_VOLTAGE = 1e3  # V


@dataclass(slots=True)
class Source:
    """What one input delivered: `received == used + sum(refused.values()) +` samples that still wait."""

    received: int = 0
    used: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    last: int = NEVER  # ns, newest stamp
    period: int = 0  # ns; 0: not known yet
    intervals: list[int] = field(default_factory=list)

    def accept(self, stamp: int) -> bool:
        """Note a newer stamp. True when the period was found anew."""
        intervals = self.intervals
        if self.last != NEVER:
            intervals.append(stamp - self.last)
        self.last = stamp
        if len(intervals) < (_INTERVALS if self.period else _FIRST_INTERVALS):
            return False
        # Lost samples make intervals of two periods and more: the median of those that are near the shorter ones.
        shorter = sorted(intervals)[len(intervals) // 4]
        self.period = round(median([one for one in intervals if one < 1.5 * shorter]))
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
        if any(abs(v) > _IMPLAUSIBLE_VOLTAGE for v in voltages):
            source.refused["not finite" if any(map(math.isinf, voltages)) else "implausible"] += 1
            return False
        self.drop_before(oldest if self.per_frame else None)
        self._waiting.append((arrival, voltages))
        self.added += 1
        return True

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
