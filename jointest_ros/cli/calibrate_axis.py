"""`jointest calibrate axis`: joint axes in the frames of the IMUs, from motion, and the mountings that follow."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from typing import Any

from rich.table import Table

from jointest_ros import config
from jointest_ros.cli.calibrate_common import add_options, command, finish, picture_file, target_file
from jointest_ros.cli.calibrate_mountings import add_joints, chosen_pairs, joints_given, read_pairs, save
from jointest_ros.cli.common import Parsers, out, progress, warn
from jointest_ros.cli.tables import columns
from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.robot import Robot, Sensor
from jointest_ros.evaluation import axis_plot
from jointest_ros.evaluation.axis_advice import advice, refusal
from jointest_ros.evaluation.axis_calibration import fit_axes
from jointest_ros.evaluation.axis_fit import Axis, AxisFit
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.joint_pairs import Pair, hinge_pairs
from jointest_ros.evaluation.mounting_fit import SeenAxis, aligned, turned
from jointest_ros.evaluation.two_axis_calibration import fit_two_axes

_PICTURE = "_axis.png"
_AS_BEFORE = math.radians(1.0)  # of an axis that is not identified now: it only decides what the others leave open
_LEFT_OVER = math.radians(0.2)  # worth a word


def add_parser(kinds: Parsers[Any]) -> None:
    """Declare the kind."""
    axis = kinds.add_parser(
        "axis",
        help="axes of joints in the frames of the IMUs, from motion",
        description="Find the axis of each hinge in the frames of both IMUs beside it, and of each joint of two axes "
        "the first one in the parent's and the second one in the child's, from a recording in which the robot moves, "
        "and write the mountings of the IMUs that follow. They need not be known before, but to 45 deg for two axes.",
        epilog="Hold the robot still for a few seconds, then move all joints while the first link turns about several "
        "directions, for a minute. What this cannot find stays as configured: the rotation about an axis, which "
        "'jointest calibrate zero' sets, and which of its two directions is positive. In the table: ±: standard "
        "deviation in the worst direction; turned: from the configured axis; left over: the part of the rates across "
        "the axis that no motion of the joint explains, before: with the configured axis, noise: by the data sheet.",
    )
    add_options(axis, shown="axes and residuals", ending=_PICTURE)
    add_joints(axis, "identify")
    axis.add_argument(
        "--keep",
        action="append",
        default=[],
        metavar="SENSOR",
        help="the mounting of this sensor is right as configured: of one whose link cannot be turned; may be repeated",
    )
    axis.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of `calibrate axis`."""
    bag, configuration = arguments.bag, config.load(arguments.config)
    pairs, left_out = chosen_pairs(arguments, configuration, 2)
    kept = _kept(arguments, pairs)
    target = target_file(arguments, configuration)
    picture = picture_file(arguments, target, _PICTURE)
    readings, when = read_pairs(arguments, configuration, pairs)
    fits = _fit(arguments, readings.means, pairs, kept)
    for text in (*readings.warnings, *(f"{text}; left out" for text in left_out)):
        warn(text)
    for table in _tables(fits):
        out.print(table)
    if refused := [(fit.pair.joint.name, text) for fit in fits if (text := refusal(fit))]:
        others = f"; likewise {', '.join(name for name, _ in refused[1:])}" if refused[1:] else ""
        raise CalibrationError(f"{bag}: joint '{refused[0][0]}': {refused[0][1]}{others}; nothing was written")
    axis_plot.draw(picture, when, fits)
    sensors = [s for s in {s.name: s for fit in fits for s in fit.pair.sensors}.values() if s.name not in kept]
    seen = {sensor.name: _seen(configuration.robot, sensor, fits) for sensor in sensors}
    fitted = {sensor.name: aligned(sensor.mounting, list(seen[sensor.name].values())) for sensor in sensors}
    save(target, sensors, {name: mounting for name, (mounting, _) in fitted.items()}, _heading(arguments, when, fits))
    for fit in fits:
        for text in advice(fit):
            warn(f"joint '{fit.pair.joint.name}': {text}")
    over = {name: dict(zip(seen[name], angles, strict=True)) for name, (_, angles) in fitted.items()}
    for text in _left_over(fits, over):
        warn(text)
    table = columns("mountings", ["sensor"], ["turned\ndeg", "left over of\nits axes, deg"])
    for sensor in sensors:
        worst = max(over[sensor.name][fit.pair.joint.name] for fit in fits if sensor in fit.pair.sensors)
        turn = turned(sensor, fitted[sensor.name][0])
        table.add_row(sensor.name, f"{math.degrees(turn):.2f}", f"{math.degrees(worst):.3f}")
    out.print(table)
    out.print(f"{target}: mountings of {', '.join(sensor.name for sensor in sensors)}")
    out.print(f"{picture}: axes and residuals")
    return finish(arguments, configuration, target, readings.damage)


def _kept(arguments: argparse.Namespace, pairs: Sequence[Pair]) -> frozenset[str]:
    """The sensors of --keep. Raises ConfigurationError."""
    names = list(dict.fromkeys(sensor.name for pair in pairs for sensor in pair.sensors))
    for name in arguments.keep:
        if name not in names:
            raise ConfigurationError(f"--keep: '{name}' is no sensor of these joints; known: {', '.join(names)}")
    for pair in pairs:
        if all(sensor.name in arguments.keep for sensor in pair.sensors):
            raise ConfigurationError(
                f"--keep: both sensors of joint '{pair.joint.name}' are to be kept; choose joints by --joint"
            )
    return frozenset(arguments.keep)


def _fit(
    arguments: argparse.Namespace, means: WindowMeans, pairs: Sequence[Pair], kept: frozenset[str]
) -> list[AxisFit]:
    fits = []
    with progress("identify") as report:
        for done, pair in enumerate(pairs):
            report(done, len(pairs))
            try:
                fit = fit_axes if len(pair.joint.axes) == 1 else fit_two_axes
                fits.append(fit(means, pair, kept))
            except CalibrationError as error:
                raise CalibrationError(f"{arguments.bag}: joint '{pair.joint.name}': {error}") from None
    return fits


def _seen(robot: Robot, sensor: Sensor, fits: Sequence[AxisFit]) -> dict[str, SeenAxis]:
    """The axes in a sensor by joint: the identified ones, and the others of its joints as they were."""
    axes: dict[str, SeenAxis] = {}
    for pair in hinge_pairs(robot, most_axes=2)[0]:
        for one, before, link_axis in zip(pair.sensors, pair.configured(), pair.link_axes, strict=True):
            if one.name == sensor.name:
                axes[pair.joint.name] = SeenAxis(before, link_axis, _AS_BEFORE)
    for fit in fits:
        for axis, link_axis in zip(fit.axes, fit.pair.link_axes, strict=True):
            if axis.sensor == sensor.name:
                axes[fit.pair.joint.name] = SeenAxis(axis.axis, link_axis, axis.std)
    return axes


def _left_over(fits: Sequence[AxisFit], over: dict[str, dict[str, float]]) -> Iterator[str]:
    """Sensors whose axes do not agree with each other as configured."""
    stds = {(axis.sensor, fit.pair.joint.name): axis.std for fit in fits for axis in fit.axes if not axis.kept}
    for sensor in dict.fromkeys(sensor for sensor, _ in stds):
        joints = {joint: angle for joint, angle in over[sensor].items() if (sensor, joint) in stds}
        worst = max(joints, key=lambda joint: joints[joint])
        if joints[worst] > max(_LEFT_OVER, 3.0 * max(stds[sensor, joint] for joint in joints)):
            yield (
                f"sensor '{sensor}': its axes are not to each other as configured, joint '{worst}' is off by "
                f"{math.degrees(joints[worst]):.2f} deg with any mounting; check axis of {', '.join(joints)}"
            )


def _tables(fits: Sequence[AxisFit]) -> Iterator[Table]:
    axes = columns("identified axes", ["joint", "sensor"], ["x\n", "y\n", "z\n", "±\ndeg", "turned\ndeg"])
    rates = columns(
        "rates, deg/s rms", ["joint"], ["of the\njoint", "parent\nacross it", "left\nover", "before\n", "noise\n"]
    )
    for fit in fits:
        names = fit.pair.joint.coordinates
        for axis, name in zip(fit.axes, names if len(names) > 1 else (*names, ""), strict=True):
            vector = _components(axis) if axis.determined else ["-"] * 3
            change = f"{math.degrees(axis.change):.2f}" if axis.determined else "-"
            axes.add_row(name, axis.sensor, *vector, _std(axis), change)
        moved = (f"{math.degrees(rate):.1f}" for rate in (fit.joint_rate, fit.across_rate))
        left = (f"{math.degrees(rate):.3f}" for rate in (fit.residual, fit.residual_before, fit.noise))
        rates.add_row(fit.pair.joint.name, *moved, *left)
    yield from (axes, rates)


def _components(axis: Axis) -> list[str]:
    return [f"{round(float(component), 4) + 0.0:.4f}" for component in axis.axis]


def _std(axis: Axis) -> str:
    if axis.kept:
        return "kept"
    return f"{math.degrees(axis.std):.3f}" if axis.determined else "undetermined"


def _heading(arguments: argparse.Namespace, when: str, fits: Sequence[AxisFit]) -> str:
    """The comment of the section: what it is, from where, and how well it fits."""
    options = [*joints_given(arguments), *(f"--keep {name}" for name in arguments.keep)]
    lines = [
        f"Axes by: {command(arguments, 'axis', *options)}",
        f"Recording: {when}.",
        "Axis in each sensor, standard deviation; rms of the rates that are left over:",
    ]
    for fit in fits:
        axes = (
            f"{a.sensor} ({', '.join(_components(a))}) {'kept' if a.kept else f'± {_std(a)} deg'}" for a in fit.axes
        )
        lines.append(f"  {fit.pair.joint.name}: {', '.join(axes)}; {math.degrees(fit.residual):.3f} deg/s")
    return "\n".join(lines)
