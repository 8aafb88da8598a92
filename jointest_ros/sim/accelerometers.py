"""Accelerometers without gyro on the links of a planar arm: three of data sheets, and what calibration leaves.

The three are those of Woods & Vikas, section V, with the full scale that the paper set. Typical figures:

- ADXL345 (Analog Devices, Rev. E; +-2 g, 256 LSB/g): noise of x and y 0.75 LSB rms at 100 Hz, which is 414 ug/sqrt(Hz)
  over 50 Hz, and grows with the square root of the rate; 0 g offset 35 mg; sensitivity 1 %.
- ADXL357 (Analog Devices, Rev. A; +-10.24 g, 51200 LSB/g): noise 75 ug/sqrt(Hz); 0 g offset 125 mg; sensitivity within
  8 %, a third of which is taken as typical.
- BNO055 (Bosch Sensortec, 1.4; +-2 g, 1 LSB/mg): noise 150 ug/sqrt(Hz); zero-g offset 80 mg; sensitivity 1 %.

The density of a data sheet fills the bandwidth of half the rate: its white noise has the standard deviation
density x sqrt(rate / 2) a sample. Noise is the same on all axes; temperature and non-linearity are left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.params import Params, param
from jointest_ros.core.robot import STANDARD_GRAVITY, Robot, Sensor
from jointest_ros.sim.imu import Imu, ImuNoise
from jointest_ros.sim.motion import LinkMotion

_MG = 1e-3 * STANDARD_GRAVITY
# What the specification of accelerometer arrays calls mixed errors (section 4, item 6): each uniform in +- this.
RESIDUAL_OFFSET = 20.0 * _MG  # m/s^2 a channel
RESIDUAL_SCALE = 0.01  # a channel
PLACEMENT_SHIFT = 2e-3  # m, along x and y
PLACEMENT_TURN = math.radians(1.0)  # rad, about z


@dataclass(frozen=True)
class AccelModel:
    """Figures of one accelerometer.

    Attributes:
        noise: density, one-sided, m/s^2/sqrt(Hz).
        full_scale: m/s^2; readings are clipped there.
        resolution: one digit, m/s^2; 0 for no rounding.
        offset, scale: typical errors without calibration, m/s^2 and a fraction.
    """

    noise: float
    full_scale: float = math.inf
    resolution: float = 0.0
    offset: float = 0.0
    scale: float = 0.0


MODELS = {
    "ideal": AccelModel(0.0),
    "adxl345": AccelModel(0.414 * _MG, 2.0 * STANDARD_GRAVITY, STANDARD_GRAVITY / 256.0, 35.0 * _MG, 0.01),
    "adxl357": AccelModel(0.075 * _MG, 10.24 * STANDARD_GRAVITY, STANDARD_GRAVITY / 51200.0, 125.0 * _MG, 0.08 / 3.0),
    "bno055": AccelModel(0.150 * _MG, 2.0 * STANDARD_GRAVITY, _MG, 80.0 * _MG, 0.01),
}


@dataclass(frozen=True)
class AccelOptions(Params):
    """What can be chosen of the accelerometers."""

    sensor: str = param("adxl357", "which accelerometer; ideal: no noise, no limits", choices=tuple(MODELS))
    calibration: str = param(
        "residual",
        "what is left of offset and scale: nothing; up to 20 mg and 1 %; or all, as the data sheet has it",
        choices=("exact", "residual", "none"),
    )
    placement: str = param(
        "exact",
        "sensors where the configuration has them; or each off by up to 2 mm along x and y and 1 deg about z",
        choices=("exact", "approximate"),
    )


def accelerometer(name: str, link: str, position: Vec3, options: AccelOptions) -> Sensor:
    """The sensor as its user knows it: figures of the data sheet, but not its errors.

    An ideal one keeps the noise figure that `Sensor` has by default: no filter can do with none.
    """
    model = MODELS[options.sensor]
    if not model.noise:
        return Sensor(name, link, position, gyro=False)
    return Sensor(name, link, position, gyro=False, accel_noise=model.noise, accel_range=model.full_scale)


class Accelerometers:
    """All accelerometers of a robot, with the errors they were drawn and the state of their random numbers.

    Consecutive calls continue each other; switching one kind of error off leaves the others as they were.

    Args:
        robot: its mountings are ignored: sensors are aligned with their links, but for the errors of placement.
        rate_hz: of the samples.
        seed: of all errors.
    """

    def __init__(self, robot: Robot, options: AccelOptions, rate_hz: float, seed: int) -> None:
        model = MODELS[options.sensor]
        offset, scale = {
            "exact": (0.0, 0.0),
            "residual": (RESIDUAL_OFFSET, RESIDUAL_SCALE),
            "none": (model.offset, model.scale),
        }[options.calibration]
        noise = ImuNoise(
            accel_noise=model.noise / math.sqrt(2.0),  # Imu has densities over the bandwidth of the whole rate
            accel_offset=offset,
            accel_scale=scale,
            accel_range=model.full_scale,
            accel_resolution=model.resolution,
        )
        amiss = 1.0 if options.placement == "approximate" else 0.0
        self._mounted: list[tuple[Sensor, Vec3, Imu]] = []
        for sensor, child in zip(robot.sensors, np.random.SeedSequence(seed).spawn(len(robot.sensors)), strict=True):
            place, own = child.spawn(2)
            shift_x, shift_y, turn = np.random.default_rng(place).uniform(-amiss, amiss, 3).tolist()
            x, y, z = sensor.position
            position = (x + PLACEMENT_SHIFT * shift_x, y + PLACEMENT_SHIFT * shift_y, z)
            mounting = Rotation.from_rotvec([0.0, 0.0, PLACEMENT_TURN * turn])
            self._mounted.append((sensor, position, Imu(noise, mounting, rate_hz, own)))

    def read(self, links: Mapping[str, LinkMotion]) -> dict[str, FloatArray]:
        """Sensor -> (n, 3) readings, m/s^2, from the motion of its link at n instants."""
        return {
            sensor.name: imu.accel(links[sensor.link].orientation, links[sensor.link].acceleration_at(position))
            for sensor, position, imu in self._mounted
        }
