"""What the evaluation of a recording costs, from the file to arrays of estimates, and how much memory it takes."""

from __future__ import annotations

import statistics
import tempfile
from dataclasses import astuple
from pathlib import Path

from jointest_ros.bags import synthetic
from jointest_ros.bags.writer import BagWriter, StorageName
from jointest_ros.benchmark.evaluation import BY, ESTIMATOR, Evaluation, in_a_process
from jointest_ros.benchmark.part import Options, PartResult
from jointest_ros.config.text import robot_yaml
from jointest_ros.reproduction.result import Cell, Report, ResultTable
from jointest_ros.sim import exoshell

RATE_HZ = 500.0
DURATIONS_S, REPEATS = (60.0, 600.0), (3, 1)
QUICK_DURATIONS_S, QUICK_REPEATS = (2.0,), (1,)
STORAGES: tuple[StorageName, ...] = ("sqlite3", "mcap")
BUDGET_US = {("sqlite3", "update"): 40.0, ("mcap", "update"): 60.0, ("sqlite3", "arrays"): 30.0}

_COLUMNS = (
    "storage",
    "recording_s",
    "by",
    "frames",
    "us_per_frame",
    "budget_us",
    "times_real_time",
    "base_mb",
    "peak_mb",
    "results_mb",
)


def run(options: Options, report: Report) -> PartResult:
    """The part `offline`."""
    durations = QUICK_DURATIONS_S if options.quick else DURATIONS_S
    repeats = QUICK_REPEATS if options.quick else REPEATS
    rows: list[tuple[Cell, ...]] = []
    jobs = [
        (seconds, number, storage) for seconds, number in zip(durations, repeats, strict=True) for storage in STORAGES
    ]
    total = round(sum(seconds * (1 + number * len(BY)) for seconds, number, _ in jobs))  # s of recording
    done = 0.0
    with tempfile.TemporaryDirectory(prefix="jointest-bench-") as folder:
        report(0, total)
        for seconds, number, storage in jobs:
            bag = _simulate(Path(folder) / storage, storage, seconds)
            found: dict[str, list[Evaluation]] = {by: [] for by in BY}
            done += seconds
            for by in BY * number:
                report(round(done), total)
                found[by].append(in_a_process(bag, _yaml(bag), by))
                done += seconds
            rows += [_row(storage, seconds, by, evaluations) for by, evaluations in found.items()]
    conditions = (
        f"{ESTIMATOR} on five IMUs with Hall voltages and ground truth at {RATE_HZ:g} Hz (simulated exoshell); "
        "CPU time of opening, reading, decoding, assembling and estimating",
        f"each in a process of its own; of the shorter recording the median of {repeats[0]}",
        "by update: frame after frame, as `jointest evaluate` does; by arrays: `run` on what was read as arrays",
        "budget_us: without the ground truth, which costs one message more a frame",
        "base_mb: Python with all modules; peak_mb: the most beyond that; results_mb: arrays of estimates and truth",
    )
    return PartResult((ResultTable("evaluation of a recording", _COLUMNS, rows, ".4g"),), conditions)


def _simulate(bag: Path, storage: StorageName, seconds: float) -> Path:
    """Write the recording and its configuration."""
    options = exoshell.ExoshellOptions(rate_hz=RATE_HZ, duration_s=seconds)
    robot = exoshell.exoshell(options.scenario)
    with BagWriter(bag, storage, overwrite=True) as writer:
        synthetic.write(writer, robot, exoshell.stretches(options))
    _yaml(bag).write_text(robot_yaml(robot, {ESTIMATOR: {}}, "Of `jointest bench`."), encoding="utf-8")
    return bag


def _yaml(bag: Path) -> Path:
    return bag.with_suffix(".yaml")


def _row(storage: str, seconds: float, by: str, evaluations: list[Evaluation]) -> tuple[Cell, ...]:
    """Medians over the evaluations."""
    frames, duration, cpu, base, peak, results = map(statistics.median, zip(*map(astuple, evaluations), strict=True))
    return (
        storage,
        seconds,
        by,
        round(frames),
        1e6 * cpu / frames,
        BUDGET_US.get((storage, by)),
        duration / cpu,
        base,
        peak,
        results,
    )
