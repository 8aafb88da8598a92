"""The recordings of `jointest evaluate` as jobs, many at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from jointest_ros.cli.common import progress
from jointest_ros.cli.evaluate_bag import Done, Task, evaluate_task
from jointest_ros.evaluation import jobs
from jointest_ros.evaluation.jobs import Workers

SMALL = 16_000_000  # bytes of recordings: with less, worker processes would begin about when all is done


def evaluated(tasks: list[Task], workers: Workers) -> Iterator[Done]:
    """What each task gives, in their order; on many processes where that brings something. Raises as `jobs.run`."""
    if workers == Workers(kept=workers.kept) and sum(map(_size, tasks)) < SMALL:
        workers = replace(workers, count=1)
    if not workers.scheduler and (len(tasks) == 1 or workers.processes == 1):
        for task in tasks:
            with progress(f"evaluate {task.bag}") as report:
                (done,) = jobs.run([partial(evaluate_task, task, report)], workers, key=_key, valid=_valid)
            yield done
        return
    reached = (0, len(tasks))

    def inside(*now: int) -> None:
        nonlocal reached
        reached = (now[0], now[1])
        report(*reached)

    results = jobs.run([partial(evaluate_task, task) for task in tasks], workers, inside, _key, _valid)
    for _ in tasks:
        with progress(f"evaluate {len(tasks)} recordings") as report:  # off while a result is printed
            report(*reached)
            done = next(results)
        yield done


def _size(task: Task) -> int:
    """Of its recording, bytes."""
    return sum(size for _, size, _ in _states(task.bag))


def _states(bag: Path) -> list[tuple[str, int, int]]:
    """Path, size and time of change (ns) of each file of a recording, as far as there is any."""
    bag, states = bag.resolve(), []
    with suppress(OSError):  # evaluate_task will tell
        for file in sorted(bag.iterdir()) if bag.is_dir() else [bag]:
            states.append((str(file), file.stat().st_size, file.stat().st_mtime_ns))
    return states


def _key(job: partial[Done]) -> str:
    """What the figures of a task, its picture and its report depend on."""
    task: Task = job.args[0]
    options = task.options
    params = sorted(options.configuration.estimators.items())
    plain = replace(options, configuration=None, origin=None)  # type: ignore[arg-type]
    outputs = [str(path and path.resolve()) for path in (task.picture, task.report)]
    return repr((str(task.bag), _states(task.bag), plain, params, outputs, task.earlier))


def _valid(job: partial[Done], done: Done) -> bool:
    """Nothing has failed, and what it wrote is there."""
    task: Task = job.args[0]
    outputs = (task.picture, task.report and task.report / "index.html")
    return not done.error and all(path is None or path.exists() for path in outputs)
