"""Reads recordings: rosbag2 directories (MCAP or SQLite, of one or several files) and bare .mcap and .db3 files."""

from __future__ import annotations

import difflib
import heapq
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from operator import itemgetter
from pathlib import Path, PurePath
from types import TracebackType

import yaml

from jointest_ros.bags.errors import BagError
from jointest_ros.bags.storage import SUFFIXES, Storage, open_compressed, open_file
from jointest_ros.core.errors import counted


class BagReader:
    """A recording, open between `__enter__` and `__exit__`. Messages are streamed: memory does not grow with it.

    Of a damaged recording (a recorder that was killed, a copy that broke off) everything before the damage is there:
    `damage` tells it at once, and `messages` raises at the end of what it could yield.

    Attributes:
        path: of the bag.
        topics: message type of each topic; several types of one topic are joined by " and ".
        counts: number of messages of each topic.
        message_count: of all topics.
        start_ns: record time of the first message, ns.
        duration_s: from the first to the last message, s.
        damage: why the recording cannot be read to its end; empty when it is sound.

    Raises:
        BagError: on entering: there is no such bag, it is something else, has no messages, cannot be read.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)

    def __enter__(self) -> BagReader:
        with ExitStack() as stack:
            storages = []
            for storage in _open(self.path):
                stack.callback(storage.close)
                storages.append(storage)
            self._describe(storages)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def _describe(self, storages: list[Storage]) -> None:
        types: dict[str, set[str]] = {}
        for storage in storages:
            for topic, msgtype, serialization in storage.connections:
                if serialization != "cdr":
                    what = f"topic '{topic}' is serialised as '{serialization}'"
                    raise BagError(f"{self.path}: {what}; only cdr can be read")
                types.setdefault(topic, set()).add(msgtype)
        self.topics = {topic: " and ".join(sorted(types[topic])) for topic in sorted(types)}
        self.counts = {topic: sum(storage.counts.get(topic, 0) for storage in storages) for topic in self.topics}
        self.message_count = sum(self.counts.values())
        self.damage = next((storage.damage for storage in storages if storage.damage), "")
        if not self.message_count:
            trouble = f"damaged, no message can be read: {self.damage}" if self.damage else "empty bag (no messages)"
            raise BagError(f"{self.path}: {trouble}")
        filled = [storage for storage in storages if sum(storage.counts.values())]
        self.start_ns = min(storage.start for storage in filled)
        self.duration_s = (max(storage.end for storage in filled) - self.start_ns) * 1e-9
        damaged_and_empty = [storage for storage in storages if storage not in filled and storage.damage]
        self._storages = sorted(filled, key=lambda storage: storage.start) + damaged_and_empty

    def resolve(self, name: str, namespace: str = "") -> str | None:
        """The absolute name of the topic that `name` means in `namespace`, or None when the bag does not have it."""
        absolute = absolute_name(name, namespace)
        return absolute if absolute in self.topics else None

    def require(self, name: str, msgtype: str, namespace: str = "") -> str:
        """The absolute name of a topic that must be there and be of type `msgtype`.

        Raises:
            BagError: it is absent (names those nearest to it) or of another type.
        """
        topic = self.resolve(name, namespace)
        if topic is None:
            raise BagError(f"{self.path}: {self._absent(absolute_name(name, namespace))}")
        if self.topics[topic] != msgtype:
            raise BagError(f"{self.path}: topic '{topic}' is of type {self.topics[topic]}; expected {msgtype}")
        return topic

    def messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Topic, record time (ns) and CDR bytes of all messages, or those of some topics, in record-time order.

        Args:
            topics: absolute names.

        Raises:
            BagError: a topic is absent; or the bag is damaged here: everything before was yielded.
        """
        wanted = frozenset(self.topics if topics is None else topics)
        if absent := sorted(wanted - self.topics.keys()):
            raise BagError(f"{self.path}: {self._absent(absent[0])}")
        return self._messages(wanted)

    def _messages(self, topics: frozenset[str]) -> Iterator[tuple[str, int, bytes]]:
        count, time = 0, self.start_ns
        try:
            for topic, time, data in self._in_order(topics):
                count += 1
                yield topic, time, data
        except Exception as error:  # a damaged file makes rosbags raise whatever its parser trips over
            seconds = (time - self.start_ns) * 1e-9
            raise BagError(
                f"{self.path}: damaged after {counted(count, 'message')}, {seconds:.3f} s into the bag: {error}"
            ) from None
        # rosbags passes over records that make no sense, and SQLite over rows
        if lost := max(0, sum(self.counts[topic] for topic in topics) - count):
            raise BagError(f"{self.path}: damaged: {counted(lost, 'message')} that it should hold cannot be found")

    def _in_order(self, topics: frozenset[str]) -> Iterator[tuple[str, int, bytes]]:
        """One file after the other; those that overlap in time are merged."""
        group: list[Storage] = []
        for storage in self._storages:
            if group and storage.start > max(member.end for member in group):
                yield from _merged(group, topics)
                group = []
            group.append(storage)
        yield from _merged(group, topics)

    def _absent(self, topic: str) -> str:
        same_ending = [known for known in self.topics if known.endswith(topic)]
        near = same_ending or difflib.get_close_matches(topic, self.topics, n=1)
        hint = f"did you mean '{near[0]}'? " if near else ""
        return f"topic '{topic}' is not in the bag; {hint}it has: {', '.join(self.topics)}"


def absolute_name(name: str, namespace: str) -> str:
    """The name of a topic with its namespace, as ROS resolves it."""
    if name.startswith("/"):
        return name
    return "/" + "/".join(part for part in (namespace.strip("/"), name) if part)


def _merged(storages: list[Storage], topics: frozenset[str]) -> Iterator[tuple[str, int, bytes]]:
    streams = [storage.messages(topics) for storage in storages]
    return streams[0] if len(streams) == 1 else heapq.merge(*streams, key=itemgetter(1))


def _open(path: Path) -> Iterator[Storage]:
    """The files of the bag at `path`, opened."""
    try:
        if not path.exists():
            raise BagError(f"{path}: no such bag")
        if not path.is_dir():
            yield open_file(path)
            return
        metadata = path / "metadata.yaml"
        if not metadata.exists():
            yield open_file(_only_file(path))
            return
        names, compression = _parse(metadata)
        files = [path / name for name in names]
        if missing := [file.name for file in files if not file.exists()]:
            raise BagError(f"{path}: files are missing: {', '.join(missing)}")
    except OSError as error:
        raise BagError(f"{path}: cannot be read: {error.strerror}") from None
    if compression:
        yield open_compressed(path)
    else:
        yield from map(open_file, files)


def _only_file(directory: Path) -> Path:
    """The data file of a bag whose recorder was killed before it wrote metadata.yaml."""
    files = sorted(file for file in directory.iterdir() if file.suffix in SUFFIXES)
    if not files:
        raise BagError(f"{directory}: not a bag; it has no metadata.yaml and no .mcap or .db3 file")
    if len(files) > 1:
        raise BagError(f"{directory}: no metadata.yaml and {len(files)} data files; give one of them")
    return files[0]


def _parse(path: Path) -> tuple[list[str], bool]:
    """Names of the data files, and whether files or messages are compressed one by one."""
    try:
        information = yaml.safe_load(path.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        names = [PurePath(name).name for name in information["relative_file_paths"]]
        return names, (information.get("compression_mode") or "").lower() not in ("", "none", "storage")
    except (yaml.YAMLError, KeyError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise BagError(f"{path}: not the metadata of a rosbag2: {error}") from None
