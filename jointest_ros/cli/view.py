"""`jointest view`: what robot_state_publisher, RViz and Foxglove need to show a robot."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from jointest_ros import config
from jointest_ros.cli.common import OutputError, Parsers, load_estimators, out, write_text
from jointest_ros.core.errors import ConfigurationError, counted
from jointest_ros.view.foxglove import foxglove_layout
from jointest_ros.view.urdf import robot_urdf

_DESCRIPTION = """\
Write the URDF of a robot, and a Foxglove layout that shows it beside the truth with all its joint angles. `ros2 launch
jointest_ros robot.launch.py config:=YAML` needs neither: it makes the URDF by itself."""


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "view",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("config", type=Path, metavar="YAML", help="the robot's configuration")
    parser.add_argument("--urdf", type=Path, metavar="FILE", help="where the URDF is written")
    parser.add_argument("--foxglove", type=Path, metavar="FILE", help="where the layout is written (.json)")
    parser.add_argument(
        "--estimator", "-e", metavar="NAME", help="whose estimates it shows (default: the first in the configuration)"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace what is there under these names")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of the command."""
    if arguments.urdf is None and arguments.foxglove is None:
        raise ConfigurationError("nothing to write: give --urdf FILE, --foxglove FILE or both")
    for file in (arguments.urdf, arguments.foxglove):
        if file is not None and file.is_file() and not arguments.overwrite:
            raise OutputError(f"{file}: exists already; remove it, choose another name or give --overwrite")
    configuration = config.load(arguments.config)
    robot = configuration.robot
    if arguments.urdf is not None:
        write_text(arguments.urdf, robot_urdf(robot))
        positions, sensors = counted(len(robot.coordinates), "joint position"), counted(len(robot.sensors), "sensor")
        out.print(f"{arguments.urdf}: {positions}, {sensors}")
    if arguments.foxglove is not None:
        chosen = [arguments.estimator] if arguments.estimator else None
        name, estimator = next(iter(load_estimators(configuration, chosen).items()))
        write_text(arguments.foxglove, foxglove_layout(robot, name, torso=estimator.torso is not None))
        out.print(f"{arguments.foxglove}: {name}; in Foxglove: import it as a layout")
    return 0
