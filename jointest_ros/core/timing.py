"""How samples become frames in time: the settings that the frame assembler and the estimators share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.params import Params, param

GAP = 1.5  # usual intervals: a longer one lacks a sample


@dataclass(frozen=True)
class Timing(Params):
    """The `timing:` section of a configuration. All times are sensor time unless said."""

    sync_tolerance: float = param(
        0.0,
        "samples within this time of the earliest one make one frame, Hall messages are paired within it by arrival; "
        "at most half the period of the stream, which is also meant by 0",
        unit="s",
        low=0.0,
        high=1.0,
    )
    max_wait: float = param(
        0.0,
        "how far the stream may run ahead of a frame that waits for a missing sensor; 0: three periods, at least 20 ms",
        unit="s",
        low=0.0,
        high=10.0,
    )
    max_gap: float = param(
        0.2,
        "a longer gap between samples is flagged and bridged with grown variance; a stamp further ahead must be "
        "confirmed by a second one",
        unit="s",
        low=0.001,
        high=60.0,
    )
    reset_jump: float = param(
        1.0,
        "a confirmed jump of the stamps by more than this, back or forward, restarts the estimators",
        unit="s",
        low=0.01,
        high=3600.0,
    )
    stale_after: float = param(
        0.5, "a joint without data for longer than this is left out of joint_states", unit="s", low=0.001, high=3600.0
    )
    hall_per_frame: bool = param(
        True,
        "every frame waits for its Hall message; false (Hall slower than the IMUs): the newest reading is used once",
    )


def rising(stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N,) mask of the stamps (ns) that are newer than all before them."""
    before = np.append(np.iinfo(np.int64).min, np.maximum.accumulate(stamps)[:-1])
    return np.asarray(stamps > before)


def jitter(intervals: NDArray[np.float64], usual: float) -> float:
    """Half of the range that two thirds of the intervals without losses are in; NaN where there are none.

    A few late messages, of which a standard deviation would tell, do not count.

    Args:
        intervals: (N,) s; `usual`: the one without losses, s.
    """
    whole = intervals[intervals <= GAP * usual]
    return float(np.subtract(*np.quantile(whole, [0.84, 0.16])) / 2.0) if len(whole) else float("nan")
