"""Each test has an executor, a context and a namespace of its own; without ROS there is none."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from ros_bench import Bench

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
