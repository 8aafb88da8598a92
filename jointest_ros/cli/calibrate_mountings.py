"""What `jointest calibrate axis` and `calibrate zero` share: their joints, the recording, the mountings written."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from jointest_ros.bags.inertial_readings import InertialReadings, read_inertial
from jointest_ros.bags.reader import BagReader
from jointest_ros.cli.calibrate_common import recorded
from jointest_ros.cli.common import progress
from jointest_ros.config import Configuration, calibration
from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.frame import Quat
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.robot import Sensor
from jointest_ros.core.stillness import Stillness
from jointest_ros.evaluation.joint_pairs import Pair, hinge_pairs


def add_joints(parser: argparse.ArgumentParser, verb: str) -> None:
    """The option by which joints are chosen."""
    parser.add_argument(
        "--joint", action="append", default=[], metavar="NAME", help=f"{verb} this joint only; may be repeated"
    )


def chosen_pairs(
    arguments: argparse.Namespace, configuration: Configuration, most_axes: int = 1
) -> tuple[list[Pair], list[str]]:
    """The joints to calibrate, of at most so many axes, and why others are left out. Raises ConfigurationError."""
    try:
        return hinge_pairs(configuration.robot, arguments.joint, most_axes)
    except ConfigurationError as error:
        raise ConfigurationError(f"{arguments.config}: {error}") from None


def read_pairs(
    arguments: argparse.Namespace, configuration: Configuration, pairs: Sequence[Pair]
) -> tuple[InertialReadings, str]:
    """The readings of the sensors of these joints, and which recording it was.

    Raises:
        BagError: as `read_inertial`.
        CalibrationError: a sensor gave no readings.
    """
    sensors = list({sensor.name: sensor for pair in pairs for sensor in pair.sensors}.values())
    with BagReader(arguments.bag) as reader, progress(f"read {arguments.bag}") as report:
        readings = read_inertial(
            reader,
            configuration.robot,
            sensors,
            configuration.timing,
            _stillness(configuration),
            arguments.namespace,
            report,
        )
        when = recorded(arguments.bag, reader)
    for pair in pairs:
        for sensor in pair.sensors:
            if sensor.name not in readings.means.given:
                others = [other.joint.name for other in pairs if sensor not in other.sensors]
                hint = f"; without its joints: {' '.join(f'--joint {name}' for name in others)}" if others else ""
                raise CalibrationError(
                    f"{arguments.bag}: joint '{pair.joint.name}': sensor '{sensor.name}' (topic {sensor.topic}) "
                    f"gave no readings of gyro and accelerometer{hint}"
                )
    return readings, when


def _stillness(configuration: Configuration) -> Stillness:
    """By the thresholds of `estimators: pcf:`."""
    params = configuration.estimators.get("pcf")
    p = params if isinstance(params, PcfParams) else PcfParams()
    return Stillness((), math.radians(p.still_gyro_dps), p.still_accel, math.radians(p.largest_bias_dps))


def save(target: Path, sensors: Sequence[Sensor], mountings: dict[str, Quat], heading: str) -> None:
    """Write the mountings of these sensors into the calibration file."""
    calibration.save_mountings(target, [replace(s, mounting=mountings[s.name]) for s in sensors], heading)


def joints_given(arguments: argparse.Namespace) -> list[str]:
    """The options of `add_joints` as they were given, for a heading."""
    return [f"--joint {name}" for name in arguments.joint]
