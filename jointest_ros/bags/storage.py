"""One file of a recording, opened: by `rosbags` when it is sound, by what can be saved of it when it is not."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Protocol

from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader

from jointest_ros.bags.errors import BagError
from jointest_ros.bags.recovered_mcap import RecoveredMcap
from jointest_ros.bags.recovered_sqlite import RecoveredSqlite, is_cut

_MAGIC = {".mcap": b"\x89MCAP0\r\n", ".db3": b"SQLite format 3\0"}
_RECOVERY: dict[str, type[RecoveredMcap] | type[RecoveredSqlite]] = {".mcap": RecoveredMcap, ".db3": RecoveredSqlite}
SUFFIXES = tuple(_MAGIC)


class Storage(Protocol):
    """What `BagReader` needs of a file.

    Attributes:
        connections: topic, message type and serialisation format, one for each publisher that was recorded.
        counts: messages by topic; topics without messages may be missing.
        start, end: record times of the first and of the last message, ns; meaningless without messages.
        damage: why the file cannot be read to its end; empty when it is sound.
    """

    connections: list[tuple[str, str, str]]
    counts: dict[str, int]
    start: int
    end: int
    damage: str

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, record time (ns) and bytes in record-time order. Raises anything at all where the file is damaged."""

    def close(self) -> None:
        """Close the file."""


class SoundStorage:
    """A file, or a whole compressed directory, that `rosbags` can open."""

    damage = ""

    def __init__(self, path: Path) -> None:
        self._reader = Reader(path)
        self._reader.open()
        self.start, self.end = self._reader.start_time, self._reader.end_time - 1
        self.connections = []
        self.counts: dict[str, int] = {}
        for connection in self._reader.connections:
            assert isinstance(connection.ext, ConnectionExtRosbag2)
            self.connections.append((connection.topic, connection.msgtype, connection.ext.serialization_format))
            self.counts[connection.topic] = self.counts.get(connection.topic, 0) + connection.msgcount

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        connections = [connection for connection in self._reader.connections if connection.topic in topics]
        if connections:
            for connection, time, data in self._reader.messages(connections):
                yield connection.topic, time, data

    def close(self) -> None:
        self._reader.close()


def check_sqlite_path(path: Path) -> None:
    """Raise a `BagError` for a path that rosbags, which puts it into a URI as it is, would take for another one."""
    if set(str(path)) & set("#?%"):
        raise BagError(f"{path}: the path of an SQLite recording must not have #, ? or % in it; rename it or use mcap")


def open_compressed(directory: Path) -> Storage:
    """The bag in `directory`, whose files or messages are compressed one by one. Nothing is saved of a damaged one."""
    try:
        return SoundStorage(directory)
    except Exception as error:  # rosbags and its decompressors raise errors of many kinds
        raise BagError(f"{directory}: cannot be read: {error}") from None


def open_file(path: Path) -> Storage:
    """The recording in one .mcap or .db3 file.

    Raises:
        BagError: it cannot be read at all, or is something else.
    """
    _check_magic(path)
    if path.suffix == ".db3":
        check_sqlite_path(path)
    try:
        if path.suffix == ".mcap" or not is_cut(path):
            return SoundStorage(path)
        reason = "the end of the file is missing"
    except Exception as error:  # a damaged file makes rosbags raise whatever its parser trips over
        reason = str(error)
    try:
        return _RECOVERY[path.suffix](path)
    except Exception:
        raise BagError(f"{path}: cannot be read: {reason}") from None


def _check_magic(path: Path) -> None:
    if path.suffix not in _MAGIC:
        hint = "; a configuration goes with --config" if path.suffix in (".yaml", ".yml") else ""
        raise BagError(f"{path}: not a bag; give a rosbag2 directory, an .mcap file or a .db3 file{hint}")
    magic = _MAGIC[path.suffix]
    try:
        with path.open("rb") as file:
            start = file.read(len(magic))
    except OSError as error:
        raise BagError(f"{path}: cannot be read: {error.strerror}") from None
    if not start:
        raise BagError(f"{path}: empty file")
    if not magic.startswith(start):
        raise BagError(f"{path}: not a bag, in spite of its suffix {path.suffix}")
