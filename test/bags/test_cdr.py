"""The direct CDR functions against rosbags' own (de)serialiser, against Fast CDR, and against nonsense."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jointest_ros.bags import cdr, cdr_encode
from jointest_ros.bags.errors import CdrError, UnknownEncoding
from jointest_ros.bags.typestore import as_little_endian, typestore

FRAME_IDS = ["x" * length for length in range(41)] + ["ü", "гироскоп/1", "手のひら", "a b\n"]
STAMP = 1_700_000_000_123_456_789


def message(msgtype: str, **fields: Any) -> Any:
    return typestore().types[msgtype](**fields)


def header(stamp: int, frame_id: str) -> Any:
    sec, nanosec = divmod(stamp, 10**9)
    time = message("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return message("std_msgs/msg/Header", stamp=time, frame_id=frame_id)


def vector(values: Any) -> Any:
    return message("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, values), strict=True)))


def quaternion(values: Any) -> Any:
    return message("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, values), strict=True)))


def imu(stamp: int, frame_id: str, gyro: Any, accel: Any, variances: tuple[float, float] = (0.0, 0.0)) -> Any:
    unknown = np.zeros(9)
    unknown[0] = -1.0
    return message(
        cdr.IMU,
        header=header(stamp, frame_id),
        orientation=quaternion((0, 0, 0, 1)),
        orientation_covariance=unknown,
        angular_velocity=vector(gyro),
        angular_velocity_covariance=(np.eye(3) * variances[0]).ravel(),
        linear_acceleration=vector(accel),
        linear_acceleration_covariance=(np.eye(3) * variances[1]).ravel(),
    )


def joint_state(frame_id: str, names: Any, position: Any, velocity: Any, effort: Any = ()) -> Any:
    return message(
        cdr.JOINT_STATE,
        header=header(STAMP, frame_id),
        name=list(names),
        position=np.array(position, dtype=float),
        velocity=np.array(velocity, dtype=float),
        effort=np.array(effort, dtype=float),
    )


def multiarray(values: Any, dims: cdr.Dims) -> Any:
    sizes = [size for _, size in dims]
    dim = [
        message("std_msgs/msg/MultiArrayDimension", label=label, size=size, stride=math.prod(sizes[k:]))
        for k, (label, size) in enumerate(dims)
    ]
    layout = message("std_msgs/msg/MultiArrayLayout", dim=dim, data_offset=0)
    return message(cdr.FLOAT32_MULTIARRAY, layout=layout, data=np.array(values, dtype=np.float32))


def serialised(content: Any, little_endian: bool = True) -> bytes:
    return bytes(typestore().serialize_cdr(content, content.__msgtype__, little_endian=little_endian))


def random_vector(seed: int, length: int = 3) -> Any:
    return tuple(np.random.default_rng(seed).normal(0.0, 10.0, length).tolist())


@pytest.mark.parametrize("number", range(len(FRAME_IDS)))
def test_imu_both_ways(number: int) -> None:
    frame_id, gyro, accel = FRAME_IDS[number], random_vector(number), random_vector(number + 1000)
    data = serialised(imu(STAMP + number, frame_id, gyro, accel, (1e-4, 2e-2)))
    assert cdr.decode_imu(data) == (STAMP + number, frame_id, gyro, accel)
    assert cdr_encode.ImuEncoder(frame_id, 1e-4, 2e-2).encode(STAMP + number, gyro, accel) == data


@pytest.mark.parametrize("number", range(len(FRAME_IDS)))
def test_stamped_vectors_both_ways(number: int) -> None:
    frame_id, values = FRAME_IDS[number], random_vector(number, 4)
    head = header(STAMP, frame_id)

    data = serialised(message(cdr.QUATERNION_STAMPED, header=head, quaternion=quaternion(values)))
    assert cdr.decode_quaternion_stamped(data) == (STAMP, frame_id, values)
    assert cdr_encode.encode_quaternion_stamped(STAMP, frame_id, values) == data

    data = serialised(message(cdr.VECTOR3_STAMPED, header=head, vector=vector(values[:3])))
    assert cdr_encode.encode_vector3_stamped(STAMP, frame_id, values[:3]) == data

    field = message(
        cdr.MAGNETIC_FIELD, header=head, magnetic_field=vector(values[:3]), magnetic_field_covariance=np.zeros(9)
    )
    data = serialised(field)
    assert cdr.decode_magnetic_field(data) == (STAMP, frame_id, values[:3])
    assert cdr_encode.encode_magnetic_field(STAMP, frame_id, values[:3]) == data


@pytest.mark.parametrize("count", range(6))
@pytest.mark.parametrize("frame_id", FRAME_IDS[::5])
@pytest.mark.parametrize("moves", [True, False])
def test_joint_state_both_ways(count: int, frame_id: str, moves: bool) -> None:
    names = tuple("joint_ä"[: 2 + k] * k for k in range(count))
    position, velocity = random_vector(count, count), random_vector(count + 50, count * moves)
    data = serialised(joint_state(frame_id, names, position, velocity))
    assert cdr.decode_joint_state(data) == (STAMP, names, position, velocity)
    assert cdr_encode.JointStateEncoder(names, frame_id).encode(STAMP, position, velocity) == data


def test_joint_state_with_sequences_of_different_lengths() -> None:
    data = serialised(joint_state("base", ["a", "b", "c"], [1.0], [], [1.0, 2.0]))
    assert cdr.decode_joint_state(data) == (STAMP, ("a", "b", "c"), (1.0,), ())


@pytest.mark.parametrize("length", [0, 1, 2, 8])
@pytest.mark.parametrize("dims", [(), (("joint", 4), ("sensor", 2)), (("", 8),), (("größe", 2), ("b", 2), ("cc", 2))])
def test_float32_multiarray_both_ways(length: int, dims: cdr.Dims) -> None:
    values = tuple(np.array(random_vector(length, length), dtype=np.float32).tolist())
    data = serialised(multiarray(values, dims))
    assert cdr.decode_float32_multiarray(data) == (values, dims)
    assert cdr_encode.encode_float32_multiarray(values, dims) == data


def test_messages_of_equal_length_are_told_apart() -> None:
    """Several publishers: what is kept of one of them says nothing of the others."""
    kinds: list[tuple[str, tuple[str, ...], tuple[float, ...], tuple[float, ...], tuple[float, ...]]] = [
        ("base", ("a", "b"), (1.0, 2.0), (3.0, 4.0), ()),
        ("base", ("a", "c"), (1.0, 2.0), (3.0, 4.0), ()),
        ("base", ("a", "b"), (1.0, 2.0), (3.0,), (5.0,)),
        ("base", ("a", "b"), (1.0, 2.0), (), (5.0, 6.0)),
        ("base", ("a", "b"), (1.0,), (3.0, 4.0), ()),
        ("base", ("a", "b"), (), (3.0, 4.0), (5.0,)),
        ("root", ("a", "b"), (1.0, 2.0), (3.0, 4.0), ()),
    ]
    messages = [(kind, serialised(joint_state(*kind))) for kind in kinds]
    longest = max(len(data) for _, data in messages)
    for turn in range(3):
        for (_, names, position, velocity, _), data in messages:
            padded = data + bytes([turn]) * (longest - len(data))  # as a middleware may
            assert cdr.decode_joint_state(padded) == (STAMP, names, position, velocity)
    shapes: tuple[cdr.Dims, ...] = (
        (("joint", 2), ("sensor", 3)),
        (("joint", 3), ("sensor", 2)),
        (("jolnt", 2), ("sensor", 3)),
    )
    for turn in range(3):
        values = tuple(float(turn + k) for k in range(6))
        for dims in shapes:
            assert cdr.decode_float32_multiarray(serialised(multiarray(values, dims))) == (values, dims)


def test_elements_before_the_data_offset_of_a_multiarray_are_skipped() -> None:
    content = multiarray([1.0, 2.0, 3.0], (("joint", 2),))
    content.layout.data_offset = 1
    assert cdr.decode_float32_multiarray(serialised(content))[0] == (2.0, 3.0)


def test_clock_and_bool() -> None:
    time = header(STAMP, "").stamp
    assert cdr_encode.encode_clock(STAMP) == serialised(message(cdr.CLOCK, clock=time))
    for value in (True, False):
        assert cdr_encode.encode_bool(value) == serialised(message(cdr.BOOL, data=value))


def test_a_stamp_before_1970_keeps_its_nanoseconds_positive() -> None:
    data = cdr_encode.encode_vector3_stamped(-1, "", (0.0, 0.0, 0.0))
    assert data == serialised(message(cdr.VECTOR3_STAMPED, header=header(-1, ""), vector=vector((0, 0, 0))))
    assert cdr.decode_magnetic_field(cdr_encode.encode_magnetic_field(-1, "", (0.0, 0.0, 0.0)))[0] == -1


def test_fast_cdr_understands_and_is_understood() -> None:
    """Byte for byte they differ: Fast CDR leaves random bytes between the fields and at the end."""
    rclpy = pytest.importorskip("rclpy.serialization")
    sensor_msgs, std_msgs = pytest.importorskip("sensor_msgs.msg"), pytest.importorskip("std_msgs.msg")

    sensor = sensor_msgs.Imu()
    sensor.header.stamp.sec, sensor.header.stamp.nanosec, sensor.header.frame_id = 5, 6, "palm"
    sensor.angular_velocity.x, sensor.linear_acceleration.z, sensor.orientation_covariance[0] = 1.0, 9.81, -1.0
    fields = (5_000_000_006, (1.0, 0.0, 0.0), (0.0, 0.0, 9.81))
    assert cdr.decode_imu(rclpy.serialize_message(sensor)) == (fields[0], "palm", *fields[1:])
    assert rclpy.deserialize_message(cdr_encode.ImuEncoder("palm").encode(*fields), sensor_msgs.Imu) == sensor

    for velocity in ((), (3.0, 4.0)):
        joints = sensor_msgs.JointState(name=["a", "long_name"], position=[1.0, 2.0], velocity=velocity)
        ours = cdr_encode.JointStateEncoder(["a", "long_name"]).encode(0, (1.0, 2.0), velocity)
        assert cdr.decode_joint_state(rclpy.serialize_message(joints)) == cdr.decode_joint_state(ours)
        assert rclpy.deserialize_message(ours, sensor_msgs.JointState) == joints

    volts = std_msgs.Float32MultiArray(data=[0.5, 1.5])
    volts.layout.dim = [std_msgs.MultiArrayDimension(label="joint", size=2, stride=2)]
    ours = cdr_encode.encode_float32_multiarray((0.5, 1.5), (("joint", 2),))
    assert cdr.decode_float32_multiarray(rclpy.serialize_message(volts)) == ((0.5, 1.5), (("joint", 2),))
    assert rclpy.deserialize_message(ours, std_msgs.Float32MultiArray) == volts


DECODERS: dict[str, tuple[Callable[[bytes], object], bytes]] = {
    cdr.IMU: (cdr.decode_imu, cdr_encode.ImuEncoder("palm").encode(STAMP, (1, 2, 3), (4, 5, 6))),
    cdr.MAGNETIC_FIELD: (cdr.decode_magnetic_field, cdr_encode.encode_magnetic_field(STAMP, "palm", (1, 2, 3))),
    cdr.QUATERNION_STAMPED: (
        cdr.decode_quaternion_stamped,
        cdr_encode.encode_quaternion_stamped(STAMP, "palm", (0, 0, 0, 1)),
    ),
    cdr.JOINT_STATE: (
        cdr.decode_joint_state,
        cdr_encode.JointStateEncoder(["a", "bcdef"], "base").encode(STAMP, (1, 2), (3, 4)),
    ),
    cdr.FLOAT32_MULTIARRAY: (
        cdr.decode_float32_multiarray,
        cdr_encode.encode_float32_multiarray((1, 2, 3, 4), (("joint", 2), ("sensor", 2))),
    ),
}
every_decoder = pytest.mark.parametrize("msgtype", DECODERS)


def refuses_or_decodes(decode: Callable[[bytes], object], data: bytes) -> None:
    try:
        decode(data)
    except CdrError as error:
        assert "\n" not in str(error)


@every_decoder
@given(data=st.binary(max_size=400), headed=st.booleans())
def test_arbitrary_bytes_raise_only_cdr_errors(msgtype: str, data: bytes, headed: bool) -> None:
    decode, _ = DECODERS[msgtype]
    refuses_or_decodes(decode, b"\0\1\0\0" + data if headed else data)


@every_decoder
@given(data=st.data())
def test_mutated_messages_raise_only_cdr_errors(msgtype: str, data: st.DataObject) -> None:
    decode, valid = DECODERS[msgtype]
    changed = bytearray(valid)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(valid) - 4))
        changed[at : at + 4] = struct.pack("<I", data.draw(st.sampled_from([0, 1, 5, 255, 2**16, 2**31, 2**32 - 1])))
    refuses_or_decodes(decode, bytes(changed))
    refuses_or_decodes(lambda raw: as_little_endian(raw, msgtype), bytes(changed))


@every_decoder
def test_truncated_messages_are_refused_and_longer_ones_are_not(msgtype: str) -> None:
    decode, valid = DECODERS[msgtype]
    for length in range(len(valid)):
        with pytest.raises(CdrError, match=msgtype):
            decode(valid[:length])
    assert decode(valid + b"random..") == decode(valid)


@every_decoder
def test_big_endian_is_reported_as_such_and_converted(msgtype: str) -> None:
    decode, valid = DECODERS[msgtype]
    content = typestore().deserialize_cdr(valid, msgtype)
    other = serialised(content, little_endian=False)
    with pytest.raises(UnknownEncoding, match="00 00"):
        decode(other)
    assert decode(as_little_endian(other, msgtype)) == decode(valid)


@every_decoder
def test_xcdr2_is_reported_as_such(msgtype: str) -> None:
    decode, valid = DECODERS[msgtype]
    other = b"\0\7" + valid[2:]
    with pytest.raises(UnknownEncoding, match="00 07"):
        decode(other)
    with pytest.raises(CdrError, match=msgtype):
        as_little_endian(other, msgtype)


@every_decoder
def test_the_options_of_the_encapsulation_do_not_matter(msgtype: str) -> None:
    decode, valid = DECODERS[msgtype]
    assert decode(b"\0\1\0\3" + valid[4:]) == decode(valid)


@pytest.mark.parametrize("length", [4097, 2**31, 2**32 - 1])
def test_absurd_lengths_are_refused(length: int) -> None:
    for decode, offset in ((cdr.decode_imu, 12), (cdr.decode_joint_state, 12), (cdr.decode_float32_multiarray, 4)):
        with pytest.raises(CdrError):
            decode(b"\0\1\0\0" + bytes(offset - 4) + struct.pack("<I", length) + bytes(500))


def test_invalid_text_is_refused() -> None:
    data = serialised(imu(0, "abc", (0, 0, 0), (0, 0, 0)))
    for wrong in (b"ab\xff\0", b"abcd"):  # not UTF-8; not terminated
        with pytest.raises(CdrError):
            cdr.decode_imu(data.replace(b"abc\0", wrong))


def test_values_that_are_not_finite_pass() -> None:
    nan, inf = math.nan, math.inf
    _, _, gyro, accel = cdr.decode_imu(cdr_encode.ImuEncoder("").encode(0, (nan, nan, nan), (inf, -inf, 1.0)))
    assert all(map(math.isnan, gyro))
    assert accel == (inf, -inf, 1.0)
    values, _ = cdr.decode_float32_multiarray(cdr_encode.encode_float32_multiarray((nan, inf)))
    assert math.isnan(values[0])
    assert values[1] == inf


def test_what_does_not_fit_into_a_message_raises_cdr_errors() -> None:
    encoder = cdr_encode.JointStateEncoder(["a", "b"])
    with pytest.raises(CdrError, match="do not fit"):
        cdr_encode.encode_clock(2**63)
    with pytest.raises(CdrError, match="do not fit"):
        encoder.encode(0, [1.0])
    with pytest.raises(CdrError, match="do not fit"):
        encoder.encode(0, [1.0, 2.0], [1.0])
    with pytest.raises(CdrError, match="do not fit"):
        cdr_encode.encode_float32_multiarray([1e39])


def test_many_different_names_do_not_pile_up() -> None:
    for number in range(3000):
        cdr.decode_magnetic_field(cdr_encode.encode_magnetic_field(0, f"frame_{number}", (0.0, 0.0, 0.0)))
    assert len(cdr._texts) <= 1024
