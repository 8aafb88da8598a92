"""Rotations in plain Python floats: quaternions (x, y, z, w) and 3-vectors as tuples.

For single samples these beat numpy by a factor of 40. A quaternion q of a rotation "B to A" maps components in B to
components in A; `multiply(p, q)` applies q first.
"""

from __future__ import annotations

import math

from jointest_ros.core.frame import Quat, Vec3

IDENTITY: Quat = (0.0, 0.0, 0.0, 1.0)


def dot(a: Vec3, b: Vec3) -> float:
    """a^T b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vec3, b: Vec3) -> Vec3:
    """[a]x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def norm(a: Vec3) -> float:
    """Length of `a`."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def unit(a: Vec3) -> Vec3:
    """`a` at length 1. Raises ZeroDivisionError for the null vector."""
    n = norm(a)
    return (a[0] / n, a[1] / n, a[2] / n)


def perpendicular(a: Vec3) -> tuple[Vec3, Vec3]:
    """Two unit vectors u, v such that (u, v, a) is right-handed orthonormal, for a unit vector `a`."""
    smallest = min(range(3), key=lambda i: abs(a[i]))
    helper = (float(smallest == 0), float(smallest == 1), float(smallest == 2))
    u = unit(cross(helper, a))
    return u, cross(a, u)


def multiply(p: Quat, q: Quat) -> Quat:
    """The rotation `q`, then `p`: R(p) R(q)."""
    px, py, pz, pw = p
    qx, qy, qz, qw = q
    return (
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
        pw * qw - px * qx - py * qy - pz * qz,
    )


def conjugate(q: Quat) -> Quat:
    """The inverse rotation, for a quaternion of length 1."""
    return (-q[0], -q[1], -q[2], q[3])


def normalized(q: Quat) -> Quat:
    """`q` at length 1. Raises ZeroDivisionError for zeros."""
    x, y, z, w = q
    n = math.sqrt(x * x + y * y + z * z + w * w)
    return (x / n, y / n, z / n, w / n)


def rotate(q: Quat, v: Vec3) -> Vec3:
    """R(q) v."""
    x, y, z, w = q
    vx, vy, vz = v
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx)


def rotate_inverse(q: Quat, v: Vec3) -> Vec3:
    """R(q)^T v."""
    x, y, z, w = q
    vx, vy, vz = v
    tx, ty, tz = 2.0 * (z * vy - y * vz), 2.0 * (x * vz - z * vx), 2.0 * (y * vx - x * vy)
    return (vx + w * tx - y * tz + z * ty, vy + w * ty - z * tx + x * tz, vz + w * tz - x * ty + y * tx)


def exp(v: Vec3) -> Quat:
    """The rotation by the rotation vector `v`, rad."""
    angle2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    if angle2 < 1e-8:  # sin(h)/(2h) and cos(h) by their series: exact to 1e-18 here
        s, w = 0.5 - angle2 / 48.0, 1.0 - angle2 / 8.0
    else:
        angle = math.sqrt(angle2)
        s, w = math.sin(0.5 * angle) / angle, math.cos(0.5 * angle)
    return (v[0] * s, v[1] * s, v[2] * s, w)


def about(axis: Vec3, angle: float) -> Quat:
    """The rotation by `angle` (rad) about a unit vector."""
    return exp((axis[0] * angle, axis[1] * angle, axis[2] * angle))


def log(q: Quat) -> Vec3:
    """The rotation vector of `q`, rad, of length at most pi."""
    x, y, z, w = q if q[3] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
    s = math.sqrt(x * x + y * y + z * z)
    k = 2.0 / w * (1.0 - s * s / (3.0 * w * w)) if s < 1e-6 else 2.0 * math.atan2(s, w) / s
    return (x * k, y * k, z * k)


def between(a: Vec3, b: Vec3) -> Quat:
    """The smallest rotation that turns the direction of `a` into that of `b`; none where one is the null vector."""
    if norm(a) * norm(b) == 0.0:
        return IDENTITY
    a, b = unit(a), unit(b)
    w = 1.0 + dot(a, b)
    if w < 1e-12:  # opposite: half a turn about anything perpendicular
        u, _ = perpendicular(a)
        return (*u, 0.0)
    return normalized((*cross(a, b), w))


def wrap(angle: float) -> float:
    """`angle` less whole turns: in [-pi, pi]."""
    return math.remainder(angle, 2.0 * math.pi)


def from_rpy(roll: float, pitch: float, yaw: float) -> Quat:
    """Rz(yaw) Ry(pitch) Rx(roll), rad: the convention of URDF."""
    return multiply(multiply(exp((0.0, 0.0, yaw)), exp((0.0, pitch, 0.0))), exp((roll, 0.0, 0.0)))


def to_rpy(q: Quat) -> Vec3:
    """Roll, pitch and yaw of `from_rpy`, rad; pitch in [-pi/2, pi/2], and where it is at either end, roll is 0."""
    x, y, z, w = q
    sine = 2.0 * (w * y - x * z)
    if abs(sine) > 1.0 - 1e-12:  # only yaw -+ roll is determined
        return (0.0, math.copysign(0.5 * math.pi, sine), wrap(math.copysign(2.0, -sine) * math.atan2(x, w)))
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return (roll, math.asin(sine), math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
