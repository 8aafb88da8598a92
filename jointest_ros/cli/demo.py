"""`jointest demo`: simulated hardware, estimators and a comparison in one process, live."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import Any

from jointest_ros import config, resources
from jointest_ros.cli.common import Parsers, add_config, load_estimators, needs_ros, out
from jointest_ros.cli.tables import error_tables, input_table
from jointest_ros.core.errors import ConfigurationError

ROBOTS = ("finger", "softhand_gripper", "exoshell", "two_link_accel")  # each with bags/<name> and config/<name>.yaml


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "demo",
        description="Play a recording through the simulated hardware node into the estimator nodes, all in this "
        "process, over ROS 2. Shows the estimates live, beside the ground truth where the recording has one, and ends "
        "with the errors. Without arguments: a shipped recording of a simulated soft finger, 15 s.",
    )
    parser.add_argument(
        "--robot",
        choices=ROBOTS,
        default=ROBOTS[0],
        help="which shipped recording, without --bag (default: %(default)s)",
    )
    parser.add_argument("--bag", type=Path, metavar="BAG", help="your own recording (with --config)")
    add_config(parser, required=False)
    parser.add_argument("--speed", type=float, default=1.0, metavar="X", help="factor of real time (default: 1)")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of the command."""
    if (arguments.bag is None) != (arguments.config is None):
        raise ConfigurationError("--bag and --config go together: the recording, and the configuration of its robot")
    bag = arguments.bag or resources.find(f"bags/{arguments.robot}")
    path = arguments.config or resources.find(f"config/{arguments.robot}.yaml")
    configuration = config.load(path)
    names = list(load_estimators(configuration, arguments.estimator))
    with needs_ros():
        from jointest_ros.nodes.demo import Demo
    with Demo(bag, path, configuration, names, arguments.speed, arguments.namespace) as demo:
        try:
            demo.play(out)
        finally:  # what was seen until Ctrl-C is shown too
            out.print()
            for table in (*error_tables(demo.errors()), input_table(demo.inputs())):
                out.print(table)
    out.print(
        "\nThe same on a robot, each in a terminal of its own (the first one stands for your sensors):", style="bold"
    )
    out.print(f"  ros2 run jointest_ros sim_hardware_node --ros-args -p source:=bag -p bag:={bag}")
    for name in names:
        space = f" -r __ns:=/{name} -p sensor_namespace:=/" if len(names) > 1 else ""
        out.print(f"  ros2 run jointest_ros {name}_node --ros-args -p config:={path}{space}")
    out.print(f"  ros2 topic echo {'/' + names[0] if len(names) > 1 else ''}/joint_states")
    if shutil.which("ros2") is None:
        out.print("No ros2 command here: leave out `ros2 run jointest_ros`; the nodes are commands of their own.")
    return 0
