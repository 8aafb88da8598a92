"""Sound recordings of every layout, and what is said of those that are none."""

from __future__ import annotations

import os
import shutil
import sqlite3
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from jointest_ros.bags.cdr import FLOAT32_MULTIARRAY, IMU, decode_imu
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.typestore import typestore
from jointest_ros.bags.writer import BagWriter, StorageName

Message = tuple[str, int, bytes]
MakeBag = Callable[..., Path]
Samples = Callable[..., Iterator[Message]]


def read(path: Path, topics: list[str] | None = None) -> list[Message]:
    with BagReader(path) as bag:
        return list(bag.messages(topics))


def refusal(path: Path) -> str:
    """What entering the bag raises: one line that names the path."""
    with pytest.raises(BagError) as raised, BagReader(path):
        pass
    assert "\n" not in str(raised.value)
    assert str(path) in str(raised.value)
    return str(raised.value)


def edit_metadata(bag: Path, change: Callable[[dict[str, Any]], object]) -> None:
    file = bag / "metadata.yaml"
    content = yaml.safe_load(file.read_text())
    change(content["rosbag2_bagfile_information"])
    file.write_text(yaml.safe_dump(content))


def joined(bags: list[Path]) -> Path:
    """The files of all bags in the first, as a recorder splits a long recording."""
    for bag in bags[1:]:
        for file in bag.iterdir():
            if file.name != "metadata.yaml":
                shutil.move(file, bags[0] / file.name)
    files = sorted(file.name for file in bags[0].iterdir() if file.name != "metadata.yaml")
    edit_metadata(bags[0], lambda information: information.update(relative_file_paths=files))
    return bags[0]


def test_directory(storage: StorageName, make_bag: MakeBag, samples: Samples) -> None:
    with BagReader(make_bag(storage)) as bag:
        assert bag.topics == {"/hall_voltages": FLOAT32_MULTIARRAY, "/imu/palm": IMU}
        assert bag.counts == {"/hall_voltages": 500, "/imu/palm": 500}
        assert bag.message_count == 1000
        assert bag.start_ns == 1_000_000_000
        assert bag.duration_s == pytest.approx(9.99)
        assert bag.damage == ""
        assert list(bag.messages()) == list(samples(1000))
        assert list(bag.messages()) == list(samples(1000)), "a second time"


def test_bare_file_and_directory_without_metadata(
    storage: StorageName, make_bag: MakeBag, data_file: Callable[[Path], Path], samples: Samples
) -> None:
    path = make_bag(storage, 100)
    assert read(data_file(path)) == list(samples(100))
    (path / "metadata.yaml").unlink()
    (path / "notes.txt").touch()
    assert read(path) == list(samples(100))


def test_selected_topics(storage: StorageName, make_bag: MakeBag, samples: Samples) -> None:
    path = make_bag(storage, 100)
    assert read(path, ["/imu/palm"]) == [message for message in samples(100) if message[0] == "/imu/palm"]
    assert read(path, []) == []
    with BagReader(path) as bag, pytest.raises(BagError, match="topic '/imu/plam' is not in the bag"):
        bag.messages(["/imu/plam"])


def test_messages_come_in_order_of_record_time(storage: StorageName, tmp_path: Path, samples: Samples) -> None:
    messages = list(samples(9000))
    shuffled = messages[6000:] + messages[:3000] + messages[5999:2999:-1]  # over several chunks of MCAP
    with BagWriter(tmp_path / "run", storage) as writer:
        writer.add_topic("/imu/palm", IMU)
        writer.add_topic("/hall_voltages", FLOAT32_MULTIARRAY)
        for message in shuffled:
            writer.write(*message)
    assert read(tmp_path / "run") == messages


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE, CompressionMode.STORAGE])
def test_compressed(storage: StorageName, mode: CompressionMode, tmp_path: Path, samples: Samples) -> None:
    if (storage, mode) == ("sqlite3", CompressionMode.STORAGE):
        pytest.skip("SQLite has no chunks")
    writer = Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(topic, msgtype, typestore=typestore())
            for topic, msgtype in (("/imu/palm", IMU), ("/hall_voltages", FLOAT32_MULTIARRAY))
        }
        for topic, time, data in samples(100):
            writer.write(connections[topic], time, data)
    assert read(tmp_path / "run") == list(samples(100))


def test_split_recording(storage: StorageName, make_bag: MakeBag, samples: Samples) -> None:
    bags = [make_bag(storage, 100, first, f"run_{number}") for number, first in enumerate((0, 100, 200))]
    with BagReader(joined(bags)) as bag:
        assert bag.message_count == 300
        assert bag.duration_s == pytest.approx(2.99)
        assert list(bag.messages()) == list(samples(300))


def test_split_recording_whose_files_overlap(storage: StorageName, make_bag: MakeBag) -> None:
    bags = [make_bag(storage, 100, first, f"run_{number}") for number, first in enumerate((50, 0, 300))]
    times = [time for _, time, _ in read(joined(bags))]
    assert times == sorted(times)
    assert len(times) == 300


def test_a_quality_of_service_that_was_edited_by_hand_hides_no_messages(
    storage: StorageName, make_bag: MakeBag, samples: Samples
) -> None:
    path = make_bag(storage, 100)

    def forget(information: dict[str, Any]) -> None:
        for topic in information["topics_with_message_count"]:
            topic["topic_metadata"]["offered_qos_profiles"] = []

    edit_metadata(path, forget)
    assert read(path) == list(samples(100))


def test_names_are_resolved_as_ros_does(storage: StorageName, tmp_path: Path, samples: Samples) -> None:
    _, time, data = next(samples(1))
    with BagWriter(tmp_path / "run", storage) as writer:
        for topic in ("/imu/palm", "/robot1/imu/palm"):
            writer.add_topic(topic, IMU)
            writer.write(topic, time, data)
    with BagReader(tmp_path / "run") as bag:
        assert bag.resolve("imu/palm") == "/imu/palm"
        assert bag.resolve("imu/palm", "robot1") == bag.resolve("imu/palm", "/robot1/") == "/robot1/imu/palm"
        assert bag.resolve("/imu/palm", "robot1") == "/imu/palm"
        assert bag.resolve("palm", "imu") == "/imu/palm"
        assert bag.resolve("palm") is None


def test_required_topics(storage: StorageName, make_bag: MakeBag) -> None:
    with BagReader(make_bag(storage, 10)) as bag:
        assert bag.require("imu/palm", IMU) == "/imu/palm"
        with pytest.raises(BagError, match=r"topic '/imu/palm' is of type sensor_msgs/msg/Imu; expected .*JointState"):
            bag.require("imu/palm", "sensor_msgs/msg/JointState")
        with pytest.raises(BagError, match=r"'/imu/plam' is not .* you mean '/imu/palm'\? it has: /hall_voltages, "):
            bag.require("imu/plam", IMU)
        with pytest.raises(BagError, match=r"topic '/palm' is not in .* did you mean '/imu/palm'"):
            bag.require("palm", IMU)
        with pytest.raises(BagError, match=r"topic '/x' is not in the bag; it has: /hall_voltages, /imu/palm$"):
            bag.require("x", IMU)


def test_memory_does_not_grow_with_the_recording(
    storage: StorageName, make_bag: MakeBag, data_file: Callable[[Path], Path]
) -> None:
    path = make_bag(storage, 200_000)
    with BagReader(path) as bag:
        tracemalloc.start()
        count = sum(1 for _ in bag.messages())
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert count == 200_000
    assert peak < 8e6 < data_file(path).stat().st_size / 4


def test_compressed_chunks_hold_the_same_in_less_space(
    make_bag: MakeBag, samples: Callable[..., Iterator[tuple[str, int, bytes]]], data_file: Callable[[Path], Path]
) -> None:
    small, large = (make_bag("mcap", 5000, name=f"bag{on}", compress=on) for on in (True, False))
    with BagReader(small) as bag:
        assert list(bag.messages()) == list(samples(5000))
    assert data_file(small).stat().st_size < data_file(large).stat().st_size / 4


def test_missing_path(tmp_path: Path) -> None:
    assert "no such bag" in refusal(tmp_path / "nothing")
    assert "no such bag" in refusal(tmp_path / "nothing.mcap")


def test_what_is_no_bag(tmp_path: Path) -> None:
    assert "not a bag" in refusal(tmp_path)
    for name in ("readme.txt", "run.bag", "run.mcap", "run.db3"):
        (tmp_path / name).write_text("just a text, and long enough to be mistaken for something else")
        assert "not a bag" in refusal(tmp_path / name)
    (tmp_path / "empty.db3").touch()
    assert "empty file" in refusal(tmp_path / "empty.db3")


def test_another_sqlite_database_is_no_bag(tmp_path: Path) -> None:
    database = sqlite3.connect(tmp_path / "other.db3")
    database.execute("CREATE TABLE people (name TEXT)")
    database.commit()
    database.close()
    assert "cannot be read" in refusal(tmp_path / "other.db3")


def test_empty_bag(storage: StorageName, make_bag: MakeBag, data_file: Callable[[Path], Path]) -> None:
    path = make_bag(storage, 0)
    assert "empty bag (no messages)" in refusal(path)
    assert "empty bag (no messages)" in refusal(data_file(path))


def test_several_files_without_metadata(storage: StorageName, make_bag: MakeBag) -> None:
    path = joined([make_bag(storage, 10, name="a"), make_bag(storage, 10, name="b")])
    (path / "metadata.yaml").unlink()
    assert "2 data files" in refusal(path)


def test_missing_files(storage: StorageName, make_bag: MakeBag, data_file: Callable[[Path], Path]) -> None:
    path = make_bag(storage, 10)
    file = data_file(path)
    file.unlink()
    assert f"files are missing: {file.name}" in refusal(path)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a: [",
        "[" * 3000,
        "text",
        "\0",
        "rosbag2_bagfile_information:",
        "rosbag2_bagfile_information: {relative_file_paths: 3}",
    ],
)
def test_broken_metadata(text: str, make_bag: MakeBag) -> None:
    path = make_bag("mcap", 10)
    (path / "metadata.yaml").write_text(text)
    assert "not the metadata of a rosbag2" in refusal(path)


def test_metadata_that_is_not_text(make_bag: MakeBag) -> None:
    path = make_bag("mcap", 10)
    (path / "metadata.yaml").write_bytes(b"\xff\xfe\xfd")
    assert "not the metadata of a rosbag2" in refusal(path)


def test_unknown_compression(make_bag: MakeBag) -> None:
    path = make_bag("mcap", 10)
    edit_metadata(path, lambda information: information.update(compression_mode="file", compression_format="lzma"))
    assert "lzma" in refusal(path)


def test_unknown_serialisation(storage: StorageName, tmp_path: Path) -> None:
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        topic = writer.add_connection("/imu", IMU, typestore=typestore(), serialization_format="json")
        writer.write(topic, 1, b"{}")
    assert "topic '/imu' is serialised as 'json'" in refusal(tmp_path / "run")


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is forbidden to root")
def test_forbidden_file(storage: StorageName, make_bag: MakeBag, data_file: Callable[[Path], Path]) -> None:
    path = make_bag(storage, 10)
    data_file(path).chmod(0)
    assert "Permission denied" in refusal(path)


def test_a_file_that_cannot_be_opened(make_bag: MakeBag, monkeypatch: pytest.MonkeyPatch) -> None:
    open_any = Path.open

    def forbid(path: Path, *args: Any, **kwargs: Any) -> Any:
        if path.suffix == ".mcap":
            raise PermissionError(13, "Permission denied")
        return open_any(path, *args, **kwargs)

    path = make_bag("mcap", 10)
    monkeypatch.setattr(Path, "open", forbid)
    assert "cannot be read: Permission denied" in refusal(path)


def test_a_bag_can_be_left_in_the_middle(storage: StorageName, make_bag: MakeBag) -> None:
    with BagReader(make_bag(storage)) as bag:
        _, _, data = next(iter(bag.messages(["/imu/palm"])))
        assert decode_imu(data)[1] == "palm"
