"""Passive complementary (Mahony) filter for one IMU (Algorithm 1) and for a pair of IMUs (Algorithm 2).

State        R (quaternion): frame B2 to frame B1 of a pair, or sensor to world for one IMU; integral I (rad/s), which
             settles at minus the gyro bias.
Prediction   R+ = exp(-[W1]x dt) R exp([W2 + I]x dt): (17), (18) with W = W2 - R^T W1, but exact while B1 turns; the
             gyros W are mean rates over the interval that ends now.
Correction   e = weight_a (a2 x R+^T a1) + weight_m (m2 x R+^T m1), vectors at length 1    (19), (20)
             I += Ki e dt,  R = R+ exp([Kp e]x dt)                                         Alg. 2 steps 8 to 11
For one IMU, B1 is the world: W1 = 0, a1 = +up, m1 = the field turned into the vertical plane through north (y).

Santaera et al. 2015, Algorithms 1 and 2, with the errata of section 1 of the specification.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from jointest_ros.core.frame import Quat, Vec3
from jointest_ros.core.rotation import (
    IDENTITY,
    between,
    conjugate,
    cross,
    dot,
    exp,
    log,
    multiply,
    normalized,
    rotate,
    rotate_inverse,
)

UP: Vec3 = (0.0, 0.0, 1.0)
STILL: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Gains:
    """Kp 1/s, Ki 1/s^2 and the weights of the two corrections (no unit)."""

    kp: float
    ki: float
    accel_weight: float
    mag_weight: float


class ComplementaryFilter:
    """The filter of the module text, for one pair of frames B1 (reference) and B2."""

    def __init__(self, gains: Gains) -> None:
        self.gains = gains
        self.rotation: Quat = IDENTITY
        self.integral: Vec3 = STILL

    def predict(self, dt: float, w1: Vec3, w2: Vec3) -> None:
        """Turn R by the gyros, rad/s in B1 and B2: mean rates over the last `dt` s."""
        i = self.integral
        turn1 = exp((-w1[0] * dt, -w1[1] * dt, -w1[2] * dt))
        turn2 = exp(((w2[0] + i[0]) * dt, (w2[1] + i[1]) * dt, (w2[2] + i[2]) * dt))
        self.rotation = multiply(turn1, multiply(self.rotation, turn2))

    def correct(self, dt: float, a1: Vec3, a2: Vec3, m1: Vec3 | None = None, m2: Vec3 | None = None) -> None:
        """Turn R towards agreement of the accelerometers and fields (any unit) in B1 and B2, which hold for `dt` s."""
        gains = self.gains
        ex, ey, ez = self._error(gains.accel_weight, a1, a2)
        if m1 is not None and m2 is not None:
            mx, my, mz = self._error(gains.mag_weight, m1, m2)
            ex, ey, ez = ex + mx, ey + my, ez + mz
        ki = gains.ki * dt
        i = self.integral
        self.integral = (i[0] + ki * ex, i[1] + ki * ey, i[2] + ki * ez)
        half = 0.5 * min(gains.kp * dt, 1.0)  # at length 1 this is exp for the small angles of one step
        self.rotation = normalized(multiply(self.rotation, (half * ex, half * ey, half * ez, 1.0)))

    def _error(self, weight: float, v1: Vec3, v2: Vec3) -> Vec3:
        """weight (v2 x R^T v1) for vectors at length 1; zero where one of them is the null vector."""
        lengths = math.sqrt(dot(v1, v1) * dot(v2, v2))
        k = weight / lengths if lengths > 0.0 else 0.0
        x, y, z = cross(v2, rotate_inverse(self.rotation, v1))
        return (k * x, k * y, k * z)

    def align(self, a1: Vec3, a2: Vec3) -> None:
        """Turn R as little as possible so that gravity agrees; the rotation about gravity stays as it is."""
        self.rotation = multiply(between(rotate(self.rotation, a2), a1), self.rotation)


def world_field(rotation: Quat, field: Vec3) -> Vec3:
    """The measured field in the world (x east, y north, z up), its horizontal part put on +y as at the right heading."""
    x, y, z = rotate(rotation, field)
    return (0.0, math.hypot(x, y), z)


def heading_north(rotation: Quat, field: Vec3) -> Quat:
    """`rotation` (sensor to world) turned about the vertical so that the measured field points north (+y)."""
    x, y, _ = rotate(rotation, field)
    return multiply(exp((0.0, 0.0, math.atan2(x, y))), rotation)


def joint_angles(axes: tuple[Vec3, ...], turned: Quat) -> tuple[float, ...]:
    """Positions of a joint, rad, from the rotation `turned` from the zero pose, which is about `axes` in succession.

    One axis: the component of the rotation vector about it (erratum of (24), (25)): what is not about the axis does not
    leak in as it does through roll-pitch-yaw. Two axes: exact when the rotation is one of this joint, otherwise the
    nearest in the sense of the first axis. Three axes, successive ones perpendicular: the middle angle is in
    [-90, 90] deg when the third axis completes the frame (roll-pitch-yaw), or [0, 180] deg when it repeats the first.
    """
    if len(axes) == 1:
        return (dot(log(turned), axes[0]),)
    first, second = axes[0], axes[1]
    if len(axes) == 2:
        one = _angle_about(first, second, rotate(turned, second))
        return one, dot(log(multiply(_about(first, -one), turned)), second)
    third = axes[2]
    image = rotate(turned, third)
    handed = dot(first, cross(second, third))
    if abs(handed) > 0.5:
        two = math.asin(max(-1.0, min(1.0, dot(first, image) / handed)))
    else:
        two = math.acos(max(-1.0, min(1.0, dot(first, image) * dot(first, third))))
    one = _angle_about(first, rotate(_about(second, two), third), image)
    rest = multiply(conjugate(multiply(_about(first, one), _about(second, two))), turned)
    return one, two, dot(log(rest), third)


def joint_rates(axes: tuple[Vec3, ...], angles: tuple[float, ...], rate: Vec3) -> tuple[float, ...]:
    """Velocities of a joint, rad/s, from its positions and the relative rate in the child's frame, rad/s."""
    last = axes[-1]
    if len(axes) == 1:
        return (dot(last, rate),)
    one_before = rotate_inverse(_about(last, angles[-1]), axes[-2])
    if len(axes) == 2:
        # least squares over the two directions
        c = dot(one_before, last)
        p, q = dot(rate, one_before), dot(rate, last)
        det = 1.0 - c * c
        return ((p - c * q) / det, (q - c * p) / det) if det > 1e-6 else (0.0, q)
    first = rotate_inverse(multiply(_about(axes[1], angles[1]), _about(last, angles[2])), axes[0])
    det = dot(first, cross(one_before, last))
    if abs(det) < 1e-3:  # gimbal lock: the split between first and third is arbitrary
        return 0.0, dot(rate, one_before), dot(rate, last)
    return (
        dot(rate, cross(one_before, last)) / det,
        dot(rate, cross(last, first)) / det,
        dot(rate, cross(first, one_before)) / det,
    )


def zero_rotation(axes: tuple[Vec3, ...], parent_accel: Vec3, child_accel: Vec3) -> Quat:
    """What turns the child's gravity into the parent's, in link frames: the identity at an exact zero pose.

    One axis: about that axis, which equals R_o by TRIAD with the axis first and gravity second (erratum of section IV).
    More axes: the smallest rotation; what is about gravity cannot be seen.
    """
    if len(axes) == 1:
        return _about(axes[0], _angle_about(axes[0], child_accel, parent_accel))
    return between(child_accel, parent_accel)


def _about(axis: Vec3, angle: float) -> Quat:
    return exp((axis[0] * angle, axis[1] * angle, axis[2] * angle))


def _angle_about(axis: Vec3, a: Vec3, b: Vec3) -> float:
    """Angle about `axis` that turns the part of `a` perpendicular to it into that of `b`."""
    return math.atan2(dot(axis, cross(a, b)), dot(a, b) - dot(a, axis) * dot(b, axis))
