"""Messages out of CDR bytes with `struct` alone, for speed. Bags and nodes use the same; `cdr_encode` is the way back.

The encoding is XCDR version 1, little endian, as every ROS 2 middleware sends it on x86 and ARM (OMG DDSI-RTPS 2.5,
section 10; OMG DDS-XTypes 1.3, section 7.4): 2 bytes of representation identifier (00 01), 2 bytes of options that a
reader ignores, then the fields, each aligned to its own size relative to the byte after these 4. A string is its length
with the terminating NUL as uint32, then the bytes; a sequence is its length as uint32, then the elements.

Decoders raise `CdrError` for malformed bytes and nothing else, and `UnknownEncoding` for another representation
identifier (see `typestore.as_little_endian`). Bytes after the message are ignored, since rmw_serialize of
rmw_fastrtps appends some, and so are those between the fields, which it leaves random. Values that are not finite
pass: who uses a field checks it. Stamps are int nanoseconds, everything else is SI as in the message definitions.
"""

from __future__ import annotations

import struct
from struct import Struct
from typing import NamedTuple

from jointest_ros.bags.errors import CdrError, UnknownEncoding
from jointest_ros.core.frame import Quat, Vec3

BOOL = "std_msgs/msg/Bool"
CLOCK = "rosgraph_msgs/msg/Clock"
FLOAT32_MULTIARRAY = "std_msgs/msg/Float32MultiArray"
IMU = "sensor_msgs/msg/Imu"
JOINT_STATE = "sensor_msgs/msg/JointState"
MAGNETIC_FIELD = "sensor_msgs/msg/MagneticField"
QUATERNION_STAMPED = "geometry_msgs/msg/QuaternionStamped"
VECTOR3_STAMPED = "geometry_msgs/msg/Vector3Stamped"

Dims = tuple[tuple[str, int], ...]  # label and size of each dimension of a multi-array

NANOSECONDS = 1_000_000_000
CDR_LE = 0x0100  # the bytes 00 01 as a little endian uint16
PREAMBLE = "<H2xiI"  # representation identifier, options, stamp: 12 bytes
_MAX_STRING = 4096  # longer names are nonsense and would fill the caches
_MAX_CACHED = 1024

_preamble = Struct(PREAMBLE)
_uint32 = Struct("<I")
_two_uint32 = Struct("<II")


class StampedLayouts(dict[bytes, Struct]):
    """Layouts of one message type (std_msgs/Header, then doubles), keyed by the 4 bytes of the frame id's length."""

    def __init__(self, doubles: str) -> None:
        super().__init__()
        self.doubles = doubles

    def __missing__(self, length: bytes) -> Struct:
        size = int.from_bytes(length, "little")
        if len(length) != _uint32.size or size > _MAX_STRING:
            raise ValueError(f"frame id of {size} bytes")
        layout = self[length] = Struct(f"{PREAMBLE}I{size}s{-(12 + size) % 8}x{self.doubles}")
        return layout


class _Texts(dict[bytes, str]):
    """Strings by their CDR bytes: decoded once, since names repeat in every message."""

    def __missing__(self, raw: bytes) -> str:
        if len(raw) > _MAX_STRING or raw[-1:] not in (b"\0", b""):
            raise ValueError(f"string of {len(raw)} bytes too long or not terminated")
        if len(self) >= _MAX_CACHED:
            self.clear()
        text = self[raw] = raw[:-1].decode()
        return text


class _Arrays(NamedTuple):
    """What is the same in all messages of one publisher of arrays: all but the values."""

    head: bytes  # from the dimensions to the number of values
    dims: Dims
    values: Struct


class _JointStates(NamedTuple):
    """What is the same in all messages of one publisher of joint states: all but stamp and figures."""

    head: bytes  # from the frame id up to the first position
    start: int  # of the first position
    names: tuple[str, ...]
    positions: int  # how many; at least one
    velocities: int
    efforts: int
    figures: Struct  # positions, number of velocities, velocities, number of efforts

    @classmethod
    def of(
        cls, data: bytes, start: int, names: tuple[str, ...], positions: int, velocities: int, efforts: int
    ) -> _JointStates:
        padded = f"4x{velocities}d" if velocities else ""  # an empty sequence is not followed by padding
        layout = Struct(f"<{positions}dI{padded}I")
        return cls(data[_preamble.size : start], start, names, positions, velocities, efforts, layout)


_texts = _Texts()
_arrays: dict[int, _Arrays] = {}  # the newest one of every length of a message
_joint_states: dict[int, _JointStates] = {}  # the same
IMU_LAYOUTS = StampedLayouts("104x3d72x3d72x")  # orientation and covariance, gyro, covariance, accel, covariance
MAGNETIC_FIELD_LAYOUTS = StampedLayouts("3d72x")  # field, covariance
QUATERNION_LAYOUTS = StampedLayouts("4d")
VECTOR3_LAYOUTS = StampedLayouts("3d")


def _refusal(msgtype: str, data: bytes, error: Exception) -> CdrError:
    if len(data) >= 4 and data[:2] != b"\0\1":
        return UnknownEncoding(f"{msgtype}: encapsulation {data[:2].hex(' ')} instead of CDR little endian (00 01)")
    return CdrError(f"{msgtype}: malformed message of {len(data)} bytes ({error})")


def _check_preamble(identifier: int, nanosec: int) -> None:
    if identifier != CDR_LE:
        raise ValueError("not CDR little endian")
    if nanosec >= NANOSECONDS:  # the sum with the seconds might not fit into the stamp of an answer
        raise ValueError(f"stamp with {nanosec} ns")


def decode_imu(data: bytes) -> tuple[int, str, Vec3, Vec3]:
    """Stamp (ns), frame id, angular velocity (rad/s), linear acceleration (m/s^2) of a sensor_msgs/Imu."""
    try:
        identifier, sec, nanosec, _, frame_id, gx, gy, gz, ax, ay, az = IMU_LAYOUTS[data[12:16]].unpack_from(data)
        if identifier != CDR_LE or nanosec >= NANOSECONDS:
            _check_preamble(identifier, nanosec)
        return sec * NANOSECONDS + nanosec, _texts[frame_id], (gx, gy, gz), (ax, ay, az)
    except (struct.error, ValueError) as error:
        raise _refusal(IMU, data, error) from None


def decode_magnetic_field(data: bytes) -> tuple[int, str, Vec3]:
    """Stamp (ns), frame id, field (tesla) of a sensor_msgs/MagneticField."""
    try:
        identifier, sec, nanosec, _, frame_id, x, y, z = MAGNETIC_FIELD_LAYOUTS[data[12:16]].unpack_from(data)
        _check_preamble(identifier, nanosec)
        return sec * NANOSECONDS + nanosec, _texts[frame_id], (x, y, z)
    except (struct.error, ValueError) as error:
        raise _refusal(MAGNETIC_FIELD, data, error) from None


def decode_quaternion_stamped(data: bytes) -> tuple[int, str, Quat]:
    """Stamp (ns), frame id, quaternion (x, y, z, w) of a geometry_msgs/QuaternionStamped."""
    try:
        identifier, sec, nanosec, _, frame_id, x, y, z, w = QUATERNION_LAYOUTS[data[12:16]].unpack_from(data)
        _check_preamble(identifier, nanosec)
        return sec * NANOSECONDS + nanosec, _texts[frame_id], (x, y, z, w)
    except (struct.error, ValueError) as error:
        raise _refusal(QUATERNION_STAMPED, data, error) from None


def decode_bool(data: bytes) -> bool:
    """Value of a std_msgs/Bool."""
    if data[:2] != b"\0\1" or len(data) < 5:
        raise _refusal(BOOL, data, ValueError("not CDR little endian" if len(data) >= 5 else "too short"))
    return data[4] != 0


def decode_joint_state(data: bytes) -> tuple[int, tuple[str, ...], tuple[float, ...], tuple[float, ...]]:
    """Stamp (ns), names, positions (rad), velocities (rad/s) of a sensor_msgs/JointState.

    The three sequences are returned as they are sent: positions and velocities may be empty or of another length.
    """
    try:
        identifier, sec, nanosec = _preamble.unpack_from(data)
        _check_preamble(identifier, nanosec)
        stamp = sec * NANOSECONDS + nanosec
        known = _joint_states.get(len(data))
        if known is not None and data.startswith(known.head, _preamble.size):
            figures = known.figures.unpack_from(data, known.start)
            if figures[known.positions] == known.velocities and figures[-1] == known.efforts:
                return stamp, known.names, figures[: known.positions], figures[known.positions + 1 : -1]
        _, offset = _read_string(data, _preamble.size)
        names, offset = _read_strings(data, offset)
        position, offset = _read_doubles(data, offset)
        start = offset - 8 * len(position)
        velocity, offset = _read_doubles(data, offset)
        effort, _ = _read_doubles(data, offset)
        if position and len(data) <= _MAX_STRING:
            _joint_states[len(data)] = _JointStates.of(data, start, names, len(position), len(velocity), len(effort))
        return stamp, names, position, velocity
    except (struct.error, ValueError) as error:
        raise _refusal(JOINT_STATE, data, error) from None


def decode_float32_multiarray(data: bytes) -> tuple[tuple[float, ...], Dims]:
    """Values, and label and size of each dimension, of a std_msgs/Float32MultiArray."""
    try:
        if data[:2] != b"\0\1":
            raise ValueError("not CDR little endian")
        known = _arrays.get(len(data))
        if known is not None and data.startswith(known.head, 4):
            return known.values.unpack_from(data, 4 + len(known.head)), known.dims
        layout, skip = _read_layout(data)
        values = layout.values.unpack_from(data, 4 + len(layout.head))
        if not skip and len(data) <= _MAX_STRING:
            _arrays[len(data)] = layout
        return values[skip:], layout.dims  # the layout's data_offset: elements before the first one
    except (struct.error, ValueError) as error:
        raise _refusal(FLOAT32_MULTIARRAY, data, error) from None


def float32_multiarray_head(data: bytes) -> bytes | None:
    """All from the dimensions to the number of values of what `decode_float32_multiarray` takes.

    The values follow; None: there are elements before the first one.
    """
    layout, skip = _read_layout(data)
    return None if skip else layout.head


def _read_layout(data: bytes) -> tuple[_Arrays, int]:
    """What comes before the values, and how many elements before the first one they begin with."""
    count, offset = _uint32.unpack_from(data, 4)[0], 8
    if 12 * count > len(data):
        raise ValueError(f"{count} dimensions")
    dims: list[tuple[str, int]] = []
    for _ in range(count):
        label, offset = _read_string(data, offset)
        offset = (offset + 3) & ~3
        size, _stride = _two_uint32.unpack_from(data, offset)
        dims.append((label, size))
        offset += 8
    skip, length = _two_uint32.unpack_from(data, offset)
    offset += 8
    if offset + 4 * length > len(data):
        raise ValueError(f"{length} values")
    return _Arrays(data[4:offset], tuple(dims), Struct(f"<{length}f")), skip


def _read_string(data: bytes, offset: int) -> tuple[str, int]:
    start = ((offset + 3) & ~3) + 4
    end = start + _uint32.unpack_from(data, start - 4)[0]
    if end > len(data):
        raise ValueError("a string reaches beyond the end")
    return _texts[data[start:end]], end


def _read_strings(data: bytes, offset: int) -> tuple[tuple[str, ...], int]:
    offset = (offset + 3) & ~3
    count = _uint32.unpack_from(data, offset)[0]
    offset += 4
    if offset + 4 * count > len(data):
        raise ValueError(f"{count} strings")
    texts = []
    for _ in range(count):
        text, offset = _read_string(data, offset)
        texts.append(text)
    return tuple(texts), offset


def _read_doubles(data: bytes, offset: int) -> tuple[tuple[float, ...], int]:
    offset = (offset + 3) & ~3
    count = _uint32.unpack_from(data, offset)[0]
    offset += 4
    if not count:  # an empty sequence is not followed by padding
        return (), offset
    offset = ((offset + 3) & ~7) + 4  # 8 bytes from the byte after the encapsulation
    end = offset + 8 * count
    if end > len(data):
        raise ValueError(f"{count} doubles")
    return struct.unpack_from(f"<{count}d", data, offset), end
