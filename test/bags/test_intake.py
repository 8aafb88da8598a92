"""From bytes to frames: nothing is lost without being counted, and nothing that comes can raise."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jointest_ros.bags import cdr, synthetic
from jointest_ros.bags.cdr_encode import ImuEncoder, encode_float32_multiarray, encode_magnetic_field
from jointest_ros.bags.intake import HALL_TOPIC, Intake
from jointest_ros.bags.typestore import typestore
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import Frame, Vec3
from jointest_ros.core.hall_sensor import HallSensor
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.timing import Timing
from jointest_ros.sim import exoshell, finger

PERIOD = 10_000_000  # ns
UP: Vec3 = (0.0, 0.0, 9.81)
ELBOW = Joint("elbow", "upper", "lower", ((1.0, 0.0, 0.0),))
ARM = Robot(
    ("upper", "lower"),
    (ELBOW,),
    (Sensor("upper", "upper"), Sensor("lower", "lower", mag=True)),
    hall=(HallSensor("elbow"), HallSensor("elbow", mirrored=True)),
)


def stamp(number: int) -> int:
    return 1_000_000_000 + number * PERIOD


def imu(number: int, name: str = "upper", gyro: Vec3 = (0.1, 0.2, 0.3), accel: Vec3 = UP) -> bytes:
    return ImuEncoder(name).encode(stamp(number), gyro, accel)


def feed(intake: Intake, *messages: tuple[str, int, bytes]) -> list[Frame]:
    """The frames of messages (topic, record time, bytes) and of the end of the stream."""
    frames = [frame for topic, time, data in messages for frame in intake.handlers[topic](data, time)]
    return frames + intake.flush()


def check_counts(intake: Intake, sent: Counter[str]) -> None:
    for topic in intake.topics:
        counts = intake.counts(topic)
        assert counts["messages"] == sent[topic]
        assert counts["messages"] == counts["used"] + sum(counts["refused"].values())


def big_endian(data: bytes, msgtype: str) -> bytes:
    message = typestore().deserialize_cdr(data, msgtype)
    return bytes(typestore().serialize_cdr(message, msgtype, little_endian=False))


# -------------------------------------------------------------------- what is sound


def test_topics_and_their_types() -> None:
    assert Intake(ARM, Timing()).topics == {
        "imu/upper": cdr.IMU,
        "imu/lower": cdr.IMU,
        "mag/lower": cdr.MAGNETIC_FIELD,
        HALL_TOPIC: cdr.FLOAT32_MULTIARRAY,
    }
    unused = dataclasses.replace(ARM, sensors=(Sensor("upper", "upper", gyro=False, accel=False),), hall=())
    assert Intake(unused, Timing()).topics == {}


@pytest.mark.parametrize(
    "simulated",
    [
        finger.simulate("PC", rate_hz=100.0, duration_s=1.0, zero_pose_s=0.0, mag=True),
        exoshell.simulate(rate_hz=1000.0, duration_s=0.2),
    ],
    ids=["finger", "exoshell"],
)
def test_frames_are_the_rows_of_the_simulated_recording(simulated: Any) -> None:
    intake = Intake(simulated.robot, Timing())
    sent: Counter[str] = Counter()
    frames = []
    for time, topic, data in synthetic.messages([simulated]):
        if topic in intake.handlers:
            sent[topic] += 1
            frames += intake.handlers[topic](data, time)
    frames += intake.flush()
    recording = simulated.recording
    assert [frame.stamp for frame in frames] == (recording.stamps + synthetic.FIRST_STAMP).tolist()
    for sensor in simulated.robot.sensors:
        assert [frame.gyro[sensor.name] for frame in frames] == [tuple(v) for v in recording.gyro[sensor.name].tolist()]
        if sensor.accel:
            accel = [frame.accel[sensor.name] for frame in frames]
            assert accel == [tuple(v) for v in recording.accel[sensor.name].tolist()]
    if recording.hall is not None:
        assert np.array_equal([frame.hall for frame in frames], recording.hall.astype(np.float32))
    check_counts(intake, sent)
    assert not any(intake.counts(topic)["refused"] for topic in intake.topics if topic.startswith(("imu", "hall")))


def test_a_shared_topic_is_told_apart_by_frame_id() -> None:
    sensors = tuple(Sensor(name, name, topic="imu", frame_id=f"{name}_chip") for name in ("upper", "lower"))
    intake = Intake(Robot(("upper", "lower"), (ELBOW,), sensors), Timing())
    assert intake.topics == {"imu": cdr.IMU}
    messages = [
        ("imu", stamp(number), imu(number, f"{name}_chip", (float(number), 0.0, turn)))
        for number in range(20)
        for name, turn in (("upper", 1.0), ("lower", 2.0), ("stranger", 3.0))
    ]
    frames = feed(intake, *messages)
    assert [frame.gyro for frame in frames] == [
        {"upper": (float(number), 0.0, 1.0), "lower": (float(number), 0.0, 2.0)} for number in range(20)
    ]
    assert intake.counts("imu") == {"messages": 60, "used": 40, "refused": {"unknown frame_id": 20}}


def test_one_sensor_with_a_frame_id_takes_only_its_own() -> None:
    sensor = Sensor("upper", "upper", frame_id="chip")
    intake = Intake(Robot(("upper",), sensors=(sensor,)), Timing())
    feed(intake, ("imu/upper", 0, imu(0, "chip")), ("imu/upper", 0, imu(1, "other")))
    assert intake.counts("imu/upper") == {"messages": 2, "used": 1, "refused": {"unknown frame_id": 1}}


@pytest.mark.parametrize("ids", [("", ""), ("chip", ""), ("chip", "chip")])
def test_sensors_that_cannot_be_told_apart(ids: tuple[str, str]) -> None:
    with pytest.raises(ConfigurationError, match=r"'lower'.topic: 'imu' is that of 'upper' too; .* frame_id"):
        Robot(
            ("upper", "lower"),
            sensors=tuple(
                Sensor(name, name, topic="imu", frame_id=frame_id)
                for name, frame_id in zip(("upper", "lower"), ids, strict=True)
            ),
        )


def test_a_sensor_on_the_topic_of_the_hall_voltages() -> None:
    robot = dataclasses.replace(ARM, sensors=(Sensor("upper", "upper", topic=HALL_TOPIC),))
    with pytest.raises(ConfigurationError, match=HALL_TOPIC):
        Intake(robot, Timing())


def test_big_endian_messages_give_the_same_frames() -> None:
    messages = []
    for number in range(10):
        messages += [
            ("imu/upper", cdr.IMU, imu(number)),
            ("mag/lower", cdr.MAGNETIC_FIELD, encode_magnetic_field(stamp(number), "lower", (1e-5, 2e-5, 4e-5))),
            (HALL_TOPIC, cdr.FLOAT32_MULTIARRAY, encode_float32_multiarray((0.5, 1.0 + number))),
            ("imu/lower", cdr.IMU, imu(number, "lower")),
        ]
    little = feed(Intake(ARM, Timing()), *((topic, stamp(k // 4), data) for k, (topic, _, data) in enumerate(messages)))
    intake = Intake(ARM, Timing())
    big = feed(
        intake, *((topic, stamp(k // 4), big_endian(data, kind)) for k, (topic, kind, data) in enumerate(messages))
    )
    assert repr(little) == repr(big)  # periods that are NaN are equal too
    assert len(big) == 10
    assert all(frame.mag and frame.hall for frame in big)
    assert all(intake.counts(topic)["used"] == 10 for topic in intake.topics)


# -------------------------------------------------------------------- what is not


def test_causes_of_refusal() -> None:
    intake = Intake(ARM, Timing())
    sound = [(topic, stamp(k), imu(k)) for k in range(10) for topic in ("imu/upper", "imu/lower")]
    bad = {
        "not finite": imu(10, gyro=(math.nan, 0.0, 0.0)),
        "implausible": imu(10, accel=(1e9, 0.0, 0.0)),
        "repeated stamp": imu(9),
        "older stamp": imu(3),
        "odd stamp": imu(100_000),
        "undecodable": imu(10)[:100],
    }
    frames = feed(intake, *sound, *(("imu/upper", stamp(10), data) for data in bad.values()))
    assert len(frames) == 10
    assert intake.counts("imu/upper") == {"messages": 16, "used": 10, "refused": dict.fromkeys(bad, 1)}
    assert intake.counts("imu/lower") == {"messages": 10, "used": 10, "refused": {}}


def test_refused_hall_and_magnetometer_messages() -> None:
    intake = Intake(ARM, Timing())
    sound = [(topic, stamp(k), imu(k)) for k in range(10) for topic in ("imu/upper", "imu/lower")]
    feed(
        intake,
        *sound,
        (HALL_TOPIC, stamp(1000), encode_float32_multiarray((0.5,))),
        (HALL_TOPIC, stamp(1000), encode_float32_multiarray((0.5, 1e6))),
        (HALL_TOPIC, stamp(1000), b"\0\1\0\0"),
        (HALL_TOPIC, stamp(1000), encode_float32_multiarray((0.5, math.nan))),
        ("mag/lower", stamp(10), encode_magnetic_field(stamp(10), "", (math.inf, 0.0, 0.0))),
        ("mag/lower", stamp(10), encode_magnetic_field(stamp(10), "", (5.0, 0.0, 0.0))),
        ("mag/lower", stamp(10), encode_magnetic_field(stamp(10), "", (1e-5, 0.0, 0.0))),
        ("mag/lower", stamp(10), encode_magnetic_field(stamp(10), "", (1e-5, 0.0, 0.0))),
        ("mag/lower", stamp(10), b""),
    )
    hall = {"wrong length": 1, "implausible": 1, "undecodable": 1, "unpaired": 1}
    assert intake.counts(HALL_TOPIC) == {"messages": 4, "used": 0, "refused": hall}
    mag = {"not finite": 1, "implausible": 1, "repeated stamp": 1, "undecodable": 1, "unpaired": 1}
    assert intake.counts("mag/lower") == {"messages": 5, "used": 0, "refused": mag}


def test_a_field_that_is_not_in_use_may_hold_anything() -> None:
    gyro_only = Intake(Robot(("upper",), sensors=(Sensor("upper", "upper", accel=False),)), Timing())
    frames = feed(gyro_only, *(("imu/upper", 0, imu(k, accel=(math.nan, math.inf, 1e30))) for k in range(5)))
    assert [frame.accel for frame in frames] == [{}] * 5
    assert gyro_only.counts("imu/upper") == {"messages": 5, "used": 5, "refused": {}}


NUMBERS = st.sampled_from([0.0, 1.0, -3.0, math.nan, math.inf, 1e9])
VECTORS = st.tuples(NUMBERS, NUMBERS, NUMBERS)
STAMPS = st.integers(0, 30) | st.sampled_from([-100, 10_000, 10_001, 2_000_000])  # in periods
IMU_DATA = st.builds(imu, STAMPS, st.just("upper"), VECTORS, VECTORS)
MAG_DATA = st.builds(lambda number, field: encode_magnetic_field(stamp(number), "", field), STAMPS, VECTORS)
HALL_DATA = st.builds(encode_float32_multiarray, st.lists(st.sampled_from([0.5, math.nan, 1e9]), max_size=3))
GARBAGE = st.binary(max_size=40) | st.builds(lambda data, cut: data[:cut], IMU_DATA, st.integers(0, 350))
BIG_ENDIAN = st.builds(big_endian, IMU_DATA, st.just(cdr.IMU))
MESSAGES = st.one_of(
    st.tuples(st.sampled_from(["imu/upper", "imu/lower"]), IMU_DATA | GARBAGE | BIG_ENDIAN),
    st.tuples(st.just("mag/lower"), MAG_DATA | GARBAGE),
    st.tuples(st.just(HALL_TOPIC), HALL_DATA | GARBAGE),
)


@settings(max_examples=300)
@given(st.lists(st.tuples(MESSAGES, st.integers(0, 30)), max_size=60), st.booleans())
def test_whatever_comes_is_used_or_refused_and_frames_are_in_order(
    messages: list[tuple[tuple[str, bytes], int]], hall_per_frame: bool
) -> None:
    intake = Intake(ARM, Timing(hall_per_frame=hall_per_frame))
    frames = feed(intake, *((topic, stamp(time), data) for (topic, data), time in messages))
    check_counts(intake, Counter(topic for (topic, _), _ in messages))
    for before, after in pairwise(frames):
        assert after.stamp > before.stamp or after.reset
    for frame in frames:
        for vector in (*frame.gyro.values(), *frame.accel.values(), *frame.mag.values()):
            assert all(map(math.isfinite, vector))
