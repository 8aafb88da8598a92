"""Messages into CDR bytes with `struct` alone: the way back from `cdr`, which describes the encoding.

What does not change from message to message (names, covariances, dimensions) is packed once. Values that do not fit
(a stamp beyond the int32 seconds of ROS, a wrong number of positions) raise `CdrError`.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from functools import lru_cache
from struct import Struct

from jointest_ros.bags.cdr import (
    CDR_LE,
    MAGNETIC_FIELD_LAYOUTS,
    NANOSECONDS,
    PREAMBLE,
    QUATERNION_LAYOUTS,
    VECTOR3_LAYOUTS,
    Dims,
    StampedLayouts,
)
from jointest_ros.bags.errors import CdrError
from jointest_ros.core.frame import Quat, Vec3

_clock = Struct(PREAMBLE)
_ABSENT = struct.pack("<9d", -1.0, *(0.0,) * 8)  # covariance of what a sensor does not have
_NO_ORIENTATION = struct.pack("<4d", 0.0, 0.0, 0.0, 1.0) + _ABSENT


class ImuEncoder:
    """sensor_msgs/Imu messages of one sensor without an orientation of its own.

    As Imu.msg has it, the covariance of what a sensor does not have begins with -1, that of the orientation always (the
    orientation itself is the default of geometry_msgs/Quaternion, the identity); a covariance of zeros means "unknown".

    Args:
        frame_id: of every message.
        gyro_variance: of each component of a sample, (rad/s)^2; None: it has no gyro.
        accel_variance: of each component of a sample, (m/s^2)^2; None: it has no accelerometer.
    """

    def __init__(self, frame_id: str, gyro_variance: float | None = 0.0, accel_variance: float | None = 0.0) -> None:
        self._before_gyro = _aligned(_string(frame_id), 8) + _NO_ORIENTATION
        self._before_accel = _diagonal(gyro_variance)
        self._after_accel = _diagonal(accel_variance)
        self._layout = Struct(f"{PREAMBLE}{len(self._before_gyro)}s3d72s3d72s")

    def encode(self, stamp: int, gyro: Sequence[float], accel: Sequence[float]) -> bytes:
        """One message: stamp (ns), angular velocity (rad/s), linear acceleration (m/s^2)."""
        sec, nanosec = divmod(stamp, NANOSECONDS)
        before_gyro, before_accel = self._before_gyro, self._before_accel
        return _pack(self._layout, sec, nanosec, before_gyro, *gyro, before_accel, *accel, self._after_accel)


class JointStateEncoder:
    """sensor_msgs/JointState messages of the same joints; `effort` stays empty."""

    def __init__(self, names: Sequence[str], frame_id: str = "") -> None:
        self._count = len(names)
        prefix = _aligned(_string(frame_id), 4) + struct.pack("<I", len(names))
        for name in names:
            prefix = _aligned(prefix + _string(name), 4)
        self._prefix = prefix
        self._with_velocity = self._layout(len(names), len(names))
        self._without_velocity = self._layout(len(names), 0)

    def encode(self, stamp: int, position: Sequence[float], velocity: Sequence[float] = ()) -> bytes:
        """One message: stamp (ns), positions (rad) and, unless empty, velocities (rad/s) in the order of the names."""
        layout = self._with_velocity if len(velocity) else self._without_velocity
        sec, nanosec = divmod(stamp, NANOSECONDS)
        return _pack(layout, sec, nanosec, self._prefix, self._count, *position, len(velocity), *velocity, 0)

    def _layout(self, *counts: int) -> Struct:
        """The prefix, then sequences of so many doubles, the last one (effort) empty."""
        layout = f"{PREAMBLE}{len(self._prefix)}s"
        size = 8 + len(self._prefix)  # from the byte after the encapsulation
        for count in counts:
            padding = -(size + 4) % 8 if count else 0
            layout += f"I{padding}x{count}d"
            size += 4 + padding + 8 * count
        return Struct(layout + "I")


def encode_magnetic_field(stamp: int, frame_id: str, field: Vec3) -> bytes:
    """A sensor_msgs/MagneticField: stamp (ns), field (tesla), covariance unknown."""
    return _encode_stamped(MAGNETIC_FIELD_LAYOUTS, stamp, frame_id, field)


def encode_vector3_stamped(stamp: int, frame_id: str, vector: Vec3) -> bytes:
    """A geometry_msgs/Vector3Stamped: stamp (ns), vector."""
    return _encode_stamped(VECTOR3_LAYOUTS, stamp, frame_id, vector)


def encode_quaternion_stamped(stamp: int, frame_id: str, quaternion: Quat) -> bytes:
    """A geometry_msgs/QuaternionStamped: stamp (ns), quaternion (x, y, z, w)."""
    return _encode_stamped(QUATERNION_LAYOUTS, stamp, frame_id, quaternion)


def encode_float32_multiarray(values: Sequence[float], dims: Dims = ()) -> bytes:
    """A std_msgs/Float32MultiArray: values in row-major order, label and size of each dimension."""
    layout, prefix = _multiarray(tuple(dims), len(values))
    return _pack(layout, prefix, len(values), *values)


def encode_clock(stamp: int) -> bytes:
    """A rosgraph_msgs/Clock: stamp (ns)."""
    return _pack(_clock, *divmod(stamp, NANOSECONDS))


def encode_bool(value: bool) -> bytes:
    """A std_msgs/Bool."""
    return b"\0\1\0\0" + bytes([value])


def _encode_stamped(layouts: StampedLayouts, stamp: int, frame_id: str, doubles: Sequence[float]) -> bytes:
    raw = _terminated(frame_id)
    sec, nanosec = divmod(stamp, NANOSECONDS)
    return _pack(layouts[len(raw).to_bytes(4, "little")], sec, nanosec, len(raw), raw, *doubles)


def _pack(layout: Struct, *fields: float | bytes) -> bytes:
    try:
        return layout.pack(CDR_LE, *fields)
    except (struct.error, OverflowError) as error:
        raise CdrError(f"values do not fit into the message: {error}") from None


def _terminated(text: str) -> bytes:
    return text.encode() + b"\0"


def _string(text: str) -> bytes:
    raw = _terminated(text)
    return struct.pack("<I", len(raw)) + raw


def _aligned(raw: bytes, alignment: int) -> bytes:
    """`raw`, padded; it must itself begin at a multiple of `alignment`."""
    return raw + bytes(-len(raw) % alignment)


def _diagonal(variance: float | None) -> bytes:
    if variance is None:
        return _ABSENT
    return struct.pack("<9d", variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance)


@lru_cache(maxsize=64)
def _multiarray(dims: Dims, length: int) -> tuple[Struct, bytes]:
    """Layout of a multi-array and its MultiArrayLayout (data_offset 0) as bytes."""
    prefix = struct.pack("<I", len(dims))
    for number, (label, size) in enumerate(dims):
        stride = math.prod(size for _, size in dims[number:])
        prefix = _aligned(prefix + _string(label), 4) + struct.pack("<II", size, stride)
    prefix += struct.pack("<I", 0)
    return Struct(f"<H2x{len(prefix)}sI{length}f"), prefix
