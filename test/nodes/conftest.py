"""ROS stays on this host, in a domain of this process; each test has an executor, a context and a namespace of its own."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from ros_bench import Bench

PROJECT = Path(__file__).resolve().parents[2]

# Before any ROS context is made. Domains up to 101 have ports that no system takes for itself.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(os.getpid() % 101 + 1)

if importlib.util.find_spec("rclpy") is None:
    collect_ignore_glob = ["test_*.py"]


@pytest.fixture
def make_bench() -> Iterator[Callable[[str], Bench]]:
    """A function that makes a `Bench` with the named executor."""
    from ros_bench import Bench

    with ExitStack() as stack:
        yield lambda executor: stack.enter_context(Bench(executor))


@pytest.fixture
def bench(make_bench: Callable[[str], Bench]) -> Bench:
    """A `Bench` with the executor that the executables use."""
    return make_bench("events")


@pytest.fixture(scope="session")
def finger_bag() -> Path:
    """15 s of the simulated finger at 100 Hz, shipped with the package."""
    return PROJECT / "bags" / "finger"


@pytest.fixture(scope="session")
def finger_config() -> Path:
    """The configuration of its robot."""
    return PROJECT / "config" / "finger.yaml"
