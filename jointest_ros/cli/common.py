"""What the sub-commands share: the console, progress on standard error, loading of configurations."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from jointest_ros.config import Configuration
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.errors import ConfigurationError, JointestError
from jointest_ros.core.estimator import Estimator

# Names and paths are shown as they are, whatever rich would make of brackets and colons in them.
out = Console(soft_wrap=True, highlight=False, markup=False, emoji=False)  # results
err = Console(stderr=True, soft_wrap=True, highlight=False, markup=False, emoji=False)  # progress, warnings, errors

Parsers = argparse._SubParsersAction  # what `add_parser` functions get


class OutputError(JointestError):
    """A file of results cannot be written."""


@contextmanager
def progress(description: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on standard error, where that is a terminal; gone when done. Call with (done, total)."""
    if not err.is_terminal:  # rich would leave an empty line there
        yield lambda done, total: None
        return
    columns = TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task(description, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def warn(text: str) -> None:
    """One line of warning on standard error."""
    err.print(f"warning: {text}", style="yellow")


def complain(command: str, text: object) -> None:
    """One line of error on standard error."""
    err.print(f"jointest {command}: error: {text}")


def write_text(path: Path, text: str) -> None:
    """Write a whole file. Raises OutputError when it cannot be written."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from None


def add_config(parser: argparse.ArgumentParser, required: bool = True) -> None:
    """The options by which a robot and its estimators are chosen."""
    parser.add_argument(
        "--config", "-c", required=required, type=Path, metavar="YAML", help="the robot's configuration"
    )
    parser.add_argument(
        "--estimator",
        "-e",
        action="append",
        metavar="NAME",
        help=f"which estimator, may be repeated: {', '.join(ESTIMATORS)} (default: all in the configuration)",
    )
    parser.add_argument(
        "--namespace", default="", metavar="NS", help="namespace of the sensors' topics in the recording"
    )


def load_estimators(configuration: Configuration, chosen: list[str] | None) -> dict[str, Estimator]:
    """The estimators by name, made from the configuration.

    Raises:
        ConfigurationError: an unknown name, the configuration has none and none is named, or it does not suit one.
    """
    names = list(dict.fromkeys(chosen or configuration.estimators))
    if not names:
        known = ", ".join(ESTIMATORS)
        raise ConfigurationError(
            f"{configuration.path}: no section under estimators; name one of {known} by --estimator"
        )
    for name in names:
        if name not in ESTIMATORS:
            raise ConfigurationError(f"--estimator: '{name}' is not allowed; give one of {', '.join(ESTIMATORS)}")
    try:
        return {
            name: ESTIMATORS[name](configuration.robot, configuration.estimators.get(name), configuration.timing)
            for name in names
        }
    except ConfigurationError as error:
        raise ConfigurationError(f"{configuration.path}: {error}") from None
