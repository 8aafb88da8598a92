"""What the converters of public recordings share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scipy.io import loadmat

from jointest_ros.bags.errors import BagError
from jointest_ros.core.progress import Progress

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


def check_source(path: Path) -> None:
    """Raise a `BagError` when there is no file at `path`."""
    if not path.is_file():
        raise BagError(f"{path}: {'not a file' if path.exists() else 'no such file'}")


def load_matlab(path: Path, variables: Sequence[str], what: str) -> dict[str, Any]:
    """Those variables of a MATLAB file.

    Args:
        what: the file ought to be, for the error: "a raw recording of the set 'song'".

    Raises:
        BagError: there is no such file, it is not of MATLAB, or lacks one of the variables.
    """
    check_source(path)
    try:
        contents = loadmat(path, variable_names=list(variables))
    except Exception as error:  # scipy raises errors of many kinds for what is not a .mat file
        raise BagError(f"{path}: not a MATLAB file that scipy can read: {error}") from None
    if missing := [name for name in variables if name not in contents]:
        raise BagError(f"{path}: not {what}: {', '.join(missing[:3])} missing")
    return {name: contents[name] for name in variables}


def row_slices(total: int, progress: Progress) -> Iterator[slice]:
    """Slices of some thousand rows, each reported once it is done."""
    for start in range(0, total, _ROWS):
        stop = min(start + _ROWS, total)
        yield slice(start, stop)
        progress(stop, total)
