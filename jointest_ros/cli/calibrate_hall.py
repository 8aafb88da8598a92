"""`jointest calibrate hall`: curve and noise of Hall sensors by a recording with a reference of the joint angles."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from jointest_ros import config
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.ground_truth import TRUTH_JOINTS
from jointest_ros.bags.hall_readings import HallReadings, read_hall
from jointest_ros.bags.reader import BagReader
from jointest_ros.cli.calibrate_common import (
    add_options,
    command,
    finish,
    picture_file,
    recorded,
    target_file,
)
from jointest_ros.cli.common import Parsers, out, progress, warn
from jointest_ros.cli.tables import columns
from jointest_ros.config import Configuration, calibration
from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.hall_sensor import HallSensor
from jointest_ros.evaluation import hall_plot
from jointest_ros.evaluation.hall_calibration import CURVES, fit_hall
from jointest_ros.evaluation.hall_plot import FittedSensor
from jointest_ros.evaluation.hall_recording import advice, reference_at


def add_parser(kinds: Parsers[Any]) -> None:
    """Declare the kind."""
    hall = kinds.add_parser(
        "hall",
        help="curve and noise of every Hall sensor",
        description="Fit curve and noise of every Hall sensor to a reference of the joint angles in the recording "
        f"(topic {TRUTH_JOINTS}: an encoder, a goniometer). Joints without a reference keep what they have, so that "
        "one goniometer does for all joints, one recording after the other.",
        epilog="Move each joint slowly through all of its range and back, a few times. The least squares are those of "
        "the voltage; readings at the sensor's rails (hall_range) do not count; outliers count little. An offset of "
        "the voltage becomes part of the curve. In the table: used: share of the readings that count; rms: of the "
        "residuals, with lag and play; curve ±: standard deviation of the fitted curve where it is least certain, from "
        "noise alone; lag: of the voltages behind the reference; play: width of the loop of hysteresis.",
    )
    add_options(hall, shown="readings, curves and residuals")
    hall.add_argument(
        "--curve",
        choices=CURVES,
        default=CURVES[0],
        help="a exp(b V) - c exp(-d V), or a monotone spline of ten points (default: %(default)s)",
    )
    hall.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of `calibrate hall`."""
    bag, configuration = arguments.bag, config.load(arguments.config)
    if not configuration.robot.hall:
        raise ConfigurationError(f"{arguments.config}: hall: none; list the sensors in the order of the voltages")
    target = target_file(arguments, configuration)
    picture = picture_file(arguments, target)
    with BagReader(bag) as reader, progress(f"read {bag}") as report:
        readings = read_hall(reader, configuration.robot, configuration.timing, arguments.namespace, report)
        when = recorded(bag, reader)
    fitted = _fit(bag, configuration, readings, arguments.curve)
    hall_plot.draw(picture, when, list(fitted.values()))
    sensors = configuration.robot.hall
    results = [fitted[k].fit.sensor if k in fitted else sensor for k, sensor in enumerate(sensors)]
    calibration.save_hall(target, results, _heading(arguments, when, _names(sensors), fitted))
    for text in (*readings.warnings, *_advice(configuration, readings, fitted)):
        warn(text)
    out.print(_table(fitted))
    if kept := [name for k, name in enumerate(_names(sensors)) if k not in fitted]:
        out.print(f"as they were, without reference or reading: {', '.join(kept)}")
    out.print(f"{target}: {len(fitted)} of {len(sensors)} Hall sensors fitted")
    out.print(f"{picture}: readings, curves and residuals")
    return finish(arguments, configuration, target, readings.damage)


def _fit(bag: Path, configuration: Configuration, readings: HallReadings, curve: str) -> dict[int, FittedSensor]:
    """Number of the sensor -> its fit, for sensors that have a reference and a reading."""
    truth, sensors = readings.truth, configuration.robot.hall
    fitted: dict[int, FittedSensor] = {}
    referenced = [k for k, sensor in enumerate(sensors) if np.isfinite(truth.position.get(sensor.joint, np.nan)).any()]
    if not referenced:
        wanted = ", ".join(dict.fromkeys(sensor.joint for sensor in sensors))
        raise BagError(f"{bag}: {TRUTH_JOINTS}: no angle of {wanted}; it has: {', '.join(truth.position) or 'nothing'}")
    with progress("fit") as report:
        for done, k in enumerate(referenced):
            sensor, name, volts = sensors[k], _names(sensors)[k], readings.volts[:, k]
            report(done, len(referenced))
            if np.isnan(volts).all():
                continue
            reference = reference_at(readings.stamps, truth.stamps, truth.position[sensor.joint])
            if np.isnan(reference).all():
                raise BagError(f"{bag}: the reference of {sensor.joint} and the voltages have no stamps in common")
            try:
                fit = fit_hall(readings.time, volts, reference, sensor, curve)
            except CalibrationError as error:
                raise CalibrationError(f"{bag}: {name}: {error}") from None
            fitted[k] = FittedSensor(name, volts, reference, fit, sensor)
    if not fitted:
        raise BagError(f"{bag}: the sensors with a reference gave no voltage (NaN throughout)")
    return fitted


def _advice(configuration: Configuration, readings: HallReadings, fitted: dict[int, FittedSensor]) -> Iterator[str]:
    limits = {
        name: pair
        for joint in configuration.robot.joints
        for name, pair in zip(joint.coordinates, joint.limits or (), strict=False)
    }
    for one in fitted.values():
        for text in advice(one.fit, readings.time, one.reference, one.configured, limits.get(one.configured.joint)):
            yield f"{one.name}: {text}"


def _names(sensors: Sequence[HallSensor]) -> list[str]:
    """Joint and number of each sensor, as `hall: sensor:` counts them."""
    joints = [sensor.joint for sensor in sensors]
    return [f"{joint} #{joints[: k + 1].count(joint)}" for k, joint in enumerate(joints)]


def _heading(arguments: argparse.Namespace, when: str, names: list[str], fitted: dict[int, FittedSensor]) -> str:
    """The comment of the file: what it is, from where, and how well it fits."""
    options = [f"--curve {arguments.curve}"] if arguments.curve != CURVES[0] else []
    lines = [
        f"Hall sensors by: {command(arguments, 'hall', *options)}",
        f"Recording: {when}; reference {TRUTH_JOINTS}.",
        "In the order of the configuration. An offset of a voltage is part of its curve. Residuals, rms:",
    ]
    for k, name in enumerate(names):
        text = "as it was before: no reference or no reading"
        if k in fitted:
            fit = fitted[k].fit
            low, high = np.degrees(fit.covered)
            text = f"{1e3 * fit.rms_volts:.1f} mV, {fit.rms_deg:.2f} deg; {fit.used.sum()} readings"
            text += f" over {low:.1f} to {high:.1f} deg"
        lines.append(f"  {name}: {text}")
    return "\n".join(lines)


def _table(fitted: dict[int, FittedSensor]) -> Table:
    headings = ("used\n", "covers\ndeg", "rms\nmV", "rms\ndeg", "curve\n± deg", "lag\nms", "play\ndeg")
    table = columns("fitted Hall sensors", ["sensor"], headings)
    for one in fitted.values():
        fit = one.fit
        low, high = np.degrees(fit.covered)
        table.add_row(
            one.name,
            f"{fit.used.sum() / np.isfinite(fit.residual).sum():.0%}",
            f"{low:.1f} to {high:.1f}",
            f"{1e3 * fit.rms_volts:.1f}",
            f"{fit.rms_deg:.2f}",
            f"{fit.std_deg.max():.2f}",
            f"{1e3 * fit.lag:.1f}",
            f"{fit.hysteresis_deg:.2f}",
        )
    return table
