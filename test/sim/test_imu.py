"""Analytic truths of the IMU model, and its errors against their data-sheet figures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jointest_ros.sim.imu import EARTH_FIELD, Imu, ImuNoise, mean_rate, random_mounting

MOUNTING = Rotation.from_rotvec([0.1, -0.4, 0.2])
IDEAL = ImuNoise()


def make(noise: ImuNoise = IDEAL, rate_hz: float = 100.0, seed: int = 0, mounting: Rotation = MOUNTING) -> Imu:
    return Imu(noise, mounting, rate_hz, np.random.SeedSequence(seed))


def still(samples: int) -> Rotation:
    return Rotation.identity(samples)


def gyro_of_still(noise: ImuNoise, rate_hz: float, seed: int, samples: int) -> np.ndarray:
    imu = make(noise, rate_hz, seed)
    return imu.gyro(still(samples + 1), np.full(samples, 1.0 / rate_hz))[0]


def test_mean_rate_of_a_tumbling_link_integrates_exactly() -> None:
    generator = np.random.default_rng(3)
    orientation = Rotation.from_rotvec(np.cumsum(0.3 * generator.standard_normal((200, 3)), axis=0))
    intervals = generator.uniform(0.005, 0.02, 199)
    turned = orientation[0]
    for rate, interval in zip(mean_rate(orientation, intervals), intervals, strict=True):
        turned = turned * Rotation.from_rotvec(rate * interval)
    assert (orientation[-1].inv() * turned).magnitude() < 1e-12


def test_constant_rate_is_read_in_the_sensor_frame_from_the_first_sample_on() -> None:
    rate = np.array([0.5, -0.2, 0.8])
    time = np.arange(-1, 50) * 0.01
    gyro, bias = make().gyro(Rotation.from_rotvec(time[:, None] * rate), np.full(50, 0.01))
    np.testing.assert_allclose(gyro, np.tile(MOUNTING.inv().apply(rate), (50, 1)), atol=1e-12)
    assert not bias.any()


def test_at_rest_the_accelerometer_reads_upward() -> None:
    orientation = Rotation.from_rotvec([[0.0, 0.0, 0.0], [np.pi / 2, 0.0, 0.0], [0.3, 0.2, 0.1]])
    accel = make(mounting=Rotation.identity()).accel(orientation, np.zeros((3, 3)))
    np.testing.assert_allclose(accel[0], [0.0, 0.0, 9.81], atol=1e-12)
    np.testing.assert_allclose(accel[1], [0.0, 9.81, 0.0], atol=1e-12)  # y points up now
    np.testing.assert_allclose(orientation.apply(accel), np.tile([0.0, 0.0, 9.81], (3, 1)), atol=1e-12)
    mounted = make().accel(orientation, np.zeros((3, 3)))
    np.testing.assert_allclose(MOUNTING.apply(mounted), accel, atol=1e-12)


def test_acceleration_upward_adds_to_gravity() -> None:
    accel = make(mounting=Rotation.identity()).accel(still(1), np.array([[0.0, 0.0, 2.0]]))
    np.testing.assert_allclose(accel, [[0.0, 0.0, 11.81]], atol=1e-12)


def test_magnetometer_sees_the_field_turned_into_its_frame() -> None:
    orientation = Rotation.from_rotvec([[0.0, 0.0, 0.7], [0.2, 0.1, -0.4]])
    mag = make().mag(orientation)
    np.testing.assert_allclose((orientation * MOUNTING).apply(mag), np.tile(EARTH_FIELD, (2, 1)), atol=1e-18)


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
@pytest.mark.parametrize("seed", range(5))
def test_white_noise_follows_from_the_density(rate_hz: float, seed: int) -> None:
    noise = ImuNoise(gyro_noise=2e-4, accel_noise=4e-3, mag_noise=3e-8)
    samples = 20_000
    imu = make(noise, rate_hz, seed, Rotation.identity())
    gyro, _ = imu.gyro(still(samples + 1), np.full(samples, 1.0 / rate_hz))
    readings = {
        2e-4: gyro,
        4e-3: imu.accel(still(samples), np.zeros((samples, 3))) - [0.0, 0.0, 9.81],
        3e-8: imu.mag(still(samples)) - EARTH_FIELD,
    }
    bound = 5.0 / np.sqrt(3 * samples)  # five standard deviations of what is computed from 3 x samples draws
    for density, values in readings.items():
        scaled = values / (density * np.sqrt(rate_hz))
        assert abs(scaled.std() - 1.0) < bound
        assert abs(scaled.mean()) < bound
        assert abs((scaled[1:] * scaled[:-1]).mean()) < bound
    assert abs(np.corrcoef(readings[2e-4].ravel(), readings[4e-3].ravel())[0, 1]) < bound


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_bias_walk_grows_with_the_square_root_of_time(rate_hz: float) -> None:
    noise = ImuNoise(gyro_bias_walk=3e-5)
    samples, seeds = 2_000, 100
    biases = np.array([gyro_of_still(noise, rate_hz, seed, samples) for seed in range(seeds)])
    steps = np.diff(biases, axis=1)
    assert abs(steps.std() / (3e-5 / np.sqrt(rate_hz)) - 1.0) < 5.0 / np.sqrt(steps.size)
    after = np.sqrt((samples - 1) / rate_hz)
    walked = (biases[:, -1] - biases[:, 0]) / (3e-5 * after)
    assert abs(walked.std() - 1.0) < 4.0 / np.sqrt(2 * walked.size)


def test_constant_biases() -> None:
    gyro = np.array([gyro_of_still(ImuNoise(gyro_bias=0.05), 100.0, seed, 2) for seed in range(300)])
    assert np.array_equal(gyro[:, 0], gyro[:, 1])
    assert np.abs(gyro).max() <= 0.05
    assert abs(gyro[:, 0].std() / (0.05 / np.sqrt(3.0)) - 1.0) < 4.0 * np.sqrt(0.8 / 4 / 900)  # kurtosis 1.8
    accel = np.array([make(ImuNoise(accel_bias=0.3), seed=seed).accel_bias for seed in range(300)])
    np.testing.assert_allclose(np.linalg.norm(accel, axis=1), 0.3)
    assert np.abs(accel.mean(axis=0)).max() < 4.0 * 0.3 / np.sqrt(3.0 * 300)


def test_each_error_has_random_numbers_of_its_own() -> None:
    everything = ImuNoise(gyro_noise=1e-3, accel_noise=1e-2, gyro_bias=0.05, gyro_bias_walk=1e-3)
    gyro = gyro_of_still(everything, 100.0, 4, 500)
    parts = (ImuNoise(gyro_noise=1e-3), ImuNoise(gyro_bias=0.05), ImuNoise(gyro_bias_walk=1e-3))
    alone = [gyro_of_still(part, 100.0, 4, 500) for part in parts]
    np.testing.assert_allclose(gyro, sum(alone), atol=1e-15)
    assert not alone[-1][0].any()  # the walk starts at the constant bias


def test_consecutive_stretches_continue_each_other() -> None:
    noise = ImuNoise(gyro_noise=1e-3, accel_noise=1e-2, mag_noise=1e-7, gyro_bias=0.05, gyro_bias_walk=1e-3)
    whole, cut = make(noise), make(noise)
    lengths = (1, 200, 99)
    pieces = [
        (*cut.gyro(still(n + 1), np.full(n, 0.01)), cut.accel(still(n), np.zeros((n, 3))), cut.mag(still(n)))
        for n in lengths
    ]
    at_once = (*whole.gyro(still(301), np.full(300, 0.01)), whole.accel(still(300), np.zeros((300, 3))))
    for joined, expected in zip(zip(*pieces, strict=True), (*at_once, whole.mag(still(300))), strict=True):
        assert np.array_equal(np.concatenate(joined), expected)


def test_resolution_and_range() -> None:
    imu = make(ImuNoise(gyro_range=0.5, gyro_resolution=0.02, accel_range=8.0, accel_resolution=0.3))
    time = np.arange(101) * 0.01
    turning = Rotation.from_rotvec((time**2)[:, None] * [0.0, 0.0, 1.0])
    gyro, _ = imu.gyro(turning, np.full(100, 0.01))
    truth = MOUNTING.apply(mean_rate(turning, np.full(100, 0.01)), inverse=True)
    expected = np.clip(truth, -0.5, 0.5)
    assert np.abs(gyro).max() == 0.5
    assert np.abs(gyro - expected).max() <= 0.01 + 1e-12
    unclipped = gyro[np.abs(truth) < 0.49] / 0.02
    np.testing.assert_allclose(unclipped, np.round(unclipped), atol=1e-9)
    accel = imu.accel(turning[1:], np.zeros((100, 3)))
    assert accel.max() == 8.0
    below = accel[accel < 7.9] / 0.3
    np.testing.assert_allclose(below, np.round(below), atol=1e-9)


def test_random_mounting_is_uniform_in_its_angle() -> None:
    generator = np.random.default_rng(5)
    angles = np.array([random_mounting(generator, 0.2).magnitude() for _ in range(1000)])
    assert angles.max() <= 0.2
    assert abs(angles.mean() - 0.1) < 4.0 * 0.2 / np.sqrt(12.0 * 1000)
    assert random_mounting(generator, 0.0).magnitude() == 0.0
