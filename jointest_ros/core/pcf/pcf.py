"""`pcf`: joint angles from one IMU on each link (Santaera et al. 2015), in three formulations.

hinge      a Kalman filter on each one-axis joint (see hinge.py); nothing can drift about gravity. The default.
relative   Algorithm 2 on each pair of IMUs: the free relative rotation, of which the angles are taken.
absolute   Algorithm 1 on each IMU, then R1^T R2. Also the orientation of single IMUs (a robot without joints).

Joints of two and three axes use `relative` when `hinge` is chosen. Rotation about gravity is observable only by a
magnetometer; without one, `relative` and `absolute` integrate the gyros there. Joints from the world link: world.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, FloatArray, Frame, Quat, Recording, Series, Status, Vec3
from jointest_ros.core.learned import GYRO_DRIFT, Bias, Learned, by_axis, fingerprint, of_axes
from jointest_ros.core.pcf.absolute import AbsolutePair
from jointest_ros.core.pcf.angle_variance import UNKNOWN_VARIANCE
from jointest_ros.core.pcf.attitude import STILL, Gains
from jointest_ros.core.pcf.hinge import HingeFilter
from jointest_ros.core.pcf.imu import AbsoluteImu, Gaps
from jointest_ros.core.pcf.pair_checks import PairCheck, PairChecks, verdict
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.pcf.relative import RelativePair
from jointest_ros.core.pcf.settings import BiasNoise, Field, HingeNoise, Smoothing
from jointest_ros.core.pcf.world import UPWARD, WorldPair, recording_with_world, with_world, world_sensor
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.stillness import Stillness
from jointest_ros.core.timing import Timing

_START = 5_000_000_000  # ns: a still phase that begins later is not the start
_BLOCK = 32768  # rows that are Python floats at the same time
_UNCALIBRATED, _UNOBSERVABLE = int(Status.UNCALIBRATED), int(Status.UNOBSERVABLE)

JointFilter = HingeFilter | RelativePair | AbsolutePair


class Pcf(Estimator):
    """The estimator of the module text. Joint positions are child relative to parent about +axis."""

    name = "pcf"
    Params = PcfParams
    innovation_limit = 15.0  # accelerations of the links are not in the noise model: sound real hinges reach 13
    params: PcfParams
    _bias: dict[str, Vec3]  # gyro biases that were measured at rest, rad/s by sensor; empty: never
    _warm: bool  # that was in an earlier run
    stillness: Stillness
    _watching: bool  # for the still start
    _first_window: int | None  # ns, end of the first one
    _variance: tuple[float, ...]

    def __init__(self, robot: Robot, params: PcfParams | None = None, timing: Timing | None = None) -> None:
        super().__init__(robot, params, timing)
        p = self.params
        gains = Gains(p.kp, p.ki, p.accel_weight, p.mag_weight, p.axes_weight)
        gaps = Gaps(self.timing.max_gap, self.timing.stale_after, math.radians(p.gap_rate_dps))
        self._world = world_sensor(robot.world) if robot.world else None
        used = [(j, self._imu_on(j, j.parent), self._imu_on(j, j.child)) for j in robot.ordered_joints]
        self.joints = tuple(name for joint, *_ in used for name in joint.coordinates)
        self._imus: dict[str, AbsoluteImu] = {}
        self._filters: list[JointFilter] = []
        if p.formulation == "absolute":
            sensors = [sensor for sensor in robot.sensors if sensor.gyro and sensor.accel]
            self._imus = {sensor.name: AbsoluteImu(sensor, gains, gaps, self._smoothing()) for sensor in sensors}
        for joint, parent, child in used:
            if parent is self._world and not (p.formulation == "hinge" and len(joint.axes) == 1):
                self._filters.append(self._world_pair(joint, child, gains, gaps))
            elif p.formulation == "absolute":
                below = self._imus_below(joint.child)
                one, two = self._imus[parent.name], self._imus[child.name]
                self._filters.append(AbsolutePair(joint, one, two, below, gains, gaps, self._bias_noise()))
            elif p.formulation == "hinge" and len(joint.axes) == 1:
                self._filters.append(HingeFilter(joint, parent, child, self._hinge_noise(), gaps))
            else:
                noise = self._bias_noise()
                self._filters.append(RelativePair(joint, parent, child, gains, gaps, noise, self._smoothing()))
        if not self._imus and not self._filters:
            raise ConfigurationError(
                "robot: no joints between IMUs; pcf needs joints, or formulation: absolute and an IMU"
            )
        self._hinges = [one for one in self._filters if isinstance(one, HingeFilter)]
        self._others = [one for one in self._filters if not isinstance(one, HingeFilter)]
        self._checks = PairChecks(robot, self._hinges)
        self._floor = math.radians(p.floor_deg) ** 2
        self.reset()
        self._start_from_zero_pose()

    def _world_pair(self, joint: Joint, child: Sensor, gains: Gains, gaps: Gaps) -> WorldPair:
        if len(joint.axes) == 2:
            raise ConfigurationError(
                f"joint '{joint.name}'.axes: 2 are not allowed on the world link '{joint.parent}'; "
                "give one, or three ([z, y, x]: yaw, pitch and roll)"
            )
        imu = self._imus.setdefault(child.name, AbsoluteImu(child, gains, gaps, self._smoothing()))
        return WorldPair(joint, imu, self._imus_below(joint.child), gains, gaps, self._bias_noise())

    def _imus_below(self, link: str) -> list[AbsoluteImu]:
        names = [self._imu_on(joint, joint.child).name for joint in self.robot.joints_below(link)]
        return [self._imus[name] for name in names if name in self._imus]

    def _imu_on(self, joint: Joint, link: str) -> Sensor:
        if self._world is not None and link == self._world.link:
            return self._world
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
            bias=self._bias_noise(),
            gravity_cone=math.radians(p.gravity_cone_deg),
            accel_weight=p.accel_weight,
            mag_weight=p.mag_weight,
            smoothing=self._smoothing(),
        )

    def _bias_noise(self) -> BiasNoise:
        return BiasNoise(math.radians(self.params.bias_std_dps), math.radians(self.params.bias_walk_dps))

    def _smoothing(self) -> Smoothing:
        p = self.params
        dip = math.radians(p.mag_dip_tolerance_deg) if p.accel_weight else math.inf  # the dip is against accelerometers
        field = Field(p.mag_norm_tolerance, dip, 1e-6 * p.mag_norm_ut, math.radians(p.mag_dip_deg))
        return Smoothing(p.accel_time, field, p.lever_arms)

    # ------------------------------------------------------------- steps

    def update(self, frame: Frame) -> Estimate:
        """One step: every joint by its own filter."""
        if self._world is not None:
            frame = with_world(frame, self._world.name)
        estimate = self._step(frame, self._filters)
        self._checks.update(frame)
        still = self.stillness.update(frame)
        if still is not None and self._watching:
            self._calibrate_start(frame.stamp, still)
        return estimate

    def _step(self, frame: Frame, filters: Sequence[JointFilter]) -> Estimate:
        """The joints of some filters, and the IMUs."""
        if frame.reset:
            for one in (*self._imus.values(), *filters):
                one.restart()
        orientation: dict[str, Quat] = {}
        for name, imu in self._imus.items():
            imu.update(frame)
            if imu.stamp == frame.stamp:
                orientation[name] = imu.attitude.rotation
        position: list[float] = []
        velocity: list[float] = []
        variance: list[float] = []
        status: list[int] = []
        for joint_filter in filters:
            q, v, p, flags = joint_filter.update(frame)
            position += q
            velocity += v
            variance += p
            status += flags
        floor, uncalibrated = self._floor, 0 if self._bias else _UNCALIBRATED
        self._variance = tuple([one + floor for one in variance])
        flags = tuple([one | uncalibrated for one in status])
        return Estimate(frame.stamp, tuple(position), tuple(velocity), self._variance, flags, None, None, orientation)

    def _calibrate_start(self, stamp: int, still: bool) -> None:
        """Calibrate from the still phase with which the stream begins, better with every window of it."""
        if self._first_window is None:
            self._first_window = stamp
        if still and self.stillness.duration >= self.params.still_start:
            self.calibrate_gyro_bias()
            if self.params.zero_at_start:
                self.calibrate_zero()
        elif not still and ((self._bias and not self._warm) or not 0 <= stamp - self._first_window < _START):
            self._watching = False

    def run(self, recording: Recording) -> Series:
        """Estimates of a stretch of frames; hinges by arrays. Equal to `update` in a loop."""
        if not self._hinges or self.params.mag_weight or self.params.accel_time or not len(recording):
            return super().run(recording)
        if self._world is not None:
            recording = recording_with_world(recording, self._world.name)
        series, start = [], 0
        for stop, still in self.stillness.run(recording):
            if self._watching:
                series.append(self._run_part(recording.part(start, stop)))
                self._calibrate_start(int(recording.stamps[stop - 1]), still)
                start = stop
        rest = recording.part(start, len(recording))
        return Series.concatenate(series + [self._run_part(part) for part in rest.parts(_BLOCK)])

    def _run_part(self, recording: Recording) -> Series:
        """The hinges by arrays, the other joints in a loop."""
        names = [name for one in self._others for name in one.joint.coordinates]
        loop: list[Estimate] = []
        if self._others:
            sensors = {*self._imus, *(sensor for one in self._others for sensor in one.sensors)}
            loop = [self._step(frame, self._others) for frame in recording.of(sensors).frames()]
        others = Series.from_estimates(loop, len(names))
        columns = [hinge.run(recording) for hinge in self._hinges]
        position, velocity, variance, status = (np.column_stack(table) for table in zip(*columns, strict=True))
        variance += self._floor
        status |= 0 if self.calibrated else _UNCALIBRATED
        if self._others:
            names = [one.joint.name for one in self._hinges] + names
            order = [names.index(name) for name in self.joints]
            position = np.hstack([position, others.position])[:, order]
            velocity = np.hstack([velocity, others.velocity])[:, order]
            variance = np.hstack([variance, others.variance])[:, order]
            status = np.hstack([status, others.status])[:, order]
        self._variance = tuple(variance[-1].tolist())
        return Series(recording.stamps, position, velocity, variance, status, orientation=others.orientation)

    # ------------------------------------------------------------- calibrations

    def calibrate_gyro_bias(self) -> None:
        """Take the means of the present still phase as gyro biases.

        Raises:
            CalibrationError: the robot moves, or has not been still for long enough.
        """
        gyro, _ = self._still_means()
        self._take_bias(gyro, math.radians(self.params.calibrated_bias_std_dps))
        self._warm = False

    @property
    def calibrated(self) -> bool:
        """Gyro biases were measured at rest, in this run or in the one that it starts from."""
        return bool(self._bias)

    def _take_bias(self, gyro: dict[str, Vec3], deviation: float) -> None:
        """Gyro biases of all sensors, rad/s, and the standard deviation of the difference of two."""
        for name, imu in self._imus.items():
            imu.imu.bias, imu.attitude.integral = gyro[name], STILL
        for joint_filter in self._filters:
            joint_filter.set_bias(gyro, deviation)
        self._bias = gyro

    def calibrate_zero(self) -> None:
        """Take the present pose as the zero pose of every joint (the paper's initialisation phase).

        Joints from the world link are relative to gravity, and stay so: only what is about gravity becomes zero.

        Raises:
            CalibrationError: the robot moves, or has not been still for long enough.
        """
        _, accel = self._still_means()
        for joint_filter in self._filters:
            on_world = joint_filter.joint.parent == self.robot.world
            if isinstance(joint_filter, HingeFilter) and on_world and not joint_filter.status & _UNOBSERVABLE:
                continue
            joint_filter.set_zero(accel)
        self._checks.clear()

    def _still_means(self) -> tuple[dict[str, Vec3], dict[str, Vec3]]:
        if self.stillness.duration <= 0.0:
            raise CalibrationError(
                "the robot moves, was not still for half a second, or a sensor is silent; hold it still and try again"
            )
        gyro, accel = self.stillness.means()
        if self._world is not None:
            gyro[self._world.name], accel[self._world.name] = STILL, UPWARD
        return gyro, accel

    # ------------------------------------------------------------- from run to run

    def learned(self) -> Learned | None:
        """Gyro biases measured at rest; zero poses, unless each start takes one."""
        if not self._bias:
            return None
        zero = {} if self.params.zero_at_start else {f.joint.name: f.zero_pose for f in self._filters}
        known = self._learned_before(self._bias_names, self._zero_sizes)
        if self._warm and known is not None:
            return replace(known, zero=zero)
        deviation = math.radians(self.params.calibrated_bias_std_dps) / math.sqrt(2.0)
        biases: dict[str, Bias] = {}
        for name in self.stillness.sensors:
            biases |= by_axis(name, self._bias[name], deviation)
        return Learned(fingerprint(self.robot), biases, zero)

    @property
    def _bias_names(self) -> list[str]:
        return [f"{name}.{axis}" for name in self.stillness.sensors for axis in "xyz"]

    @property
    def _zero_sizes(self) -> dict[str, int]:
        return {f.joint.name: len(f.zero_pose) for f in self._filters}

    def _start_warm(self) -> None:
        """Start from the gyro biases of an earlier run; a still start measures them anew."""
        known = self._learned_before(self._bias_names, self._zero_sizes)
        if known is None:
            return
        gyro = {name: of_axes(name, known.biases) for name in self.stillness.sensors}
        if self._world is not None:
            gyro[self._world.name] = STILL
        own = max(deviation for _, deviation in known.biases.values())
        difference = math.sqrt(2.0) * math.hypot(own, GYRO_DRIFT)
        self._take_bias(gyro, min(difference, math.radians(self.params.bias_std_dps)))
        self._warm = True

    def _start_from_zero_pose(self) -> None:
        known = self._learned_before(self._bias_names, self._zero_sizes)
        if known is not None and not self.params.zero_at_start:
            for one in self._filters:
                if one.joint.name in known.zero:
                    one.take_zero_pose(known.zero[one.joint.name])

    # ------------------------------------------------------------- state

    def reset(self) -> None:
        """Forget angles, the start, and the biases of this run; zero poses are kept."""
        p, world = self.params, self._world.name if self._world is not None else None
        self.stillness = Stillness(
            tuple(dict.fromkeys((*self._imus, *(s for f in self._filters for s in f.sensors if s != world)))),
            math.radians(p.still_gyro_dps),
            p.still_accel,
            math.radians(p.largest_bias_dps),
        )
        self._bias, self._warm = {}, False
        self._watching = p.still_start > 0.0
        self._first_window = None
        self._variance = (UNKNOWN_VARIANCE,) * len(self.joints)
        for one in (*self._imus.values(), *self._filters):
            one.reset()
        self._checks.reset()
        self._start_warm()

    def get_state(self) -> dict[str, Any]:
        """The whole state; but the means of the present still phase only while the still start is awaited."""
        return {
            "bias": {name: list(bias) for name, bias in self._bias.items()},
            "warm": self._warm,
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
        self._bias = {name: (x, y, z) for name, (x, y, z) in state["bias"].items()}
        self._warm, self._watching = state["warm"], state["watching"]
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
        return [f.innovation / math.sqrt(f.innovation_variance) for f in self._hinges]

    def innovation_joints(self) -> tuple[str, ...]:
        """See `Estimator`."""
        return tuple([one.joint.name for one in self._hinges])

    def pair_checks(self) -> list[PairCheck]:
        """Whether the IMUs of hinges agree, which `update` watches: by pair, redundant ones last."""
        return self._checks.checks()

    def warnings(self) -> list[str]:
        """IMUs that do not agree with their neighbours."""
        text = verdict(self.pair_checks())
        return [*super().warnings(), *([text] if text else [])]

    def biases(self) -> dict[str, float]:
        """Gyro biases, rad/s: `<joint>.gyro` along the axis of a hinge (child minus parent), else by component."""
        biases: dict[str, float] = {}
        for one in (*self._imus.values(), *self._filters):
            biases.update(one.biases())
        return biases
