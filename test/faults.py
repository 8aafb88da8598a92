"""What can go wrong between sensors and a node, as functions on streams of messages.

A stream is a list of messages in the order in which they are published. A fault takes the simulated stream and a random
generator and gives the one that is published instead. It does its harm between BEGIN and END; what comes after END is
good data. So a fault is the same in every run, over DDS or not.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jointest_ros.bags import synthetic
from jointest_ros.bags.cdr import decode_float32_multiarray, decode_imu, decode_joint_state
from jointest_ros.bags.cdr_encode import ImuEncoder, encode_float32_multiarray
from jointest_ros.bags.ground_truth import TRUTH_JOINTS
from jointest_ros.bags.intake import HALL_TOPIC
from jointest_ros.core.frame import Vec3
from jointest_ros.sim.scenarios import SCENARIOS

Message = tuple[int, str, bytes]  # when it is published (ns), topic, CDR bytes
Stream = list[Message]
Fault = Callable[[Stream, "Rig", np.random.Generator], Stream]
Errors = dict[int, tuple[float, ...]]  # stamp -> estimate less truth of every joint, rad

S, MS = 1_000_000_000, 1_000_000  # ns
START = synthetic.FIRST_STAMP
BEGIN, END = START + 4 * S, START + 5_500 * MS
RECOVERED = END + 2 * S  # from here on the errors count
LENGTH_S = 10.5
HOUR = 3_600 * S
NAN: Vec3 = (math.nan,) * 3


@dataclass(frozen=True)
class Rig:
    """A robot with the estimators that suit it, side by side on one stream; a fault of one sensor hits `victim`."""

    source: str
    config: str
    options: dict[str, Any]
    estimators: tuple[str, ...]
    victim: str  # topic

    @property
    def path(self) -> Path:
        """Its shipped configuration."""
        return Path(__file__).resolve().parents[1] / "config" / self.config


RIGS = {
    "finger": Rig("finger", "finger.yaml", {"scenario": "PC", "zero_pose_s": 2.0}, ("pcf",), "imu/middle"),
    "exoshell": Rig("exoshell", "exoshell.yaml", {"scenario": "clipped"}, ("gyro", "hall", "kf", "kckf"), "imu/imu_3"),
    "two_link_arm": Rig(
        "two_link_arm",
        "two_link_accel.yaml",
        {"scenario": "slow_periodic"},
        ("accel_analytical", "accel_ekf", "accel_ukf"),
        "imu/b1",
    ),
}


@dataclass(frozen=True)
class Simulation:
    """What the sensors of a rig send, and the truth."""

    messages: Stream
    joints: tuple[str, ...]
    truth: dict[int, tuple[float, ...]]  # by stamp

    def error(self, stamp: int, joints: tuple[str, ...], position: tuple[float, ...]) -> tuple[float, ...]:
        """Position less truth of these joints, rad."""
        truth = dict(zip(self.joints, self.truth[stamp], strict=True))
        return tuple([angle - truth[joint] for joint, angle in zip(joints, position, strict=True)])


def simulate(rig: Rig, seed: int) -> Simulation:
    """`LENGTH_S` at 100 Hz."""
    kind = SCENARIOS[rig.source]
    options = kind.options(rate_hz=100.0, duration_s=LENGTH_S, seed=seed, **rig.options)
    messages: Stream = []
    truth: dict[int, tuple[float, ...]] = {}
    joints: tuple[str, ...] = ()
    for message in synthetic.messages(kind.stretches(options)):
        if message[1] == TRUTH_JOINTS:
            stamp, joints, position, _ = decode_joint_state(message[2])
            truth[stamp] = position
        else:
            messages.append(message)
    return Simulation(messages, joints, truth)


# ---------------------------------------------------------------- errors


def rms(errors: Errors) -> float:
    """Over all joints and stamps."""
    return math.sqrt(float(np.mean(np.square(list(errors.values())))))


def since(errors: Errors, stamp: int) -> Errors:
    """From a stamp on."""
    return {one: error for one, error in errors.items() if one >= stamp}


def changes(errors: Errors) -> Errors:
    """What comes on top of the first error: of an estimator without an absolute reference."""
    first = next(iter(errors.values()))
    return {stamp: tuple([e - f for e, f in zip(error, first, strict=True)]) for stamp, error in errors.items()}


# ---------------------------------------------------------------- faults


def _harmful(message: Message) -> bool:
    return BEGIN <= message[0] < END


def _in_order(stream: Iterable[Message]) -> Stream:
    return sorted(stream, key=lambda message: message[0])


def imu(data: bytes, shift: int = 0, gyro: Vec3 | None = None, accel: Vec3 | None = None) -> bytes:
    """An Imu message with another stamp (by `shift` ns) and other fields."""
    stamp, frame_id, old_gyro, old_accel = decode_imu(data)
    return ImuEncoder(frame_id).encode(stamp + shift, gyro or old_gyro, accel or old_accel)


def shifted(message: Message, shift: int) -> Message:
    """The same sample with another stamp; Hall messages have none."""
    time, topic, data = message
    return time, topic, data if topic == HALL_TOPIC else imu(data, shift)


def loss(share: float) -> Fault:
    """Every message is lost with this probability."""
    return lambda stream, rig, random: [m for m in stream if not (_harmful(m) and random.random() < share)]


def bursts(stream: Stream, rig: Rig, random: np.random.Generator) -> Stream:
    """All topics go silent together for 20 to 400 ms, then come for as long."""
    silent: list[tuple[int, int]] = []
    at = BEGIN
    while at < END:
        length, pause = random.integers(20 * MS, 400 * MS, 2).tolist()
        silent.append((at, min(at + length, END)))
        at += length + pause
    return [m for m in stream if not any(start <= m[0] < stop for start, stop in silent)]


def stalls(stream: Stream, rig: Rig, random: np.random.Generator) -> Stream:
    """Every topic by itself hangs three times: what it should send for 200 ms comes at once, when that is over."""
    topics = sorted({topic for _, topic, _ in stream})
    begins = {topic: BEGIN + (random.random(3) * 1.3 * S).astype(int) for topic in topics}

    def held(time: int, topic: str) -> int:
        for begin in sorted(begins[topic].tolist()):
            if begin <= time < begin + 200 * MS:
                return int(begin + 200 * MS)
        return time

    return _in_order((held(time, topic), topic, data) for time, topic, data in stream)


def overtaken(stream: Stream, rig: Rig, random: np.random.Generator) -> Stream:
    """One Imu message in five comes 200 ms late, after those that were sent later."""
    return _in_order(
        (m[0] + 200 * MS, *m[1:]) if _harmful(m) and m[1] != HALL_TOPIC and random.random() < 0.2 else m for m in stream
    )


def late_sensor(stream: Stream, rig: Rig, random: np.random.Generator) -> Stream:
    """All messages of one sensor come 200 ms late."""
    return _in_order((m[0] + 200 * MS, *m[1:]) if _harmful(m) and m[1] == rig.victim else m for m in stream)


def dead(*others: str) -> Fault:
    """One sensor, or these others, is silent and returns."""
    return lambda stream, rig, random: [m for m in stream if not (_harmful(m) and m[1] in (others or (rig.victim,)))]


def all_dead(stream: Stream, rig: Rig, random: np.random.Generator) -> Stream:
    """All is silent and returns: the driver is restarted."""
    return [m for m in stream if not _harmful(m)]


def frozen(hall: bool = False) -> Fault:
    """One sensor repeats its reading with new stamps."""

    def fault(stream: Stream, rig: Rig, random: np.random.Generator) -> Stream:
        victim = HALL_TOPIC if hall else rig.victim
        held: bytes | None = None
        result: Stream = []
        for time, topic, data in stream:
            if topic == victim and BEGIN <= time < END:
                held = held or data
                if not hall:
                    _, _, gyro, accel = decode_imu(held)
                    result.append((time, topic, imu(data, 0, gyro, accel)))
                else:
                    result.append((time, topic, held))
            else:
                result.append((time, topic, data))
        return result

    return fault


def not_numbers(stream: Stream, rig: Rig, random: np.random.Generator) -> Stream:
    """One sensor sends NaN, five times as often as it should; so does Hall."""
    result: Stream = []
    for m in stream:
        time, topic, data = m
        if _harmful(m) and topic == rig.victim:
            result += [(time, topic, imu(data, k * MS, NAN, NAN)) for k in range(5)]
        elif _harmful(m) and topic == HALL_TOPIC:
            values, dims = decode_float32_multiarray(data)
            result += [(time, topic, encode_float32_multiarray((math.nan,) * len(values), dims))]
        else:
            result.append(m)
    return result


def _garbage(data: bytes, random: np.random.Generator) -> bytes:
    """Bytes that are no message, or one of a wrong length."""
    kind = random.integers(4)
    if kind == 0:
        return data[: random.integers(len(data) - 1)]
    if kind == 1:
        return random.bytes(int(random.integers(2 * len(data))))
    if kind == 2:
        return data[:12] + struct.pack("<I", 2**32 - 1) + data[16:]
    return b"\7\7" + data[2:]


def garbage(stream: Stream, rig: Rig, random: np.random.Generator) -> Stream:
    """Beside every good message of every topic, five that are none."""
    result: Stream = []
    for m in stream:
        time, topic, data = m
        if _harmful(m):
            result += [(time, topic, _garbage(data, random)) for _ in range(5)]
            if topic == HALL_TOPIC:
                result.append((time, topic, encode_float32_multiarray((1.0,) * 7)))
        result.append(m)
    return result


def clock(jump: int) -> Fault:
    """The clock of the sensors is off by `jump` ns, and then right again."""
    return lambda stream, rig, random: [shifted(m, jump) if _harmful(m) else m for m in stream]


def sensor_clock(jump: int) -> Fault:
    """The clock of one sensor is off by `jump` ns, and then right again."""
    return lambda stream, rig, random: [shifted(m, jump) if _harmful(m) and m[1] == rig.victim else m for m in stream]


def looping(stream: Stream, rig: Rig, random: np.random.Generator) -> Stream:
    """A recording that is played to the middle and begins again, all of it."""
    length = BEGIN - START
    return [m for m in stream if m[0] < BEGIN] + [(m[0] + length, *m[1:]) for m in stream]


def twice(stream: Stream, rig: Rig, random: np.random.Generator) -> Stream:
    """Two publishers send the same messages, one of them 3 ms later."""
    return _in_order([*stream, *((m[0] + 3 * MS, *m[1:]) for m in stream if _harmful(m))])


def old_bag(stream: Stream, rig: Rig, random: np.random.Generator) -> Stream:
    """Beside the hardware an old recording is played: other stamps, other movements."""
    old = [(m[0] + S + 4 * MS, *shifted(m, -24 * HOUR)[1:]) for m in stream if BEGIN <= m[0] + S < END]
    return _in_order([*stream, *old])


def intruder(stream: Stream, rig: Rig, random: np.random.Generator) -> Stream:
    """Another driver sends on the topics of the robot what it measured a second ago, with stamps in between."""
    strange: Stream = []
    for time, topic, data in stream:
        if BEGIN <= time + S < END:
            strange.append((time + S + 5 * MS, topic, data if topic == HALL_TOPIC else imu(data, S + 5 * MS)))
    return _in_order([*stream, *strange])


FAULTS: dict[str, Fault] = {
    "5 % lost": loss(0.05),
    "50 % lost": loss(0.5),
    "bursts of loss": bursts,
    "topics hang for 200 ms": stalls,
    "200 ms late, overtaken": overtaken,
    "one sensor 200 ms late": late_sensor,
    "a sensor dies": dead(),
    "Hall dies": dead(HALL_TOPIC),
    "all die": all_dead,
    "a sensor freezes": frozen(),
    "Hall freezes": frozen(hall=True),
    "NaN": not_numbers,
    "garbage": garbage,
    "clock + 1 h": clock(HOUR),
    "clock - 1 h": clock(-HOUR),
    "a sensor's clock + 1 h": sensor_clock(HOUR),
    "a sensor's clock - 1 h": sensor_clock(-HOUR),
    "looping bag": looping,
    "two publishers": twice,
    "an old bag beside the hardware": old_bag,
    "two robots on the same topics": intruder,
}
