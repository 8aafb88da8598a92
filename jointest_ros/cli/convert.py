"""`jointest convert`: a public recording becomes a rosbag2 with ground truth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from jointest_ros.bags.convert import FORMATS
from jointest_ros.cli.common import Parsers, add_params, given_params, out, progress
from jointest_ros.core.errors import counted


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "convert",
        description="Turn a public recording into a rosbag2 recording with imu/<sensor> topics and ground truth.",
        epilog="formats:\n" + "\n".join(f"  {name:8} {entry.description}" for name, entry in FORMATS.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    formats = parser.add_subparsers(dest="format", metavar="FORMAT", required=True)
    for name, entry in FORMATS.items():
        one = formats.add_parser(name, description=f"Convert: {entry.description}.")
        one.add_argument("source", type=Path, metavar="SRC", help="the file as its authors published it")
        one.add_argument(
            "-o", "--output", required=True, type=Path, metavar="BAG", help="directory of the new recording"
        )
        one.add_argument("--storage", choices=("mcap", "sqlite3"), default="mcap", help="default: %(default)s")
        one.add_argument("--overwrite", action="store_true", help="replace a recording of that name")
        add_params(one, entry.options)
        one.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of the command."""
    entry = FORMATS[arguments.format]
    options = given_params(arguments, entry.options)
    with progress(f"convert {arguments.source.name}") as report:
        summary = entry.function(
            arguments.source, arguments.output, arguments.storage, report, arguments.overwrite, **options
        )
    out.print(f"{summary.bag}: {summary.duration_s:.1f} s")
    for topic, count in summary.messages.items():
        out.print(f"  {topic}  {counted(count, 'message')}")
    for note in summary.notes:
        out.print(f"  {note}")
    return 0
