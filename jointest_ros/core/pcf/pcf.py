"""`pcf`: joint angles from one IMU on each link (Santaera et al. 2015), in three formulations.

hinge      a Kalman filter on each one-axis joint (see hinge.py); nothing can drift about gravity. The default.
relative   Algorithm 2 on each pair of IMUs: the free relative rotation, of which the angles are taken.
absolute   Algorithm 1 on each IMU, then R1^T R2. Also the orientation of single IMUs (a robot without joints).

Joints of two and three axes use `relative` when `hinge` is chosen. Rotation about gravity is observable only by a
magnetometer; without one, `relative` and `absolute` integrate the gyros there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, FloatArray, Frame, Recording, Series, Status, Vec3
from jointest_ros.core.params import Params, param
from jointest_ros.core.pcf.attitude import STILL, Gains
from jointest_ros.core.pcf.hinge import HingeFilter, HingeNoise
from jointest_ros.core.pcf.imu import AbsoluteImu, Gaps
from jointest_ros.core.pcf.pair import UNKNOWN_VARIANCE, AbsolutePair, RelativePair
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.stillness import Stillness
from jointest_ros.core.timing import Timing

FORMULATIONS = ("hinge", "relative", "absolute")


@dataclass(frozen=True)
class PcfParams(Params):
    """The `estimators: pcf:` section of a configuration."""

    formulation: str = param("hinge", "which filter: see the estimator's page", choices=FORMULATIONS)
    kp: float = param(
        1.0,
        "proportional gain of relative and absolute; lower it where the robot shakes",
        unit="1/s",
        low=0.0,
        high=100.0,
    )
    ki: float = param(
        0.05, "integral gain of relative and absolute (learns the gyro bias)", unit="1/s^2", low=0.0, high=100.0
    )
    accel_weight: float = param(1.0, "weight of the accelerometers in the correction", low=0.0, high=1e3)
    mag_weight: float = param(0.0, "weight of the magnetometers in the correction; 0: not used", low=0.0, high=1e3)
    bias_walk_dps: float = param(
        1e-4, "hinge: random walk of the gyro bias difference", unit="deg/s/sqrt(s)", low=0.0, high=10.0
    )
    bias_std_dps: float = param(
        4.0, "hinge: standard deviation of an uncalibrated gyro bias difference", unit="deg/s", low=0.0, high=100.0
    )
    calibrated_bias_std_dps: float = param(
        0.005, "hinge: the same after a calibration at rest", unit="deg/s", low=0.0, high=100.0
    )
    gap_rate_dps: float = param(
        200.0,
        "standard deviation of the joint rate that a gap longer than max_gap hides",
        unit="deg/s",
        low=0.0,
        high=1e4,
    )
    floor_deg: float = param(
        0.05,
        "added to the reported standard deviation for lever arms and mounting, which no sensor noise covers",
        unit="deg",
        low=0.0,
        high=45.0,
    )
    gravity_cone_deg: float = param(
        10.0, "hinge: an axis closer to gravity than this runs on the gyro alone", unit="deg", low=0.1, high=45.0
    )
    still_start: float = param(
        1.0,
        "gyro biases are calibrated when the robot stands still for this long at the start; 0: never",
        unit="s",
        low=0.0,
        high=60.0,
    )
    still_gyro_dps: float = param(
        1.0, "still: largest standard deviation of a gyro axis", unit="deg/s", low=1e-3, high=100.0
    )
    still_accel: float = param(
        0.5, "still: largest standard deviation of an accelerometer axis", unit="m/s^2", low=1e-3, high=10.0
    )
    largest_bias_dps: float = param(
        5.0, "still: a mean rate above this is motion, not bias", unit="deg/s", low=1e-3, high=100.0
    )
    zero_at_start: bool = param(False, "the pose of the still start is the zero pose of every joint")


_START = 5_000_000_000  # ns: a still phase that begins later is not the start
_BLOCK = 32768  # rows that are Python floats at the same time
_UNCALIBRATED = int(Status.UNCALIBRATED)


class Pcf(Estimator):
    """The estimator of the module text. Joint positions are child relative to parent about +axis."""

    name = "pcf"
    Params = PcfParams
    params: PcfParams
    calibrated: bool  # gyro biases were measured at rest
    stillness: Stillness
    _watching: bool  # for the still start
    _first_window: int | None  # ns, end of the first one
    _variance: tuple[float, ...]

    def __init__(self, robot: Robot, params: PcfParams | None = None, timing: Timing | None = None) -> None:
        super().__init__(robot, params, timing)
        p = self.params
        gains = Gains(p.kp, p.ki, p.accel_weight, p.mag_weight)
        gaps = Gaps(self.timing.max_gap, self.timing.stale_after, math.radians(p.gap_rate_dps))
        used = [(j, self._imu_on(j, j.parent), self._imu_on(j, j.child)) for j in robot.ordered_joints]
        self.joints = tuple(name for joint, *_ in used for name in joint.coordinates)
        self._imus: dict[str, AbsoluteImu] = {}
        self._filters: list[HingeFilter | RelativePair | AbsolutePair] = []
        if p.formulation == "absolute":
            sensors = [sensor for sensor in robot.sensors if sensor.gyro and sensor.accel]
            self._imus = {sensor.name: AbsoluteImu(sensor, gains, gaps) for sensor in sensors}
        for joint, parent, child in used:
            if p.formulation == "absolute":
                below = [self._imus[self._imu_on(j, j.child).name] for j in robot.joints_below(joint.child)]
                one, two = self._imus[parent.name], self._imus[child.name]
                self._filters.append(AbsolutePair(joint, one, two, below, gains, gaps))
            elif p.formulation == "hinge" and len(joint.axes) == 1:
                self._filters.append(HingeFilter(joint, parent, child, self._hinge_noise(), gaps))
            else:
                self._filters.append(RelativePair(joint, parent, child, gains, gaps))
        if not self._imus and not self._filters:
            raise ConfigurationError(
                "robot: no joints between IMUs; pcf needs joints, or formulation: absolute and an IMU"
            )
        self._hinges = [one for one in self._filters if isinstance(one, HingeFilter)]
        self._floor = math.radians(p.floor_deg) ** 2
        self.reset()

    def _imu_on(self, joint: Joint, link: str) -> Sensor:
        for sensor in self.robot.sensors_on(link):
            if sensor.gyro and sensor.accel:
                return sensor
        raise ConfigurationError(
            f"joint '{joint.name}': link '{link}' carries no sensor with gyro and accelerometer; "
            "pcf needs one on either side"
        )

    def _hinge_noise(self) -> HingeNoise:
        p = self.params
        return HingeNoise(
            bias_walk=math.radians(p.bias_walk_dps),
            bias_std=math.radians(p.bias_std_dps),
            calibrated_bias_std=math.radians(p.calibrated_bias_std_dps),
            gravity_cone=math.radians(p.gravity_cone_deg),
            accel_weight=p.accel_weight,
            mag_weight=p.mag_weight,
        )

    # ------------------------------------------------------------- steps

    def update(self, frame: Frame) -> Estimate:
        """One step: every joint by its own filter."""
        if frame.reset:
            for one in (*self._imus.values(), *self._filters):
                one.restart()
        for imu in self._imus.values():
            imu.update(frame)
        position: list[float] = []
        velocity: list[float] = []
        variance: list[float] = []
        status: list[int] = []
        for joint_filter in self._filters:
            q, v, p, flags = joint_filter.update(frame)
            position += q
            velocity += v
            variance += p
            status += flags
        floor, uncalibrated = self._floor, 0 if self.calibrated else _UNCALIBRATED
        self._variance = tuple([one + floor for one in variance])
        flags = tuple([one | uncalibrated for one in status])
        orientation = {name: imu.attitude.rotation for name, imu in self._imus.items() if imu.stamp == frame.stamp}
        still = self.stillness.update(frame)
        if still is not None and self._watching:
            self._calibrate_start(frame.stamp, still)
        return Estimate(frame.stamp, tuple(position), tuple(velocity), self._variance, flags, orientation=orientation)

    def _calibrate_start(self, stamp: int, still: bool) -> None:
        """Calibrate from the still phase with which the stream begins, better with every window of it."""
        if self._first_window is None:
            self._first_window = stamp
        if still and self.stillness.duration >= self.params.still_start:
            self.calibrate_gyro_bias()
            if self.params.zero_at_start:
                self.calibrate_zero()
        elif not still and (self.calibrated or not 0 <= stamp - self._first_window < _START):
            self._watching = False

    def run(self, recording: Recording) -> Series:
        """Estimates of a stretch of frames; hinges by arrays. Equal to `update` in a loop."""
        hinges_only = self._hinges and len(self._hinges) == len(self._filters)
        if not hinges_only or self.params.mag_weight or not len(recording):
            return super().run(recording)
        series, start = [], 0
        for stop, still in self.stillness.run(recording):
            if self._watching:
                series.append(self._run_hinges(recording.part(start, stop)))
                self._calibrate_start(int(recording.stamps[stop - 1]), still)
                start = stop
        rest = recording.part(start, len(recording))
        return Series.concatenate(series + [self._run_hinges(part) for part in rest.parts(_BLOCK)])

    def _run_hinges(self, recording: Recording) -> Series:
        columns = [hinge.run(recording) for hinge in self._hinges]
        position, velocity, variance, status = (np.column_stack(table) for table in zip(*columns, strict=True))
        variance += self._floor
        status |= 0 if self.calibrated else _UNCALIBRATED
        self._variance = tuple(variance[-1].tolist())
        return Series(recording.stamps, position, velocity, variance, status)

    # ------------------------------------------------------------- calibrations

    def calibrate_gyro_bias(self) -> None:
        """Take the means of the present still phase as gyro biases.

        Raises:
            CalibrationError: the robot moves, or has not been still for long enough.
        """
        gyro, _ = self._still_means()
        for name, imu in self._imus.items():
            imu.imu.bias, imu.attitude.integral = gyro[name], STILL
        for joint_filter in self._filters:
            joint_filter.set_bias(gyro)
        self.calibrated = True

    def calibrate_zero(self) -> None:
        """Take the present pose as the zero pose of every joint (the paper's initialisation phase).

        Raises:
            CalibrationError: the robot moves, or has not been still for long enough.
        """
        _, accel = self._still_means()
        for joint_filter in self._filters:
            joint_filter.set_zero(accel)

    def _still_means(self) -> tuple[dict[str, Vec3], dict[str, Vec3]]:
        if self.stillness.duration <= 0.0:
            raise CalibrationError(
                "the robot moves, was not still for half a second, or a sensor is silent; hold it still and try again"
            )
        return self.stillness.means()

    # ------------------------------------------------------------- state

    def reset(self) -> None:
        """Forget angles, biases and the start; zero poses are kept."""
        p = self.params
        self.stillness = Stillness(
            tuple(self._imus) or tuple(dict.fromkeys(s for f in self._filters for s in f.sensors)),
            math.radians(p.still_gyro_dps),
            p.still_accel,
            math.radians(p.largest_bias_dps),
        )
        self.calibrated = False
        self._watching = p.still_start > 0.0
        self._first_window = None
        self._variance = (UNKNOWN_VARIANCE,) * len(self.joints)
        for one in (*self._imus.values(), *self._filters):
            one.reset()

    def get_state(self) -> dict[str, Any]:
        """The whole state; but the means of the present still phase only while the still start is awaited."""
        return {
            "calibrated": self.calibrated,
            "watching": self._watching,
            "first_window": self._first_window,
            "stillness": self.stillness.get_state() if self._watching else None,
            "variance": list(self._variance),
            "imus": {name: imu.get_state() for name, imu in self._imus.items()},
            "joints": {f.joint.name: f.get_state() for f in self._filters},
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue identically from `get_state`."""
        self.reset()
        self.calibrated, self._watching = state["calibrated"], state["watching"]
        self._first_window, self._variance = state["first_window"], tuple(state["variance"])
        if state["stillness"] is not None:
            self.stillness.set_state(state["stillness"])
        for name, imu in self._imus.items():
            imu.set_state(state["imus"][name])
        for joint_filter in self._filters:
            joint_filter.set_state(state["joints"][joint_filter.joint.name])

    def covariance(self) -> FloatArray:
        """Diagonal: the joints are estimated one by one."""
        return np.diag(self._variance)

    def innovations(self) -> list[float]:
        """Of the hinges' newest corrections, over their standard deviations; NaN where there was none."""
        hinges = [f for f in self._filters if isinstance(f, HingeFilter)]
        return [f.innovation / math.sqrt(f.innovation_variance) for f in hinges]

    def biases(self) -> dict[str, float]:
        """Gyro biases, rad/s: `<joint>.gyro` along the axis of a hinge (child minus parent), else by component."""
        biases: dict[str, float] = {}
        for one in (*self._imus.values(), *self._filters):
            biases.update(one.biases())
        return biases
