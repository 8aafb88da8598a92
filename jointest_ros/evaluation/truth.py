"""Ground truth as arrays, and the matching of estimates to it by stamp."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray


@dataclass
class Truth:
    """What was measured or simulated beside the sensors. Rows of NaN: that sample says nothing of this joint.

    Attributes:
        stamps: (N,) ns, increasing, of the joint samples.
        position: joint -> (N,) rad.
        velocity: joint -> (N,) rad/s.
        orientation: sensor -> ((M,) ns, (M, 4) quaternion x, y, z, w, sensor to world).
    """

    stamps: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    position: dict[str, FloatArray] = field(default_factory=dict)
    velocity: dict[str, FloatArray] = field(default_factory=dict)
    orientation: dict[str, tuple[NDArray[np.int64], FloatArray]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(len(self.stamps) or self.orientation)


def match(stamps: NDArray[np.int64], truth_stamps: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(rows of the estimate, rows of the truth) that belong together: the nearest, within half a truth period.

    Both stamp arrays increase. The truth period is the median of its intervals.
    """
    if not len(stamps) or not len(truth_stamps):
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    after = np.searchsorted(stamps, truth_stamps).clip(1, max(len(stamps) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(stamps) - 1)
    nearest = np.where(abs(truth_stamps - stamps[before]) <= abs(stamps[after] - truth_stamps), before, after)
    period = float(np.median(np.diff(truth_stamps))) if len(truth_stamps) > 1 else 0.0
    close = np.flatnonzero(abs(stamps[nearest] - truth_stamps) <= 0.5 * period)
    return nearest[close], close
