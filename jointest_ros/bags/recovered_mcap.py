"""What can be read of an MCAP file whose end is missing or damaged: the file of a recorder that was killed.

A sound file ends with an index and a footer, which `rosbags` needs. Without them the records are read one after the
other from the start (MCAP specification, https://mcap.dev/spec): a record is one byte of type, its length as uint64,
then its content; schemas, channels and messages mostly lie inside of chunks, which may be compressed.
"""

from __future__ import annotations

import struct
from array import array
from bisect import bisect_left
from collections.abc import Collection, Iterator
from io import BytesIO
from itertools import accumulate
from operator import itemgetter
from pathlib import Path
from struct import Struct
from typing import BinaryIO

from rosbags.rosbag2.storage_mcap import decompress

from jointest_ros.bags.mcap_records import CHANNEL, CHUNK, FOOTER, MAGIC, MESSAGE, RECORD, SCHEMA

Message = tuple[str, int, bytes]  # topic, record time (ns), data

_NEVER = 2**63 - 1

_message_header = Struct("<HIQQ")  # channel, sequence, log time, publish time
_chunk_header = Struct("<QQQI")  # first and last log time, uncompressed size, CRC; then compression, records
_by_time = itemgetter(1)


class _Damage(Exception):
    """Where the records break off."""


class RecoveredMcap:
    """A `Storage` of the records before the damage.

    The file is read twice: now, to know its topics and times, and in `messages`.

    Raises:
        ValueError: the records are complete; the file is not damaged but of a kind that `rosbags` does not read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._size = path.stat().st_size  # of now: it may still be growing
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str, str]] = {}
        self.counts: dict[str, int] = {}
        self.end = 0
        starts = array("q")
        try:
            for block in self._blocks():
                starts.append(min(time for _, time, _ in block))
                self.end = max(self.end, *(time for _, time, _ in block))
                for topic, _, _ in block:
                    self.counts[topic] = self.counts.get(topic, 0) + 1
        except _Damage as error:
            self.damage = str(error)
        else:
            raise ValueError("not damaged")
        self.connections = list(self._channels.values())
        self.start = min(starts, default=_NEVER)
        # no block from the k-th on has a message before _floor[k]
        self._floor = array("q", accumulate(reversed(starts), min, initial=_NEVER))
        self._floor.reverse()

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        pending: list[Message] = []
        for number, block in enumerate(self._blocks(), 1):
            pending += [message for message in block if message[0] in topics]
            pending.sort(key=_by_time)
            ready = bisect_left(pending, self._floor[number], key=_by_time)
            yield from pending[:ready]
            del pending[:ready]

    def close(self) -> None:
        """Nothing is kept open."""

    def _blocks(self) -> Iterator[list[Message]]:
        """The messages of each chunk in the order of the file. Raises `_Damage` where the file breaks off."""
        with self._path.open("rb") as file:
            file.seek(len(MAGIC))
            for kind, content, complete in _records(file, self._size):
                if kind == FOOTER:
                    return
                block: list[Message] = []
                damage = None
                try:
                    self._take(kind, content, complete, block)
                except _Damage as error:
                    damage = error
                except Exception as error:  # random bytes: struct.error, KeyError, those of decompressors, ...
                    damage = _Damage(f"a record cannot be read ({error})")
                if block:
                    yield block
                if damage:
                    raise damage
        raise _Damage("the end of the file is missing")

    def _take(self, kind: int, content: bytes, complete: bool, block: list[Message]) -> None:
        """Remember what a record declares, put its messages into `block`."""
        if kind == CHUNK:
            records = _chunk_records(content, complete)
            for inner in _records(BytesIO(records), len(records)):
                self._take(*inner, block)
        elif not complete:
            raise _Damage("the file ends inside of a record")
        elif kind == MESSAGE:
            channel, _, time, _ = _message_header.unpack_from(content)
            block.append((self._channels[channel][0], time, content[_message_header.size :]))
        elif kind == SCHEMA:
            self._schemas[struct.unpack_from("<H", content)[0]] = _string(content, 2)[0]
        elif kind == CHANNEL:
            number, schema = struct.unpack_from("<HH", content)
            topic, offset = _string(content, 4)
            self._channels[number] = (topic, self._schemas.get(schema, ""), _string(content, offset)[0])


def _records(stream: BinaryIO, size: int) -> Iterator[tuple[int, bytes, bool]]:
    """Type and content of each record up to `size`, and whether its content is complete (the last may break off)."""
    while (left := size - stream.tell()) > 0:
        if left < RECORD.size:
            raise _Damage("the file ends inside of a record")
        kind, length = RECORD.unpack(stream.read(RECORD.size))
        content = stream.read(min(length, left - RECORD.size))
        yield kind, content, len(content) == length


def _chunk_records(content: bytes, complete: bool) -> bytes:
    """The records in a chunk. Of an incomplete one they can be read as far as they go, unless they are compressed."""
    _, _, uncompressed_size, crc = _chunk_header.unpack_from(content)
    compression, offset = _string(content, _chunk_header.size)
    (length,) = struct.unpack_from("<Q", content, offset)
    records = content[offset + 8 : offset + 8 + length]
    if complete:
        return decompress(records, compression, uncompressed_size, crc)
    if compression:
        raise _Damage("the file ends inside of a compressed chunk")
    return records


def _string(content: bytes, offset: int) -> tuple[str, int]:
    end = offset + 4 + struct.unpack_from("<I", content, offset)[0]
    return content[offset + 4 : end].decode(), end
