"""Which estimate belongs to which truth sample."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jointest_ros.evaluation.truth import Truth, match

MS = 1_000_000


def stamps(*milliseconds: float) -> np.ndarray:
    return np.array([round(ms * MS) for ms in milliseconds], dtype=np.int64)


def matched(estimates: np.ndarray, truth: np.ndarray) -> list[tuple[int, int]]:
    rows, of_truth = match(estimates, truth)
    return list(zip(rows.tolist(), of_truth.tolist(), strict=True))


@pytest.mark.parametrize(
    ("estimates", "truth", "expected"),
    [
        # equal stamps, shifted by less and by more than half a period
        (stamps(0, 10, 20), stamps(0, 10, 20), [(0, 0), (1, 1), (2, 2)]),
        (stamps(4, 14, 24), stamps(0, 10, 20), [(0, 0), (1, 1), (2, 2)]),
        (stamps(-4, 6, 16), stamps(0, 10, 20), [(0, 0), (1, 1), (2, 2)]),
        (stamps(106, 116), stamps(0, 10, 20), []),
        # exactly half a period: still within; of two as near the earlier one
        (stamps(5), stamps(0, 10, 20), [(0, 0), (0, 1)]),
        (stamps(5, 15), stamps(0, 10, 20), [(0, 0), (0, 1), (1, 2)]),
        # estimates faster, and slower, than the truth
        (stamps(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10), stamps(0, 5, 10), [(0, 0), (5, 1), (10, 2)]),
        (stamps(0, 20), stamps(0, 5, 10, 15, 20), [(0, 0), (1, 4)]),
        # a hole in the estimates
        (stamps(0, 10, 50, 60), stamps(0, 10, 20, 30, 40, 50, 60), [(0, 0), (1, 1), (2, 5), (3, 6)]),
        # the period is the median: a gap in the truth does not widen the tolerance
        (stamps(0, 10, 500), stamps(0, 10, 20, 30, 1000), [(0, 0), (1, 1)]),
        # one sample of truth has no period: it must be met exactly
        (stamps(0, 10), stamps(10), [(1, 0)]),
        (stamps(0, 10), stamps(11), []),
        # one estimate, none, no truth
        (stamps(21), stamps(0, 10, 20), [(0, 2)]),
        (stamps(), stamps(0, 10), []),
        (stamps(0, 10), stamps(), []),
    ],
)
def test_the_nearest_within_half_a_truth_period(
    estimates: np.ndarray, truth: np.ndarray, expected: list[tuple[int, int]]
) -> None:
    assert matched(estimates, truth) == expected


@settings(max_examples=200)
@given(
    st.lists(st.integers(0, 200), unique=True, max_size=30).map(sorted),
    st.lists(st.integers(0, 200), unique=True, min_size=1, max_size=30).map(sorted),
)
def test_as_by_trying_every_pair(estimates: list[int], truth: list[int]) -> None:
    half = 0.5 * float(np.median(np.diff(truth))) if len(truth) > 1 else 0.0
    expected = []
    for number, stamp in enumerate(truth):
        if estimates:
            nearest = min(range(len(estimates)), key=lambda row: (abs(estimates[row] - stamp), row))
            if abs(estimates[nearest] - stamp) <= half:
                expected.append((nearest, number))
    assert matched(np.array(estimates, dtype=np.int64), np.array(truth, dtype=np.int64)) == expected


def test_stamps_of_today_lose_no_digit() -> None:
    now = 1_700_000_000_000_000_000
    truth = now + np.arange(5, dtype=np.int64) * 3
    assert matched(truth + 1, truth) == [(n, n) for n in range(5)]


def test_truth_is_true_when_there_is_any() -> None:
    assert not Truth()
    assert Truth(stamps(0))
    assert Truth(orientation={"imu": (stamps(0), np.zeros((1, 4)))})
