"""Recordings that broke off or were damaged: what is sound comes first, then one error that says where it ends."""

from __future__ import annotations

import random
import re
import sqlite3
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from jointest_ros.bags.cdr import IMU
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.typestore import typestore
from jointest_ros.bags.writer import StorageName

Message = tuple[str, int, bytes]
MakeBag = Callable[..., Path]
Samples = Callable[..., Iterator[Message]]
DataFile = Callable[[Path], Path]


def read_until_damage(path: Path) -> tuple[list[Message], str]:
    """The messages of a damaged bag and the error at their end."""
    messages = []
    with BagReader(path) as bag, pytest.raises(BagError) as raised:
        for message in bag.messages():
            messages.append(message)
    error = str(raised.value)
    start = re.escape(f"{path}: damaged after {len(messages)} messages, ")
    assert re.match(rf"{start}\d+\.\d+ s into the bag: .+$", error)
    return messages, error


def truncate(file: Path, fraction: float) -> None:
    with file.open("rb+") as stream:
        stream.truncate(int(file.stat().st_size * fraction))


@pytest.mark.parametrize("fraction", [0.1, 0.5, 0.9, 0.999])
def test_truncated(
    storage: StorageName, fraction: float, make_bag: MakeBag, data_file: DataFile, samples: Samples
) -> None:
    path, expected = make_bag(storage, 10_000), list(samples(10_000))
    truncate(data_file(path), fraction)
    with BagReader(path) as bag:
        assert bag.damage
        assert bag.message_count == sum(bag.counts.values())
        announced, duration = bag.message_count, bag.duration_s
    messages, error = read_until_damage(path)
    assert messages == expected[: len(messages)]
    assert len(messages) == announced
    assert duration == pytest.approx((len(messages) - 1) * 0.01)
    assert f"{duration:.3f} s into the bag" in error
    # SQLite loses more: its rows are linked by pages that may lie behind the cut
    assert len(messages) > 10_000 * (fraction - (0.01 if storage == "mcap" else 0.08))


def test_selected_topics_of_a_truncated_bag(storage: StorageName, make_bag: MakeBag, data_file: DataFile) -> None:
    path = make_bag(storage, 10_000)
    truncate(data_file(path), 0.5)
    with BagReader(path) as bag, pytest.raises(BagError, match="damaged after"):
        for topic, _, _ in bag.messages(["/imu/palm"]):
            assert topic == "/imu/palm"


def test_a_killed_recorder(make_bag: MakeBag, data_file: DataFile, samples: Samples) -> None:
    """No metadata.yaml, and an MCAP file without its end."""
    path, expected = make_bag("mcap", 10_000), list(samples(10_000))
    (path / "metadata.yaml").unlink()
    truncate(data_file(path), 0.7)
    messages, error = read_until_damage(path)
    assert 6_900 < len(messages) < 7_300
    assert messages == expected[: len(messages)]
    assert "the file ends inside of a record" in error


def test_chunks_that_break_off_when_compressed(tmp_path: Path, data_file: DataFile) -> None:
    writer = Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    generator, expected = random.Random(1), []
    with writer:
        connection = writer.add_connection("/noise", IMU, typestore=typestore())
        for time in range(10_000):
            expected.append(("/noise", time, generator.randbytes(324)))
            writer.write(connection, time, expected[-1][2])
    truncate(data_file(tmp_path / "run"), 0.9)
    messages, error = read_until_damage(tmp_path / "run")
    assert messages == expected[: len(messages)]
    assert 5_000 < len(messages) < 9_000
    assert "inside of a compressed chunk" in error


def record(kind: int, content: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def mcap_without_chunks(encoding: str = "cdr") -> bytes:
    start = b"\x89MCAP0\r\n" + record(0x01, text("ros2") + text("test"))
    start += record(0x03, struct.pack("<H", 7) + text("std_msgs/msg/Bool") + text("ros2msg") + text("bool data"))
    start += record(0x04, struct.pack("<HH", 3, 7) + text("/flag") + text(encoding) + struct.pack("<I", 0))
    for time in (5, 1, 4, 2, 3):
        start += record(0x05, struct.pack("<HIQQ", 3, 0, time, time) + bytes([time]))
    return start


def test_mcap_without_chunks_and_end(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(mcap_without_chunks())
    messages, error = read_until_damage(path)
    assert messages == [("/flag", time, bytes([time])) for time in (1, 2, 3, 4, 5)]
    assert "the end of the file is missing" in error
    with BagReader(path) as bag:
        assert bag.topics == {"/flag": "std_msgs/msg/Bool"}
        assert bag.duration_s == pytest.approx(4e-9)


def test_unknown_serialisation_in_a_truncated_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(mcap_without_chunks("json"))
    with pytest.raises(BagError, match="'/flag' is serialised as 'json'"), BagReader(path):
        pass


def test_nothing_left(storage: StorageName, make_bag: MakeBag, data_file: DataFile) -> None:
    for name, size in (("a", 1), ("b", 40), ("c", 100)):
        path = make_bag(storage, 100, name=name)
        with data_file(path).open("rb+") as stream:
            stream.truncate(size)
        with pytest.raises(BagError, match=r"(damaged, no message can be read|cannot be read): \w+"), BagReader(path):
            pass


def test_damage_in_the_middle(storage: StorageName, make_bag: MakeBag, data_file: DataFile, samples: Samples) -> None:
    path, expected = make_bag(storage, 10_000), list(samples(10_000))
    with data_file(path).open("rb+") as stream:
        stream.seek(data_file(path).stat().st_size * 3 // 4 // 4096 * 4096)
        stream.write(b"\xff" * 8192)
    messages, _ = read_until_damage(path)
    assert messages == expected[: len(messages)]
    assert len(messages) > 4_000  # MCAP: all but the damaged chunk


def test_damaged_index_of_times(make_bag: MakeBag, data_file: DataFile, samples: Samples) -> None:
    """The rows can still be read in the order in which they were written."""
    path = make_bag("sqlite3", 1000)
    database = sqlite3.connect(data_file(path))
    ((root,),) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'timestamp_idx'")
    ((page_size,),) = database.execute("PRAGMA page_size")
    database.close()
    with data_file(path).open("rb+") as stream:
        stream.seek((root - 1) * page_size)
        stream.write(b"\xff" * page_size)
    messages, _ = read_until_damage(path)
    assert messages == list(samples(1000))


def test_last_file_of_a_split_recording(
    storage: StorageName, make_bag: MakeBag, data_file: DataFile, samples: Samples
) -> None:
    first, last = make_bag(storage, 1000, name="a"), make_bag(storage, 1000, 1000, name="b")
    file = data_file(last).rename(first / data_file(last).name)
    metadata = (first / "metadata.yaml").read_text()
    metadata = metadata.replace("relative_file_paths:\n", f"relative_file_paths:\n  - {file.name}\n")
    (first / "metadata.yaml").write_text(metadata)
    truncate(file, 0.7)
    messages, _ = read_until_damage(first)
    assert 1500 < len(messages) < 1800
    assert messages == list(samples(len(messages)))
    truncate(file, 0.0002)
    if storage == "mcap":  # nothing but the magic is left of it
        assert read_until_damage(first)[0] == list(samples(1000))


def test_messages_that_are_silently_passed_over(make_bag: MakeBag, data_file: DataFile, samples: Samples) -> None:
    """A message of MCAP whose record type or channel is damaged looks like one that is not asked for."""
    path, expected = make_bag("mcap", 100), list(samples(100))
    content = data_file(path).read_bytes()
    at = content.index(expected[40][2])
    data_file(path).write_bytes(content[: at - 31] + b"\x70" + content[at - 30 :])
    messages = []
    with BagReader(path) as bag, pytest.raises(BagError, match="damaged: 1 message that it should hold"):
        for message in bag.messages():
            messages.append(message)
    assert messages == expected[:40] + expected[41:]


@pytest.mark.parametrize("seed", range(60))
def test_random_damage_raises_nothing_but_bag_errors(
    storage: StorageName, seed: int, make_bag: MakeBag, data_file: DataFile
) -> None:
    path = make_bag(storage, 100)
    generator = random.Random(seed)
    content = bytearray(data_file(path).read_bytes())
    for _ in range(generator.choice([1, 10, 100])):
        content[generator.randrange(len(content))] = generator.randrange(256)
    if generator.random() < 0.3:
        del content[generator.randrange(len(content)) :]
    data_file(path).write_bytes(content)
    if generator.random() < 0.5:
        (path / "metadata.yaml").unlink()
    try:
        with BagReader(path) as bag:
            for topic, time, data in bag.messages():
                assert (type(topic), type(time), type(data)) == (str, int, bytes)
    except BagError as error:
        assert "\n" not in str(error)
