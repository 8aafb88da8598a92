"""Passive complementary (Mahony) filter for one IMU (Algorithm 1) and for a pair of IMUs (Algorithm 2).

State        R (quaternion): frame B2 to frame B1 of a pair, or sensor to world for one IMU; integral I (rad/s), which
             settles at minus the gyro bias.
Prediction   W = W2 + I - R^T W1, R+ = R exp([W + dt/2 W2 x R^T W1]x dt)                   (17), (18); the second term
             makes it exact to the third order while both frames turn. Gyros are mean rates since the last sample.
Correction   e = weight_a (a2 x R+^T a1) + weight_m (m2 x R+^T m1), vectors at length 1    (19), (20)
             + weight_axes times that of two_axes.py, for a joint of two axes
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
    about,
    between,
    conjugate,
    cross,
    dot,
    exp,
    log,
    multiply,
    rotate,
    rotate_inverse,
)

UP: Vec3 = (0.0, 0.0, 1.0)
STILL: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Gains:
    """Kp 1/s, Ki 1/s^2 and the weights of the three corrections (no unit)."""

    kp: float
    ki: float
    accel_weight: float
    mag_weight: float
    axes_weight: float = 0.0


class ComplementaryFilter:
    """The filter of the module text, for one pair of frames B1 (reference) and B2."""

    def __init__(self, gains: Gains) -> None:
        self.gains = gains
        self.rotation: Quat = IDENTITY
        self.integral: Vec3 = STILL

    def step(
        self,
        elapsed: float,
        measured: float,
        w1: Vec3,
        w2: Vec3,
        a1: Vec3,
        a2: Vec3,
        m1: Vec3 | None = None,
        m2: Vec3 | None = None,
        field_time: float = 0.0,
        axes: Vec3 = STILL,
    ) -> Vec3:
        """One sample: gyros (rad/s), accelerometers, fields (any unit) in B1 and B2. Returns W, rad/s in B2.

        The gyros hold for the `elapsed` s since the last sample, the accelerometers for `measured` s of them (less
        where samples are missing), the fields for `field_time` s (more where magnetometers are slower). `axes` is
        what is added to e. Written out in components: calls of `rotation.py` would cost half as much again.
        """
        gains = self.gains
        x, y, z, w = self.rotation
        ix, iy, iz = self.integral
        # R^T W1
        vx, vy, vz = w1
        tx, ty, tz = 2.0 * (z * vy - y * vz), 2.0 * (x * vz - z * vx), 2.0 * (y * vx - x * vy)
        ux, uy, uz = vx + w * tx - y * tz + z * ty, vy + w * ty - z * tx + x * tz, vz + w * tz - x * ty + y * tx
        vx, vy, vz = w2
        rx, ry, rz = vx + ix - ux, vy + iy - uy, vz + iz - uz
        # R exp([W + dt/2 W2 x R^T W1]x dt), of which h is half the turn
        h = 0.5 * elapsed
        hh = h * h
        hx, hy, hz = (
            h * rx + hh * (vy * uz - vz * uy),
            h * ry + hh * (vz * ux - vx * uz),
            h * rz + hh * (vx * uy - vy * ux),
        )
        hh = hx * hx + hy * hy + hz * hz
        if hh < 1e-4:  # sin(h)/h and cos(h) by their series: exact to 1e-16 here
            s, c = (
                1.0 - hh * (1.0 / 6.0 - hh * (1.0 / 120.0)),
                1.0 - hh * (0.5 - hh * (1.0 / 24.0 - hh * (1.0 / 720.0))),
            )
        else:
            h = math.sqrt(hh)
            s, c = math.sin(h) / h, math.cos(h)
        hx, hy, hz = hx * s, hy * s, hz * s
        x, y, z, w = (
            w * hx + x * c + y * hz - z * hy,
            w * hy - x * hz + y * c + z * hx,
            w * hz + x * hy - y * hx + z * c,
            w * c - x * hx - y * hy - z * hz,
        )
        # e = a2 x R^T a1, times the seconds for which it holds
        vx, vy, vz = a1
        tx, ty, tz = 2.0 * (z * vy - y * vz), 2.0 * (x * vz - z * vx), 2.0 * (y * vx - x * vy)
        ux, uy, uz = vx + w * tx - y * tz + z * ty, vy + w * ty - z * tx + x * tz, vz + w * tz - x * ty + y * tx
        vx, vy, vz = a2
        lengths = math.sqrt((ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz))
        k = gains.accel_weight * measured / lengths if lengths > 0.0 else 0.0
        ex, ey, ez = k * (vy * uz - vz * uy), k * (vz * ux - vx * uz), k * (vx * uy - vy * ux)
        if m1 is not None and m2 is not None:
            lengths = math.sqrt(dot(m1, m1) * dot(m2, m2))
            k = gains.mag_weight * field_time / lengths if lengths > 0.0 else 0.0
            ux, uy, uz = cross(m2, rotate_inverse((x, y, z, w), m1))
            ex, ey, ez = ex + k * ux, ey + k * uy, ez + k * uz
        if axes is not STILL:
            k = gains.axes_weight * measured
            ex, ey, ez = ex + k * axes[0], ey + k * axes[1], ez + k * axes[2]
        k = gains.ki
        self.integral = (ix + k * ex, iy + k * ey, iz + k * ez)
        # R+ exp([Kp e]x dt), for the small angles of one step
        k = measured if measured > field_time else field_time
        k = 0.5 * gains.kp if gains.kp * k < 1.0 else 0.5 / k
        hx, hy, hz = k * ex, k * ey, k * ez
        x, y, z, w = (
            x + w * hx + y * hz - z * hy,
            y + w * hy - x * hz + z * hx,
            z + w * hz + x * hy - y * hx,
            w - x * hx - y * hy - z * hz,
        )
        n = 1.0 / math.sqrt(x * x + y * y + z * z + w * w)
        self.rotation = (x * n, y * n, z * n, w * n)
        return rx, ry, rz

    def align(self, a1: Vec3, a2: Vec3) -> None:
        """Turn R as little as possible so that gravity agrees; the rotation about gravity stays as it is."""
        self.rotation = multiply(between(rotate(self.rotation, a2), a1), self.rotation)


def world_field(rotation: Quat, field: Vec3) -> Vec3:
    """The measured field in the world (x east, y north, z up), its horizontal part put on +y."""
    x, y, z = rotate(rotation, field)
    return (0.0, math.hypot(x, y), z)


def heading_north(rotation: Quat, field: Vec3) -> Quat:
    """`rotation` (sensor to world) turned about the vertical so that the measured field points north (+y)."""
    x, y, _ = rotate(rotation, field)
    return multiply(exp((0.0, 0.0, math.atan2(x, y))), rotation)


def heading_difference(a: Quat, b: Quat) -> Quat:
    """The turn about the vertical that brings the attitude `b` (sensor to world) nearest to `a`."""
    _, _, z, w = multiply(a, conjugate(b))
    n = math.hypot(z, w)
    return (0.0, 0.0, z / n, w / n) if n > 0.0 else IDENTITY


def joint_angles(axes: tuple[Vec3, ...], turned: Quat) -> tuple[float, ...]:
    """Positions of a joint, rad, from the rotation `turned` from the zero pose, which is about `axes` in succession.

    One axis: the component of the rotation vector about it (erratum of (24), (25)): what is not about the axis does not
    leak in as it does through roll-pitch-yaw. Two axes: exact when the rotation is one of this joint, otherwise the
    nearest in the sense of the first axis. Three axes, successive ones perpendicular: the middle angle is in
    [-90, 90] deg when the third axis completes the frame (roll-pitch-yaw), or [0, 180] deg when it repeats the first.
    """
    if len(axes) == 1:
        return (_turn_about(axes[0], turned),)
    first, second = axes[0], axes[1]
    if len(axes) == 2:
        one = angle_about(first, second, rotate(turned, second))
        return one, dot(log(multiply(about(first, -one), turned)), second)
    third = axes[2]
    image = rotate(turned, third)
    handed = dot(first, cross(second, third))
    if abs(handed) > 0.5:
        two = math.asin(max(-1.0, min(1.0, dot(first, image) / handed)))
    else:
        two = math.acos(max(-1.0, min(1.0, dot(first, image) * dot(first, third))))
    one = angle_about(first, rotate(about(second, two), third), image)
    rest = multiply(conjugate(multiply(about(first, one), about(second, two))), turned)
    return one, two, dot(log(rest), third)


def joint_rates(axes: tuple[Vec3, ...], angles: tuple[float, ...], rate: Vec3) -> tuple[float, ...]:
    """Velocities of a joint, rad/s, from its positions and the relative rate in the child's frame, rad/s."""
    last = axes[-1]
    if len(axes) == 1:
        return (dot(last, rate),)
    one_before = rotate_inverse(about(last, angles[-1]), axes[-2])
    if len(axes) == 2:
        # least squares over the two directions
        c = dot(one_before, last)
        p, q = dot(rate, one_before), dot(rate, last)
        det = 1.0 - c * c
        return ((p - c * q) / det, (q - c * p) / det) if det > 1e-6 else (0.0, q)
    first = rotate_inverse(multiply(about(axes[1], angles[1]), about(last, angles[2])), axes[0])
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
        return about(axes[0], angle_about(axes[0], child_accel, parent_accel))
    return between(child_accel, parent_accel)


def lever(axis: Vec3, accel: Vec3) -> float:
    """Squared sine of the angle between a unit `axis` and the measured gravity; 0 without gravity."""
    x, y, z = accel
    length2 = x * x + y * y + z * z
    along = axis[0] * x + axis[1] * y + axis[2] * z
    return 1.0 - along * along / length2 if length2 > 0.0 else 0.0


def _turn_about(axis: Vec3, turned: Quat) -> float:
    """dot(log(turned), axis), written out: every pair needs it at every sample."""
    x, y, z, w = turned
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    s = math.sqrt(x * x + y * y + z * z)
    k = 2.0 / w * (1.0 - s * s / (3.0 * w * w)) if s < 1e-6 else 2.0 * math.atan2(s, w) / s
    return k * (axis[0] * x + axis[1] * y + axis[2] * z)


def angle_about(axis: Vec3, a: Vec3, b: Vec3) -> float:
    """Angle about `axis` that turns the part of `a` perpendicular to it into that of `b`."""
    return math.atan2(dot(axis, cross(a, b)), dot(a, b) - dot(a, axis) * dot(b, axis))
