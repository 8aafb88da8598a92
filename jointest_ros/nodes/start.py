"""Entry point of the nodes' executables: `pcf_node` runs `main` of `jointest_ros.nodes.pcf_node`, and so on."""

from __future__ import annotations

import signal
import sys
from importlib import import_module
from pathlib import Path

from jointest_ros.interruption import ended_by


def main() -> int:
    """Run the node after which this executable is named; its exit code, 2 where ROS 2 is not installed."""
    name = Path(sys.argv[0]).stem
    with ended_by(signal.SIGINT, signal.SIGTERM):  # until the node handles signals itself
        from jointest_ros.nodes.at_hand import NoRosError, ros_at_hand

        try:
            with ros_at_hand():
                node = import_module(f"jointest_ros.nodes.{name}")
        except NoRosError as error:
            print(f"{name}: error: {error}", file=sys.stderr)
            return 2
        return int(node.main())
