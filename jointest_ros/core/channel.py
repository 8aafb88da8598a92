"""What is taken of an inertial sensor, which of its samples are refused at sight, and how it is calibrated."""

from __future__ import annotations

import math
from dataclasses import dataclass

from jointest_ros.core.frame import Vec3
from jointest_ros.core.input_quality import gyro_saturation_limit, saturation_limit
from jointest_ros.core.robot import UNCALIBRATED_SCALE, Sensor

IMPLAUSIBLE_GYRO = 1e3  # rad/s, ten times the fastest MEMS gyro range
IMPLAUSIBLE_ACCEL = 1e5  # m/s^2, fifty times the widest MEMS shock accelerometer range


@dataclass(frozen=True, slots=True)
class Channel:
    """An inertial sensor as the frame assembler takes it.

    Attributes:
        gyro, accel: are in use.
        delay: ns, goes off the stamps.
        gyro_limit, accel_limit: rad/s, m/s^2; a reading whose sum of all axes is below it needs no closer look.
        gyro_scale: factors, None: not calibrated.
        accel_calibration: rows of the matrix and offset, None: not calibrated.
    """

    gyro: bool
    accel: bool
    delay: int
    gyro_limit: float
    accel_limit: float
    gyro_scale: Vec3 | None
    accel_calibration: tuple[Vec3, Vec3, Vec3, Vec3] | None

    @classmethod
    def of(cls, sensor: Sensor) -> Channel:
        """As configured."""
        return cls(
            sensor.gyro,
            sensor.accel,
            round(sensor.delay * 1e9),
            min(IMPLAUSIBLE_GYRO, gyro_saturation_limit(sensor)),
            min(IMPLAUSIBLE_ACCEL, saturation_limit(sensor)),
            None if sensor.gyro_scale == UNCALIBRATED_SCALE else sensor.gyro_scale,
            (*sensor.accel_matrix, sensor.accel_offset) if sensor.accel_calibrated else None,
        )

    def unsound(self, gyro: Vec3, accel: Vec3) -> str:
        """Why a sample is refused for what it reads in the fields in use; "" where it is not."""
        rate, force = gyro if self.gyro else (), accel if self.accel else ()
        if not all(map(math.isfinite, rate + force)):
            return "not finite"
        if sum(map(abs, rate)) < IMPLAUSIBLE_GYRO and sum(map(abs, force)) < IMPLAUSIBLE_ACCEL:
            return ""
        return "implausible"


def calibrated(reading: Vec3, row_x: Vec3, row_y: Vec3, row_z: Vec3, offset: Vec3) -> Vec3:
    """Acceleration of an accelerometer's reading, m/s^2: matrix (by rows) times reading, plus offset."""
    x, y, z = reading
    return (
        row_x[0] * x + row_x[1] * y + row_x[2] * z + offset[0],
        row_y[0] * x + row_y[1] * y + row_y[2] * z + offset[1],
        row_z[0] * x + row_z[1] * y + row_z[2] * z + offset[2],
    )
