"""The options of commands that do many things at a time."""

from __future__ import annotations

import argparse
from pathlib import Path

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.evaluation.jobs import Workers


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Declare them."""
    group = parser.add_argument_group("many at a time (docs/many.md)")
    group.add_argument(
        "--jobs",
        "-j",
        type=int,
        metavar="N",
        help="processes on this machine, each with memory of its own; 1: one after the other (default: one a core)",
    )
    group.add_argument(
        "--scheduler",
        default="",
        metavar="ADDRESS",
        help="on the Dask cluster whose scheduler is there, as tcp://HOST:8786; needs pip install "
        "'jointest_ros[cluster]' here and on its workers",
    )
    group.add_argument(
        "--resume",
        type=Path,
        metavar="DIR",
        help="keep each result in DIR as soon as it is there, and take from there what was done before: the same "
        "command goes on where it was broken off",
    )


def given_workers(arguments: argparse.Namespace) -> Workers:
    """What was chosen. Raises ConfigurationError."""
    jobs = arguments.jobs
    if jobs is not None and jobs < 1:
        raise ConfigurationError(f"--jobs: {jobs} is not allowed; give 1 or more")
    if jobs is not None and arguments.scheduler:
        raise ConfigurationError("--jobs: of no use with --scheduler, whose cluster has its own number of workers")
    return Workers(jobs or 0, arguments.scheduler, arguments.resume)
