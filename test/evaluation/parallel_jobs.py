"""Functions that worker processes import by name."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np

from jointest_ros.core.errors import ConfigurationError


def walk(seed: int) -> tuple[int, float]:
    """A computation that depends on its job alone, to the last bit."""
    return seed, float(np.cumsum(np.random.default_rng(seed).normal(size=2000)).std())


def walk_or_die(seed: int, folder: str) -> tuple[int, float]:
    """The first time that job 3 is done, its worker is killed."""
    mark = Path(folder) / "died"
    if seed == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return walk(seed)


def die(_: int) -> None:
    """A job that no worker survives."""
    os.kill(os.getpid(), signal.SIGKILL)


def refuse(seed: int) -> int:
    """Some jobs cannot be done."""
    if seed in (2, 3):
        raise ConfigurationError(f"job {seed}")
    return seed


def count(seed: int, folder: str) -> int:
    """Leaves a file for each time that it is called."""
    number = len(list(Path(folder).glob(f"{seed}-*")))
    (Path(folder) / f"{seed}-{number}").touch()
    return seed * seed


def where() -> tuple[int, str, str | None]:
    """Of the worker."""
    return os.getpid(), os.getcwd(), os.environ.get("OPENBLAS_NUM_THREADS")


def software() -> str:
    """No two processes have the same."""
    return f"0.0.9 of {os.getpid()}"
