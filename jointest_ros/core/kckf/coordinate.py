"""What the filters keep of one coordinate besides its state: a silent gyro, lost frames, and when Hall was last of use.

A sample that is missing for up to `max_gap` is bridged: the rate is held, Hall readings wait, and when the next sample
comes the angle is corrected by the trapezoid between the two. What is missing for longer is unknown: it adds
`gap_rate`^2 t^2 to the variance (a rate that keeps for `max_gap` after that), and Hall readings alone carry the angle.
What was measured just before may have been wrong already (a driver that dies, two streams that the assembler needs a
tenth of a second to tell apart), and a bias learned from that is unlearned slowly: that of LOOK_BACK before is taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from jointest_ros.core.frame import Status
from jointest_ros.core.timing import Timing

UNKNOWN = math.pi**2  # rad^2, variance of an angle of which nothing is known
LOOK_BACK = 0.25  # s; what is remembered is once to twice as old
_TRAPEZOID = 1.0 / 8.0  # share of the change of rate over a bridged gap that is taken as its standard deviation
_NO_DATA, _GAP, _STALE, _STARTING = int(Status.NO_DATA), int(Status.GAP), int(Status.STALE), int(Status.STARTING)
_UNOBSERVABLE, _DISTURBED = int(Status.UNOBSERVABLE), int(Status.DISTURBED)


@dataclass(frozen=True)
class GapRule:
    """How time without data is treated."""

    gap_rate: float  # rad/s, standard deviation of a rate that nobody measured
    max_gap: float  # s
    stale_after: float  # s

    @classmethod
    def of(cls, timing: Timing, gap_rate_dps: float) -> GapRule:
        """From the settings of a user."""
        return cls(math.radians(gap_rate_dps), timing.max_gap, timing.stale_after)


class Coordinate:
    """Bookkeeping of one coordinate.

    Attributes:
        rate: newest gyro rate, rad/s, with its bias; held while samples are missing.
        missing: s since the last sample.
        waiting: Hall readings are not used, a sample may yet come.
        blind: s since the last usable Hall reading.
        started: there was one, or none is expected.
        lost: with this step it was missing for longer than `max_gap`, for the first time.
    """

    def __init__(self, rule: GapRule, hall: bool) -> None:
        self.rule = rule
        self.hall = hall
        self.restart()

    def restart(self) -> None:
        """Before the first frame."""
        self.rate = 0.0
        self.missing = 0.0
        self.waiting = False
        self.blind = 0.0
        self.started = not self.hall
        self.lost = False

    def bridge(self, rate: float, dt: float, gap: float) -> tuple[float, float, float, int]:
        """(rate to predict with, shift of the angle rad, added variance rad^2, status) for a step of `dt` s.

        `rate` is NaN where a gyro is missing, and comes back as NaN when it has been for too long; `gap` s of `dt` lie
        before the interval that the sample covers.
        """
        rule, held = self.rule, self.rate
        if rate == rate:
            silent, self.missing, self.waiting = self.missing, 0.0, False
            self.rate = rate
            unknown = silent + gap
            self.lost = silent <= rule.max_gap < unknown
            if unknown <= rule.max_gap:
                spread = _TRAPEZOID * (rate - held) * unknown
                return rate, 0.5 * (rate - held) * (silent - gap), spread * spread, 0
            if silent > rule.max_gap:  # its variance is in already
                unknown = gap
            return rate, 0.0, min((rule.gap_rate * unknown) ** 2, UNKNOWN), _GAP if unknown else 0
        before = self.missing
        self.missing = before + dt
        self.lost = before <= rule.max_gap < self.missing
        flags = _NO_DATA | (_STALE if self.missing > rule.stale_after else 0)
        if self.missing <= rule.max_gap:
            self.waiting = True
            return held, 0.0, 0.0, flags
        self.waiting = False
        unknown = self.missing if before <= rule.max_gap else math.sqrt(dt * rule.max_gap)
        return math.nan, 0.0, min((rule.gap_rate * unknown) ** 2, UNKNOWN), flags | _GAP

    def without_hall(self, dt: float, present: bool) -> int:
        """Status of a step in which no Hall reading was used; `present`: there was one, but clipped."""
        self.blind += dt
        if not self.hall:
            return _UNOBSERVABLE
        flags = _DISTURBED if present else _NO_DATA
        if not self.started:
            flags |= _STARTING
        return flags | _UNOBSERVABLE if self.blind > self.rule.stale_after else flags

    def get_state(self) -> list[Any]:
        """All that changes."""
        return [self.rate, self.missing, self.waiting, self.blind, self.started]

    def set_state(self, state: list[Any]) -> None:
        """Continue from `get_state`."""
        self.rate, self.missing, self.waiting, self.blind, self.started = state
