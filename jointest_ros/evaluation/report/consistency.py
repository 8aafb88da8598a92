"""Whether estimators know how wrong they are: NIS and NEES over time, with the bounds of chi-square.

Bar-Shalom, Li, Kirubarajan 2001, Estimation with Applications to Tracking and Navigation, 5.4. Both are divided by
their degrees of freedom here: 1 is right, more means that the stated variances are too small.

The innovations of a consistent filter are white: the bounds of a stretch are those of all its innovations. Errors of
successive estimates are the same error for a while: the bounds of a stretch are those of a single sample.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from jointest_ros.core.frame import FloatArray, Series
from jointest_ros.evaluation.metrics import after, joint_error
from jointest_ros.evaluation.truth import Truth

PROBABILITY = 0.95  # of the bounds
_STRETCHES = 300  # in which a recording is shown
_SHORTEST_S = 0.1


@dataclass(frozen=True)
class Innovations:
    """Normalised innovations of one estimator.

    Attributes:
        stamps: (T,) ns, of the frames.
        squares: (T,) sum of their squares.
        used: (T,) how many there were.
        values: (K,) all of them.
    """

    stamps: NDArray[np.int64]
    squares: FloatArray
    used: NDArray[np.int64]
    values: FloatArray

    @classmethod
    def from_rows(cls, stamps: Sequence[int], rows: Sequence[Sequence[float]]) -> Innovations:
        """Of frames: the innovations of each, NaN where a reading was not used."""
        used = [[value for value in row if value == value] for row in rows]
        return cls(
            np.array(stamps, dtype=np.int64),
            np.array([sum(value * value for value in row) for row in used], dtype=float),
            np.array([len(row) for row in used], dtype=np.int64),
            np.array([value for row in used for value in row], dtype=float),
        )

    @classmethod
    def concatenate(cls, parts: Sequence[Innovations]) -> Innovations:
        """Join consecutive stretches, at least one."""
        stamps, squares, used, values = zip(
            *((part.stamps, part.squares, part.used, part.values) for part in parts), strict=True
        )
        return cls(np.concatenate(stamps), np.concatenate(squares), np.concatenate(used), np.concatenate(values))


@dataclass(frozen=True)
class Course:
    """NIS or NEES by stretches of time, (S,) each.

    Attributes:
        seconds: middle of the stretch, after the first truth sample.
        ratio: mean square over degrees of freedom.
        low, high: between which it is with `PROBABILITY`, if the estimator is consistent.
    """

    seconds: FloatArray
    ratio: FloatArray
    low: FloatArray
    high: FloatArray

    @property
    def inside(self) -> float:
        """Share of the stretches within the bounds."""
        return float(np.mean((self.low <= self.ratio) & (self.ratio <= self.high)))


def nis_course(innovations: Innovations, zero: int, skip_s: float = 0.0) -> Course | None:
    """NIS over time, from `skip_s` after the stamp `zero` (ns) on; None without innovations."""
    counted = (innovations.used > 0) & (innovations.stamps - zero >= skip_s * 1e9)
    if not counted.any():
        return None
    seconds = np.asarray((innovations.stamps[counted] - zero) * 1e-9)
    squares, used = innovations.squares[counted], innovations.used[counted]
    return _course(seconds, squares, used, independent=True)


def nees_course(
    series: Series, joints: tuple[str, ...], truth: Truth, skip_s: float, continuous: frozenset[str]
) -> Course | None:
    """NEES of the joint angles over time, of variances alone (not of covariances); None where none is reported."""
    squares, used = np.zeros(len(truth.stamps)), np.zeros(len(truth.stamps), dtype=np.int64)
    for column, joint in enumerate(joints):
        error = joint_error(series, column, truth, joint, skip_s, wrapped=joint in continuous)
        if error is None:
            continue
        variance = series.variance[error.rows, column]
        known = variance > 0.0
        rows = np.searchsorted(truth.stamps, error.stamps[known])
        squares[rows] += np.radians(error.degrees[known]) ** 2 / variance[known]
        used[rows] += 1
    counted = (used > 0) & after(truth.stamps, skip_s)
    if not counted.any():
        return None
    seconds = np.asarray((truth.stamps[counted] - truth.stamps[0]) * 1e-9)
    return _course(seconds, squares[counted], used[counted], independent=False)


def within_two_sigma(errors: FloatArray, spread: FloatArray) -> float:
    """Share of errors that are within two reported standard deviations `spread`: 95.4 % of normal ones."""
    return float(np.mean(np.abs(errors) <= spread))


def _course(seconds: FloatArray, squares: FloatArray, used: NDArray[np.int64], *, independent: bool) -> Course:
    length = max((seconds[-1] - seconds[0]) / _STRETCHES, _SHORTEST_S)
    stretch = np.minimum(((seconds - seconds[0]) / length).astype(np.int64), _STRETCHES - 1)
    begins = np.flatnonzero(np.diff(stretch, prepend=-1))
    count = np.diff(begins, append=len(seconds))
    total = np.add.reduceat(used, begins)
    freedom = total if independent else total / count
    tail = 0.5 * (1.0 - PROBABILITY)
    return Course(
        np.add.reduceat(seconds, begins) / count,
        np.add.reduceat(squares, begins) / total,
        chi2.ppf(tail, freedom) / freedom,
        chi2.ppf(1.0 - tail, freedom) / freedom,
    )


def courses(
    series: Mapping[str, Series],
    joints: Mapping[str, tuple[str, ...]],
    truth: Truth,
    skip_s: float,
    continuous: frozenset[str],
) -> dict[str, Course]:
    """NEES by estimator, of those that report variances."""
    found = {name: nees_course(one, joints[name], truth, skip_s, continuous) for name, one in series.items()}
    return {name: course for name, course in found.items() if course is not None}
