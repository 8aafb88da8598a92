"""CPU time of pieces of work, taken in turns, so that whatever else the machine does falls on all of them alike."""

from __future__ import annotations

import gc
import math
import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import process_time_ns
from typing import TypeVar

from jointest_ros.reproduction.result import Report

REFERENCE = "plain Python loop"
_TURNS = 200  # of the reference in one round

Task = Callable[[int], int]  # number of the round -> how many frames were processed
K = TypeVar("K")  # name of a task


@dataclass(frozen=True)
class Cost:
    """CPU time of a frame, us: median of the rounds, and half of the range that the middle half of them covers."""

    us: float
    spread_us: float


def measure(tasks: Mapping[K, Task], rounds: int, report: Report) -> dict[K, Cost]:
    """Every task once a round, in the same order; the first round warms up and does not count.

    The garbage collector waits meanwhile, as in the standard library's timeit: when it runs depends on all else.
    """
    taken: dict[K, list[float]] = {name: [] for name in tasks}
    for number in range(rounds + 1):
        report(number, rounds + 1)
        for name, task in tasks.items():
            gc.collect(0)
            gc.disable()
            try:
                start = process_time_ns()
                frames = task(number)
                spent = process_time_ns() - start
            finally:
                gc.enable()
            if number:
                taken[name].append(spent / 1e3 / frames)
    return {name: _cost(values) for name, values in taken.items()}


def _cost(values: list[float]) -> Cost:
    low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
    return Cost(middle, 0.5 * (high - low))


def reference(_round: int) -> int:
    """A fixed piece of arithmetic in plain Python, to compare machines by: a quaternion turned step by step."""
    x, y, z, w = 0.0, 0.0, 0.0, 1.0
    a, b, c = 0.01, -0.02, 0.03
    for _ in range(_TURNS):
        x, y, z, w = (
            x + w * a + y * c - z * b,
            y + w * b + z * a - x * c,
            z + w * c + x * b - y * a,
            w - x * a - y * b - z * c,
        )
        scale = 1.0 / math.sqrt(x * x + y * y + z * z + w * w)
        x, y, z, w = x * scale, y * scale, z * scale, w * scale
    return _TURNS
