"""Frames and estimates as objects and as arrays: the two forms hold the same."""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jointest_ros.core.frame import Estimate, Frame, Recording, Series, Status

number = st.floats(-1e3, 1e3)
vector = st.tuples(number, number, number)
table = st.dictionaries(st.sampled_from(["a", "b", "c"]), vector)
hall = st.none() | st.tuples(number, number | st.just(math.nan)).filter(lambda row: row[0] == row[0])
frames = st.lists(
    st.builds(
        Frame,
        stamp=st.integers(0, 2**62),
        gyro=table,
        accel=table,
        mag=table,
        hall=hall,
        period=number | st.just(math.nan),
        reset=st.booleans(),
    ),
    max_size=20,
)


def same(one: object, other: object) -> bool:
    """Equal, NaN and NaN included."""
    return repr(one) == repr(other)


@given(frames)
def test_frames_become_arrays_and_frames_again(given_frames: list[Frame]) -> None:
    again = list(Recording.from_frames(given_frames).frames())
    assert len(again) == len(given_frames)
    for one, other in zip(given_frames, again, strict=True):
        for name in ("stamp", "hall", "period", "reset"):
            assert same(getattr(one, name), getattr(other, name)), name
        for name in ("gyro", "accel", "mag"):
            assert getattr(one, name) == getattr(other, name)


@given(frames.filter(bool), st.integers(1, 7))
def test_parts_join_to_the_whole(given_frames: list[Frame], rows: int) -> None:
    recording = Recording.from_frames(given_frames)
    parts = list(recording.parts(rows))
    assert all(len(part) == rows for part in parts[:-1]) and sum(map(len, parts)) == len(recording)
    joined = [frame for part in parts for frame in part.frames()]
    assert same(joined, list(recording.frames()))


def test_rows_with_nan_are_missing() -> None:
    nan = math.nan
    recording = Recording(
        np.array([1, 2, 3]),
        gyro={"a": np.array([[1.0, 2.0, 3.0], [nan, 2.0, 3.0], [4.0, 5.0, math.inf]])},
        accel={"a": np.zeros((3, 3))},
        hall=np.array([[nan, nan], [nan, 1.0], [2.0, 3.0]]),
    )
    found = list(recording.frames())
    assert [frame.gyro for frame in found] == [{"a": (1.0, 2.0, 3.0)}, {}, {}]
    assert all(frame.accel == {"a": (0.0, 0.0, 0.0)} for frame in found)
    assert found[0].hall is None
    assert same(found[1].hall, (nan, 1.0))
    assert found[2].hall == (2.0, 3.0)
    assert all(math.isnan(frame.period) and not frame.reset for frame in found)


def test_a_part_is_a_view() -> None:
    recording = Recording.from_frames([Frame(k, {"a": (k, 0.0, 0.0)}) for k in range(10)])
    part = recording.part(3, 5)
    assert part.stamps.tolist() == [3, 4]
    assert np.shares_memory(part.gyro["a"], recording.gyro["a"])


def series(start: int, rows: int, orientation: bool = False) -> Series:
    estimates = [
        Estimate(
            start + k,
            (0.1 * k, 0.2),
            (0.3, 0.4),
            (0.5, 0.6),
            (Status.OK, Status.GAP | Status.STALE),
            torso=(1.0, 2.0, 3.0),
            orientation={"a": (0.0, 0.0, 0.0, 1.0)} if orientation and k % 2 else {},
        )
        for k in range(rows)
    ]
    return Series.from_estimates(estimates, 2)


def test_estimates_become_columns() -> None:
    found = series(5, 4, orientation=True)
    assert found.stamps.tolist() == [5, 6, 7, 8]
    np.testing.assert_allclose(found.position[:, 0], [0.0, 0.1, 0.2, 0.3])
    assert found.status[:, 1].tolist() == [36] * 4
    assert found.torso is not None and found.torso.shape == (4, 3)
    assert found.torso_orientation is None
    np.testing.assert_array_equal(np.isnan(found.orientation["a"][:, 0]), [True, False, True, False])


def test_no_estimates_are_empty_columns() -> None:
    found = series(0, 0)
    assert len(found) == 0
    assert found.position.shape == (0, 2)


def test_consecutive_series_join() -> None:
    joined = Series.concatenate([series(0, 3, orientation=True), series(3, 2)])
    assert joined.stamps.tolist() == [0, 1, 2, 3, 4]
    assert joined.torso is not None and len(joined.torso) == 5
    assert np.isnan(joined.orientation["a"][3:]).all()


def test_every_column_of_a_series_is_one_of_an_estimate() -> None:
    singular = {spec.name.removesuffix("s") for spec in fields(Estimate)}
    assert {spec.name.removesuffix("s") for spec in fields(Series)} == singular


@pytest.mark.parametrize("flag", [flag for flag in Status if flag])
def test_status_flags_are_single_bits(flag: Status) -> None:
    assert int(flag).bit_count() == 1
