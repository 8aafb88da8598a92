"""An IMU on a rigid link: exact samples from the link's true motion, then the errors of a real sensor.

Gyro samples are the mean rate over the interval that ends at their stamp, as digital IMUs deliver it; accelerometers
and magnetometers are sampled at the stamp. The world's z axis points up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Vec3

GRAVITY = 9.81  # m/s^2: the value that the scenarios of all three specs are computed with
EARTH_FIELD: Vec3 = (20e-6, 0.0, -44e-6)  # tesla, world frame, x to magnetic north: a mid-latitude field


@dataclass(frozen=True)
class ImuNoise:
    """Error figures of one IMU. White noise of a density d has the standard deviation d sqrt(rate) a sample.

    Attributes:
        gyro_noise, accel_noise, mag_noise: densities, rad/s/sqrt(Hz), m/s^2/sqrt(Hz), tesla/sqrt(Hz).
        gyro_bias: each component of the constant bias is uniform in +- this, rad/s.
        gyro_bias_walk: random walk on top of it, rad/s/sqrt(s).
        gyro_scale: error of the scale of each axis, uniform in +- this, a fraction.
        accel_bias: norm of a constant bias in a random direction, m/s^2.
        accel_offset, accel_scale: another, each component uniform in +- this, m/s^2, and the error of the scale of each
            axis, uniform in +- this, a fraction: what calibration leaves.
        gyro_range, accel_range: full scale, rad/s and m/s^2; readings are clipped there.
        gyro_resolution, accel_resolution: one digit, rad/s and m/s^2; 0 for no rounding.
    """

    gyro_noise: float = 0.0
    accel_noise: float = 0.0
    mag_noise: float = 0.0
    gyro_bias: float = 0.0
    gyro_bias_walk: float = 0.0
    gyro_scale: float = 0.0
    accel_bias: float = 0.0
    accel_offset: float = 0.0
    accel_scale: float = 0.0
    gyro_range: float = math.inf
    accel_range: float = math.inf
    gyro_resolution: float = 0.0
    accel_resolution: float = 0.0


def mean_rate(orientation: Rotation, intervals: FloatArray) -> FloatArray:
    """Mean rate (n, 3), rad/s, in the moving frame, over n `intervals` (s) between n + 1 orientations.

    Exact: exp(rate dt) carries one orientation into the next, whatever happened between them.
    """
    return np.asarray((orientation[:-1].inv() * orientation[1:]).as_rotvec()) / intervals[:, None]


def random_mounting(generator: np.random.Generator, largest_angle: float) -> Rotation:
    """A rotation about a random axis by an angle uniform in 0 to `largest_angle`, rad."""
    return Rotation.from_rotvec(random_direction(generator) * generator.uniform(0.0, largest_angle))


def random_direction(generator: np.random.Generator) -> FloatArray:
    """A unit vector (3,), uniform on the sphere."""
    direction = generator.standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction))


class Imu:
    """One IMU fixed to a link, with its drawn biases and the state of its random numbers.

    Each kind of error has a stream of its own, so that switching one off leaves the others as they were, and
    consecutive calls continue each other: two stretches give the numbers of one long stretch.

    Attributes:
        mounting: rotation sensor frame to link frame.
        accel_bias: (3,) m/s^2, sensor frame.
        gyro_scale, accel_scale: (3,) reading over rate and over acceleration of each axis.
        accel_axes: (3, 3) before that: the acceleration along its axes, where they are not perpendicular.
    """

    def __init__(self, noise: ImuNoise, mounting: Rotation, rate_hz: float, seed: np.random.SeedSequence) -> None:
        self.noise = noise
        self.mounting = mounting
        self._rate_hz = rate_hz
        gyro_bias, accel_bias, *rest = (np.random.default_rng(child) for child in seed.spawn(8))
        self._walk, self._gyro_noise, self._accel_noise, self._mag_noise, calibration, gyro_scale = rest
        self._next_gyro_bias = noise.gyro_bias * gyro_bias.uniform(-1.0, 1.0, 3)
        self.gyro_scale: FloatArray = 1.0 + noise.gyro_scale * gyro_scale.uniform(-1.0, 1.0, 3)
        offset, scale = calibration.uniform(-1.0, 1.0, (2, 3))
        self.accel_bias: FloatArray = noise.accel_bias * random_direction(accel_bias) + noise.accel_offset * offset
        self.accel_scale: FloatArray = 1.0 + noise.accel_scale * scale
        self.accel_axes: FloatArray = np.eye(3)

    def gyro(self, orientation: Rotation, intervals: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gyro samples and the biases in them, both (n, 3), rad/s, sensor frame.

        `orientation`: n + 1 rotations link to world, at the ends of the n `intervals` (s).
        """
        return self.gyro_of(mean_rate(orientation, intervals))

    def gyro_of(self, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As `gyro`, from the true mean rates (n, 3), rad/s, in the link frame."""
        truth = self.mounting.apply(rate, inverse=True)
        steps = self.noise.gyro_bias_walk / math.sqrt(self._rate_hz) * self._walk.standard_normal(truth.shape)
        walk = np.cumsum(np.vstack([self._next_gyro_bias, steps]), axis=0)
        bias, self._next_gyro_bias = walk[:-1], walk[-1]
        noisy = truth * self.gyro_scale + bias + self._white(self._gyro_noise, self.noise.gyro_noise, truth)
        return _read_out(noisy, self.noise.gyro_resolution, self.noise.gyro_range), bias

    def accel(self, orientation: Rotation, acceleration: FloatArray) -> FloatArray:
        """Accelerometer samples (n, 3), m/s^2, sensor frame: specific force, +9.81 upward at rest.

        `orientation`: n rotations link to world; `acceleration`: (n, 3) of the sensor itself, link frame, no gravity.
        """
        upward = orientation.apply([0.0, 0.0, GRAVITY], inverse=True)
        truth = self.mounting.apply(acceleration + upward, inverse=True)
        white = self._white(self._accel_noise, self.noise.accel_noise, truth)
        noisy = (truth @ self.accel_axes.T) * self.accel_scale + self.accel_bias + white
        return _read_out(noisy, self.noise.accel_resolution, self.noise.accel_range)

    def mag(self, orientation: Rotation) -> FloatArray:
        """Magnetometer samples (n, 3), tesla, sensor frame, in the undisturbed `EARTH_FIELD`."""
        truth = self.mounting.apply(orientation.apply(EARTH_FIELD, inverse=True), inverse=True)
        return np.asarray(truth + self._white(self._mag_noise, self.noise.mag_noise, truth))

    def _white(self, generator: np.random.Generator, density: float, like: FloatArray) -> FloatArray:
        return density * math.sqrt(self._rate_hz) * generator.standard_normal(like.shape)


def _read_out(samples: FloatArray, resolution: float, full_scale: float) -> FloatArray:
    if resolution > 0.0:
        samples = np.round(samples / resolution) * resolution
    return np.clip(samples, -full_scale, full_scale)
