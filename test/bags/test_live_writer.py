"""Recordings that are written while they happen: what is in them at any moment, and where the disk is full."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from rosbags.highlevel import AnyReader
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader

from jointest_ros.bags.cdr import FLOAT32_MULTIARRAY, IMU
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.live_writer import LiveWriter
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter

Message = tuple[str, int, bytes]
Samples = Callable[..., Iterator[Message]]

CHUNK = 500  # messages between two flushes


def begin(path: Path) -> LiveWriter:
    """A writer with the topics of `samples`."""
    writer = LiveWriter(path)
    writer.add_topic("/imu/palm", IMU, best_effort=True)
    writer.add_topic("/hall_voltages", FLOAT32_MULTIARRAY, best_effort=False)
    return writer


def fill(writer: LiveWriter, messages: list[Message]) -> None:
    for number, message in enumerate(messages, 1):
        writer.write(*message)
        if number % CHUNK == 0:
            writer.flush()


def read(path: Path) -> tuple[list[Message], str]:
    """The messages that can be read, and why not more."""
    messages = []
    with BagReader(path) as bag:
        try:
            messages.extend(bag.messages())
        except BagError:
            assert bag.damage
        return messages, bag.damage


def test_what_was_written_is_read(tmp_path: Path, samples: Samples) -> None:
    expected = list(samples(1234))
    writer = begin(tmp_path / "run")
    fill(writer, expected)
    writer.flush()
    writer.close()
    assert writer.counts == {"/imu/palm": 617, "/hall_voltages": 617}
    assert writer.size == (tmp_path / "run" / "run.mcap").stat().st_size
    assert read(tmp_path / "run") == (expected, "")
    with AnyReader([tmp_path / "run"]) as reader:
        numbers = [
            (connection.topic, time, reader.deserialize(data, connection.msgtype))
            for connection, time, data in reader.messages()
        ]
    assert [(topic, time) for topic, time, _ in numbers] == [(topic, time) for topic, time, _ in expected]


def test_messages_of_some_topics_and_times_are_found_by_the_index(tmp_path: Path, samples: Samples) -> None:
    expected = list(samples(3000))
    writer = begin(tmp_path / "run")
    fill(writer, expected)
    writer.close()
    start, stop = expected[700][1], expected[2100][1]
    with Reader(tmp_path / "run" / "run.mcap") as reader:
        (imu,) = [connection for connection in reader.connections if connection.topic == "/imu/palm"]
        found = [(time, bytes(data)) for _, time, data in reader.messages([imu], start=start, stop=stop)]
    wanted = [(time, data) for topic, time, data in expected if topic == "/imu/palm" and start <= time < stop]
    assert found == wanted


def test_the_metadata_are_those_of_the_other_writer(tmp_path: Path, samples: Samples) -> None:
    """Which ROS 2 Jazzy plays: version, qualities of service, hashes of types, counts and times."""
    expected = list(samples(100))
    writer = begin(tmp_path / "run")
    fill(writer, expected)
    writer.flush()
    writer.close()
    with BagWriter(tmp_path / "other" / "run") as other:
        other.add_topic("/imu/palm", IMU, "sensor")
        other.add_topic("/hall_voltages", FLOAT32_MULTIARRAY, "reliable")
        for message in expected:
            other.write(*message)
    ours, theirs = (
        yaml.safe_load((folder / "run" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        for folder in (tmp_path, tmp_path / "other")
    )
    assert (ours.pop("ros_distro"), theirs.pop("ros_distro")) == ("jazzy", "rosbags")
    assert ours == theirs

    def described(folder: Path) -> list[Any]:
        with Reader(folder / "run" / "run.mcap") as reader:
            return [
                (c.topic, c.msgtype, c.msgdef, c.msgcount, c.ext.offered_qos_profiles)
                for c in reader.connections
                if isinstance(c.ext, ConnectionExtRosbag2)
            ]

    assert described(tmp_path) == described(tmp_path / "other")


def test_a_topic_that_comes_later(tmp_path: Path, samples: Samples) -> None:
    expected = list(samples(1000))
    writer = begin(tmp_path / "run")
    fill(writer, expected)
    writer.add_topic("/imu/tip", IMU, best_effort=True)
    later = [("/imu/tip", time + 10**12, data) for topic, time, data in expected if topic == "/imu/palm"]
    fill(writer, later)
    assert read(tmp_path / "run")[0] == expected + later
    writer.close()
    assert read(tmp_path / "run") == (expected + later, "")


def test_after_a_kill_all_that_was_flushed_is_there(tmp_path: Path, samples: Samples) -> None:
    expected = list(samples(1234))
    writer = begin(tmp_path / "run")
    fill(writer, expected)
    messages, damage = read(tmp_path / "run")  # no more of it is on the disk
    assert messages == expected[: 2 * CHUNK]
    assert "end of the file is missing" in damage
    writer.discard()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["file", "folder", "below a file"])
def test_targets_that_are_there(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "run"
    if kind == "folder":
        path.mkdir()
    else:
        path.touch()
    target, reason = (path / "bag", "cannot be written") if kind == "below a file" else (path, "exists already")
    with pytest.raises(BagError, match=reason):
        LiveWriter(target)
    assert path.exists()


def test_a_type_that_is_not_known(tmp_path: Path) -> None:
    writer = begin(tmp_path / "run")
    with pytest.raises(BagError, match="/x: its type my_msgs/msg/X is not one of ROS 2 Jazzy"):
        writer.add_topic("/x", "my_msgs/msg/X", best_effort=False)
    writer.discard()


# ------------------------------------------------------------------ a full disk


class FullDisk:
    """A file for which there is so much room, and no more; what it is cut by can be written again."""

    def __init__(self, file: Any, room: int) -> None:
        self._file, self._room = file, room

    def write(self, data: memoryview) -> int:
        left = self._room - self._file.tell()
        if not left:
            raise OSError(errno.ENOSPC, "No space left on device")
        return int(self._file.write(data[:left]))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def test_wherever_the_disk_is_full_what_fits_is_a_sound_recording(tmp_path: Path, samples: Samples) -> None:
    expected = list(samples(8 * CHUNK))
    writer = begin(tmp_path / "whole")
    least = writer.size
    fill(writer, expected)
    data = writer.size
    writer.close()
    kept = []
    for number, room in enumerate(range(least, writer.size, (writer.size - least) // 40)):
        path = tmp_path / str(number)
        limited = begin(path)
        limited._file = FullDisk(limited._file, room)  # type: ignore[assignment]
        if room < data:
            with pytest.raises(BagError, match=f"{number}: cannot be written: No space left on device"):
                fill(limited, expected)
        else:
            fill(limited, expected)
        try:
            limited.close()
        except BagError as error:
            assert not kept  # no room for an empty recording: it was only the header
            assert "No space left" in str(error)
            continue
        if not sum(limited.counts.values()):
            continue
        messages, damage = read(path)
        assert damage == ""
        assert messages == expected[: len(messages)]
        assert sum(limited.counts.values()) == len(messages)
        assert (path / f"{number}.mcap").stat().st_size <= room
        kept.append(len(messages))
    assert kept == sorted(kept)
    assert kept[-1] >= 6 * CHUNK  # all but what the index takes
    assert len(kept) > 25


def test_no_room_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is left behind that would keep the next try from this name."""

    def fail(writer: LiveWriter, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full, pytest.raises(BagError, match="cannot be written: No space left on device"):
        full.setattr(LiveWriter, "_write", fail)
        LiveWriter(tmp_path / "run")
    assert list(tmp_path.iterdir()) == []
    LiveWriter(tmp_path / "run").close()


def test_no_room_for_metadata(tmp_path: Path, samples: Samples, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file of metadata needs room too: the last chunk makes it."""
    expected = list(samples(4 * CHUNK))
    writer = begin(tmp_path / "run")
    fill(writer, expected)
    original, attempts = Path.write_text, []

    def fail_once(path: Path, *arguments: Any, **options: Any) -> int:
        attempts.append(path)
        if len(attempts) == 1:
            raise OSError(errno.ENOSPC, "No space left on device")
        return original(path, *arguments, **options)

    monkeypatch.setattr(Path, "write_text", fail_once)
    writer.close()
    assert read(tmp_path / "run") == (expected[: 3 * CHUNK], "")
