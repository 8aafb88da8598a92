"""What is found wrong with accelerometers whose samples are sound, and what is not."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from jointest_ros.core.assembler import FrameAssembler
from jointest_ros.core.frame import Vec3
from jointest_ros.core.input_quality import Frozen, InputQuality, saturation
from jointest_ros.core.robot import STANDARD_GRAVITY, Sensor

PERIOD = 10_000_000  # ns
A1, A2 = (Sensor(name, "a", gyro=False, accel_range=2.0 * STANDARD_GRAVITY) for name in ("a1", "a2"))
B1 = Sensor("b1", "b", gyro=False)
IMU = Sensor("imu", "hand")
UP = np.array([0.0, 0.0, STANDARD_GRAVITY])

Motion = Callable[[int], np.ndarray]  # number of the sample -> reading


def resting(reading: np.ndarray = UP, sigma: float = 0.03, seed: int = 0) -> Motion:
    noise = sigma * np.random.default_rng(seed).standard_normal((1000, 3))
    return lambda k: reading + noise[k]


def moving(k: int) -> np.ndarray:
    return UP + np.array([3.0 * math.sin(0.2 * k), 2.0 * math.cos(0.15 * k), 0.0])


def feed(
    sensors: tuple[Sensor, ...], motions: dict[str, Motion], samples: int = 300, gyro: Vec3 = (0.0, 0.0, 0.0)
) -> FrameAssembler:
    """An assembler that got so many samples at 100 Hz."""
    assembler = FrameAssembler(sensors)
    for k in range(samples):
        for sensor in sensors:
            x, y, z = (float(value) for value in motions[sensor.name](k))
            alive = (gyro[0], gyro[1], gyro[2] + 1e-4 * (k % 2))  # an IMU that is frozen as a whole is refused
            assembler.add_imu(sensor.name, (k + 1) * PERIOD, alive, (x, y, z))
    return assembler


def found(quality: InputQuality, sensor: str) -> str:
    return "; ".join(quality.findings(sensor))


# ---------------------------------------------------------------- units, and g


@pytest.mark.parametrize(
    ("norm", "expected"),
    [
        (1.0, "a1 reads 1.00 at rest: is it in g instead of m/s^2?"),
        (1000.0, "a1 reads 1000.00 at rest: is it in mg instead of m/s^2?"),
        (8.9, "a1 reads 8.90 m/s^2 at rest, gravity is 9.81: "),
        (0.0, "a1 reads 0.00 m/s^2 at rest, gravity is 9.81: "),
        (16384.0, "a1 reads 16384.00 m/s^2 at rest, gravity is 9.81: "),
        (9.45, ""),
        (10.2, ""),
    ],
)
def test_what_a_sensor_at_rest_reads(norm: float, expected: str) -> None:
    sensor = replace(A1, accel_range=math.inf)
    reading = norm * np.array([0.6, 0.0, -0.8])
    quality = feed((sensor,), {"a1": resting(reading, sigma=1e-7 * norm)}).quality
    assert found(quality, "a1").startswith(expected)
    assert bool(found(quality, "a1")) == bool(expected)


@pytest.mark.parametrize("motion", [lambda k: 0.1 * moving(k), lambda k: 1.2 * moving(k)])
def test_a_sensor_that_moves_is_not_judged(motion: Motion) -> None:
    assert found(feed((B1,), {"b1": motion}).quality, "b1") == ""


def test_a_gyro_that_turns_tells_that_it_is_no_rest() -> None:
    """A wheel about the vertical: the centripetal acceleration is as constant as gravity."""
    wheel = {"imu": resting(UP + np.array([8.0, 0.0, 0.0]))}
    assert found(feed((IMU,), wheel, gyro=(0.0, 0.0, 9.0)).quality, "imu") == ""
    assert found(feed((IMU,), wheel, gyro=(0.0, 0.0, 0.01)).quality, "imu").startswith("imu reads 12.66 m/s^2")


def test_the_calibrated_reading_counts() -> None:
    in_g = replace(B1, accel_matrix=tuple(tuple(STANDARD_GRAVITY * row) for row in np.eye(3)))
    assert found(feed((in_g,), {"b1": resting(UP / STANDARD_GRAVITY, 0.003)}).quality, "b1") == ""


def test_a_fault_that_goes_is_forgotten() -> None:
    readings = (resting(), resting(UP / STANDARD_GRAVITY, 0.003))
    quality = feed((B1,), {"b1": lambda k: readings[k < 300](k)}, samples=310).quality
    assert "in g" in found(quality, "b1")
    quality = feed((B1,), {"b1": lambda k: readings[k < 300](k)}, samples=600).quality
    assert found(quality, "b1") == ""


# ---------------------------------------------------------------- saturated


def test_every_saturated_sample_is_counted() -> None:
    limit = 2.0 * STANDARD_GRAVITY

    def clipped(k: int) -> np.ndarray:
        return np.clip([3.0 * limit * math.sin(0.1 * k), 1.0, -2.0], -limit, limit)

    expected = sum(abs(clipped(k)).max() >= 0.99 * limit for k in range(300))
    assert expected > 100
    quality = feed((A1, A2), {"a1": clipped, "a2": resting()}).quality
    assert quality.saturated == {"a1": expected, "a2": 0}
    (text,) = quality.summary({"a1": 300, "a2": 300})
    assert text == f"a1: {expected} samples saturated at the full scale of 2 g, {expected / 300:.1%} of all"


def test_the_sum_of_the_axes_may_be_large_without_saturation() -> None:
    quality = feed((A1,), {"a1": lambda k: np.full(3, 1.9 * STANDARD_GRAVITY)}).quality
    assert quality.saturated == {"a1": 0}


def test_without_a_full_scale_nothing_is_counted() -> None:
    quality = feed((B1,), {"b1": lambda k: np.full(3, 1e4)}).quality
    assert quality.saturated == {}
    assert not saturation(B1)((1e4, 1e4, 1e4))


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_saturation_of_a_calibrated_reading_is_that_of_the_raw_one(axis: int, sign: float) -> None:
    matrix = np.eye(3) + np.array([[-0.05, 0.01, 0.0], [0.0, 0.03, 0.0], [0.02, 0.0, 0.04]])
    offset = np.array([1.0, -0.5, 0.2])
    sensor = replace(A1, accel_matrix=tuple(map(tuple, matrix)), accel_offset=tuple(offset))
    for share, expected in ((0.98, False), (1.0, True)):
        raw = np.array([0.3, -0.2, 0.1])
        raw[axis] = sign * share * sensor.accel_range
        assert saturation(sensor)(tuple((matrix @ raw + offset).tolist())) is expected
        assert saturation(A1)(tuple(raw.tolist())) is expected


# ---------------------------------------------------------------- frozen


def test_a_sensor_that_repeats_itself_on_a_moving_link_is_frozen() -> None:
    stuck = moving(100)
    motions: dict[str, Motion] = {"a1": lambda k: stuck if k > 100 else moving(k), "a2": moving, "b1": moving}
    assembler = feed((A1, A2, B1), motions)
    assert found(assembler.quality, "a1") == "a1 repeats one acceleration while its link moves: frozen?"
    assert found(assembler.quality, "a2") == found(assembler.quality, "b1") == ""
    (text,) = assembler.quality.summary({"a1": 300, "a2": 300})
    assert text == "a1 repeats one acceleration for 2.0 s while its link moves: frozen?"
    assembler = feed((A1, A2, B1), {**motions, "a1": lambda k: stuck if 100 < k < 250 else moving(k)})
    assert found(assembler.quality, "a1") == ""


def test_a_link_at_rest_may_repeat_itself_whatever_others_do() -> None:
    """Coarse digits: one sensor lies between two of them, the other does not."""
    dithering = resting(UP, sigma=0.02, seed=1)
    motions: dict[str, Motion] = {"a1": lambda k: UP, "a2": lambda k: dithering(k).round(1), "b1": moving}
    quality = feed((A1, A2, B1), motions).quality
    assert not any(found(quality, name) for name in motions)


def test_the_gyro_tells_that_its_accelerometer_is_frozen() -> None:
    assert found(feed((IMU,), {"imu": lambda k: UP}, gyro=(0.0, 0.4, 0.0)).quality, "imu").startswith("imu repeats")
    assert found(feed((IMU,), {"imu": lambda k: UP}, gyro=(0.0, 0.04, 0.0)).quality, "imu") == ""


def test_frozen_for_less_than_half_a_second_is_none() -> None:
    frozen = Frozen((A1, A2))
    for k in range(60):
        x, y, z = moving(k)
        frozen.update(k * PERIOD, {"a1": (1.0, 2.0, 3.0), "a2": (x, y, z)})
        assert (list(frozen.since) == ["a1"]) == (k >= 50)
    assert frozen.since == {"a1": 0}


def test_frozen_goes_on_from_its_state_in_json() -> None:
    one = Frozen((A1, A2))
    for k in range(200):
        x, y, z = moving(k)
        if k % 7 == 0:
            other = Frozen((A1, A2))
            other.set_state(json.loads(json.dumps(one.get_state())))
            one = other
        one.update(k * PERIOD, {"a1": (1.0, 2.0, 3.0) if 20 <= k < 120 else (x, y, z), "a2": (x, y, z)})
        assert ("a1" in one.since) == (70 <= k < 120)


def test_a_missing_sensor_is_not_frozen() -> None:
    frozen = Frozen((A1, A2))
    for k in range(200):
        x, y, z = moving(k)
        frozen.update(k * PERIOD, {"a2": (x, y, z)} if k else {"a1": (1.0, 2.0, 3.0), "a2": (x, y, z)})
    assert not frozen.since
