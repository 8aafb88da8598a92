"""Accelerometers moved to the joint: what the turning of a link does to the accelerometer on it is taken out.

    a - T x r - W x (W x r)    r from the joint to the sensor, W the gyro, T its change over its interval

At the joint both sensors measure the same specific force, whatever the motion. All vectors are in the sensor's frame.
"""

from __future__ import annotations

from typing import TypeVar

from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.robot import Joint, Sensor
from jointest_ros.core.rotation import rotate_inverse

Scalar = TypeVar("Scalar", float, FloatArray)
Components = tuple[Scalar, Scalar, Scalar]


def arms(joint: Joint, parent: Sensor, child: Sensor) -> tuple[Vec3, Vec3]:
    """The ways from the joint to its two sensors, m, each in the frame of that sensor."""
    x, y, z = (p - o for p, o in zip(parent.position, joint.origin, strict=True))
    return rotate_inverse(parent.mounting, (x, y, z)), rotate_inverse(child.mounting, child.position)


def change(before: Vec3, now: Vec3, elapsed: float) -> Vec3:
    """Change of a rate per second."""
    return (now[0] - before[0]) / elapsed, (now[1] - before[1]) / elapsed, (now[2] - before[2]) / elapsed


def at_joint(
    accel: Components[Scalar], rate: Components[Scalar], turning: Components[Scalar], arm: Vec3
) -> Components[Scalar]:
    """The specific force at the joint, of one sample or of T samples by components."""
    ax, ay, az = accel
    wx, wy, wz = rate
    tx, ty, tz = turning
    rx, ry, rz = arm
    along = wx * rx + wy * ry + wz * rz
    square = wx * wx + wy * wy + wz * wz
    return (
        ax - (ty * rz - tz * ry) - (wx * along - square * rx),
        ay - (tz * rx - tx * rz) - (wy * along - square * ry),
        az - (tx * ry - ty * rx) - (wz * along - square * rz),
    )
