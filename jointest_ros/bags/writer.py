"""Writes rosbag2 recordings that ROS 2 Jazzy plays with the right quality of service."""

from __future__ import annotations

import re
import shutil
import sqlite3
import tempfile
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Literal

from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from jointest_ros.bags.errors import BagError
from jointest_ros.bags.storage import SUFFIXES, check_sqlite_path
from jointest_ros.bags.typestore import typestore

StorageName = Literal["mcap", "sqlite3"]
QosName = Literal["sensor", "reliable"]

# The version that Jazzy itself writes (rosbag2 0.26: qualities of service by name, as a list). It would read 8 as well,
# where they are numbers in a string, but what Jazzy makes itself is what its players and tools are tested with.
_METADATA_VERSION: Literal[9] = 9
_FOREVER = QosTime(9223372036, 854775807)  # RMW_DURATION_INFINITE


def _qos(reliability: QosReliability, depth: int) -> Qos:
    automatic = QosLiveliness.AUTOMATIC
    keep_last, volatile = QosHistory.KEEP_LAST, QosDurability.VOLATILE
    return Qos(keep_last, depth, reliability, volatile, _FOREVER, _FOREVER, automatic, _FOREVER, False)


_QOS: dict[QosName, Qos] = {
    "sensor": _qos(QosReliability.BEST_EFFORT, 1000),
    "reliable": _qos(QosReliability.RELIABLE, 10),
}


class BagWriter:
    """A new recording, complete once `__exit__` has returned; until then it is in `<name>.partial-*` beside `path`.

    An exception leaves nothing behind. After a kill the partial directory remains; an MCAP file in it can be read up to
    the last chunk of 1 MiB, while SQLite holds nothing before the end: it is written in one transaction, for speed.
    Memory does not grow with the recording.

    Args:
        path: directory of the bag; its parents are made.
        storage: "mcap" or "sqlite3".
        overwrite: replace a bag that is there already. Anything but a bag is never replaced.
        compress: the chunks of an MCAP file by zstd, as every MCAP reader knows it: a fifth of the size, as fast.

    Raises:
        BagError: on entering: `path` exists; anywhere: it cannot be written.
    """

    def __init__(
        self, path: Path | str, storage: StorageName = "mcap", overwrite: bool = False, compress: bool = True
    ) -> None:
        self.path = Path(path)
        self._compress = compress
        self._plugin = StoragePlugin[storage.upper()]
        self._overwrite = overwrite
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> BagWriter:
        try:
            self._check_target()
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._partial = Path(tempfile.mkdtemp(prefix=f"{self.path.name}.partial-", dir=self.path.parent))
        except OSError as error:
            raise self._failure(error) from None
        target = self._partial / self.path.name
        self._writer = Writer(target, version=_METADATA_VERSION, storage_plugin=self._plugin)
        if self._compress and self._plugin is StoragePlugin.MCAP:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        try:
            self._writer.open()
        except (OSError, sqlite3.Error) as error:
            shutil.rmtree(self._partial, ignore_errors=True)
            raise self._failure(error) from None
        return self

    def _check_target(self) -> None:
        if self._plugin is StoragePlugin.SQLITE3:
            check_sqlite_path(self.path)
        if not self.path.exists():
            return
        if not self._overwrite:
            raise BagError(f"{self.path}: exists already; remove it, choose another name or give --overwrite")
        if not _is_bag(self.path):
            raise BagError(f"{self.path}: exists already and is not a bag; it is not overwritten")

    def add_topic(self, topic: str, msgtype: str, qos: QosName = "reliable") -> None:
        """Declare a topic before its first message.

        Args:
            topic: absolute name.
            msgtype: such as "sensor_msgs/msg/Imu".
            qos: how a player publishes it: "sensor" (best effort: IMUs, Hall voltages) or "reliable" (the rest).

        Raises:
            BagError: it was declared before.
        """
        if topic in self._connections:
            raise BagError(f"{self.path}: topic '{topic}' is declared twice")
        self._connections[topic] = self._writer.add_connection(
            topic, msgtype, typestore=typestore(), offered_qos_profiles=[_QOS[qos]]
        )

    def write(self, topic: str, record_time_ns: int, data: bytes) -> None:
        """Append one message, serialised as CDR."""
        try:
            self._writer.write(self._connections[topic], record_time_ns, data)
        except (OSError, sqlite3.Error, OverflowError) as error:
            raise self._failure(error) from None

    def note(self, key: str, text: str) -> None:
        """Put a remark into the metadata of the recording (`custom_data`)."""
        self._writer.set_custom_data(key, text)

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far, by topic."""
        return {topic: self._writer.counts[connection.id] for topic, connection in self._connections.items()}

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._writer.close()
                self._put_into_place()
        except (OSError, sqlite3.Error) as failure:
            raise self._failure(failure) from None
        finally:
            with suppress(Exception):  # closes what is still open; the first error is the one to report
                self._writer.abort()
            shutil.rmtree(self._partial, ignore_errors=True)

    def _put_into_place(self) -> None:
        if self._overwrite and self.path.exists():
            self.path.rename(self._partial / "replaced")
        (self._partial / self.path.name).rename(self.path)

    def _failure(self, error: Exception) -> BagError:
        reason = re.sub(r"^\[Errno \d+\] ", "", str(error))
        return BagError(f"{self.path}: cannot be written: {reason}")


def _is_bag(path: Path) -> bool:
    """Whether all of a directory is what a recorder writes, so that nothing else is lost with it."""
    suffixes = (*SUFFIXES, ".zstd")
    return path.is_dir() and all(f.name == "metadata.yaml" or f.suffix in suffixes for f in path.iterdir())
