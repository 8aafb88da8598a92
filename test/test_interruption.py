"""Ctrl-C while a program loads leaves no traceback, whatever is being imported."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from jointest_ros.interruption import ended_by_ctrl_c

PROJECT = Path(__file__).resolve().parents[1]

# SIGINT when the import of the module of the first argument begins
CODE = """
import os, signal, sys
at = sys.argv.pop(1)
sys.argv.pop(0)
class Interrupt:
    def find_spec(self, name, *_):
        if name == at:
            os.kill(os.getpid(), signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever started us may ignore it
sys.meta_path.insert(0, Interrupt())
from {entry} import main
sys.exit(main())
"""


def _interrupted(entry: str, at: str, *command: str) -> tuple[int, str, str]:
    code = CODE.replace("{entry}", entry)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(PROJECT), os.environ.get("PYTHONPATH", "")])}
    call = [sys.executable, "-c", code, at, *command]
    done = subprocess.run(call, env=environment, capture_output=True, text=True, check=False, timeout=60)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("at", ["jointest_ros.cli.evaluate", "numpy", "scipy", "rich", "jointest_ros.core.errors"])
def test_of_a_command(at: str) -> None:
    outcome = _interrupted("jointest_ros.cli.main", at, "jointest", "evaluate", "bag", "--config", "robot.yaml")
    assert outcome == (130, "", "jointest: interrupted\n")


@pytest.mark.skipif(find_spec("rclpy") is None, reason="needs ROS 2")
@pytest.mark.parametrize("node", ["pcf_node", "sim_hardware_node"])
@pytest.mark.parametrize("at", ["numpy", "rclpy", "jointest_ros.nodes.spin"])
def test_of_a_node(node: str, at: str) -> None:
    assert _interrupted("jointest_ros.nodes.start", at, f"bin/{node}", "--help") == (0, "", "")


def test_others_keep_their_handler() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with ended_by_ctrl_c():
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        signal.signal(signal.SIGINT, signal.default_int_handler)
        with ended_by_ctrl_c():
            assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
