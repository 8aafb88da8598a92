"""Streams of an arm's messages, and the comparison of the two ways from messages to frames: to the last bit."""

from __future__ import annotations

import dataclasses
import random
from functools import cache
from typing import Any

from jointest_ros.bags.array_intake import ArrayIntake, Stretch
from jointest_ros.bags.cdr import Dims
from jointest_ros.bags.cdr_encode import ImuEncoder, encode_float32_multiarray
from jointest_ros.bags.intake import HALL_TOPIC, Intake
from jointest_ros.core.frame import Frame, Recording
from jointest_ros.core.hall_sensor import HallSensor
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.timing import Timing

CHUNK = 64  # frames, instead of so many that these recordings would be one block
BEGIN, PERIOD = 100_000_000_000, 10_000_000  # ns
ARM = Robot(
    ("upper", "lower"),
    (Joint("elbow", "upper", "lower", ((1.0, 0.0, 0.0),)),),
    (Sensor("upper", "upper"), Sensor("lower", "lower")),
    hall=(HallSensor("elbow"), HallSensor("elbow", mirrored=True)),
)
LOWER, HALL = "imu/lower", HALL_TOPIC
SENSORS = ARM.sensors
MATRIX = ((1.01, 0.002, -0.003), (0.0, 0.98, 0.004), (0.001, 0.0, 1.02))
CALIBRATED = dataclasses.replace(
    ARM,
    sensors=(
        dataclasses.replace(SENSORS[0], accel_matrix=MATRIX, accel_offset=(0.1, -0.2, 0.3), accel_range=160.0),
        dataclasses.replace(SENSORS[1], gyro_scale=(1.01, 0.99, 1.003), delay=0.003),
    ),
)
ACCEL_ONLY = dataclasses.replace(ARM, sensors=(SENSORS[0], dataclasses.replace(SENSORS[1], gyro=False)))

Message = tuple[str, int, bytes]  # topic, record time ns, bytes


def state(intake: Intake) -> dict[str, Any]:
    """All that the intake would go on with, and all that it tells, in plain types."""
    assembler = dict(vars(intake.assembler))
    quality, hall = dict(vars(assembler.pop("quality"))), dict(vars(assembler.pop("hall")))
    frozen = dict(vars(quality.pop("_frozen")))
    frames = [(frame.stamp, frame.gyro, frame.accel) for frame in quality.pop("_frames")]
    pace = dict(vars(assembler.pop("pace")))
    counts = {topic: intake.counts(topic) for topic in intake.topics}
    sources = assembler.pop("sources")
    mixtures = {name: source.mixture and vars(source.mixture) for name, source in sources.items()}
    counts |= {name: dataclasses.replace(source, mixture=None) for name, source in sources.items()}
    others = {"frames of a window": frames, "counts": counts, "mixtures": mixtures}
    return assembler | pace | quality | hall | frozen | others


def assert_same(one: Recording, other: Recording) -> None:
    """To the bit, types and order of the sensors included."""
    for field in dataclasses.fields(Recording):
        a, b = getattr(one, field.name), getattr(other, field.name)
        pairs = zip(a.items(), b.items(), strict=True) if isinstance(a, dict) else [((field.name, a), (field.name, b))]
        for (name, table), (name_too, table_too) in pairs:
            assert name == name_too
            assert (table is None) == (table_too is None), field.name
            if table is not None:
                assert (table.dtype, table.shape) == (table_too.dtype, table_too.shape), field.name
                assert table.tobytes() == table_too.tobytes(), (field.name, name)


def _as_recording(stretch: Stretch) -> Recording:
    return stretch if isinstance(stretch, Recording) else Recording.from_frames(stretch)


def compare(robot: Robot, timing: Timing, messages: list[Message]) -> tuple[Intake, Recording]:
    """Frames and state of both ways, from messages without a file."""
    intake = Intake(robot, timing)
    frames: list[Frame] = []
    for topic, time, data in messages:
        frames += intake.handlers[topic](data, time)
    frames += intake.flush()
    by_arrays = Intake(robot, timing)
    arrays = ArrayIntake(by_arrays, {topic: topic for topic in intake.topics})
    parts: list[Recording] = []
    waiting: list[Message] = []
    step = CHUNK * len(intake.topics)
    for start in range(0, len(messages), step):
        more, waiting = arrays.add(waiting + messages[start : start + step])
        parts += map(_as_recording, more)
    parts += map(_as_recording, arrays.finish(waiting))
    recording = Recording.concatenate(parts or [Recording.from_frames([])])
    assert_same(Recording.concatenate([Recording.from_frames(frames)]), recording)
    assert state(intake) == state(by_arrays)
    return by_arrays, recording


def stream(count: int = 600, **options: Any) -> list[Message]:
    """So many frames of ARM at 100 Hz."""
    return [*_stream(count, **options)]


@cache
def _stream(count: int, hall_last: bool = True, jitter: int = 0, late: int = 0, dims: Dims = ()) -> tuple[Message, ...]:
    """With `jitter` of the stamps, and each message of a frame arriving `late` after the one before, ns."""
    rng, messages = random.Random(1), list[Message]()
    for k in range(count):
        begin = BEGIN + k * PERIOD
        frame: list[tuple[str, bytes]] = []
        for name in ("upper", "lower"):
            gyro, accel = (tuple(rng.gauss(mean, 0.3) for mean in means) for means in ((0, 0, 1), (0, 0, 9.81)))
            stamp = begin + rng.randint(-jitter, jitter)
            frame.append((f"imu/{name}", ImuEncoder(name).encode(stamp, gyro, accel)))  # type: ignore[arg-type]
        hall = (HALL, encode_float32_multiarray((rng.gauss(2.0, 0.3), rng.gauss(2.0, 0.3)), dims))
        frame = [*frame, hall] if hall_last else [hall, *frame]
        messages += [(topic, begin + number * late, data) for number, (topic, data) in enumerate(frame)]
    return tuple(messages)
