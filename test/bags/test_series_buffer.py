"""Estimates collected in place, against joining them at the end."""

from __future__ import annotations

import numpy as np
import pytest

from jointest_ros.bags.series_buffer import SeriesBuffer
from jointest_ros.core.frame import Series


def stretch(start: int, length: int, joints: int, torso: bool, sensors: tuple[str, ...]) -> Series:
    rng = np.random.default_rng(start)
    return Series(
        np.arange(start, start + length, dtype=np.int64),
        rng.standard_normal((length, joints)),
        rng.standard_normal((length, joints)),
        rng.random((length, joints)),
        rng.integers(0, 128, (length, joints)),
        rng.standard_normal((length, 3)) if torso else None,
        rng.standard_normal((length, 4)) if torso else None,
        {sensor: rng.standard_normal((length, 4)) for sensor in sensors},
    )


@pytest.mark.parametrize("joints", [0, 1, 4])
@pytest.mark.parametrize("torso", [True, False])
def test_a_buffer_gives_what_joining_the_stretches_gives(joints: int, torso: bool) -> None:
    parts = [
        stretch(0, 5, joints, torso, ("a",)),
        stretch(5, 1, joints, torso, ("b", "a")),
        stretch(6, 0, joints, torso, ()),
        stretch(6, 7, joints, torso, ("b",)),
    ]
    buffer = SeriesBuffer(joints)
    for part in parts:
        buffer.add(part)
    found, expected = buffer.series(), Series.concatenate(parts)
    for name in ("stamps", "position", "velocity", "variance", "status", "torso", "torso_orientation"):
        one, other = getattr(found, name), getattr(expected, name)
        if other is None:
            assert one is None
        else:
            assert one.dtype == other.dtype and one.shape == other.shape and np.array_equal(one, other)
    assert set(found.orientation) == set(expected.orientation)
    for sensor, rows in expected.orientation.items():
        assert np.array_equal(found.orientation[sensor], rows, equal_nan=True)


def test_a_table_that_one_stretch_lacks_is_left_out() -> None:
    parts = [stretch(0, 3, 2, True, ()), stretch(3, 3, 2, False, ())]
    buffer = SeriesBuffer(2)
    for part in parts:
        buffer.add(part)
    assert buffer.series().torso is None and buffer.series().torso_orientation is None


def test_nothing_is_an_empty_series() -> None:
    assert len(SeriesBuffer(3).series()) == 0
    assert SeriesBuffer(3).series().position.shape == (0, 3)
