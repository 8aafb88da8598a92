"""`jointest calibrate accel`: matrix and offset of accelerometers by the still poses of a recording."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jointest_ros import config
from jointest_ros.bags.accel_readings import AccelReadings, read_accel
from jointest_ros.bags.reader import BagReader
from jointest_ros.cli import calibrate_accel_report as report_of
from jointest_ros.cli.calibrate_common import add_options, command, finish, picture_file, recorded, target_file
from jointest_ros.cli.common import Parsers, out, progress, warn
from jointest_ros.config import Configuration, calibration
from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.frame import Vec3, vec3
from jointest_ros.core.robot import STANDARD_GRAVITY, Robot, Sensor
from jointest_ros.evaluation import accel_plot
from jointest_ros.evaluation.accel_calibration import AccelFit, fit_directions, fit_norm
from jointest_ros.evaluation.accel_plot import FittedAccel
from jointest_ros.evaluation.accel_poses import (
    Pose,
    StillPhases,
    axes_up,
    find_poses,
    in_sensor_frame,
    name_of,
    read_directions,
)

METHODS = ("directions", "norm")
_GRAVITIES = (9.0, 10.5)  # m/s^2, on Earth and then some
_CONES = (1.0, 44.0)  # deg; from 45 deg on two axes would do

Directions = dict[str, list[Vec3 | None]]  # link -> direction that points up in each pose, None: not to be used


def add_parser(kinds: Parsers[Any]) -> None:
    """Declare the kind."""
    accel = kinds.add_parser(
        "accel",
        help="matrix and offset of every accelerometer",
        description="Fit acceleration = matrix reading + offset of every accelerometer by poses in which the robot is "
        "held still, each with another direction of its links up.",
        epilog="Hold each pose for 2 s or longer, on something firm: a tilt of 0.1 deg is 1.7 mg. The six poses with "
        "+-x, +-y, +-z of the link up give all 12 unknowns, and so do any four or more that do not lie in one plane. "
        "Poses in one plane, such as a planar arm can take, give what counts in that plane; the rest stays as "
        "configured. In the tables: rank: of the 12 unknowns; condition: how unevenly the poses tell (1.7 for the six "
        "axes); before, after: rms of what the poses leave, as configured and as fitted; ±: standard deviations.",
    )
    add_options(accel, shown="what each pose leaves, before and after")
    accel.add_argument(
        "--poses",
        action="append",
        default=[],
        metavar="[LINK:]LIST",
        help="which direction of the link points up in each still phase, in their order: +x,-x,+y,-y,+z,-z; 0/0.6/0.8 "
        "for others, ? for a phase not to be used (--poses=-x,+x where it begins with -); for all links, or for LINK, "
        "may be repeated (default: the axis of the link that is up within --cone)",
    )
    accel.add_argument(
        "--cone", type=float, default=20.0, metavar="DEG", help="how far an axis may be from up (default: %(default)g)"
    )
    accel.add_argument(
        "--method",
        choices=METHODS,
        default=METHODS[0],
        help="norm: no directions, only that every pose reads g; nine or more poses in all directions, and how a "
        "sensor is turned on its link stays unknown (default: %(default)s)",
    )
    accel.add_argument(
        "--shortest",
        type=float,
        default=1.0,
        metavar="S",
        help="shorter still phases are no poses; the first and last 0.2 s do not count (default: %(default)g)",
    )
    accel.add_argument(
        "--gravity",
        type=float,
        default=STANDARD_GRAVITY,
        metavar="M/S2",
        help="where it was recorded: 9.780 at the equator, 9.832 at the poles (default: %(default)g)",
    )
    accel.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of `calibrate accel`."""
    bag, configuration, gravity = arguments.bag, config.load(arguments.config), arguments.gravity
    _check(arguments, configuration)
    given = _given(arguments.poses, configuration.robot)
    target = target_file(arguments, configuration)
    picture = picture_file(arguments, target)
    with BagReader(bag) as reader, progress(f"read {bag}") as report:
        readings = read_accel(reader, configuration.robot, configuration.timing, arguments.namespace, report)
        when = recorded(bag, reader)
    try:
        fitted, refused = _fit(arguments, configuration.robot, readings, given)
    except CalibrationError as error:
        raise CalibrationError(f"{bag}: {error}") from None
    accel_plot.draw(picture, when, fitted, gravity)
    sensors = [_calibrated(configuration.robot.sensor(one.name), one.fit) for one in fitted]
    calibration.save_accel(target, sensors, report_of.heading(_command(arguments), when, fitted, gravity))
    for text in (*readings.warnings, *refused, *report_of.advice(fitted, gravity)):
        warn(text)
    out.print(report_of.quality_table(fitted, gravity))
    out.print(report_of.parameter_table(fitted, gravity))
    number = sum(sensor.accel for sensor in configuration.robot.sensors)
    out.print(f"{target}: {len(fitted)} of {number} accelerometers fitted")
    out.print(f"{picture}: what each pose leaves, before and after")
    return finish(arguments, configuration, target, readings.damage)


def _check(arguments: argparse.Namespace, configuration: Configuration) -> None:
    if not any(sensor.accel for sensor in configuration.robot.sensors):
        raise ConfigurationError(f"{arguments.config}: sensors: none with an accelerometer")
    for name, value, (low, high), unit in (
        ("--gravity", arguments.gravity, _GRAVITIES, "m/s^2"),
        ("--cone", arguments.cone, _CONES, "deg"),
        ("--shortest", arguments.shortest, (0.0, 3600.0), "s"),
    ):
        if not low <= value <= high:
            raise CalibrationError(f"{name}: {value} is not allowed; give {low:g} to {high:g} {unit}")
    if arguments.poses and arguments.method == "norm":
        raise CalibrationError("--poses: is of no use with --method norm; leave one of them out")


def _given(texts: Sequence[str], robot: Robot) -> Directions:
    """What --poses says, by link."""
    given: Directions = {}
    for text in texts:
        link, colon, directions = text.rpartition(":")
        if colon and link not in robot.links:
            raise CalibrationError(f"--poses: '{link}' is not a link; known: {', '.join(robot.links)}")
        try:
            given |= dict.fromkeys([link] if colon else robot.links, read_directions(directions))
        except CalibrationError as error:
            raise CalibrationError(f"--poses: {error}") from None
    return given


def _command(arguments: argparse.Namespace) -> str:
    options = [f"--poses={poses}" for poses in arguments.poses]
    return command(arguments, "accel", *options, *(["--method norm"] if arguments.method == "norm" else []))


def _fit(
    arguments: argparse.Namespace, robot: Robot, readings: AccelReadings, given: Directions
) -> tuple[list[FittedAccel], list[str]]:
    """The sensors that could be fitted, and why the others could not. Raises CalibrationError when none could."""
    phases = find_poses(readings.stamps, readings.accel, arguments.shortest)
    if not phases.poses:
        raise CalibrationError(f"{phases}; hold the robot still in each pose for {arguments.shortest + 1.0:g} s")
    fitted: list[FittedAccel] = []
    refused = [f"'{s.name}': no reading" for s in robot.sensors if s.accel and s.name not in readings.accel]
    for link in robot.links:
        sensors = [sensor for sensor in robot.sensors_on(link) if sensor.name in readings.accel]
        up = _directions(arguments, phases, sensors, given.get(link))
        for sensor in sensors:
            try:
                fitted.append(_fit_one(arguments, sensor, phases.poses, up))
            except CalibrationError as error:
                refused.append(f"'{sensor.name}': {error}")
    if not fitted:
        raise CalibrationError(f"{phases}; {refused[0]}")
    return fitted, [f"not calibrated: {text}" for text in refused]


def _directions(
    arguments: argparse.Namespace, phases: StillPhases, sensors: Sequence[Sensor], given: list[Vec3 | None] | None
) -> list[Vec3 | None]:
    """The direction of a link that points up in each pose."""
    if arguments.method == "norm":
        return [None] * len(phases.poses)
    if given is not None and len(given) == len(phases.poses):
        return given
    found = axes_up(phases.poses, sensors, math.radians(arguments.cone))
    if given is None:
        return found
    seen = f"{','.join(map(name_of, found))} of '{sensors[0].link}'" if sensors else "nothing"
    raise CalibrationError(f"--poses: {len(given)} directions, but {phases}; by the readings up was {seen}")


def _fit_one(
    arguments: argparse.Namespace, sensor: Sensor, poses: Sequence[Pose], up: Sequence[Vec3 | None]
) -> FittedAccel:
    norm = arguments.method == "norm"
    used = [(pose, direction) for pose, direction in zip(poses, up, strict=True) if norm or direction]
    readings = np.array([pose.mean[sensor.name] for pose, _ in used]).reshape(-1, 3)
    errors = np.array([pose.error[sensor.name] for pose, _ in used]).reshape(-1, 3)
    if norm:
        fit = fit_norm(readings, errors, sensor, arguments.gravity)
    else:
        known = in_sensor_frame([direction for _, direction in used if direction], sensor)
        fit = fit_directions(readings, errors, known, sensor, arguments.gravity)
    names = [f"{number}" if norm else name_of(direction) for number, (_, direction) in enumerate(used, 1)]
    return FittedAccel(sensor.name, tuple(names), fit)


def _calibrated(sensor: Sensor, fit: AccelFit) -> Sensor:
    x, y, z = map(vec3, fit.matrix)
    return replace(sensor, accel_matrix=(x, y, z), accel_offset=vec3(fit.offset))
