"""The records of an MCAP file as bytes, after its specification, https://mcap.dev/spec.

A record is one byte of type, the length of its content as uint64, and the content; numbers are little endian.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from struct import Struct

import lz4.frame

MAGIC = b"\x89MCAP0\r\n"
_HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(1, 9)
_STATISTICS, _METADATA, _METADATA_INDEX, _SUMMARY_OFFSET, _DATA_END = range(0x0B, 0x10)
_COMPRESSION = "lz4"

_u8, _u16, _u32, _u64, _2u64 = Struct("<B"), Struct("<H"), Struct("<I"), Struct("<Q"), Struct("<QQ")
RECORD = Struct("<BQ")  # type and length of the content
_message = Struct("<BQHIQQ")  # type and length of the record; channel, sequence, log time, publish time
_totals = Struct("<QHIIIIQQ")  # messages, schemas, channels, attachments, metadata, chunks, first and last time


def header() -> bytes:
    """What a file begins with."""
    return MAGIC + _as_record(_HEADER, _text("ros2") + _text("jointest_ros"))


def schema(number: int, msgtype: str, definition: str) -> bytes:
    """The definition of a message type."""
    return _as_record(SCHEMA, _u16.pack(number) + _text(msgtype) + _text("ros2msg") + _text(definition))


def channel(number: int, topic: str, qos: str) -> bytes:
    """A topic, with the schema of the same number."""
    content = _u16.pack(number) + _u16.pack(number) + _text(topic) + _text("cdr")
    return _as_record(CHANNEL, content + _map({"offered_qos_profiles": qos}))


class ChunkInTheMaking:
    """Messages that will be one chunk. Attributes: `length` of their records, bytes; `times`, first and last, ns."""

    def __init__(self) -> None:
        self.length = 0
        self.times: tuple[int, int] | None = None
        self._records: list[bytes] = []
        self._index: dict[int, list[bytes]] = {}

    def add(self, number: int, time: int, data: bytes) -> None:
        """A message of channel `number`."""
        self._index.setdefault(number, []).append(_2u64.pack(time, self.length))
        self._records += (_message.pack(MESSAGE, 22 + len(data), number, 0, time, time), data)
        self.length += _message.size + len(data)
        first, last = self.times or (time, time)
        self.times = min(first, time), max(last, time)

    def end(self, start: int) -> tuple[bytes, Chunk]:
        """The records, and what the summary will say of them; `start`: where in the file they will be."""
        records, times = b"".join(self._records), self.times or (0, 0)
        compressed = lz4.frame.compress(records)
        head = _2u64.pack(*times) + _u64.pack(len(records)) + _u32.pack(0) + _text(_COMPRESSION)
        blob = _as_record(CHUNK, head + _u64.pack(len(compressed)) + compressed)
        length, offsets = len(blob), {}
        for number, entries in self._index.items():
            offsets[number] = start + len(blob)
            index = _u16.pack(number) + _u32.pack(16 * len(entries)) + b"".join(entries)
            blob += _as_record(_MESSAGE_INDEX, index)
        counts = Counter({number: len(entries) for number, entries in self._index.items()})
        sizes = len(blob) - length, len(compressed), len(records)
        return blob, Chunk(start, length, offsets, *sizes, times, counts)


@dataclass(frozen=True)
class Chunk:
    """A chunk in the file: where it is (bytes), and what is in it."""

    start: int
    length: int
    indexes: dict[int, int]  # channel -> where its index is
    index_length: int
    compressed: int
    uncompressed: int
    times: tuple[int, int]  # first and last, ns
    counts: Counter[int]  # messages of each channel

    def index(self) -> bytes:
        """Its record in the summary."""
        offsets = b"".join(_u16.pack(number) + _u64.pack(offset) for number, offset in self.indexes.items())
        place = _2u64.pack(*self.times) + _2u64.pack(self.start, self.length) + _u32.pack(len(offsets)) + offsets
        sizes = _u64.pack(self.index_length) + _text(_COMPRESSION) + _2u64.pack(self.compressed, self.uncompressed)
        return _as_record(_CHUNK_INDEX, place + sizes)


def ending(
    start: int,
    information: str,
    schemas: Iterable[bytes],
    channels: Iterable[bytes],
    chunks: list[Chunk],
    counts: Mapping[int, int],
) -> bytes:
    """All that follows the chunks: metadata of the recording, and the summary by which readers find everything.

    Args:
        start: where in the file it will be, bytes.
        information: of rosbag2, as in metadata.yaml.
        schemas, channels: their records.
        counts: messages of each channel.
    """
    metadata = _as_record(_METADATA, _text("rosbag2") + _map({"serialized_metadata": information}))
    blob = metadata + _as_record(_DATA_END, _u32.pack(0))
    summary, offsets = start + len(blob), b""
    place = _2u64.pack(start, len(metadata)) + _text("rosbag2")
    for kind, records in (
        (SCHEMA, b"".join(schemas)),
        (CHANNEL, b"".join(channels)),
        (_CHUNK_INDEX, b"".join(chunk.index() for chunk in chunks)),
        (_METADATA_INDEX, _as_record(_METADATA_INDEX, place)),
        (_STATISTICS, _as_record(_STATISTICS, _statistics(chunks, counts))),
    ):
        if records:
            offsets += _as_record(_SUMMARY_OFFSET, _u8.pack(kind) + _2u64.pack(start + len(blob), len(records)))
        blob += records
    footer = _2u64.pack(summary, start + len(blob)) + _u32.pack(0)
    return blob + offsets + _as_record(FOOTER, footer) + MAGIC


def span(chunks: list[Chunk]) -> tuple[int, int]:
    """Times of the first and of the last message, ns; 0 without any."""
    times = [chunk.times for chunk in chunks]
    return (min(first for first, _ in times), max(last for _, last in times)) if times else (0, 0)


def _statistics(chunks: list[Chunk], counts: Mapping[int, int]) -> bytes:
    totals = _totals.pack(sum(counts.values()), len(counts), len(counts), 0, 1, len(chunks), *span(chunks))
    by_channel = b"".join(_u16.pack(number) + _u64.pack(count) for number, count in counts.items())
    return totals + _u32.pack(len(by_channel)) + by_channel


def _as_record(kind: int, content: bytes) -> bytes:
    return RECORD.pack(kind, len(content)) + content


def _text(text: str) -> bytes:
    data = text.encode()
    return _u32.pack(len(data)) + data


def _map(entries: dict[str, str]) -> bytes:
    content = b"".join(_text(key) + _text(value) for key, value in entries.items())
    return _u32.pack(len(content)) + content
