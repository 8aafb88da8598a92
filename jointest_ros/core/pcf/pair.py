"""What the `relative` and `absolute` formulations of the PCF share: how the rotation of a pair of IMUs becomes angles.

Both hold R12 (child sensor to parent sensor): `relative` as the state of one filter, `absolute` as R1^T R2 of two. With
the mountings M (sensor to link) and the zero pose Z, R_o = M1^T Z M2 is R12 at the zero pose, and R_o^T R12 is the
rotation of the joint about its axes as the child's sensor has them (25).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from jointest_ros.core.frame import Quat, Status, Vec3
from jointest_ros.core.pcf.angle_variance import UNKNOWN_VARIANCE, AngleVariance
from jointest_ros.core.pcf.attitude import (
    STILL,
    Gains,
    joint_angles,
    joint_rates,
    lever,
    zero_rotation,
)
from jointest_ros.core.pcf.imu import Gaps
from jointest_ros.core.pcf.settings import BiasNoise
from jointest_ros.core.pcf.two_axes import TwoAxes
from jointest_ros.core.robot import STANDARD_GRAVITY, Joint, Sensor
from jointest_ros.core.rotation import IDENTITY, conjugate, dot, multiply, rotate, rotate_inverse, unit, wrap
from jointest_ros.core.saturated_gyros import SaturatedGyros

START_VARIANCE = 0.25  # rad^2, of the first angle: it may be taken while the robot moves
_LEAST_LEVER = 0.03  # squared sine of the angle between axis and gravity (10 deg) below which gravity tells nothing
_NO_DATA, _GAP, _STALE, _STARTING = int(Status.NO_DATA), int(Status.GAP), int(Status.STALE), int(Status.STARTING)
_UNOBSERVABLE, _DISTURBED = int(Status.UNOBSERVABLE), int(Status.DISTURBED)
_VARIANCE_STEP = 0.019  # s
_LISTS = ("zero", "position", "velocity", "variance", "status", "unobservable", "field")

# positions rad, velocities rad/s, variances rad^2, `Status` flags: one entry an axis of the joint
JointOutput = tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...], tuple[int, ...]]


class Pair:
    """What both formulations share: from R12 to the positions of one joint."""

    stamp: int | None  # ns, of the newest frame with both sensors
    mag_stamp: int | None  # ns, of the newest frame with both magnetometers, undisturbed
    disturbed: bool  # a magnetometer is, and both have no influence
    field: Vec3  # tesla, in the child's sensor at `mag_stamp`
    _pending: float  # s since the variances were calculated
    _axes_seen: float  # what the geometry of two axes shows of the rotation about gravity, times its weight

    def __init__(self, joint: Joint, parent: Sensor, child: Sensor, gains: Gains, gaps: Gaps, bias: BiasNoise) -> None:
        self.joint, self.parent, self.child, self.gains, self.gaps = joint, parent, child, gains, gaps
        limits = joint.limits or ((-math.inf, math.inf),) * len(joint.axes)
        self._middles = tuple([0.5 * (low + high) if joint.limits else 0.0 for low, high in limits])
        # The middle of a range of a turn or less tells the branch of an angle, otherwise (None) the angle before does.
        self._branches = tuple(
            [
                one if high - low <= 2.0 * math.pi else None
                for one, (low, high) in zip(self._middles, limits, strict=True)
            ]
        )
        gyro_density2 = parent.gyro_noise**2 + child.gyro_noise**2
        accel2 = (parent.accel_noise**2 + child.accel_noise**2) / STANDARD_GRAVITY**2
        self.tilt = AngleVariance(gains, gyro_density2, accel2, bias)  # about what is horizontal
        self.turn = AngleVariance(gains, gyro_density2, 0.0, bias)  # about gravity
        self._saturation = SaturatedGyros((parent, child), gaps.gap_rate)
        self._take_zero(IDENTITY)
        self.restart()

    def restart(self) -> None:
        """Start the angles afresh from the next frame."""
        n = len(self.joint.axes)
        self.stamp = self.mag_stamp = None
        self.disturbed = False
        self._saturated, self._saturation.time = False, 0.0
        self.field = STILL
        self.position, self.velocity, self.variance = (0.0,) * n, (0.0,) * n, (UNKNOWN_VARIANCE,) * n
        self.tilt.begin(START_VARIANCE)
        self._axes_seen = self._pending = 0.0
        self.status, self.unobservable = (_STARTING,) * n, (0,) * n

    def reset(self) -> None:
        """Forget the angles and what is known of the biases; the zero pose is kept."""
        self.restart()
        for one in (self.tilt, self.turn):
            one.calibrate()

    @property
    def sensors(self) -> tuple[str, str]:
        """Names of the two sensors."""
        return self.parent.name, self.child.name

    def get_state(self) -> dict[str, Any]:
        """All that changes, as plain numbers."""
        lists = {name: list(getattr(self, name)) for name in _LISTS}
        state = {"stamp": self.stamp, "mag_stamp": self.mag_stamp, "disturbed": self.disturbed, **lists}
        variances = {"tilt": self.tilt.get_state(), "turn": self.turn.get_state(), "pending": self._pending}
        return state | variances | {"saturated": self._saturation.time}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`."""
        self.stamp, self.mag_stamp, self.disturbed = state["stamp"], state["mag_stamp"], state["disturbed"]
        self._saturation.time, self._pending = state["saturated"], state["pending"]
        self.tilt.set_state(state["tilt"])
        self.turn.set_state(state["turn"])
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
        self._two_axes: TwoAxes | None = None
        if len(self.axes) == 2:  # the second one turns with the child, whatever zero pose the mountings feign
            self.axes = self.axes[0], rotate_inverse(self.child.mounting, self.joint.axes[1])
            self._two_axes = TwoAxes(self.axes, self.at_zero, self._middles)

    @property
    def zero_pose(self) -> tuple[float, ...]:
        """Rotation child link to parent link at the zero pose, x, y, z, w."""
        return self.zero

    def take_zero_pose(self, numbers: tuple[float, ...]) -> None:
        """Before the first frame: `zero_pose` of an earlier run."""
        x, y, z, w = numbers
        self._take_zero((x, y, z, w))

    def set_bias(self, gyro: dict[str, Vec3], deviation: float) -> None:
        """Gyro biases measured at rest, rad/s by sensor, and the standard deviation of their difference."""
        for one in (self.tilt, self.turn):
            one.calibrate(deviation)

    def set_zero(self, accel: dict[str, Vec3]) -> None:
        """The present pose is the zero pose; mean accelerometers by sensor, m/s^2."""
        b1 = rotate(self.parent.mounting, accel[self.parent.name])
        b2 = rotate(self.child.mounting, accel[self.child.name])
        axes = self.joint.axes
        if len(axes) == 2:
            self._take_zero(TwoAxes(axes, IDENTITY, (0.0, 0.0)).from_gravity(b1, b2) or zero_rotation(axes, b1, b2))
        elif len(axes) > 2 or lever(axes[0], b1) > _LEAST_LEVER:
            self._take_zero(zero_rotation(axes, b1, b2))
        self.position = self.variance = (0.0,) * len(self.axes)
        for one in (self.tilt, self.turn):
            one.begin(0.0)

    def first_guess(self, a1: Vec3, a2: Vec3) -> Quat:
        """R12 that agrees with gravity and with the joint; what gravity does not show is as at the zero pose."""
        if len(self.axes) == 1 and lever(self.axes[0], a2) < _LEAST_LEVER:
            return self.at_zero
        a1 = rotate_inverse(self.at_zero, a1)
        turned = self._two_axes.from_gravity(a1, a2) if self._two_axes else None
        return multiply(self.at_zero, turned or zero_rotation(self.axes, a1, a2))

    # ------------------------------------------------------------- steps

    def _output(self, stamp: int, r12: Quat, rate: Vec3, a2: Vec3, elapsed: float) -> JointOutput:
        """Take over R12 and the relative rate (in the child's sensor) at `stamp`, `elapsed` s after the last one."""
        angles = joint_angles(self.axes, multiply(self._from_zero, r12))
        flags, gap = _DISTURBED if self.disturbed else 0, 0.0
        if elapsed > self.gaps.max_gap:
            flags, gap = flags | _GAP, self.gaps.spread(elapsed)
        if self._saturated:
            flags, gap = flags | _DISTURBED, gap + self._saturation.spread(elapsed)
        else:
            self._saturation.time = 0.0
        self._pending += elapsed
        if self._pending > _VARIANCE_STEP or gap or self.stamp is None:
            self._judge(stamp, angles, a2, gap)
        self.stamp, self.velocity = stamp, joint_rates(self.axes, angles, rate)
        if len(angles) == 1:
            (angle,), (near,) = angles, self._branches
            self.position = (_near(self.position[0] if near is None else near, angle),)
        else:
            rows = zip(angles, self.position, self._branches, strict=True)
            self.position = tuple([_near(before if near is None else near, angle) for angle, before, near in rows])
        self.status = tuple([flags | one for one in self.unobservable]) if flags else self.unobservable
        return self.position, self.velocity, self.variance, self.status

    def _judge(self, stamp: int, angles: tuple[float, ...], a2: Vec3, added: float) -> None:
        """Variances, with `added` rad^2 that nobody measured, and flags of what is not seen.

        They change within tenths of a second: every 20 ms is enough, and they are half the cost of a step.
        """
        turns, seen = self._turns(angles, a2), self._seen(stamp, a2)
        unobservable = [seen <= _LEAST_LEVER and turn >= 1.0 - _LEAST_LEVER for turn in turns]
        if self.stamp is None:
            self.turn.begin(self._first_turn_variance(unobservable))
            self.position = self._middles
        tilt, turned = self.tilt.step(self._pending, 1.0, added), self.turn.step(self._pending, seen, added)
        self._pending = 0.0
        self.variance = tuple([min(max(0.0, 1.0 - turn) * tilt + turn * turned, UNKNOWN_VARIANCE) for turn in turns])
        self.unobservable = tuple([_UNOBSERVABLE if one else 0 for one in unobservable])

    def _first_turn_variance(self, unobservable: Sequence[bool]) -> float:
        """Of the rotation about gravity that `first_guess` gave, rad^2."""
        return START_VARIANCE if len(unobservable) < 3 and not any(unobservable) else UNKNOWN_VARIANCE

    def _turns(self, angles: tuple[float, ...], a2: Vec3) -> Sequence[float]:
        """Squares of the turn of each coordinate when the child turns about gravity by 1 rad, which nothing else shows.

        One axis: the squared cosine of the angle between it and gravity.
        """
        length2 = dot(a2, a2)
        if length2 == 0.0:
            return (1.0,) * len(angles)
        if len(angles) == 1:
            along = dot(self.axes[0], a2)
            return (along * along / length2,)
        return [turn * turn / length2 for turn in joint_rates(self.axes, angles, a2)]

    def _seen(self, stamp: int, a2: Vec3) -> float:
        """How much of a turn about gravity magnetometers and axes show, times their weights."""
        if self.mag_stamp is None or (stamp - self.mag_stamp) * 1e-9 > self.gaps.max_gap:
            return self._axes_seen
        return self._axes_seen + self.gains.mag_weight * lever(unit(a2), self.field) if any(a2) else 0.0

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


def _near(position: float, angle: float) -> float:
    """The angle, rad, with the whole turns that bring it nearest to a position."""
    turn = angle - position
    return angle if -math.pi <= turn <= math.pi else position + wrap(turn)
