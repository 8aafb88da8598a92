"""Entry point of the nodes' executables: `pcf_node` runs `main` of `jointest_ros.nodes.pcf_node`, and so on."""

from __future__ import annotations

import signal
import sys
from importlib import import_module
from pathlib import Path

from jointest_ros.interruption import ended_by


def main() -> int:
    """Run the node after which this executable is named; its exit code."""
    with ended_by(signal.SIGINT, signal.SIGTERM):  # until the node handles signals itself
        return int(import_module(f"jointest_ros.nodes.{Path(sys.argv[0]).stem}").main())
