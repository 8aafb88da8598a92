"""`jointest calibrate`: fits what the estimators need to a recording, and writes the calibration file."""

from __future__ import annotations

from typing import Any

from jointest_ros.cli import calibrate_accel, calibrate_axis, calibrate_gyro, calibrate_hall, calibrate_zero
from jointest_ros.cli.common import Parsers


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "calibrate",
        description="Fit what the estimators need to a recording, and write the calibration file that the "
        "configuration names by calibration_file. Each kind writes its own section and leaves the others.",
    )
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    calibrate_hall.add_parser(kinds)
    calibrate_accel.add_parser(kinds)
    calibrate_axis.add_parser(kinds)
    calibrate_zero.add_parser(kinds)
    calibrate_gyro.add_parser(kinds)
