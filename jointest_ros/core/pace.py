"""How fast a stream of samples goes, and the tolerances in time that follow from that."""

from __future__ import annotations

from collections.abc import Collection

from jointest_ros.core.assembler_inputs import NEVER, Source
from jointest_ros.core.timing import Timing

GONE = 10  # periods after which a silent sensor says nothing about the period of the stream
_MIN_WAIT = 20_000_000  # ns
_FIRST_TOLERANCE = 400_000  # ns, while the period is unknown: less than half a period at 1 kHz


class Pace:
    """The period of a stream, which is that of its fastest sensor, and what follows from it; all in ns.

    Attributes:
        newest: newest accepted stamp of any sensor.
        period: 0: not known yet.
        tolerance: within which samples belong to one frame.
        wait: by which the stream may run ahead of a frame that lacks a sample.
        max_gap, reset_jump: of `timing`.
        farthest: a stamp that is ahead by more must be confirmed.
    """

    def __init__(self, timing: Timing) -> None:
        self._sync_tolerance, self._max_wait = round(timing.sync_tolerance * 1e9), round(timing.max_wait * 1e9)
        self.max_gap, self.reset_jump = round(timing.max_gap * 1e9), round(timing.reset_jump * 1e9)
        self.newest = NEVER
        self.period = 0
        self.follow(())

    def follow(self, sources: Collection[Source]) -> None:
        """Take the period from the sensors that are present."""
        present = [s.period for s in sources if s.period and self.newest - s.last <= GONE * s.period]
        if present:
            self.period = min(present)
        half = self.period // 2 or _FIRST_TOLERANCE
        self.tolerance = min(self._sync_tolerance, half) if self._sync_tolerance else half
        self.wait = self._max_wait or max(3 * self.period, _MIN_WAIT)
        self.farthest = max(self.max_gap, 3 * self.period)
