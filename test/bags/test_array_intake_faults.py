"""Streams with faults read as arrays: the same frames, counters and state as message by message, to the last bit."""

from __future__ import annotations

import random
from typing import Any

import pytest
from arm_streams import ARM, BEGIN, CALIBRATED, HALL, LOWER, PERIOD, Message, compare, stream

from jointest_ros.bags.cdr import IMU
from jointest_ros.bags.cdr_encode import ImuEncoder, encode_float32_multiarray
from jointest_ros.bags.typestore import typestore
from jointest_ros.core.robot import Robot
from jointest_ros.core.timing import Timing

AT = 1000  # place of the odd message in the stream: of the lower IMU, in frame 333


def imu(
    k: int, stamp: int = 0, gyro: Any = (0.1, 0.2, 0.3), accel: Any = (0.0, 0.0, 9.81), name: str = "lower"
) -> bytes:
    return ImuEncoder(name).encode(BEGIN + k * PERIOD + stamp, gyro, accel)


def replaced(data: bytes, count: int = 1) -> list[Message]:
    messages = stream()
    for k in range(AT, AT + 3 * count, 3):
        messages[k] = (LOWER, messages[k][1], data)
    return messages


def hall_replaced(data: bytes) -> list[Message]:
    messages = stream()
    messages[AT + 1] = (HALL, messages[AT + 1][1], data)
    return messages


def without(*places: int) -> list[Message]:
    return [message for k, message in enumerate(stream()) if k not in places]


def shifted(start: int, by: int, stop: int = 1 << 30, arrival: bool = False) -> list[Message]:
    """The stamps of all IMU messages in frames `start` to `stop` are later; or their times of arrival."""
    messages = []
    for k, (topic, time, data) in enumerate(stream()):
        inside = start <= k // 3 < stop
        if inside and arrival:
            time += by
        elif inside and topic != HALL:
            stamp = time + by
            data = data[:4] + (stamp // 10**9).to_bytes(4, "little") + (stamp % 10**9).to_bytes(4, "little") + data[12:]
        messages.append((topic, time, data))
    return messages


def big_endian() -> list[Message]:
    messages = stream()
    for k in range(AT, AT + 60, 3):
        topic, time, data = messages[k]
        message = typestore().deserialize_cdr(data, IMU)
        messages[k] = (topic, time, bytes(typestore().serialize_cdr(message, IMU, little_endian=False)))
    return messages


def twice() -> list[Message]:
    """For a second, somebody else sends on the topic of the lower IMU as well."""
    others = [
        (LOWER, BEGIN + k * PERIOD + PERIOD // 2, imu(k, PERIOD // 2, gyro=(3.0, 2.0, 1.0))) for k in range(250, 350)
    ]
    return sorted([*stream(), *others], key=lambda message: message[1])


NAN = float("nan")
UNSOUND = {
    "not finite gyro": replaced(imu(333, gyro=(NAN, 0.0, 0.0))),
    "not finite accel": replaced(imu(333, accel=(0.0, float("inf"), 0.0))),
    "implausible gyro": replaced(imu(333, gyro=(2000.0, 0.0, 0.0))),
    "saturated accel": replaced(imu(333, accel=(0.0, 0.0, 159.9))),
    "repeated stamp": replaced(imu(332)),
    "older stamp": replaced(imu(320)),
    "stamp within tolerance of the one before": replaced(imu(332, stamp=PERIOD // 4)),
    "far stamp": replaced(imu(333, stamp=10**10)),
    "stamp far back": replaced(imu(0, stamp=-(10**9))),
    "unknown frame id": replaced(imu(333, name="other")),
    "unknown frame id throughout": replaced(imu(333, name="other"), 80),
    "of another length": replaced(imu(333) + bytes(8)),
    "truncated": replaced(imu(333)[:-8]),
    "empty": replaced(b""),
    "nanoseconds over a second": replaced(imu(333)[:8] + b"\xff\xff\xff\xff" + imu(333)[12:]),
    "big endian": big_endian(),
    "frozen while it turns": [
        (topic, time, imu((time - BEGIN) // PERIOD, gyro=(0.5, 0.0, 0.0)) if topic == LOWER and k > AT else data)
        for k, (topic, time, data) in enumerate(stream())
    ],
    "at rest with equal readings": [
        (topic, time, imu((time - BEGIN) // PERIOD, gyro=(0.0, 0.0, 0.0)) if topic == LOWER and k > AT else data)
        for k, (topic, time, data) in enumerate(stream())
    ],
    "Hall not finite": hall_replaced(encode_float32_multiarray((float("inf"), 0.0))),
    "Hall without a reading": hall_replaced(encode_float32_multiarray((NAN, 1.0))),
    "Hall implausible": hall_replaced(encode_float32_multiarray((1e6, 0.0))),
    "Hall of another length": hall_replaced(encode_float32_multiarray((1.0, 1.0, 1.0))),
    "Hall of a wrong layout": hall_replaced(encode_float32_multiarray((1.0, 1.0), (("sensor", 2), ("joint", 1)))),
    "Hall of another layout": hall_replaced(encode_float32_multiarray((1.0, 1.0), (("joint", 1), ("sensor", 2)))),
    "Hall truncated": hall_replaced(encode_float32_multiarray((1.0, 1.0))[:-2]),
    "Hall missing": without(AT + 1),
    "Hall missing for a while": without(*range(AT + 1, AT + 300, 3)),
    "Hall twice": sorted([*stream(), stream()[AT + 1]], key=lambda message: message[1]),
    "Hall late": sorted(
        [(t, time + 12_000_000 * (k == AT + 1), d) for k, (t, time, d) in enumerate(stream())], key=lambda m: m[1]
    ),
    "IMU missing": without(AT),
    "IMU missing for a while": without(*range(AT, AT + 300, 3)),
    "IMU gone": without(*range(AT, 1800, 3)),
    "IMU that comes late": without(*range(1, AT, 3)),
    "frame missing": without(*range(AT - 1, AT + 2)),
    "gap": without(*range(AT - 1, AT + 29)),
    "long gap": without(*range(AT - 1, AT + 89)),
    "jump forward": shifted(300, 5 * 10**9),
    "jump back": shifted(300, -5 * 10**9),
    "jump forward and back": shifted(300, 5 * 10**9, 400),
    "small step back": shifted(300, -15_000_000),
    "clock of the host set back": shifted(300, -(10**10), arrival=True),
    "arrivals out of order": shifted(300, -25_000_000, 310, arrival=True),
    "one sensor slower": [m for k, m in enumerate(stream()) if m[0] != LOWER or k % 2],
    "two publishers": twice(),
    "stops within a frame": stream()[:-2],
    "too short": stream()[:40],
    "nothing": [],
}


@pytest.mark.parametrize("name", UNSOUND)
@pytest.mark.parametrize("robot", [ARM, CALIBRATED], ids=["", "calibrated"])
def test_a_stream_with_a_fault(robot: Robot, name: str) -> None:
    compare(robot, Timing(), UNSOUND[name])


@pytest.mark.parametrize(
    "timing",
    [
        Timing(hall_per_frame=False),
        Timing(sync_tolerance=0.001),
        Timing(max_wait=0.0005),
        Timing(max_gap=0.005),
        Timing(reset_jump=0.01),
    ],
    ids=str,
)
def test_other_timings(timing: Timing) -> None:
    compare(ARM, timing, stream(jitter=2_000_000, late=600_000))
    compare(ARM, timing, stream(hall_last=False))
    compare(CALIBRATED, timing, UNSOUND["gap"])


def test_damage_at_random() -> None:
    """Whatever happens to the bytes, to the order and to the times: both ways make the same of it."""
    for seed in range(100):
        rng, messages = random.Random(seed), stream(300, jitter=(0, 1_000_000, 4_000_000)[seed % 3])
        for _ in range(rng.randint(1, 6)):
            k = rng.randrange(150, len(messages) - 3)
            topic, time, data = messages[k]
            match rng.randrange(6):
                case 0:
                    del messages[k]
                case 1:
                    messages.insert(rng.randrange(150, len(messages)), messages[k])
                case 2:
                    place = rng.randrange(len(data))
                    messages[k] = (topic, time, data[:place] + bytes([rng.randrange(256)]) + data[place + 1 :])
                case 3:
                    messages[k] = (topic, time + rng.randint(-(10**7), 10**7), data)
                case 4:
                    messages[k], messages[k + 1] = messages[k + 1], messages[k]
                case _:
                    messages[k] = (topic, time, data[: rng.randrange(len(data))])
        compare(ARM, Timing(), messages)
