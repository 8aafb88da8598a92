"""Whatever comes in as bytes: decoders refuse or decode, and no estimator ever raises or puts out what is no number."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jointest_ros import config
from jointest_ros.bags import cdr, cdr_encode, synthetic
from jointest_ros.bags.errors import CdrError
from jointest_ros.bags.intake import HALL_TOPIC, Intake
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.frame import Frame
from jointest_ros.sim.scenarios import SCENARIOS

CONFIGS = Path(__file__).resolve().parents[2] / "config"
MS = 1_000_000
# estimator -> rig, its scenario, its configuration
ESTIMATED = {
    "pcf": ("finger", "PC", "finger.yaml"),
    **dict.fromkeys(("gyro", "hall", "kf", "kckf"), ("exoshell", "clipped", "exoshell.yaml")),
    **dict.fromkeys(
        ("accel_analytical", "accel_ekf", "accel_ukf"), ("two_link_arm", "slow_periodic", "two_link_accel.yaml")
    ),
}
DECODERS: dict[str, Callable[[bytes], object]] = {
    cdr.IMU: cdr.decode_imu,
    cdr.FLOAT32_MULTIARRAY: cdr.decode_float32_multiarray,
    cdr.MAGNETIC_FIELD: cdr.decode_magnetic_field,
    cdr.JOINT_STATE: cdr.decode_joint_state,
    cdr.QUATERNION_STAMPED: cdr.decode_quaternion_stamped,
}
VALID: dict[str, bytes] = {
    cdr.IMU: cdr_encode.ImuEncoder("palm").encode(10**18, (1, 2, 3), (4, 5, 6)),
    cdr.FLOAT32_MULTIARRAY: cdr_encode.encode_float32_multiarray((1.0,) * 8, (("joint", 4), ("sensor", 2))),
    cdr.MAGNETIC_FIELD: cdr_encode.encode_magnetic_field(10**18, "palm", (1, 2, 3)),
    cdr.JOINT_STATE: cdr_encode.JointStateEncoder(["a", "bcdef"], "base").encode(10**18, (1, 2), (3, 4)),
    cdr.QUATERNION_STAMPED: cdr_encode.encode_quaternion_stamped(10**18, "palm", (0, 0, 0, 1)),
}

ENCAPSULATIONS = [b"\0\0", b"\0\1", b"\0\2", b"\0\3", b"\0\6", b"\0\7", b"\0\x0a", b"\0\x0b", b"\x80\0", b"\xff\xff"]
LENGTHS = [0, 1, 2, 3, 7, 8, 255, 4095, 4096, 4097, 2**16, 2**30, 2**31 - 1, 2**31, 2**32 - 8, 2**32 - 1]
place = st.floats(0.0, 1.0, exclude_max=True)  # share of the message
mutation = st.one_of(
    st.tuples(st.just("flip"), place, st.integers(0, 7)),
    st.tuples(st.just("byte"), place, st.integers(0, 255)),
    st.tuples(st.just("length"), place, st.sampled_from(LENGTHS)),
    st.tuples(st.just("cut"), place, st.just(0)),
    st.tuples(st.just("drop"), place, st.integers(1, 16)),
    st.tuples(st.just("insert"), place, st.integers(1, 16)),
    st.tuples(st.just("encapsulation"), place, st.integers(0, len(ENCAPSULATIONS) - 1)),
    st.tuples(st.just("swap"), place, st.just(0)),
)
mutations = st.lists(mutation, min_size=1, max_size=4)
Mutation = tuple[str, float, int]


def mutated(data: bytes, changes: list[Mutation]) -> bytes:
    """A message with some of its bytes changed."""
    message = bytearray(data)
    for what, share, number in changes:
        at = int(share * len(message))
        if what == "flip" and message:
            message[at] ^= 1 << number
        elif what == "byte" and message:
            message[at] = number
        elif what == "length":
            at &= ~3
            message[at : at + 4] = struct.pack("<I", number)
        elif what == "cut":
            del message[at:]
        elif what == "drop":
            del message[at : at + number]
        elif what == "insert":
            message[at:at] = bytes([number]) * number
        elif what == "encapsulation":
            message[0:2] = ENCAPSULATIONS[number]
        elif what == "swap":  # as big endian has them
            at &= ~3
            message[at : at + 4] = message[at : at + 4][::-1]
    return bytes(message)


@pytest.mark.parametrize("msgtype", DECODERS)
@settings(max_examples=200)
@given(changes=mutations)
def test_mutated_messages(msgtype: str, changes: list[Mutation]) -> None:
    try:
        DECODERS[msgtype](mutated(VALID[msgtype], changes))
    except CdrError as error:
        assert "\n" not in str(error)


# ---------------------------------------------------------------- through the intake into the estimators


@cache
def _sound(rig: str, scenario: str) -> list[list[tuple[str, bytes]]]:
    """Sound messages of a rig, by stamp: 0.6 s, of which the last third moves."""
    kind = SCENARIOS[rig]
    stretches = kind.stretches(kind.options(scenario=scenario, rate_hz=100.0, duration_s=3.0, seed=3))
    ticks: dict[int, list[tuple[str, bytes]]] = {}
    for stamp, topic, data in synthetic.messages(stretches):
        if not topic.startswith("ground_truth/"):
            ticks.setdefault(stamp, []).append((topic, data))
    return list(ticks.values())[240:]


class Stream:
    """One estimator behind its intake, and what it must never do."""

    def __init__(self, name: str) -> None:
        rig, scenario, file = ESTIMATED[name]
        configuration = config.load(CONFIGS / file)
        self.estimator = ESTIMATORS[name](configuration.robot, configuration.estimators.get(name), configuration.timing)
        self.intake = Intake(configuration.robot, configuration.timing)
        self.sound = _sound(rig, scenario)
        self.imus = {
            topic: decoded[1]
            for topic, data in self.sound[0]
            if topic != HALL_TOPIC
            for decoded in [cdr.decode_imu(data)]
        }
        self.topics = list(self.intake.topics)
        self.estimates = 0
        self.arrival = 0

    def take(self, topic: str, data: bytes) -> None:
        self.arrival += 100_000
        self.estimate(self.intake.handlers[topic](data, self.arrival))

    def estimate(self, frames: list[Frame]) -> None:
        for frame in frames:
            estimate = self.estimator.update(frame)
            numbers = [*estimate.position, *estimate.velocity, *estimate.variance, *self.estimator.biases().values()]
            numbers += [*(estimate.torso or ()), *(estimate.torso_orientation or ())]
            assert all(map(math.isfinite, numbers)), estimate
            assert min(estimate.variance) >= 0.0
            assert np.isfinite(self.estimator.covariance()).all()
            assert not any(map(math.isinf, self.estimator.innovations()))
            self.estimates += 1

    def tick(self, number: int, shift: int = 0) -> None:
        """The sound messages of one stamp, moved by so many ns; after the last one they begin anew, later."""
        round_, row = divmod(number, len(self.sound))
        shift += round_ * len(self.sound) * 10 * MS
        for topic, data in self.sound[row]:
            self.arrival += 1_000_000
            self.take(topic, data if topic == HALL_TOPIC else _shifted(data, shift))

    def finish(self) -> None:
        """All is accounted for."""
        self.estimate(self.intake.flush())
        for topic in self.topics:
            counts = self.intake.counts(topic)
            assert counts["messages"] == counts["used"] + sum(counts["refused"].values())


def _shifted(data: bytes, shift: int) -> bytes:
    stamp, frame_id, gyro, accel = cdr.decode_imu(data)
    return cdr_encode.ImuEncoder(frame_id).encode(stamp + shift, gyro, accel)


number = st.one_of(
    st.floats(-20.0, 20.0),
    st.floats(),
    st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e308, -1e308, 5e-324, 999.0, 9.9e4, -9.9e4, 1e-160]),
)
vector = st.tuples(number, number, number)
gap = st.one_of(
    st.integers(-20 * MS, 40 * MS),
    st.just(0),
    st.integers(-5_000 * MS, 5_000 * MS),
    st.sampled_from([-3_600_000 * MS, 3_600_000 * MS, -(2**31) * 1000 * MS, (2**31 - 2) * 1000 * MS]),
)
volts = st.lists(st.floats(width=32), max_size=12)
event = st.one_of(
    st.tuples(st.just("sound"), st.integers(1, 30), st.just(0), st.just(())),
    st.tuples(st.just("imu"), st.integers(0, 7), gap, st.tuples(vector, vector)),
    st.tuples(st.just("imu"), st.integers(0, 7), gap, st.tuples(vector, vector)),
    st.tuples(st.just("hall"), st.integers(0, 2), st.just(0), volts),
    st.tuples(st.just("mutated"), st.integers(0, 7), st.just(0), mutations),
    st.tuples(st.just("bytes"), st.integers(0, 7), st.just(0), st.binary(max_size=80)),
    st.tuples(st.just("clock"), st.just(0), gap, st.just(())),
    st.tuples(st.just("reset"), st.just(0), st.just(0), st.just(())),
)


@pytest.mark.parametrize("name", ESTIMATED)
@settings(max_examples=20)
@given(events=st.lists(event, max_size=40))
def test_arbitrary_messages_into_every_estimator(name: str, events: list[tuple]) -> None:  # type: ignore[type-arg]
    stream = Stream(name)
    shift = row = 0
    for what, which, step, content in events:
        topic = stream.topics[which % len(stream.topics)]
        newest = cdr.decode_imu(stream.sound[row % len(stream.sound)][0][1])[0] + shift
        if what == "sound":
            for _ in range(which):
                stream.tick(row, shift)
                row += 1
        elif what == "imu" and topic != HALL_TOPIC:
            stamp = min(max(newest + step, -(2**31) * 10**9), (2**31 - 1) * 10**9)
            stream.take(topic, cdr_encode.ImuEncoder(stream.imus[topic]).encode(stamp, *content))
        elif what == "hall" and HALL_TOPIC in stream.topics:
            dims = ((), (("joint", len(content)),), (("joint", 4), ("sensor", 2)))[which]
            stream.take(HALL_TOPIC, cdr_encode.encode_float32_multiarray(content, dims))
        elif what == "mutated":
            data = dict(stream.sound[row % len(stream.sound)])[topic]
            stream.take(topic, mutated(data, content))
        elif what == "bytes":
            stream.take(topic, content)
        elif what == "clock":
            bound = 10**9 * 10**9  # so that stamps keep fitting into a message
            shift = min(max(shift + step, -bound), bound)
        elif what == "reset":
            stream.estimator.reset()
    before = stream.estimates
    for tick in range(row, row + 140):  # a first stamp of just less than reset_jump ahead costs a hundred of them
        stream.tick(tick, shift)
    stream.finish()
    assert stream.estimates - before >= 30
