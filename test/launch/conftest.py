"""Executables as a user starts them; without ROS there are none."""

from __future__ import annotations

import importlib.util
import os
import signal
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest
from processes import Process, start

if TYPE_CHECKING:
    from listener import Listener

if importlib.util.find_spec("rclpy") is None:
    collect_ignore_glob = ["test_*.py"]


@pytest.fixture
def listener() -> Iterator[Listener]:
    """Hears what was launched."""
    from listener import Listener  # which needs ROS

    one = Listener()
    yield one
    one.close()


@pytest.fixture
def launch() -> Iterator[Callable[..., Process]]:
    """`processes.start`; what was started does not outlive the test."""
    started: list[Process] = []

    def begin(name: str, *arguments: str) -> Process:
        started.append(start(name, *arguments))
        return started[-1]

    yield begin
    for process in started:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
