"""The samples of one IMU over time: gaps in them, gyro bias, and the attitude by Algorithm 1 (`absolute`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from jointest_ros.core.frame import Frame, Status, Vec3
from jointest_ros.core.pcf.attitude import STILL, UP, ComplementaryFilter, Gains, heading_north, world_field
from jointest_ros.core.pcf.average import AccelAverage
from jointest_ros.core.pcf.field import FieldWatch
from jointest_ros.core.pcf.lever_arm import at_joint, change
from jointest_ros.core.pcf.settings import NO_SMOOTHING, Smoothing
from jointest_ros.core.robot import Sensor
from jointest_ros.core.rotation import between, exp, multiply

UNKNOWN_PERIOD = 0.01  # s, taken where the period is not known yet
# Sums of IntFlag members cost half a microsecond each: plain numbers here.
_NO_DATA, _GAP, _STALE = int(Status.NO_DATA), int(Status.GAP), int(Status.STALE)


@dataclass(frozen=True)
class Gaps:
    """How time without samples is treated."""

    max_gap: float  # s
    stale_after: float  # s
    gap_rate: float  # rad/s, standard deviation of a rate that nobody measured

    def measured(self, elapsed: float, period: float) -> float:
        """The last part of `elapsed` s that the newest sample covers, s. Less than all of it: samples are missing."""
        if elapsed <= 1.5 * period:
            return elapsed
        if period == period:
            return period
        return elapsed if elapsed <= self.max_gap else UNKNOWN_PERIOD

    def hold(self, stamp: int, before: int | None, measured: float) -> float:
        """For how long a slower measurement at `stamp` stands that came at `before` the last time, s."""
        return measured if before is None else min((stamp - before) * 1e-9, self.max_gap)

    def spread(self, elapsed: float) -> float:
        """What `elapsed` s without samples add to the variance of an angle, rad^2."""
        return (self.gap_rate * elapsed) ** 2 if elapsed > self.max_gap else 0.0

    def flags(self, elapsed: float) -> int:
        """`Status` of a joint whose sensors have been silent for `elapsed` s."""
        return _NO_DATA | (_GAP if elapsed > self.max_gap else 0) | (_STALE if elapsed > self.stale_after else 0)


def bridge(before: Vec3, now: Vec3, elapsed: float, measured: float) -> Vec3:
    """Mean rate over `elapsed` s of which only the last `measured` were measured.

    The missing part takes the mean of the rates on either side.
    """
    if measured == elapsed:
        return now
    k = 0.5 * (1.0 - measured / elapsed)
    return (
        now[0] + k * (before[0] - now[0]),
        now[1] + k * (before[1] - now[1]),
        now[2] + k * (before[2] - now[2]),
    )


class Imu:
    """The samples of one sensor as a filter wants them, with the gyro bias removed that was calibrated at rest."""

    def __init__(self, sensor: Sensor, smoothing: Smoothing, arm: Vec3 | None = None) -> None:
        """`arm`: from the joint to the sensor, m in the sensor's frame; the accelerometer is moved along it."""
        self.sensor, self._name, self._arm = sensor, sensor.name, arm
        self.average = AccelAverage(smoothing.accel_time) if smoothing.accel_time else None
        self.watch = FieldWatch(smoothing.field)
        self.reset()

    def restart(self) -> None:
        """Forget the newest samples; the bias and the reference of the field are kept."""
        self.before: Vec3 = STILL  # rad/s, rate of the sample before
        self.watch.restart()
        if self.average is not None:
            self.average.restart()

    def reset(self) -> None:
        """Forget the bias and the reference too."""
        self.bias: Vec3 = STILL  # rad/s
        self.watch.reset()
        self.restart()

    def read(self, frame: Frame, elapsed: float, integral: Vec3) -> tuple[Vec3, Vec3] | None:
        """(gyro without bias, accelerometer at the joint and averaged, if wanted) or None where one is missing.

        `elapsed` s since the sample before; NaN: it is the first one, or after a gap. `integral`: of the filter, rad/s,
        minus what it has found of the bias since.
        """
        gyro, accel = frame.gyro.get(self._name), frame.accel.get(self._name)
        if gyro is None or accel is None:
            return None
        (x, y, z), (bx, by, bz) = gyro, self.bias
        rate = (x - bx, y - by, z - bz)
        if self._arm is not None:
            turning = change(self.before, rate, elapsed) if 0.0 < elapsed <= 1.5 * frame.period else STILL
            accel = at_joint(accel, rate, turning, self._arm)
        if self.average is not None and self.bias != STILL:  # measured
            carried = (rate[0] + integral[0], rate[1] + integral[1], rate[2] + integral[2])
            accel = self.average.add(carried, accel, elapsed)
        return rate, accel

    def sound_field(self, frame: Frame) -> Vec3 | None:
        """The magnetic field, or None where this frame has none or it is disturbed. Once a frame."""
        field = frame.mag.get(self._name)
        if field is None:
            return None
        return field if self.watch.sound(frame.stamp, frame.gyro[self._name], frame.accel[self._name], field) else None

    def get_state(self) -> dict[str, Any]:
        """All that changes, as plain numbers and lists."""
        average = [] if self.average is None else self.average.get_state()
        state = {"bias": list(self.bias), "before": list(self.before), "watch": self.watch.get_state()}
        return {**state, "average": average}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`."""
        self.bias, self.before = tuple(state["bias"]), tuple(state["before"])
        self.watch.set_state(state["watch"])
        if self.average is not None:
            self.average.set_state(state["average"])


class AbsoluteImu:
    """Algorithm 1 on one sensor: `attitude.rotation` is sensor to world (z up; y north with a magnetometer)."""

    stamp: int | None  # ns, of the newest sample
    mag_stamp: int | None

    def __init__(self, sensor: Sensor, gains: Gains, gaps: Gaps, smoothing: Smoothing = NO_SMOOTHING) -> None:
        self.imu, self.gaps = Imu(sensor, smoothing), gaps
        self.attitude = ComplementaryFilter(gains)
        self.restart()

    @property
    def disturbed(self) -> bool:
        """The magnetometer is, and has no influence."""
        return self.imu.watch.disturbed

    def update(self, frame: Frame) -> None:
        """One step; none where the sensor is missing."""
        attitude, imu = self.attitude, self.imu
        elapsed = math.nan if self.stamp is None else (frame.stamp - self.stamp) * 1e-9
        sample = imu.read(frame, elapsed if elapsed <= self.gaps.max_gap else math.nan, attitude.integral)
        if sample is None:
            return
        gyro, accel = sample
        field = imu.sound_field(frame) if attitude.gains.mag_weight else None
        if self.stamp is None:
            attitude.rotation = between(accel, UP)
        else:
            measured = self.gaps.measured(elapsed, frame.period)
            rate, turned = bridge(self.imu.before, gyro, elapsed, measured), elapsed
            if elapsed > self.gaps.max_gap:  # nobody knows: gravity alone, and no turn
                turned = 0.0
                attitude.align(UP, accel)
            north = None
            if field is not None:
                turn = exp((rate[0] * turned, rate[1] * turned, rate[2] * turned))
                north = world_field(multiply(attitude.rotation, turn), field)
            field_time = self.gaps.hold(frame.stamp, self.mag_stamp, measured)
            attitude.step(turned, measured, STILL, rate, UP, accel, north, field, field_time)
        if field is not None:
            if self.mag_stamp is None:
                attitude.rotation = heading_north(attitude.rotation, field)
            self.mag_stamp = frame.stamp
        self.imu.before, self.stamp = gyro, frame.stamp

    def restart(self) -> None:
        """Start the attitude afresh from the next sample; what is known of the bias is kept."""
        self.stamp = self.mag_stamp = None
        self.imu.restart()

    def reset(self) -> None:
        """Forget attitude and bias."""
        self.restart()
        self.imu.reset()
        self.attitude.integral = STILL

    def biases(self) -> dict[str, float]:
        """Gyro bias by component in the sensor's frame, rad/s: calibrated part less the integral."""
        parts = zip("xyz", self.imu.bias, self.attitude.integral, strict=True)
        return {f"{self.imu.sensor.name}.gyro_{c}": b - i for c, b, i in parts}

    def get_state(self) -> dict[str, Any]:
        """All that changes, as plain numbers."""
        return {
            "stamp": self.stamp,
            "mag_stamp": self.mag_stamp,
            "rotation": list(self.attitude.rotation),
            "integral": list(self.attitude.integral),
            "imu": self.imu.get_state(),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`."""
        self.stamp, self.mag_stamp = state["stamp"], state["mag_stamp"]
        self.attitude.rotation, self.attitude.integral = tuple(state["rotation"]), tuple(state["integral"])
        self.imu.set_state(state["imu"])
