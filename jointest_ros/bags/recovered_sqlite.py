"""What can be read of a damaged .db3 file: the rows in the order in which they were written, up to the damage."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from urllib.parse import quote

_NEVER = 2**63 - 1


def is_cut(path: Path) -> bool:
    """Whether the file is shorter than its header says (https://sqlite.org/fileformat.html, 1.3).

    SQLite itself reads half of a page as a page whose second half is zeros, and so skips rows without an error.
    """
    with path.open("rb") as file:
        header = file.read(32)
    page_size, pages = int.from_bytes(header[16:18], "big"), int.from_bytes(header[28:32], "big")
    return path.stat().st_size < (65536 if page_size == 1 else page_size) * pages


class RecoveredSqlite:
    """A `Storage` of the rows before the damage.

    Rows come in the order of their ids, which a damaged index of times does not hinder. A recorder writes them in the
    order of their times but for small exceptions.

    Raises:
        sqlite3.Error: not even the table of topics can be read.
    """

    def __init__(self, path: Path) -> None:
        self._database = sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1", uri=True)
        try:
            # without this SQLite refuses every file that is shorter than its header says (btree.c, lockBtree)
            self._database.execute("PRAGMA writable_schema=ON")
            rows = self._database.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
        except sqlite3.Error:
            self._database.close()
            raise
        self._topics = {number: name for number, name, _, _ in rows}
        self.connections = [(name, msgtype, serialization) for _, name, msgtype, serialization in rows]
        self.counts: dict[str, int] = {}
        self.start, self.end = _NEVER, 0
        # when all rows can be read the damage is in what they do not need: the index of times
        self.damage = "the end of the file is missing" if is_cut(path) else "its index is damaged"
        try:
            for topic, time, _ in self._rows():
                self.start, self.end = min(self.start, time), max(self.end, time)
                self.counts[topic] = self.counts.get(topic, 0) + 1
        except sqlite3.Error as error:
            self.damage = str(error)

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        for row in self._rows():
            if row[0] in topics:
                yield row
        raise sqlite3.DatabaseError(self.damage)

    def close(self) -> None:
        self._database.close()

    def _rows(self) -> Iterator[tuple[str, int, bytes]]:
        for topic, time, data in self._database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id"):
            if topic not in self._topics or not isinstance(time, int) or not isinstance(data, bytes):
                raise sqlite3.DatabaseError("a row that makes no sense")
            yield self._topics[topic], time, data
