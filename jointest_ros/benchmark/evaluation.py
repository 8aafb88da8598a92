"""The evaluation of one recording in a process of its own: what it costs, and the memory that it takes.

    python -m jointest_ros.benchmark.evaluation BAG YAML update|arrays

prints a line of JSON, see `Evaluation`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from time import process_time
from typing import Any

from jointest_ros import config
from jointest_ros.bags import offline
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.series_buffer import SeriesBuffer
from jointest_ros.benchmark.memory import memory
from jointest_ros.benchmark.part import BenchError
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.frame import Recording, Series
from jointest_ros.evaluation.truth import Truth

BY = ("update", "arrays")
ESTIMATOR = "kckf"


@dataclass(frozen=True)
class Evaluation:
    """What one evaluation took.

    Attributes:
        frames: number of them.
        duration_s: of the recording.
        cpu_s: of reading, decoding, assembling and estimating.
        base_mb: memory of the process before, all modules imported.
        peak_mb: highest memory, without `base_mb`.
        results_mb: of the arrays of estimates and ground truth.
    """

    frames: int
    duration_s: float
    cpu_s: float
    base_mb: float
    peak_mb: float
    results_mb: float


def in_a_process(bag: Path, yaml: Path, by: str) -> Evaluation:
    """Evaluate in a fresh Python. Raises BenchError with its last words when it fails."""
    import jointest_ros

    paths = [str(Path(jointest_ros.__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", __name__, str(bag), str(yaml), by]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        words = done.stderr.strip().splitlines() or [f"code {done.returncode}"]
        raise BenchError(f"the evaluation of {bag.name} failed: {words[-1]}")
    return Evaluation(**json.loads(done.stdout))


def evaluate(bag: Path, yaml: Path, by: str) -> Evaluation:
    """Evaluate in this process: `by` `update`, frame by frame as nodes do, or by `arrays`, chunk by chunk."""
    configuration = config.load(yaml)
    estimator = ESTIMATORS[ESTIMATOR](
        configuration.robot, configuration.estimators.get(ESTIMATOR), configuration.timing
    )
    intake = Intake(configuration.robot, configuration.timing)
    base = memory()
    start = process_time()
    with BagReader(bag) as reader:
        duration = reader.duration_s
        if by == "update":
            sink = offline.SeriesSink({ESTIMATOR: estimator})
            outcome = offline.run(reader, intake, {ESTIMATOR: estimator}, sink)
            series = sink.series(ESTIMATOR)
        else:
            buffer = SeriesBuffer(len(estimator.joints))

            def run(recording: Recording) -> None:
                buffer.add(estimator.run(recording))

            outcome = offline.read_recordings(reader, intake, run)
            series = buffer.series()
    spent = process_time() - start
    peak = max(memory("VmHWM"), base)
    return Evaluation(outcome.frames, duration, spent, base, peak - base, _size(series) + _size(outcome.truth))


def _size(tables: Series | Truth) -> float:
    """MB of all arrays."""

    def size(value: Any) -> int:
        if isinstance(value, dict):
            return sum(map(size, value.values()))
        if isinstance(value, tuple):
            return sum(map(size, value))
        return int(getattr(value, "nbytes", 0))

    return sum(size(getattr(tables, field.name)) for field in fields(tables)) / 1e6


if __name__ == "__main__":
    print(json.dumps(asdict(evaluate(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]))))
