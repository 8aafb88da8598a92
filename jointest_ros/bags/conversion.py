"""What the converters of public recordings share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from jointest_ros.bags.errors import BagError

Progress = Callable[[int, int], None]  # rows done, rows in all

_ROWS = 4096


@dataclass(frozen=True)
class ConversionSummary:
    """What a conversion wrote.

    Attributes:
        bag: the new recording.
        duration_s: from its first row to its last, s.
        messages: number of messages by topic.
        notes: what was left out and why, a sentence each.
    """

    bag: Path
    duration_s: float
    messages: dict[str, int]
    notes: tuple[str, ...] = ()


def no_progress(done: int, total: int) -> None:
    """Report nothing."""


def check_source(path: Path) -> None:
    """Raise a `BagError` when there is no file at `path`."""
    if not path.is_file():
        raise BagError(f"{path}: {'not a file' if path.exists() else 'no such file'}")


def row_slices(total: int, progress: Progress) -> Iterator[slice]:
    """Slices of some thousand rows, each reported once it is done."""
    for start in range(0, total, _ROWS):
        stop = min(start + _ROWS, total)
        yield slice(start, stop)
        progress(stop, total)
