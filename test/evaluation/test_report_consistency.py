"""NIS and NEES over time: bounds that hold what they promise, for estimators that are right and for others."""

from __future__ import annotations

import numpy as np
import pytest

from jointest_ros.core.frame import Series
from jointest_ros.evaluation.report.consistency import Innovations, nees_course, nis_course, within_two_sigma
from jointest_ros.evaluation.truth import Truth

PERIOD = 10_000_000  # ns


def innovations(count: int, width: int, scale: float, seed: int = 0) -> Innovations:
    rows = scale * np.random.default_rng(seed).normal(size=(count, width))
    return Innovations.from_rows(range(0, count * PERIOD, PERIOD), rows.tolist())


def test_white_innovations_are_within_their_bounds_as_often_as_stated() -> None:
    course = nis_course(innovations(60_000, 3, 1.0), 0)
    assert course is not None
    assert course.inside == pytest.approx(0.95, abs=0.035)  # 300 stretches: 1.3 % standard deviation
    assert course.ratio.mean() == pytest.approx(1.0, abs=0.02)
    assert (course.low < 1.0).all()
    assert (course.high > 1.0).all()


@pytest.mark.parametrize("scale", [0.8, 1.25])
def test_too_large_and_too_small_variances_are_out_of_bounds(scale: float) -> None:
    course = nis_course(innovations(60_000, 3, scale), 0)
    assert course is not None
    assert course.inside < 0.05
    assert course.ratio.mean() == pytest.approx(scale**2, rel=0.03)


def test_readings_that_were_not_used_do_not_count() -> None:
    nan = float("nan")
    one = Innovations.from_rows([0, PERIOD, 2 * PERIOD], [[nan, 2.0], [nan, nan], [1.0, 1.0]])
    assert one.used.tolist() == [1, 0, 2]
    assert one.squares.tolist() == [4.0, 0.0, 2.0]
    assert one.values.tolist() == [2.0, 1.0, 1.0]
    course = nis_course(one, 0, 0.015)
    assert course is not None
    assert course.ratio.tolist() == [1.0]
    assert nis_course(one, 0, 1.0) is None
    assert nis_course(Innovations.from_rows([0], [[]]), 0) is None


def test_parts_join_to_the_whole() -> None:
    whole = innovations(100, 2, 1.0)
    rows = whole.values.reshape(100, 2).tolist()
    stamps = whole.stamps.tolist()
    joined = Innovations.concatenate(
        [Innovations.from_rows(stamps[:30], rows[:30]), Innovations.from_rows(stamps[30:], rows[30:])]
    )
    for name in ("stamps", "squares", "used", "values"):
        assert np.array_equal(getattr(joined, name), getattr(whole, name))


def test_nees_takes_every_joint_that_states_a_variance() -> None:
    count = 4000
    stamps = np.arange(count, dtype=np.int64) * PERIOD
    random = np.random.default_rng(3)
    truth = Truth(stamps, {joint: np.zeros(count) for joint in ("one", "two", "three")})
    position = random.normal(size=(count, 3)) * (0.1, 0.2, 5.0)
    variance = np.tile((0.01, 0.04, np.nan), (count, 1))
    series = Series(stamps, position, np.zeros((count, 3)), variance, np.zeros((count, 3), dtype=np.int64))
    course = nees_course(series, ("one", "two", "three"), truth, 10.0, frozenset())
    assert course is not None
    assert course.seconds[0] >= 10.0
    assert course.ratio.mean() == pytest.approx(1.0, abs=0.05)
    assert course.high == pytest.approx(np.full(len(course.high), 7.378 / 2.0), abs=1e-3)  # chi-square of 2 at 97.5 %
    errors, spread = position[:, 0], np.full(count, 0.2)
    assert within_two_sigma(errors, spread) == pytest.approx(0.954, abs=0.01)
    nothing = Series(stamps, position, np.zeros((count, 3)), np.full((count, 3), np.nan), series.status)
    assert nees_course(nothing, ("one", "two", "three"), truth, 0.0, frozenset()) is None
