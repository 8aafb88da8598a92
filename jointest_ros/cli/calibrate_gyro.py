"""`jointest calibrate gyro`: the scales of gyros by motion about hinges and gravity."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from rich.table import Table

from jointest_ros import config
from jointest_ros.cli.calibrate_common import add_options, command, finish, target_file
from jointest_ros.cli.calibrate_mountings import add_joints, chosen_pairs, joints_given, read_pairs
from jointest_ros.cli.common import Parsers, out, progress, warn
from jointest_ros.cli.tables import columns
from jointest_ros.config import calibration
from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.robot import UNCALIBRATED_SCALE
from jointest_ros.evaluation.gyro_calibration import (
    HingeInformation,
    Scale,
    calibrated,
    combine,
    hinge_information,
    why_unknown,
)
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.joint_pairs import Pair

_UNUSUAL = 0.05  # of a scale: more than data sheets allow


def add_parser(kinds: Parsers[Any]) -> None:
    """Declare the kind."""
    gyro = kinds.add_parser(
        "gyro",
        help="scales of gyros about the axes of hinges",
        description="Find the scale of each gyro about the axes of the hinges beside it, from a recording in which "
        "the joints move: what the gyros add up to is compared with what the accelerometers show. It needs no encoder.",
        epilog="Bend each joint to and fro as far as it goes for a minute or more, axes horizontal, while the first "
        "link turns about them too if it can; further is better, since an offset of an accelerometer looks like a "
        "wrong scale where it sees gravity from few sides. Run 'jointest calibrate accel' first if you can, and "
        "'jointest calibrate axis' if mountings are not known. Written is what is known to 1 %; it is 1 where the "
        "error is less than its standard deviation; axes of a gyro that are not those of a hinge stay as they are. In "
        "the table: error: true rate over reading, less 1; ±: standard deviation; along hinge: how much of the hinge's "
        "axis lies along that of the gyro; travel: of the joint.",
    )
    add_options(gyro)
    add_joints(gyro, "use")
    gyro.add_argument("--skip", type=float, default=0.0, metavar="S", help="leave out the first S seconds (default: 0)")
    gyro.add_argument("--duration", type=float, default=math.inf, metavar="S", help="use S seconds only (default: all)")
    gyro.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of `calibrate gyro`."""
    bag, loaded = arguments.bag, config.load(arguments.config)
    for name, value, least in (("--skip", arguments.skip, "0 or more"), ("--duration", arguments.duration, "some")):
        if not value >= 0.0 or (name == "--duration" and value == 0.0):
            raise CalibrationError(f"{name}: {value:g} is not allowed; give {least} seconds")
    raw = tuple(replace(sensor, gyro_scale=UNCALIBRATED_SCALE) for sensor in loaded.robot.sensors)
    configuration = replace(loaded, robot=replace(loaded.robot, sensors=raw))
    pairs, left_out = chosen_pairs(arguments, configuration)
    target = target_file(arguments, configuration)
    readings, when = read_pairs(arguments, configuration, pairs)
    for text in (*readings.warnings, *(f"{text}; left out" for text in left_out)):
        warn(text)
    hinges = _fit(arguments, readings.means, pairs)
    scales = combine(hinges)
    sensors = calibrated(loaded.robot.sensors, scales)
    unknown = list(_unknown(scales, hinges))
    if not sensors:
        raise CalibrationError(f"{bag}: {unknown[0]}; nothing was written")
    calibration.save_gyro(target, sensors, _heading(arguments, when, scales))
    for text in (*unknown, *_unusual(scales)):
        warn(text)
    for table in _tables(scales, hinges):
        out.print(table)
    out.print(f"{target}: gyro scales of {', '.join(sensor.name for sensor in sensors)}")
    return finish(arguments, configuration, target, readings.damage)


def _fit(arguments: argparse.Namespace, means: WindowMeans, pairs: Sequence[Pair]) -> list[HingeInformation]:
    part, hinges = means.between(arguments.skip, arguments.skip + arguments.duration), []
    with progress("fit") as report:
        for done, pair in enumerate(pairs):
            report(done, len(pairs))
            try:
                hinges.append(hinge_information(part, pair))
            except CalibrationError as error:
                raise CalibrationError(f"{arguments.bag}: joint '{pair.joint.name}': {error}") from None
    return hinges


def _unknown(scales: Sequence[Scale], hinges: Sequence[HingeInformation]) -> Iterator[str]:
    """Why nothing is known of a sensor."""
    for sensor in dict.fromkeys(one.sensor for one in scales):
        if not any(one.known for one in scales if one.sensor == sensor):
            yield f"sensor '{sensor}': scale not found: {why_unknown(sensor, scales, hinges)}"


def _unusual(scales: Sequence[Scale]) -> Iterator[str]:
    for one in scales:
        if one.known and abs(one.scale - 1.0) > _UNUSUAL:
            yield (
                f"sensor '{one.sensor}': the {'xyz'[one.axis]} axis is off by {100.0 * (one.scale - 1.0):+.1f} %, more "
                "than data sheets allow; check its range and unit, and the axis of the hinge"
            )


def _tables(scales: Sequence[Scale], hinges: Sequence[HingeInformation]) -> Iterator[Table]:
    found = columns("gyro scales", ["sensor", "axis"], ["error\n%", "±\n%", "scale\nwritten", "along\nhinge"])
    for one in scales:
        if one.known:
            found.add_row(one.sensor, "xyz"[one.axis], *_figures(one), f"{one.corrected:.4f}", f"{one.hinge:.2f}")
    moved = columns("motion", ["joint"], ["travel\ndeg", "axis from\ngravity, deg", "left over\nm/s^2"])
    for hinge in hinges:
        angles = (f"{math.degrees(angle):.0f}" for angle in (hinge.travel, hinge.tilt))
        moved.add_row(hinge.pair.joint.name, *angles, f"{hinge.residual:.3f}")
    yield from (found, moved)


def _figures(one: Scale) -> tuple[str, str]:
    return f"{100.0 * (one.scale - 1.0):+.2f}", f"{100.0 * one.std:.2f}"


def _heading(arguments: argparse.Namespace, when: str, scales: Sequence[Scale]) -> str:
    """The comment of the section: what it is, from where, and how well it is known."""
    options = joints_given(arguments) + ([f"--skip {arguments.skip:g}"] if arguments.skip else [])
    options += [f"--duration {arguments.duration:g}"] if math.isfinite(arguments.duration) else []
    lines = [
        f"Gyro scales by: {command(arguments, 'gyro', *options)}",
        f"Recording: {when}.",
        "Errors found, with standard deviation (smaller ones are not corrected); the other axes are as they were:",
    ]
    for one in scales:
        if one.known:
            error, std = _figures(one)
            lines.append(f"  {one.sensor} {'xyz'[one.axis]}: {error} % ± {std} %")
    return "\n".join(lines)
