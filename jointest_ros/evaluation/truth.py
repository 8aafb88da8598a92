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
        movement: (stamp ns, whether it moves from then on), in the order of time; empty where nobody says so.
    """

    stamps: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    position: dict[str, FloatArray] = field(default_factory=dict)
    velocity: dict[str, FloatArray] = field(default_factory=dict)
    orientation: dict[str, tuple[NDArray[np.int64], FloatArray]] = field(default_factory=dict)
    movement: tuple[tuple[int, bool], ...] = ()

    def __bool__(self) -> bool:
        return bool(len(self.stamps) or self.orientation)

    def while_moving(self) -> Truth:
        """Only the samples at which it moves."""
        changes = np.array([stamp for stamp, _ in self.movement], dtype=np.int64)
        moves = np.array([False, *(value for _, value in self.movement)])

        def kept(stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
            return np.asarray(moves[np.searchsorted(changes, stamps, side="right")])

        rows = kept(self.stamps)
        return Truth(
            self.stamps[rows],
            {joint: values[rows] for joint, values in self.position.items()},
            {joint: values[rows] for joint, values in self.velocity.items()},
            {sensor: (t[kept(t)], values[kept(t)]) for sensor, (t, values) in self.orientation.items()},
            self.movement,
        )


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
