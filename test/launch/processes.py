"""The executables as processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from jointest_ros.core.catalogue import ESTIMATORS

PROJECT = Path(__file__).resolve().parents[2]
TIMEOUT = 60.0  # s, far more than anything takes

Process = subprocess.Popen[str]
Completed = subprocess.CompletedProcess[str]


def _command(name: str, *without: str) -> list[str]:
    """What `ros2 run jointest_ros <name>` starts where the package is installed; else Python with arguments."""
    installed = Path(sys.prefix, "lib", "jointest_ros", name)
    return [str(installed)] if installed.exists() else [sys.executable, *without]


_COMMANDS = {
    "jointest": _command("jointest", "-c", "import sys; from jointest_ros.cli.main import main; sys.exit(main())")
} | {
    name: _command(name, "-m", f"jointest_ros.nodes.{name}")
    for name in ("sim_hardware_node", *(f"{estimator}_node" for estimator in ESTIMATORS))
}


def start(name: str, *arguments: str) -> Process:
    """Start an executable without a terminal, in a process group of its own."""
    path = os.pathsep.join(filter(None, [str(PROJECT), os.environ.get("PYTHONPATH", "")]))
    return subprocess.Popen(
        [*_COMMANDS[name], *arguments],
        env={**os.environ, "PYTHONPATH": path},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(process: Process) -> Completed:
    """Wait for its end; it does not outlive the wait."""
    try:
        out, err = process.communicate(timeout=TIMEOUT)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    return Completed(process.args, process.returncode, out, err)


def run(name: str, *arguments: str) -> Completed:
    """Start an executable and wait for its end."""
    return finish(start(name, *arguments))
