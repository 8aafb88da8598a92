"""Recordings like others, but for some messages or their end."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter

Change = Callable[[str, int, bytes], bytes | None]  # topic, record time (ns), CDR bytes -> other bytes; None: left out


def copied(source: Path, target: Path, change: Change) -> Path:
    """The recording `source` with other message bytes at `target`; topics of which nothing is left are absent."""
    with BagReader(source) as reader, BagWriter(target) as writer:
        added = set()
        for topic, time, data in reader.messages():
            changed = change(topic, time, data)
            if changed is None:
                continue
            if topic not in added:
                added.add(topic)
                writer.add_topic(topic, reader.topics[topic])
            writer.write(topic, time, changed)
    return target


def cut(bag: Path, share: float) -> Path:
    """The recording itself (mcap), broken off: only this share of its file is left."""
    (file,) = bag.glob("*.mcap")
    with file.open("rb+") as stream:
        stream.truncate(int(file.stat().st_size * share))
    return bag


def broken_off(source: Path, target: Path, share: float) -> Path:
    """A copy that is `cut`."""
    return cut(Path(shutil.copytree(source, target)), share)
