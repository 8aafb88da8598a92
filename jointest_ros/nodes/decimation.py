"""Limits a rate of output by the stamps: exact in the long run whatever the input rate, the same in every replay."""

from __future__ import annotations

from fractions import Fraction

_NS = 1_000_000_000


class Decimation:
    """Lets one estimate pass in each interval of 1 / `rate_hz`: the one nearest to where the interval begins."""

    def __init__(self, rate_hz: float) -> None:
        rate = Fraction(rate_hz).limit_denominator(1000)
        self._numerator, self._denominator = rate.numerator, rate.denominator * _NS
        self._start = 0  # ns, stamp with which interval 0 begins
        self._interval = -1

    def passes(self, stamp: int, period: float) -> bool:
        """Whether an estimate at `stamp` ns is put out; `period` s of the stream, NaN while it is unknown."""
        # half a period: stamps that scatter about the border of an interval are not on either side of it by chance
        elapsed = stamp - self._start + (round(0.5 * _NS * period) if period == period else 0)
        interval = elapsed * self._numerator // self._denominator
        if interval == self._interval:
            return False
        if interval < self._interval or self._interval < 0:  # the first one, also after the clock was set back
            self._start, interval = stamp, 0
        self._interval = interval
        return True
