"""`jointest simulate`: a synthetic recording with ground truth, and the configuration that belongs to it."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jointest_ros import config
from jointest_ros.bags import synthetic
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.writer import BagWriter
from jointest_ros.cli.common import Parsers, add_params, given_params, out, param_flag, progress, write_text
from jointest_ros.config.text import robot_yaml
from jointest_ros.sim.scenarios import OWN, OWN_DESCRIPTION, OWN_OPTIONS, SCENARIOS, Rig, Source, own
from jointest_ros.sim.simulated import SimulationOptions, read_options


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "simulate",
        description="Write a synthetic rosbag2 recording with ground truth: of a rig, and beside it, as BAG.yaml, the "
        "configuration of its robot with the true mountings of the sensors; or of your own robot (config).",
    )
    rigs = parser.add_subparsers(dest="rig", metavar="RIG", required=True)
    for rig in SCENARIOS.values():
        epilog = "scenarios:\n" + "\n".join(f"  {name:13} {text}" for name, text in rig.scenarios.items())
        _add_source(rigs, rig.name, rig.description, rig.options, epilog, " and its BAG.yaml").set_defaults(run=run)
    one = _add_source(rigs, OWN, OWN_DESCRIPTION, OWN_OPTIONS, "No BAG.yaml is written: the configuration is yours.")
    one.add_argument("config", type=Path, metavar="YAML", help="the robot's configuration")
    one.set_defaults(run=run_own)


def _add_source(
    rigs: Parsers[Any], name: str, description: str, options: type[SimulationOptions], epilog: str, beside: str = ""
) -> argparse.ArgumentParser:
    one: argparse.ArgumentParser = rigs.add_parser(
        name,
        help=description,
        description=f"Simulate: {description}.",
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    one.add_argument("-o", "--output", required=True, type=Path, metavar="BAG", help="directory of the new recording")
    one.add_argument("--storage", choices=("mcap", "sqlite3"), default="mcap", help="default: %(default)s")
    one.add_argument("--overwrite", action="store_true", help=f"replace a recording of that name{beside}")
    add_params(one, options)
    return one


def run(arguments: argparse.Namespace) -> int:
    """Body of the command for a rig."""
    rig: Rig = SCENARIOS[arguments.rig]
    options = read_options(rig.options, given_params(arguments, rig.options))
    configuration = arguments.output.parent / f"{arguments.output.name}.yaml"
    if configuration.exists() and not arguments.overwrite:
        raise BagError(f"{configuration}: exists already; remove it, choose another name or give --overwrite")
    robot = next(rig.stretches(options)).robot
    command = f"jointest simulate {rig.name} -o {arguments.output.name}"
    chosen = "".join(_given(spec, getattr(options, spec.name)) for spec in dataclasses.fields(rig.options))
    heading = f"The robot of the recording beside it, with its true mountings. Made by:\n{command}{chosen}"
    _write(arguments, rig, options, {configuration: robot_yaml(robot, rig.estimators, heading)})
    out.print(f"{configuration}: its robot")
    poses = str(getattr(options, "scenario", "")).startswith("poses")
    out.print(
        f"next: jointest {'calibrate accel' if poses else 'evaluate'} {arguments.output} --config {configuration}"
    )
    return 0


def run_own(arguments: argparse.Namespace) -> int:
    """Body of the command for one's own robot."""
    configuration = config.load(arguments.config)
    options = read_options(OWN_OPTIONS, given_params(arguments, OWN_OPTIONS))
    _write(arguments, own(configuration.robot), options, {})
    name = "" if configuration.estimators else " --estimator NAME"
    out.print(f"next: jointest evaluate {arguments.output} --config {arguments.config}{name}")
    return 0


def _write(
    arguments: argparse.Namespace, source: Source, options: SimulationOptions, beside: Mapping[Path, str]
) -> None:
    """The recording, and the texts `beside` it."""
    robot = next(source.stretches(options)).robot
    total = round(options.duration_s * options.rate_hz) * synthetic.messages_a_frame(robot)
    with (
        progress(f"{source.name} {arguments.output}") as report,
        BagWriter(arguments.output, arguments.storage, overwrite=arguments.overwrite) as writer,
    ):
        synthetic.write(writer, robot, source.stretches(options), lambda done: report(done, total))
        for path, text in beside.items():
            write_text(path, text)
    out.print(f"{arguments.output}: {options.duration_s:g} s at {options.rate_hz:g} Hz, {total} messages")


def _given(spec: dataclasses.Field[Any], value: Any) -> str:
    if value == spec.default:
        return ""
    if isinstance(value, bool):
        return f" --{'' if value else 'no-'}{param_flag(spec)}"
    return f" --{param_flag(spec)} {value}"
