"""What the sub-commands share: the console, progress on standard error, loading of configurations."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from jointest_ros.config import Configuration, calibration
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.errors import ConfigurationError, JointestError
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.params import Params, allowed_text
from jointest_ros.core.progress import no_progress
from jointest_ros.nodes.at_hand import ros_at_hand

_NARROWEST = 8  # characters that a column of text keeps on a narrow terminal


class TableConsole(Console):
    """A console on which tables keep their numbers, and names that do not wrap, whole on the narrowest terminal."""

    def print(self, *objects: Any, **options: Any) -> None:
        for table in objects:
            for column in table.columns if isinstance(table, Table) else ():
                width = max((cell_len(line) for cell in column.cells for line in str(cell).splitlines()), default=0)
                whole = column.no_wrap or column.justify == "right"
                column.min_width = width if whole else min(width, _NARROWEST)
                column.no_wrap, column.overflow = False, "fold"  # headings, and what is left
        super().print(*objects, **options)


# Names and paths are shown as they are, whatever rich would make of brackets and colons in them.
_PIPE_WIDTH = None if sys.stdout.isatty() or "COLUMNS" in os.environ else 160  # rich would fold tables at 80 there
out = TableConsole(width=_PIPE_WIDTH, soft_wrap=True, highlight=False, markup=False, emoji=False)  # results
err = Console(stderr=True, soft_wrap=True, highlight=False, markup=False, emoji=False)  # progress, warnings, errors

Parsers = argparse._SubParsersAction  # what `add_parser` functions get


class OutputError(JointestError):
    """A file of results cannot be written."""


@contextmanager
def needs_ros(on_this_host: bool = True) -> Iterator[None]:
    """Around the import of what uses ROS 2, which then stays on this host unless it is to hear others.

    Raises:
        NoRosError: it is not there.
    """
    if on_this_host:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with ros_at_hand():
        yield


@contextmanager
def progress(description: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on standard error, where that is a terminal; gone when done. Call with (done, total)."""
    if not err.is_terminal:  # rich would leave an empty line there
        yield no_progress
        return
    columns = TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task(description, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def warn(text: str) -> None:
    """One line of warning on standard error."""
    err.print(f"warning: {text}", style="yellow")


def tell_calibration(configuration: Configuration) -> None:
    """One line on standard error where a calibration file takes precedence over the configuration."""
    file = configuration.calibration_file
    if file is not None and (sections := calibration.sections_of(file)):
        err.print(f"{file}: calibration in use ({', '.join(sections)})")


def complain(command: str, text: object) -> None:
    """One line of error on standard error."""
    err.print(f"jointest {command}: error: {text}")


def smoothers(estimators: dict[str, Estimator]) -> dict[str, Any]:
    """Those that can smooth. Raises ConfigurationError when none can."""
    able = {name: estimator for name, estimator in estimators.items() if hasattr(estimator, "smooth")}
    if not able:
        raise ConfigurationError(f"--smooth: {', '.join(estimators)} cannot smooth; accel_ekf with model: joint can")
    return able


def write_text(path: Path, text: str) -> None:
    """Write a whole file. Raises OutputError when it cannot be written."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from None


def write_json(target: str, document: Any) -> None:
    """Figures into a file, or to standard output ("-"). Raises OutputError."""
    text = json.dumps(document, indent=2, allow_nan=False)
    if target == "-":
        out.print(text)
        return
    write_text(Path(target), text + "\n")
    out.print(f"{target}: figures")


def add_params(parser: argparse.ArgumentParser, kind: type[Params]) -> None:
    """An option for each declared parameter; its range is checked where it is declared."""
    for spec in dataclasses.fields(kind):
        default: Any = spec.default
        allowed = "" if isinstance(default, bool) else f"{allowed_text(spec)}; "
        shown = ("on" if default else "off") if isinstance(default, bool) else default
        text = f"{spec.metadata['description']} ({allowed}default: {shown})".replace("%", "%%")
        options: dict[str, Any] = {"type": type(default), "metavar": "X"}
        if isinstance(default, bool):
            options = {"action": argparse.BooleanOptionalAction}
        parser.add_argument(f"--{param_flag(spec)}", dest=spec.name, default=default, help=text, **options)


def given_params(arguments: argparse.Namespace, kind: type[Params]) -> dict[str, Any]:
    """What was given for the parameters that `add_params` declared, by their names."""
    return {spec.name: getattr(arguments, spec.name) for spec in dataclasses.fields(kind)}


def param_flag(spec: dataclasses.Field[Any]) -> str:
    """The name of a parameter's option: without its unit."""
    return spec.name.removesuffix("_hz").removesuffix("_s").removesuffix("_deg").replace("_", "-")


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
