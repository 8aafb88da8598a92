"""What the kinds of `jointest calibrate` share: their options, the files that they write, and what they say of them."""

from __future__ import annotations

import argparse
import os
from datetime import datetime, timezone
from pathlib import Path

from jointest_ros.bags.reader import BagReader
from jointest_ros.cli.common import OutputError, complain, out
from jointest_ros.config import Configuration, calibration
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.evaluation import plots


def add_options(parser: argparse.ArgumentParser, shown: str = "", ending: str = ".png") -> None:
    """Recording, configuration and what is written; with --plot where there is something `shown` in a picture."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2 directory, or a .mcap or .db3 file")
    parser.add_argument("--config", "-c", required=True, type=Path, metavar="YAML", help="the robot's configuration")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="default: the configuration's calibration_file"
    )
    if shown:
        parser.add_argument("--plot", type=Path, metavar="FILE", help=f"{shown}; default: <output>{ending}")
    parser.add_argument("--namespace", default="", metavar="NS", help="namespace of the topics in the recording")


def target_file(arguments: argparse.Namespace, configuration: Configuration) -> Path:
    """The calibration file to write. Raises ConfigurationError, OutputError before anything is read or written."""
    target: Path | None = arguments.output or configuration.calibration_file
    if target is None:
        raise ConfigurationError(f"{arguments.config}: calibration_file: none; name a file there, or give -o FILE")
    if target.resolve() == arguments.config.resolve():
        raise OutputError(f"{target}: is the configuration, which is never written; choose another name")
    try:
        calibration.load(target, configuration.robot)
    except ConfigurationError as error:
        raise OutputError(f"{error}; it is no calibration of this robot, and stays: choose another name") from None
    return target


def picture_file(arguments: argparse.Namespace, target: Path, ending: str = ".png") -> Path:
    """The picture to draw. Raises PlotError for another suffix, OutputError where it is the calibration file."""
    picture: Path = arguments.plot or target.with_name(target.stem + ending)
    plots.check_suffix(picture)
    if picture.resolve() == target.resolve():
        raise OutputError(f"{picture}: is the calibration file; choose another name for one of them")
    return picture


def recorded(bag: Path, reader: BagReader) -> str:
    """Which recording it was: for headings and titles."""
    start = datetime.fromtimestamp(reader.start_ns * 1e-9, timezone.utc)
    return f"{bag.resolve().name}, recorded {start:%Y-%m-%d %H:%M:%S} UTC by its stamps"


def command(arguments: argparse.Namespace, kind: str, *options: str) -> str:
    """The call, for a heading."""
    return " ".join([f"jointest calibrate {kind} {arguments.bag.name} --config {arguments.config.name}", *options])


def finish(arguments: argparse.Namespace, configuration: Configuration, target: Path, damage: str) -> int:
    """Say how the file is used and what was not read of the recording; the exit code."""
    if configuration.calibration_file is None or target.resolve() != configuration.calibration_file.resolve():
        name = os.path.relpath(target.resolve(), arguments.config.resolve().parent)
        out.print(f"to use it, write into {arguments.config}: calibration_file: {name}")
    if damage:
        complain("calibrate", f"{damage}; the calibration rests on what came before")
        return 2
    return 0
