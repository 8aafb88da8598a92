"""Writes a recording while it happens: cheap for each message, in the file every second, sound even on a full disk.

`BagWriter` is for what can be written again: `rosbags` takes 18 us for a message, holds messages back until a chunk is
full, and has no end for a file that does not fit on the disk.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from jointest_ros.bags import mcap_records
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.typestore import typestore

_FOREVER = {"sec": 9223372036, "nsec": 854775807}  # RMW_DURATION_INFINITE


@dataclass(frozen=True)
class _Topic:
    number: int  # of channel and schema
    name: str
    msgtype: str
    best_effort: bool
    schema: bytes = field(init=False)
    channel: bytes = field(init=False)

    def __post_init__(self) -> None:
        definition, _ = typestore().generate_msgdef(self.msgtype, ros_version=2)
        object.__setattr__(self, "schema", mcap_records.schema(self.number, self.msgtype, definition))
        qos = yaml.safe_dump(self._qos()).strip()
        object.__setattr__(self, "channel", mcap_records.channel(self.number, self.name, qos))

    def information(self, count: int) -> dict[str, Any]:
        """Its entry in the metadata."""
        return {
            "topic_metadata": {
                "name": self.name,
                "type": self.msgtype,
                "serialization_format": "cdr",
                "offered_qos_profiles": self._qos(),
                "type_description_hash": typestore().hash_rihs01(self.msgtype),
            },
            "message_count": count,
        }

    def _qos(self) -> list[dict[str, Any]]:
        """How a player publishes it, as ROS 2 Jazzy writes that."""
        return [
            {
                "history": "keep_last",
                "depth": 1000 if self.best_effort else 10,
                "reliability": "best_effort" if self.best_effort else "reliable",
                "durability": "volatile",
                "deadline": dict(_FOREVER),
                "lifespan": dict(_FOREVER),
                "liveliness": "automatic",
                "liveliness_lease_duration": dict(_FOREVER),
                "avoid_ros_namespace_conventions": False,
            }
        ]


class LiveWriter:
    """A rosbag2 that grows in its place: the directory `path` with one MCAP file.

    What was flushed can be read even if the process is killed. Memory grows by about 0.5 kB a flush. Where the disk is
    full, the last messages are given up for the index: the recording is shorter, and complete.

    Attributes:
        counts: messages in the file, by topic.
        size: of the file so far, bytes.

    Raises:
        BagError: `path` exists or cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.counts: dict[str, int] = {}
        self.size = 0
        self._topics: dict[str, _Topic] = {}
        self._chunks: list[mcap_records.Chunk] = []
        self._chunk = mcap_records.ChunkInTheMaking()
        try:
            path.mkdir(parents=True)
            self._file = open(path / f"{path.name}.mcap", "xb", buffering=0)  # noqa: SIM115 - until close
        except FileExistsError:
            raise BagError(f"{path}: exists already; remove it or choose another name") from None
        except OSError as error:
            raise self._failure(error) from None
        try:
            self._append(mcap_records.header())
        except BagError:
            self.discard()  # it can be tried again under this name
            raise

    def add_topic(self, topic: str, msgtype: str, best_effort: bool) -> None:
        """Declare a topic before its first message.

        Args:
            topic: absolute name.
            msgtype: such as "sensor_msgs/msg/Imu", one that ROS 2 Jazzy brings along.
            best_effort: how a player publishes it.

        Raises:
            BagError: the type is not known, or the disk is full.
        """
        if msgtype not in typestore().fielddefs:
            raise BagError(f"{topic}: its type {msgtype} is not one of ROS 2 Jazzy; it cannot be recorded")
        added = _Topic(len(self._topics) + 1, topic, msgtype, best_effort)
        self._append(added.schema + added.channel)
        self._topics[topic] = added
        self.counts[topic] = 0

    def write(self, topic: str, time: int, data: bytes) -> None:
        """Take one message: CDR bytes, and when it was received, ns. It is in the file after the next `flush`."""
        self._chunk.add(self._topics[topic].number, time, data)

    def flush(self) -> None:
        """Put what was taken into the file, as one chunk.

        Raises:
            BagError: the disk is full; the file is what it was before, and what was taken is lost.
        """
        if self._chunk.times is None:
            return
        blob, chunk = self._chunk.end(self.size)
        self._chunk = mcap_records.ChunkInTheMaking()
        self._append(blob)
        self._chunks.append(chunk)
        self._count(chunk, 1)

    def close(self) -> None:
        """End the file, and write metadata.yaml. On a full disk the last chunks make room for that.

        Raises:
            BagError: there is not even room for an empty recording.
        """
        try:
            while True:
                try:
                    self._end()
                    return
                except OSError as error:
                    if not self._chunks:
                        raise self._failure(error) from None
                    last = self._chunks.pop()
                    self._count(last, -1)
                    self._cut(last.start)
        finally:
            self._file.close()

    def discard(self) -> None:
        """Remove the recording."""
        self._file.close()
        shutil.rmtree(self.path, ignore_errors=True)

    def _end(self) -> None:
        information = self._information()
        topics = self._topics.values()
        schemas, channels = [topic.schema for topic in topics], [topic.channel for topic in topics]
        counts = {topic.number: self.counts[topic.name] for topic in topics}
        text = yaml.safe_dump(information)
        self._write(mcap_records.ending(self.size, text, schemas, channels, self._chunks, counts))
        draft = self.path / "metadata.yaml.tmp"
        draft.write_text(yaml.safe_dump({"rosbag2_bagfile_information": information}), encoding="utf-8")
        draft.replace(self.path / "metadata.yaml")

    def _information(self) -> dict[str, Any]:
        """What metadata.yaml says, and the file itself too."""
        first, last = mcap_records.span(self._chunks)
        name, total = f"{self.path.name}.mcap", sum(self.counts.values())
        topics = [topic.information(self.counts[topic.name]) for topic in self._topics.values()]
        extent = {
            "starting_time": {"nanoseconds_since_epoch": first},
            "duration": {"nanoseconds": last - first},
            "message_count": total,
        }
        return {
            "version": 9,
            "storage_identifier": "mcap",
            "relative_file_paths": [name],
            **extent,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "files": [{"path": name, **extent}],
            "custom_data": None,
            "ros_distro": "jazzy",
        }

    def _count(self, chunk: mcap_records.Chunk, sign: int) -> None:
        for topic in self._topics.values():
            self.counts[topic.name] += sign * chunk.counts[topic.number]

    # ---------------------------------------------------------------- file

    def _append(self, data: bytes) -> None:
        """All of it or nothing. Raises BagError."""
        size = self.size
        try:
            self._write(data)
        except OSError as error:
            self._cut(size)
            raise self._failure(error) from None

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            written = self._file.write(view)
            self.size += written
            view = view[written:]

    def _cut(self, size: int) -> None:
        self._file.truncate(size)
        self._file.seek(size)
        self.size = size

    def _failure(self, error: OSError) -> BagError:
        return BagError(f"{self.path}: cannot be written: {os.strerror(error.errno or 0)}")
