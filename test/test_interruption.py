"""A signal while a program loads leaves no traceback, whatever is being imported."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from jointest_ros.interruption import ended_by

PROJECT = Path(__file__).resolve().parents[1]

# the signal of the first argument when the import of the module of the second begins
CODE = """
import os, signal, sys
number, at = int(sys.argv.pop(1)), sys.argv.pop(1)
sys.argv.pop(0)
class Interrupt:
    def find_spec(self, name, *_):
        if name == at:
            os.kill(os.getpid(), number)
signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever started us may ignore it
sys.meta_path.insert(0, Interrupt())
from {entry} import main
sys.exit(main())
"""


def _interrupted(entry: str, number: int, at: str, *command: str) -> tuple[int, str, str]:
    code = CODE.replace("{entry}", entry)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(PROJECT), os.environ.get("PYTHONPATH", "")])}
    call = [sys.executable, "-c", code, str(int(number)), at, *command]
    done = subprocess.run(call, env=environment, capture_output=True, text=True, check=False, timeout=60)
    return done.returncode, done.stdout, done.stderr


COMMAND = ("jointest", "evaluate", "bag", "--config", "robot.yaml")


@pytest.mark.parametrize("at", ["jointest_ros.cli.evaluate", "numpy", "scipy", "rich", "jointest_ros.core.errors"])
def test_of_a_command(at: str) -> None:
    outcome = _interrupted("jointest_ros.cli.main", signal.SIGINT, at, *COMMAND)
    assert outcome == (130, "", "jointest: interrupted\n")


def test_a_command_is_terminated_as_any_other() -> None:
    assert _interrupted("jointest_ros.cli.main", signal.SIGTERM, "numpy", *COMMAND) == (-signal.SIGTERM, "", "")


@pytest.mark.skipif(find_spec("rclpy") is None, reason="needs ROS 2")
@pytest.mark.parametrize("node", ["pcf_node", "sim_hardware_node"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("at", ["numpy", "rclpy", "jointest_ros.nodes.spin"])
def test_of_a_node(node: str, number: int, at: str) -> None:
    assert _interrupted("jointest_ros.nodes.start", number, at, f"bin/{node}", "--help") == (0, "", "")


@pytest.mark.parametrize(
    ("number", "own"), [(signal.SIGINT, signal.default_int_handler), (signal.SIGTERM, signal.SIG_DFL)]
)
def test_others_keep_their_handler(number: signal.Signals, own: Any) -> None:
    before = signal.signal(number, signal.SIG_IGN)
    try:
        with ended_by(number):
            assert signal.getsignal(number) is signal.SIG_IGN
        signal.signal(number, own)
        with ended_by(number):
            assert signal.getsignal(number) is not own
        assert signal.getsignal(number) is own
    finally:
        signal.signal(number, before)
