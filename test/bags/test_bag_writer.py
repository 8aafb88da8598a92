"""What is written, how others read it, and what is left behind when writing fails."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from rosbags.highlevel import AnyReader
from rosbags.interfaces import ConnectionExtRosbag2, QosDurability, QosReliability
from rosbags.rosbag2 import Reader

from jointest_ros.bags.cdr import FLOAT32_MULTIARRAY, IMU, JOINT_STATE
from jointest_ros.bags.cdr_encode import JointStateEncoder
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter, StorageName

Message = tuple[str, int, bytes]
MakeBag = Callable[..., Path]
Samples = Callable[..., Iterator[Message]]


def test_rosbags_reads_what_was_written(storage: StorageName, make_bag: MakeBag) -> None:
    with AnyReader([make_bag(storage, 100)]) as reader:
        gyro, voltages = [], []
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/imu/palm":
                assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time  # type: ignore[attr-defined]
                gyro.append(message.angular_velocity.x)  # type: ignore[attr-defined]
            else:
                voltages.append(message.data.tolist())  # type: ignore[attr-defined]
    assert gyro == [float(k) for k in range(0, 100, 2)]
    assert voltages == [[float(k), 0.5] for k in range(1, 100, 2)]


def test_quality_of_service_and_version(storage: StorageName, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run", storage) as bag:
        bag.add_topic("/imu/palm", IMU, "sensor")
        bag.add_topic("/joint_states", JOINT_STATE)
        bag.write("/joint_states", 1, JointStateEncoder(["a"]).encode(1, [0.0]))
        assert bag.counts == {"/imu/palm": 0, "/joint_states": 1}
    information = yaml.safe_load((tmp_path / "run/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["storage_identifier"] == storage
    in_metadata = {
        topic["topic_metadata"]["name"]: topic["topic_metadata"]["offered_qos_profiles"][0]["reliability"]
        for topic in information["topics_with_message_count"]
    }
    assert in_metadata == {"/imu/palm": "best_effort", "/joint_states": "reliable"}
    with Reader(tmp_path / "run" / information["relative_file_paths"][0]) as reader:  # and in the file itself
        for connection in reader.connections:
            assert isinstance(connection.ext, ConnectionExtRosbag2)
            (qos,) = connection.ext.offered_qos_profiles
            assert qos.reliability.name.lower() == in_metadata[connection.topic]
            assert qos.durability == QosDurability.VOLATILE
            assert qos.deadline.sec == 9223372036
            assert QosReliability.BEST_EFFORT.value == 2
            assert connection.digest.startswith("RIHS01_") or storage == "mcap"
            assert connection.msgdef.data


def test_existing_targets(storage: StorageName, make_bag: MakeBag, tmp_path: Path, samples: Samples) -> None:
    path = make_bag(storage, 10)
    with pytest.raises(BagError, match="exists already"), BagWriter(path, storage):
        pass
    with BagReader(path) as bag:
        assert bag.message_count == 10
    with BagWriter(path, storage, overwrite=True) as writer:
        writer.add_topic("/imu/palm", IMU)
        writer.write(*next(samples(1)))
    with BagReader(path) as bag:
        assert bag.message_count == 1
    assert list(tmp_path.iterdir()) == [path]


def test_only_bags_are_overwritten(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "thesis.tex").touch()
    (tmp_path / "file").touch()
    for name in ("folder", "file"):
        with pytest.raises(BagError, match="is not a bag"), BagWriter(tmp_path / name, overwrite=True):
            pass
    assert (tmp_path / "folder" / "thesis.tex").exists()


def test_an_exception_leaves_nothing_behind(storage: StorageName, tmp_path: Path, samples: Samples) -> None:
    with pytest.raises(KeyboardInterrupt), BagWriter(tmp_path / "deep" / "run", storage) as bag:
        bag.add_topic("/imu/palm", IMU)
        bag.write(*next(samples(1)))
        assert [path.name.partition(".")[0] for path in (tmp_path / "deep").iterdir()] == ["run"]
        assert not (tmp_path / "deep" / "run").exists()
        raise KeyboardInterrupt
    assert list((tmp_path / "deep").iterdir()) == []


def test_an_exception_keeps_the_bag_that_was_to_be_replaced(
    storage: StorageName, make_bag: MakeBag, tmp_path: Path
) -> None:
    path = make_bag(storage, 10)
    with pytest.raises(ZeroDivisionError), BagWriter(path, storage, overwrite=True):
        raise ZeroDivisionError
    with BagReader(path) as bag:
        assert bag.message_count == 10
    assert list(tmp_path.iterdir()) == [path]


def test_a_killed_writer_leaves_a_name_that_says_so(tmp_path: Path, samples: Samples) -> None:
    """As a kill would: the writer is never left."""
    writer = BagWriter(tmp_path / "run", "mcap").__enter__()
    writer.add_topic("/imu/palm", IMU, "sensor")
    writer.add_topic("/hall_voltages", FLOAT32_MULTIARRAY, "sensor")
    for message in samples(20_000):
        writer.write(*message)
    (partial,) = tmp_path.iterdir()
    assert partial.name.startswith("run.partial-")
    with BagReader(partial / "run") as bag, pytest.raises(BagError, match="damaged after"):
        for count, message in enumerate(bag.messages()):
            expected = next(samples(1, count))
            assert message == expected
    assert count > 10_000
    writer.__exit__(KeyboardInterrupt, None, None)


def test_places_that_cannot_be_written(storage: StorageName, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    bag = BagWriter(tmp_path / "file" / "run", storage)
    with pytest.raises(BagError, match=r"cannot be written: File exists: .*file'$"), bag:
        pass


def test_a_full_disk(storage: StorageName, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, samples: Samples) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    refused = pytest.raises(BagError, match=r"cannot be written: No space left on device$")
    with refused, BagWriter(tmp_path / "run", storage) as bag:
        bag.add_topic("/imu/palm", IMU)
        monkeypatch.setattr(bag._writer, "write", fail)
        bag.write(*next(samples(1)))
    with refused, BagWriter(tmp_path / "run", storage) as bag:
        monkeypatch.setattr(bag._writer, "close", fail)
    assert list(tmp_path.iterdir()) == []


def test_paths_that_sqlite_would_misunderstand(make_bag: MakeBag) -> None:
    with pytest.raises(BagError, match=r"must not have #, \? or % in it"):
        make_bag("sqlite3", 10, name="trial#1")
    path = make_bag("sqlite3", 10).rename(make_bag("mcap", 10, name="50%41").with_name("trial?1"))
    with pytest.raises(BagError, match=r"must not have #, \? or % in it"), BagReader(path):
        pass
    with BagReader(path.with_name("50%41")) as bag:
        assert bag.message_count == 10


def test_a_topic_that_is_declared_twice(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="topic '/imu/palm' is declared twice"), BagWriter(tmp_path / "run") as bag:
        bag.add_topic("/imu/palm", IMU)
        bag.add_topic("/imu/palm", IMU)


def test_a_negative_record_time(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="cannot be written"), BagWriter(tmp_path / "run", "mcap") as bag:
        bag.add_topic("/imu/palm", IMU)
        bag.write("/imu/palm", -1, b"")


def test_memory_does_not_grow_with_the_recording(storage: StorageName, tmp_path: Path, samples: Samples) -> None:
    with BagWriter(tmp_path / "run", storage) as bag:
        bag.add_topic("/imu/palm", IMU)
        bag.add_topic("/hall_voltages", FLOAT32_MULTIARRAY)
        tracemalloc.start()
        peaks = []
        for k, message in enumerate(samples(60_000)):
            bag.write(*message)
            if (k + 1) % 20_000 == 0:
                peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[2] < 1.1 * peaks[0] + 1e5
