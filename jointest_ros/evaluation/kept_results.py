"""Results of jobs in a folder, from which a run that was broken off goes on."""

from __future__ import annotations

import hashlib
import os
import pickle
import platform
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy

import jointest_ros
from jointest_ros.core.errors import JointestError


class KeptResultsError(JointestError):
    """Results cannot be kept."""


class KeptResults:
    """A folder with a file for each result. One that cannot be read counts as none.

    Raises:
        KeptResultsError: the folder cannot be made, or not be written.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise self._error(error) from None

    def read(self, key: str) -> Any:
        """The result; None: there is none."""
        try:
            return pickle.loads(self._file(key).read_bytes())
        except Exception:  # pickle raises whatever a damaged file leads to
            return None

    def write(self, key: str, result: Any) -> None:
        """Whole or not at all. Raises KeptResultsError."""
        file = self._file(key)
        draft = file.with_suffix(f".{os.getpid()}")
        try:
            draft.write_bytes(pickle.dumps(result))
            draft.replace(file)
        except OSError as error:
            raise self._error(error) from None

    def _file(self, key: str) -> Path:
        return self._folder / f"{hashlib.sha256(f'{software()} {key}'.encode()).hexdigest()[:32]}.pickle"

    def _error(self, error: OSError) -> KeptResultsError:
        return KeptResultsError(f"--resume {self._folder}: cannot be written: {error.strerror}")


def name(job: partial[Any]) -> str:
    """Function and arguments; these are numbers, texts, or tuples and ranges of them."""
    return repr((job.func.__module__, job.func.__qualname__, job.args, sorted(job.keywords.items())))


@cache
def software() -> str:
    """What results depend on besides their input: versions, and a digest of the sources of this package."""
    digest = hashlib.sha256()
    folder = Path(jointest_ros.__file__).parent
    for file in sorted(folder.rglob("*.py")):
        digest.update(str(file.relative_to(folder)).encode() + b"\0" + file.read_bytes())
    package = f"{jointest_ros.__version__} ({digest.hexdigest()[:8]})"
    return f"{package} with numpy {np.__version__}, scipy {scipy.__version__}, Python {platform.python_version()}"
