"""Recordings read as arrays against the same recordings message by message: nothing may differ, to the last bit."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_streams import (
    ACCEL_ONLY,
    ARM,
    CALIBRATED,
    CHUNK,
    HALL,
    PERIOD,
    Message,
    assert_same,
    compare,
    state,
    stream,
)

from jointest_ros import config
from jointest_ros.bags import array_intake, offline, synthetic
from jointest_ros.bags.cdr_encode import ImuEncoder
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter, StorageName
from jointest_ros.core.frame import Frame, Recording
from jointest_ros.core.robot import Robot, Sensor
from jointest_ros.core.timing import Timing
from jointest_ros.sim import exoshell, finger

PROJECT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(offline, "_CHUNK", CHUNK)


@pytest.fixture
def blocks(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Frames of each block that was taken as one."""
    taken: list[int] = []
    add = array_intake.add_block

    def counted(*arguments: Any) -> Recording | None:
        recording = add(*arguments)
        if recording is not None:
            taken.append(len(recording))
        return recording

    monkeypatch.setattr(array_intake, "add_block", counted)
    return taken


def compare_bags(bag: Path, robot: Robot, timing: Timing, namespace: str = "") -> tuple[offline.Outcome, Recording]:
    """The same from a file: as arrays, as frames, and message by message."""
    one, two, three = (Intake(robot, timing) for _ in range(3))
    expected, damage = [], ""
    with BagReader(bag) as reader:
        found, _ = offline.check_topics(reader, one, namespace)
        try:
            for topic, time, data in reader.messages(tuple(found)):
                expected += one.handlers[found[topic]](data, time)
        except BagError as error:
            damage = str(error)
        expected += one.flush()
    with BagReader(bag) as reader:
        recording, outcome = offline.read_recording(reader, two, namespace)
    frames: list[Frame] = []
    with BagReader(bag) as reader:
        same = offline.read_frames(reader, three, frames.extend, namespace)
    assert frames == expected
    assert_same(Recording.from_frames(expected), recording)
    assert state(one) == state(two) == state(three)
    assert one.warnings() == two.warnings() == three.warnings()
    assert outcome.damage == same.damage == damage
    assert outcome.frames == same.frames == len(expected)
    assert outcome.inputs == same.inputs == {topic: one.counts(name) for topic, name in found.items()}
    return outcome, recording


# -------------------------------------------------------------------- recordings


@pytest.mark.parametrize("name", ["exoshell", "finger", "two_link_accel", "softhand_gripper"])
def test_the_recordings_of_the_package(name: str) -> None:
    configuration = config.load(PROJECT / "config" / f"{name}.yaml")
    outcome, _ = compare_bags(PROJECT / "bags" / name, configuration.robot, configuration.timing)
    assert outcome.frames > 100


@pytest.mark.parametrize("rate", [100.0, 1000.0])
def test_simulated_recordings(rate: float, tmp_path: Path, storage: StorageName, blocks: list[int]) -> None:
    options = exoshell.ExoshellOptions(rate_hz=rate, duration_s=500.0 / rate)
    robot = exoshell.exoshell(options.scenario)
    with BagWriter(tmp_path / "run", storage) as writer:
        synthetic.write(writer, robot, exoshell.stretches(options))
    outcome, recording = compare_bags(tmp_path / "run", robot, Timing())
    assert sum(blocks) > 0.8 * outcome.frames
    assert recording.hall is not None
    assert np.isfinite(recording.hall).all()


def test_a_recording_in_a_namespace_and_without_one_of_its_topics(tmp_path: Path, blocks: list[int]) -> None:
    simulated = finger.simulate("PC", rate_hz=100.0, duration_s=3.0, seed=2)
    messages = [(f"/left/{topic}", stamp, data) for stamp, topic, data in synthetic.messages([simulated])]
    lacking = next(f"/left/{sensor.topic}" for sensor in simulated.robot.sensors)
    for name, kept in (("all", messages), ("some", [m for m in messages if m[0] != lacking])):
        with BagWriter(tmp_path / name, "mcap") as writer:
            for topic, msgtype in synthetic.topics(simulated.robot).items():
                if f"/left/{topic}" in {message[0] for message in kept}:
                    writer.add_topic(f"/left/{topic}", msgtype)
            for message in kept:
                writer.write(*message)
        compare_bags(tmp_path / name, simulated.robot, Timing(), "left")
    assert blocks  # of the first one


def test_a_recording_that_is_damaged(make_bag: Callable[..., Path], data_file: Callable[[Path], Path]) -> None:
    bag = make_bag("mcap", 4000)
    file = data_file(bag)
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    palm = Robot(("palm",), (), (Sensor("palm", "palm"),))
    outcome, _ = compare_bags(bag, palm, Timing())
    assert outcome.damage
    with BagReader(bag) as reader, pytest.raises(BagError, match="no matching topic"):
        offline.read_recording(reader, Intake(palm, Timing()), "elsewhere")


# -------------------------------------------------------------------- streams


@pytest.mark.parametrize("robot", [ARM, CALIBRATED, ACCEL_ONLY])
@pytest.mark.parametrize(
    "messages",
    [
        stream(),
        stream(hall_last=False),
        stream(jitter=500_000, late=300_000),
        stream(dims=(("joint", 1), ("sensor", 2))),
    ],
    ids=["plain", "Hall first", "jitter", "layout"],
)
def test_sound_streams_are_taken_as_blocks(robot: Robot, messages: list[Message], blocks: list[int]) -> None:
    compare(robot, Timing(), messages)
    assert sum(blocks) > 400


def test_what_another_robot_sent_before_changes_nothing(blocks: list[int]) -> None:
    """Its messages have the same length, and other names: what a decoder remembers must not hold up this one."""
    for label in ("spring", "sensor", "string"):
        blocks.clear()
        compare(ARM, Timing(), stream(dims=(("joint", 1), (label, 2))))
        assert sum(blocks) > 400, label


def test_the_order_within_a_frame_may_change(blocks: list[int]) -> None:
    rng, messages = random.Random(3), stream()
    shuffled: list[Message] = []
    for k in range(0, len(messages), 3):
        shuffled += rng.sample(messages[k : k + 3], 3)
    compare(ARM, Timing(), shuffled)
    assert sum(blocks) > 400


def test_a_reading_that_a_driver_repeats(blocks: list[int]) -> None:
    """It sends at 1 kHz what the sensor measures at 100 Hz."""
    messages = [
        (topic, number, ImuEncoder("palm").encode(number, (0.5, k * 1e-3, 0.0), (0.0, 0.0, 9.81)))
        for k in range(60)
        for topic, number in (("imu/palm", 1_000_000_000 + k * PERIOD + j * 1_000_000) for j in range(10))
    ]
    compare(Robot(("palm",), (), (Sensor("palm", "palm"),)), Timing(), messages)
    assert sum(blocks) > 400


def test_other_rates_change_the_period(blocks: list[int]) -> None:
    """The period is found anew within blocks; at a tenth of the rate sensors seem silent, until that is noticed."""
    messages = stream(300)
    for factor in (1.2, 3.0, 10.0):
        slower = [(topic, round(time * factor), data) for topic, time, data in stream(300)]
        begin = messages[-1][1] + 50_000_000 - slower[0][1]
        for topic, time, data in slower:
            stamp = time + begin
            if topic != HALL:
                data = (
                    data[:4]
                    + (stamp // 10**9).to_bytes(4, "little")
                    + (stamp % 10**9).to_bytes(4, "little")
                    + data[12:]
                )
            messages.append((topic, stamp, data))
    _, recording = compare(ARM, Timing(), messages)
    assert recording.period is not None
    assert len(set(recording.period.tolist())) > 3
    assert sum(blocks) > 600


def test_sensors_that_share_a_topic_and_magnetometers_go_one_by_one(blocks: list[int]) -> None:
    shared = dataclasses.replace(
        ARM, sensors=tuple(dataclasses.replace(sensor, topic="imus", frame_id=sensor.name) for sensor in ARM.sensors)
    )
    messages = [("imus" if topic != HALL else topic, time, data) for topic, time, data in stream(200)]
    _, recording = compare(shared, Timing(), messages)
    assert len(recording) == 200
    assert not blocks
