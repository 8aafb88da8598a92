"""A recording as window means and still phases, however it is cut."""

from __future__ import annotations

import numpy as np
import pytest
from finger_windows import means_of, stillness

from jointest_ros.core.frame import Recording
from jointest_ros.evaluation.inertial_windows import Windows

RATE = 1000.0


def recording(samples: int, rate: float = RATE) -> Recording:
    """A ramp on every component of two sensors."""
    stamps = np.round((np.arange(samples) + 1e6) * 1e9 / rate).astype(np.int64)
    ramp = np.arange(samples)[:, None] / rate * np.array([1.0, 2.0, 3.0])
    return Recording(stamps, {"a": ramp, "b": -ramp}, {"a": 10.0 * ramp, "b": ramp.copy()})


def test_means_of_each_window() -> None:
    means = means_of(recording(1000))
    assert means.length == 0.02
    assert np.all(np.diff(means.start) == 20_000_000)
    middle = (means.start - means.first) * 1e-9 + 0.5 * (means.length - 1.0 / RATE)
    assert means.gyro["a"] == pytest.approx(middle[:, None] * [1.0, 2.0, 3.0])
    assert means.accel["b"] == pytest.approx(middle[:, None] * [1.0, 2.0, 3.0])
    assert means.given == {"a", "b"}


@pytest.mark.parametrize("chunk", [7, 64, 997])
def test_the_cut_of_the_stream_changes_nothing(chunk: int) -> None:
    plain = recording(3000)
    plain.gyro["a"][500:530] = np.nan
    whole, cut = means_of(plain, 3000), means_of(plain, chunk)
    assert cut.start.tolist() == whole.start.tolist()
    for sensor in ("a", "b"):
        assert cut.gyro[sensor] == pytest.approx(whole.gyro[sensor], nan_ok=True)
    assert [(phase.start, phase.end) for phase in cut.still] == [(phase.start, phase.end) for phase in whole.still]


def test_slow_sensors_have_longer_windows() -> None:
    assert means_of(recording(500, 100.0)).length == pytest.approx(0.03)


def test_windows_without_enough_samples_are_missing() -> None:
    plain = recording(400)
    plain.gyro["a"][105:120] = np.nan  # 15 of 20
    plain.accel["b"][:] = np.nan
    means = means_of(plain)
    assert np.flatnonzero(np.isnan(means.gyro["a"]).any(axis=1)).tolist() == [5]
    assert np.isnan(means.accel["b"]).all() and np.isfinite(means.accel["a"]).all()
    assert means.given == {"a"}


def test_still_phases() -> None:
    generator = np.random.default_rng(0)
    samples = 8000
    noise = 1e-3 * generator.standard_normal((samples, 3))
    moving = np.zeros(samples)
    moving[2000:4000] = np.sin(np.arange(2000) / 100.0)
    gyro = {"a": noise + 0.02 + moving[:, None]}
    accel = {"a": np.array([0.0, 0.0, 9.8]) + 0.05 * generator.standard_normal((samples, 3))}
    stamps = np.arange(samples) * 1_000_000
    first, second = means_of(Recording(stamps, gyro, accel)).still
    assert (first.start, second.end) == (0, pytest.approx(8e9, abs=0.5e9))
    assert first.end == pytest.approx(2e9, abs=0.51e9) and second.start == pytest.approx(4e9, abs=0.51e9)
    assert first.duration == pytest.approx(2.0, abs=0.51)
    for phase in (first, second):
        assert phase.gyro["a"] == pytest.approx((0.02, 0.02, 0.02), abs=1e-3)
        assert phase.accel["a"] == pytest.approx((0.0, 0.0, 9.8), abs=0.02)


def test_nothing_gives_nothing() -> None:
    windows = Windows(("a",), stillness("a"))
    windows.add(Recording.from_frames([]))
    means = windows.means()
    assert len(means.start) == 0 and not means.still and not means.given
