"""When the robot counts as still, and what is averaged meanwhile."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from jointest_ros.core.frame import FloatArray, Frame, Recording
from jointest_ros.core.stillness import Stillness

RATE = 200
SENSORS = ("a", "b")
UP = np.array([0.0, 0.0, 9.81])
BIAS = {"a": np.array([0.02, -0.03, 0.01]), "b": np.array([-0.01, 0.04, 0.0])}


def judge(**changes: float) -> Stillness:
    limits = {"gyro_std": math.radians(1.0), "accel_std": 0.5, "gyro_bias": math.radians(5.0)} | changes
    return Stillness(SENSORS, **limits)


def recording(seconds: float = 5.0, seed: int = 0, rate: int = RATE, noise: float = 1.0) -> Recording:
    """Two sensors at rest, with biases, at the noise of an MPU6050."""
    generator = np.random.default_rng(seed)
    samples = round(seconds * rate)

    def white(density: float) -> FloatArray:
        return noise * density * math.sqrt(rate) * generator.standard_normal((samples, 3))

    stamps = np.arange(samples, dtype=np.int64) * round(1e9 / rate)
    gyro = {name: bias + white(math.radians(0.005)) for name, bias in BIAS.items()}
    return Recording(stamps, gyro, {name: UP + white(4e-3) for name in SENSORS})


def verdicts(stillness: Stillness, frames: Recording) -> list[bool]:
    return [still for frame in frames.frames() if (still := stillness.update(frame)) is not None]


def test_at_rest_every_window_is_still() -> None:
    stillness = judge()
    assert verdicts(stillness, recording(5.0)) == [True] * 9  # a window takes the frame that closes it
    assert stillness.duration == pytest.approx(4.5)
    gyro, accel = stillness.means()
    for name in SENSORS:
        np.testing.assert_allclose(gyro[name], BIAS[name], atol=2e-4)
        np.testing.assert_allclose(accel[name], UP, atol=1e-2)


def test_means_are_those_of_the_whole_phase() -> None:
    stillness, rest = judge(), recording(5.0, seed=1)
    verdicts(stillness, rest)
    gyro, _ = stillness.means()
    np.testing.assert_allclose(gyro["a"], rest.gyro["a"][:901].mean(axis=0), atol=1e-5)


def moving(kind: str) -> Recording:
    rest = recording(6.0, seed=2)
    time = rest.stamps * 1e-9
    moved = np.where(time >= 3.0, time - 3.0, 0.0)
    if kind == "swing":
        rest.gyro["b"][:, 0] += np.where(moved > 0.0, np.cos(10.0 * moved), 0.0)
    elif kind == "shaken":
        rest.accel["a"][:, 1] += 2.0 * np.sin(20.0 * moved)
    elif kind == "slow turn about the vertical":
        rest.gyro["a"][:, 2] += np.where(moved > 0.0, math.radians(1.0), 0.0)
    elif kind == "slow tilting":
        angle = math.radians(1.0) * moved
        rest.accel["b"] += 9.81 * np.column_stack([np.sin(angle), 0.0 * angle, np.cos(angle) - 1.0])
    elif kind == "another posture":
        rest.accel["b"][time >= 3.0] += [0.3, 0.0, 0.0]
    elif kind == "fast turn":
        rest.gyro["a"][time >= 3.0, 2] += math.radians(10.0)
    return rest


@pytest.mark.parametrize(
    "kind", ["swing", "shaken", "slow turn about the vertical", "slow tilting", "another posture", "fast turn"]
)
def test_what_moves_is_not_still(kind: str) -> None:
    stillness = judge()
    found = verdicts(stillness, moving(kind))
    assert found[:5] == [True] * 5
    assert not all(found[5:8])
    assert stillness.duration < 3.0


def test_a_rate_that_is_too_large_for_a_bias_is_motion_from_the_start() -> None:
    rest = recording(2.0)
    rest.gyro["a"] += math.radians(6.0)
    assert verdicts(judge(), rest) == [False] * 3


def test_movement_forgets_what_was_found() -> None:
    stillness, rest = judge(), recording(3.0)
    verdicts(stillness, rest)
    rest.gyro["a"] += 1.0
    rest.stamps += 3_000_000_000
    verdicts(stillness, rest.part(0, 110))
    assert stillness.duration == 0.0 and stillness.means() == ({}, {})


@pytest.mark.parametrize("share", [0.0, 0.01])
def test_a_silent_sensor_is_not_still(share: float) -> None:
    rest = recording(3.0)
    generator = np.random.default_rng(1)
    rest.accel["b"][generator.random(len(rest)) >= share] = np.nan
    assert verdicts(judge(), rest) == [False] * 5


def test_lost_samples_do_no_harm() -> None:
    rest = recording(3.0)
    generator = np.random.default_rng(1)
    for table in (rest.gyro, rest.accel):
        for name in SENSORS:
            table[name][generator.random(len(rest)) < 0.5] = np.nan
    assert verdicts(judge(), rest) == [True] * 5


def test_a_window_with_a_long_gap_says_nothing() -> None:
    rest = recording(3.0)
    rest.stamps[250:] += 2_000_000_000
    stillness = judge()
    assert verdicts(stillness, rest) == [True, True, False, True, True, True]
    assert stillness.duration == pytest.approx(1.5)


def test_reset_begins_anew() -> None:
    stillness = judge()
    frames = list(recording(3.0).frames())
    frames[450].reset = True
    found = [still for frame in frames[:470] if (still := stillness.update(frame)) is not None]
    assert found == [True] * 4
    assert stillness.duration == 0.0


def scrambled() -> Recording:
    """Still, moving, still, with lost samples, a gap, an absent sensor and resets."""
    rest = recording(12.0, seed=5)
    generator = np.random.default_rng(6)
    rest.gyro["b"][800:1000] += 1.0
    for name in SENSORS:
        rest.gyro[name][generator.random(len(rest)) < 0.1] = np.nan
    rest.accel["a"][1500:1700] = np.nan
    rest.stamps[1900:] += 1_500_000_000
    reset = np.zeros(len(rest), dtype=bool)
    reset[[0, 333, 2100, 2101]] = True
    rest.stamps[2100:] -= 5_000_000_000
    return Recording(rest.stamps, rest.gyro, rest.accel, reset=reset)


@pytest.mark.parametrize("size", [1, 7, 100, 101, 997, 10_000])
def test_run_equals_the_loop(size: int) -> None:
    whole = scrambled()
    loop, arrays = judge(), judge()
    expected = [(k, still) for k, frame in enumerate(whole.frames(), 1) if (still := loop.update(frame)) is not None]
    found, before = [], 0
    for part in whole.parts(size):
        found += [(before + taken, still) for taken, still in arrays.run(part)]
        before += len(part)
    assert found == expected
    assert {still for _, still in expected} == {True, False}
    assert arrays.duration == loop.duration
    for one, other in zip(arrays.means(), loop.means(), strict=True):
        assert one.keys() == other.keys()
        for name in one:
            np.testing.assert_allclose(one[name], other[name], rtol=1e-12)


def test_state_continues_identically_through_json() -> None:
    frames = list(scrambled().frames())
    for cut in (1, 77, 650, 1000):
        one = judge()
        for frame in frames[:cut]:
            one.update(frame)
        other = judge()
        other.set_state(json.loads(json.dumps(one.get_state())))
        for frame in frames[cut : cut + 300]:
            assert one.update(frame) == other.update(frame)
            assert one.duration == other.duration
        assert one.means() == other.means()


def test_frames_without_the_sensor_at_all() -> None:
    stillness = judge()
    found = [stillness.update(Frame(k * 5_000_000, {"a": (0.0, 0.0, 0.0)})) for k in range(102)]
    assert found.count(False) == 1 and True not in found
