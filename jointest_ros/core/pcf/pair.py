"""The `relative` and `absolute` formulations of the PCF: how pairs of IMUs become joint angles.

Both hold R12 (child sensor to parent sensor): `relative` as the state of one filter, `absolute` as R1^T R2 of two. With
the mountings M (sensor to link) and the zero pose Z, R_o = M1^T Z M2 is R12 at the zero pose, and R_o^T R12 is the
rotation of the joint about its axes as the child's sensor has them (25).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from jointest_ros.core.frame import Frame, Quat, Status, Vec3
from jointest_ros.core.pcf.attitude import (
    STILL,
    ComplementaryFilter,
    Gains,
    heading_difference,
    joint_angles,
    joint_rates,
    lever,
    zero_rotation,
)
from jointest_ros.core.pcf.imu import AbsoluteImu, Gaps, Imu, bridge
from jointest_ros.core.pcf.settings import NO_SMOOTHING, Smoothing
from jointest_ros.core.robot import STANDARD_GRAVITY, Joint, Sensor
from jointest_ros.core.rotation import IDENTITY, conjugate, dot, multiply, rotate, rotate_inverse, wrap
from jointest_ros.core.saturated_gyros import SaturatedGyros

UNKNOWN_VARIANCE = math.pi**2 / 3.0  # rad^2, of an angle of which nothing is known
START_VARIANCE = 0.25  # rad^2, of the first angle: it may be taken while the robot moves
_LEAST_LEVER = 0.03  # squared sine of the angle between axis and gravity (10 deg) below which gravity tells nothing
_NO_DATA, _GAP, _STALE, _STARTING = int(Status.NO_DATA), int(Status.GAP), int(Status.STALE), int(Status.STARTING)
_UNOBSERVABLE, _DISTURBED = int(Status.UNOBSERVABLE), int(Status.DISTURBED)
_LISTS = ("zero", "position", "velocity", "variance", "status", "field")

# positions rad, velocities rad/s, variances rad^2, `Status` flags: one entry an axis of the joint
JointOutput = tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...], tuple[int, ...]]


class _Pair:
    """What both formulations share: from R12 to the positions of one joint."""

    stamp: int | None  # ns, of the newest frame with both sensors
    mag_stamp: int | None  # ns, of the newest frame with both magnetometers, undisturbed
    disturbed: bool  # a magnetometer is, and both have no influence
    field: Vec3  # tesla, in the child's sensor at `mag_stamp`

    def __init__(self, joint: Joint, parent: Sensor, child: Sensor, gains: Gains, gaps: Gaps) -> None:
        self.joint, self.parent, self.child, self.gains, self.gaps = joint, parent, child, gains, gaps
        limits = joint.limits or ((-math.inf, math.inf),) * len(joint.axes)
        self._middles = tuple([0.5 * (low + high) if joint.limits else 0.0 for low, high in limits])
        # The middle of a range of a turn or less tells the branch of an angle, otherwise the angle before does.
        self._bounded = tuple([high - low <= 2.0 * math.pi for low, high in limits])
        self._gyro_density2 = parent.gyro_noise**2 + child.gyro_noise**2
        accel2 = (parent.accel_noise**2 + child.accel_noise**2) / STANDARD_GRAVITY**2
        self._correction_density2 = (gains.kp**2 + gains.ki) * accel2
        self._saturation = SaturatedGyros((parent, child), gaps.gap_rate)
        self._take_zero(IDENTITY)
        self.restart()

    def restart(self) -> None:
        """Start the angles afresh from the next frame."""
        n = len(self.joint.axes)
        self.stamp = self.mag_stamp = None
        self.disturbed = False
        self._saturated, self._saturation.time = False, 0.0
        self._added = 0.0  # rad^2, to every variance at the newest step, by what nobody measured
        self.field = STILL
        self.position, self.velocity, self.variance = (0.0,) * n, (0.0,) * n, (UNKNOWN_VARIANCE,) * n
        self.status = (_STARTING,) * n

    @property
    def sensors(self) -> tuple[str, str]:
        """Names of the two sensors."""
        return self.parent.name, self.child.name

    def get_state(self) -> dict[str, Any]:
        """All that changes, as plain numbers."""
        lists = {name: list(getattr(self, name)) for name in _LISTS}
        state = {"stamp": self.stamp, "mag_stamp": self.mag_stamp, "disturbed": self.disturbed, **lists}
        return state | {"saturated": self._saturation.time}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`."""
        self.stamp, self.mag_stamp, self.disturbed = state["stamp"], state["mag_stamp"], state["disturbed"]
        self._saturation.time = state["saturated"]
        for name in _LISTS:
            setattr(self, name, tuple(state[name]))
        self._take_zero(self.zero)

    # ------------------------------------------------------------- zero pose

    def _take_zero(self, zero: Quat) -> None:
        self.zero = zero  # child link to parent link at the zero pose
        child = multiply(zero, self.child.mounting)
        self.at_zero = multiply(conjugate(self.parent.mounting), child)  # R_o
        self._from_zero = conjugate(self.at_zero)
        self.axes = tuple(rotate_inverse(child, axis) for axis in self.joint.axes)  # in the child's sensor

    @property
    def zero_pose(self) -> tuple[float, ...]:
        """Rotation child link to parent link at the zero pose, x, y, z, w."""
        return self.zero

    def take_zero_pose(self, numbers: tuple[float, ...]) -> None:
        """Before the first frame: `zero_pose` of an earlier run."""
        x, y, z, w = numbers
        self._take_zero((x, y, z, w))

    def set_zero(self, accel: dict[str, Vec3]) -> None:
        """The present pose is the zero pose; mean accelerometers by sensor, m/s^2."""
        b1 = rotate(self.parent.mounting, accel[self.parent.name])
        b2 = rotate(self.child.mounting, accel[self.child.name])
        if len(self.joint.axes) > 1 or lever(self.joint.axes[0], b1) > _LEAST_LEVER:
            self._take_zero(zero_rotation(self.joint.axes, b1, b2))
        self.position = self.variance = (0.0,) * len(self.axes)

    def first_guess(self, a1: Vec3, a2: Vec3) -> Quat:
        """R12 that agrees with gravity and with the joint; what gravity does not show is as at the zero pose."""
        if len(self.axes) == 1 and lever(self.axes[0], a2) < _LEAST_LEVER:
            return self.at_zero
        return multiply(self.at_zero, zero_rotation(self.axes, rotate_inverse(self.at_zero, a1), a2))

    # ------------------------------------------------------------- steps

    def _output(self, stamp: int, r12: Quat, rate: Vec3, a2: Vec3, elapsed: float) -> JointOutput:
        """Take over R12 and the relative rate (in the child's sensor) at `stamp`, `elapsed` s after the last one."""
        angles = joint_angles(self.axes, multiply(self._from_zero, r12))
        levers = self._levers(stamp, angles, a2)
        if self.stamp is None:
            self.variance = tuple([START_VARIANCE if s2 > _LEAST_LEVER else UNKNOWN_VARIANCE for s2 in levers])
            self.position = self._middles
        flags, gap = _DISTURBED if self.disturbed else 0, 0.0
        if elapsed > self.gaps.max_gap:
            flags, gap = flags | _GAP, self.gaps.spread(elapsed)
        if self._saturated:
            flags, gap = flags | _DISTURBED, gap + self._saturation.spread(elapsed)
        else:
            self._saturation.time = 0.0
        self._added = gap
        decay, noise, correction = self.gains.kp * elapsed, self._gyro_density2, self._correction_density2
        position, variance, status = [], [], []
        for i, s2 in enumerate(levers):
            near = self._middles[i] if self._bounded[i] else self.position[i]
            turn = angles[i] - near
            position.append(near + turn if -math.pi <= turn <= math.pi else near + wrap(turn))
            kept = 1.0 - decay * s2 if decay * s2 < 1.0 else 0.0
            after = kept * kept * self.variance[i] + (noise + correction * s2) * elapsed + gap
            variance.append(after if after < UNKNOWN_VARIANCE else UNKNOWN_VARIANCE)
            status.append(flags if s2 > _LEAST_LEVER else flags | _UNOBSERVABLE)
        self.stamp, self.velocity = stamp, joint_rates(self.axes, angles, rate)
        self.position, self.variance, self.status = tuple(position), tuple(variance), tuple(status)
        return self.position, self.velocity, self.variance, self.status

    def _levers(self, stamp: int, angles: tuple[float, ...], a2: Vec3) -> Sequence[float]:
        """How much of a turn of each coordinate the measured directions show, 0 (nothing) to 1.

        A turn about gravity, at 1 rad/s, turns coordinate i at t_i and cannot be seen: 1 - t_i^2 is left (one axis: the
        squared sine of the angle between axis and gravity). The same holds for the magnetic field.
        """
        levers = self._levers_of(a2, angles)
        if self.mag_stamp is not None and (stamp - self.mag_stamp) * 1e-9 <= self.gaps.max_gap:
            weight = self.gains.mag_weight
            fields = self._levers_of(self.field, angles)
            return [min(1.0, one + weight * other) for one, other in zip(levers, fields, strict=True)]
        return levers

    def _levers_of(self, direction: Vec3, angles: tuple[float, ...]) -> Sequence[float]:
        if len(angles) == 1:
            return (lever(self.axes[0], direction),)
        length2 = dot(direction, direction)
        if length2 == 0.0:
            return (0.0,) * len(angles)
        return [max(0.0, 1.0 - t * t / length2) for t in joint_rates(self.axes, angles, direction)]

    def _extrapolate(self, stamp: int) -> JointOutput:
        """Without new data: the velocity carries the position on for at most `max_gap`; the state is left alone."""
        gaps = self.gaps
        if self.stamp is None:
            flags = _NO_DATA | _STALE
            return self.position, self.velocity, self.variance, tuple(one | flags for one in self.status)
        elapsed = (stamp - self.stamp) * 1e-9
        flags = gaps.flags(elapsed)
        carried = min(elapsed, gaps.max_gap)
        position = tuple(p + v * carried for p, v in zip(self.position, self.velocity, strict=True))
        velocity = self.velocity if elapsed <= gaps.max_gap else (0.0,) * len(position)
        variance = tuple(min(v + gaps.spread(elapsed), UNKNOWN_VARIANCE) for v in self.variance)
        return position, velocity, variance, tuple(one | flags for one in self.status)


class RelativePair(_Pair):
    """Algorithm 2 on the two sensors of a joint."""

    def __init__(
        self,
        joint: Joint,
        parent: Sensor,
        child: Sensor,
        gains: Gains,
        gaps: Gaps,
        smoothing: Smoothing = NO_SMOOTHING,
    ) -> None:
        self._imu1, self._imu2 = Imu(parent, smoothing), Imu(child, smoothing)
        self.filter = ComplementaryFilter(gains)
        super().__init__(joint, parent, child, gains, gaps)

    def update(self, frame: Frame) -> JointOutput:
        """One step."""
        one_filter, gaps = self.filter, self.gaps
        elapsed = since = 0.0 if self.stamp is None else (frame.stamp - self.stamp) * 1e-9
        if self.stamp is None or elapsed > gaps.max_gap:
            since = math.nan
        one, two = self._imu1.read(frame, since, STILL), self._imu2.read(frame, since, one_filter.integral)
        if one is None or two is None:
            return self._extrapolate(frame.stamp)
        self._saturated = bool(self._saturation) and self._saturation.any(frame.gyro)
        (w1, a1), (w2, a2) = one, two
        measured = elapsed if elapsed <= 1.5 * frame.period else gaps.measured(elapsed, frame.period)
        mean1, mean2, turned = w1, w2, elapsed
        if since != since:  # nobody knows: gravity alone, and no turn
            turned = 0.0
            if self.stamp is None or len(self.axes) == 1:
                one_filter.rotation = self.first_guess(a1, a2)
            else:
                one_filter.align(a1, a2)
        elif measured < elapsed:
            mean1 = bridge(self._imu1.before, w1, elapsed, measured)
            mean2 = bridge(self._imu2.before, w2, elapsed, measured)
        m1 = m2 = None
        field_time = 0.0
        if self.gains.mag_weight:
            m1, m2 = self._imu1.sound_field(frame), self._imu2.sound_field(frame)
            self.disturbed = self._imu1.watch.disturbed or self._imu2.watch.disturbed
            if m1 is not None and m2 is not None:
                field_time = gaps.hold(frame.stamp, self.mag_stamp, measured)
                self.mag_stamp, self.field = frame.stamp, m2
        rate = one_filter.step(turned, measured, mean1, mean2, a1, a2, m1, m2, field_time)
        self._imu1.before, self._imu2.before = w1, w2
        return self._output(frame.stamp, one_filter.rotation, rate, a2, elapsed)

    def set_bias(self, gyro: dict[str, Vec3], deviation: float) -> None:
        """Gyro biases measured at rest, rad/s by sensor; their standard deviation does not count here."""
        self._imu1.bias, self._imu2.bias = gyro[self.parent.name], gyro[self.child.name]
        self.filter.integral = STILL

    def set_zero(self, accel: dict[str, Vec3]) -> None:
        super().set_zero(accel)
        self.filter.rotation = self.at_zero

    def reset(self) -> None:
        """Forget angles and biases; the zero pose is kept."""
        self.restart()
        self.filter.integral = STILL
        for imu in (self._imu1, self._imu2):
            imu.reset()

    def restart(self) -> None:
        super().restart()
        for imu in (self._imu1, self._imu2):
            imu.restart()

    def biases(self) -> dict[str, float]:
        """Bias difference, child minus parent in the child's sensor, rad/s: calibrated part less the integral."""
        parent = rotate_inverse(self.filter.rotation, self._imu1.bias)
        parts = zip("xyz", self._imu2.bias, parent, self.filter.integral, strict=True)
        return {f"{self.joint.name}.gyro_{c}": b2 - b1 - i for c, b2, b1, i in parts}

    def get_state(self) -> dict[str, Any]:
        return super().get_state() | {
            "rotation": list(self.filter.rotation),
            "integral": list(self.filter.integral),
            "imus": [imu.get_state() for imu in (self._imu1, self._imu2)],
        }

    def set_state(self, state: dict[str, Any]) -> None:
        super().set_state(state)
        self.filter.rotation, self.filter.integral = tuple(state["rotation"]), tuple(state["integral"])
        for imu, saved in zip((self._imu1, self._imu2), state["imus"], strict=True):
            imu.set_state(saved)


class AbsolutePair(_Pair):
    """R1^T R2 of two filters of Algorithm 1, which the estimator has updated already.

    Without magnetometers every IMU has a heading of its own. Where the pair starts, the child and all IMUs `below` it
    in the tree are turned about the vertical, so that the joint is in its place.
    """

    def __init__(
        self,
        joint: Joint,
        parent: AbsoluteImu,
        child: AbsoluteImu,
        below: Sequence[AbsoluteImu],
        gains: Gains,
        gaps: Gaps,
    ) -> None:
        self._one, self._two, self._below = parent, child, below
        super().__init__(joint, parent.imu.sensor, child.imu.sensor, gains, gaps)

    def update(self, frame: Frame) -> JointOutput:
        """Take the angles from the two attitudes."""
        one, two = self._one, self._two
        if one.stamp != frame.stamp or two.stamp != frame.stamp:
            return self._extrapolate(frame.stamp)
        self._saturated = bool(self._saturation) and self._saturation.any(frame.gyro)
        a2 = frame.accel[self.child.name]
        elapsed = 0.0 if self.stamp is None else (frame.stamp - self.stamp) * 1e-9
        if self.stamp is None or (len(self.axes) == 1 and elapsed > self.gaps.max_gap):
            self._turn_to(self.first_guess(frame.accel[self.parent.name], a2))
        if one.mag_stamp is not None and two.mag_stamp is not None:
            self.mag_stamp, self.disturbed = min(one.mag_stamp, two.mag_stamp), one.disturbed or two.disturbed
            self.field = frame.mag.get(self.child.name, self.field)
        r12 = multiply(conjugate(one.attitude.rotation), two.attitude.rotation)
        w1, w2, i1, i2 = one.imu.before, two.imu.before, one.attitude.integral, two.attitude.integral
        x, y, z = rotate_inverse(r12, (w1[0] + i1[0], w1[1] + i1[1], w1[2] + i1[2]))
        rate = (w2[0] + i2[0] - x, w2[1] + i2[1] - y, w2[2] + i2[2] - z)
        return self._output(frame.stamp, r12, rate, a2, elapsed)

    def _turn_to(self, r12: Quat) -> None:
        """Give the child the heading with which R1^T R2 comes nearest to `r12`."""
        if self.gains.mag_weight:
            return
        one, two = self._one.attitude, self._two.attitude
        turn = heading_difference(multiply(one.rotation, r12), two.rotation)
        for imu in (self._two, *self._below):
            imu.attitude.rotation = multiply(turn, imu.attitude.rotation)

    def set_bias(self, gyro: dict[str, Vec3], deviation: float) -> None:
        """The estimator sets the biases of the single IMUs."""

    def set_zero(self, accel: dict[str, Vec3]) -> None:
        super().set_zero(accel)
        self._turn_to(self.at_zero)

    def reset(self) -> None:
        """Forget angles; the zero pose is kept."""
        self.restart()

    def biases(self) -> dict[str, float]:
        """None: they are those of the single IMUs."""
        return {}
