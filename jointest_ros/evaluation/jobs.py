"""Many independent jobs on many processes: a pool on this machine, or a Dask cluster; a worker that dies costs nothing.

Both go through the interface of `concurrent.futures`. Results are those of the serial run, in its order.
"""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar

from jointest_ros.core.errors import JointestError
from jointest_ros.core.progress import Progress, no_progress
from jointest_ros.evaluation.kept_results import KeptResults, name, software

ResultT = TypeVar("ResultT")
Outcomes = Generator[tuple[int, Any], None, None]  # number of a job, and its result or exception; in any order

_DEATHS = 3  # pools that may break one after the other without a result
_ANSWER_S = 10  # for a scheduler


class WorkerError(JointestError):
    """Workers cannot be had, die again and again, or run other software than this process."""


@dataclass(frozen=True)
class Workers:
    """Where jobs run, and where their results stay.

    Attributes:
        count: processes on this machine; 0: one for each core; 1: none but this one.
        scheduler: address of a Dask scheduler, whose workers take the jobs instead; "": none.
        kept: folder that gets each result as soon as it is there. What is found there already is not computed again, so
            that a run that was broken off goes on. Only folders that none but trusted users can write: the results are
            pickles.
    """

    count: int = 0
    scheduler: str = ""
    kept: Path | None = None

    @property
    def processes(self) -> int:
        """On this machine."""
        usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        return self.count or usable or 1


HERE = Workers(1)


def run(
    jobs: Sequence[partial[ResultT]],
    workers: Workers = HERE,
    progress: Progress = no_progress,
    key: Callable[[partial[ResultT]], str] = name,
    valid: Callable[[partial[ResultT], ResultT], bool] = lambda job, result: True,
) -> Iterator[ResultT]:
    """`(job() for job in jobs)`, by many processes where that brings something.

    Whoever calls this from a script needs `if __name__ == "__main__":` there, since workers import it.

    Args:
        jobs: calls of functions of a module; arguments and result can be pickled, and the result depends on nothing
            else.
        progress: is called first with what was kept.
        key: what tells a job from all others, and its input from other input, for `workers.kept`.
        valid: whether a result is to be kept, and one that was kept still holds.

    Raises:
        WorkerError: see there.
        KeptResultsError: the folder cannot be written.
        Whatever a job raises, when its turn has come, as in the serial run.
    """
    kept = KeptResults(workers.kept) if workers.kept else None
    results: dict[int, Any] = {}
    left = dict(enumerate(jobs))
    if kept:
        for number, job in enumerate(jobs):
            found = kept.read(key(job))
            if found is not None and valid(job, found):
                results[number] = found
                del left[number]
    done = len(results)
    progress(done, len(jobs))
    with closing(_outcomes(left, workers)) as outcomes:
        for turn in range(len(jobs)):
            while turn not in results:
                number, outcome = next(outcomes)
                results[number] = outcome
                if kept and not isinstance(outcome, Exception) and valid(jobs[number], outcome):
                    kept.write(key(jobs[number]), outcome)
                done += 1
                progress(done, len(jobs))
            result = results.pop(turn)
            if isinstance(result, Exception):
                raise result
            yield result


def _outcomes(jobs: dict[int, partial[ResultT]], workers: Workers) -> Outcomes:
    if workers.scheduler and jobs:
        return _on_cluster(jobs, workers.scheduler)
    count = min(workers.processes, len(jobs))
    return _in_pools(jobs, count) if count > 1 else ((number, job()) for number, job in jobs.items())


def _in_pools(jobs: dict[int, partial[ResultT]], count: int) -> Outcomes:
    """One pool; another one whenever it breaks, for what is left."""
    left, deaths = dict(jobs), 0
    while left:
        with _pool(min(count, len(left))) as pool:
            futures = _submit(pool, left)
            for future in as_completed(futures):
                outcome = _outcome(future)
                if not isinstance(outcome, BrokenProcessPool):
                    deaths = 0
                    del left[futures[future]]
                    yield futures[future], outcome
        deaths += 1
        if left and deaths == _DEATHS:
            raise WorkerError(
                f"worker processes died {_DEATHS} times, {len(left)} jobs are left: is there enough memory for {count} "
                "at a time? --jobs 1 does one after the other"
            )


def _submit(pool: Executor, jobs: dict[int, partial[ResultT]]) -> dict[Future[ResultT], int]:
    """Their futures. Workers are born here with Ctrl-C blocked: that is for this process alone."""
    futures = {}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with suppress(BrokenProcessPool):  # a worker may be dead by now
            for number, job in jobs.items():
                futures[pool.submit(job)] = number
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return futures


def _outcome(future: Future[ResultT]) -> ResultT | Exception:
    try:
        return future.result()
    except Exception as error:
        return error


@contextmanager
def _pool(count: int) -> Iterator[Executor]:
    """Worker processes; they end at once when the body is left by Ctrl-C or an error."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # of the workers: there is one for each core
    others = set(active_children())
    # Not by fork: a thread of a library might hold a lock at that moment.
    pool = ProcessPoolExecutor(count, get_context("spawn"), initializer=_begin)
    try:
        yield pool
    except BaseException:
        for process in set(active_children()) - others:
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """In a worker process, first of all."""
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A process that was killed leaves no workers behind."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _on_cluster(jobs: dict[int, partial[ResultT]], address: str) -> Outcomes:
    """By the workers of a cluster. What a dead one takes with it, the scheduler gives to another one."""
    with _cluster(address) as executor:
        here, wanted = str(Path.cwd()), software()
        left, rounds = dict(jobs), 0
        while left:
            rounds += 1
            futures = {executor.submit(_call, here, wanted, job): number for number, job in left.items()}
            for future in as_completed(futures):
                outcome = _outcome(future)
                if type(outcome).__name__ == "KilledWorker":
                    raise WorkerError(f"--scheduler {address}: workers died again and again on the same job: {outcome}")
                if isinstance(outcome, CancelledError):
                    raise WorkerError(f"--scheduler {address}: the scheduler went away before all was done")
                if type(outcome) is ValueError and rounds < _DEATHS:
                    continue  # Dask stumbles over a result whose worker dies while it is on its way here: once more
                del left[futures[future]]
                yield futures[future], outcome if isinstance(outcome, Exception) else outcome[0]


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    try:
        import distributed
    except ImportError:
        raise WorkerError("--scheduler needs Dask: pip install 'jointest_ros[cluster]'") from None
    dask: Any = distributed  # partly without types
    for part in ("distributed", "distributed.client"):  # what they would print as tracebacks is told by WorkerError
        logging.getLogger(part).setLevel(logging.CRITICAL)
    try:
        dask.comm.get_address_host_port(address)  # a client with a wrong one complains when it ends
        client = dask.Client(address, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        why = str(error).partition("\n")[0] or "no answer"
        raise WorkerError(f"--scheduler: no Dask scheduler at '{address}': {why}") from None
    with client:
        _check_software(client, address)
        yield client.get_executor(pure=False)


def _check_software(client: Any, address: str) -> None:
    """Results would be others where the software is: no job begins before this is known of the workers there."""
    if not client.nthreads():
        logging.getLogger(__name__).warning("the Dask scheduler at %s has no workers yet: waiting", address)
    wanted = software()
    try:
        client.wait_for_workers(1)
        answers = client.run(software, on_error="return")
    except OSError:
        raise WorkerError(f"--scheduler {address}: the scheduler went away") from None
    for worker, found in answers.items():
        if isinstance(found, OSError):  # it has just died: jobs go to others
            continue
        if isinstance(found, Exception):
            raise WorkerError(f"--scheduler {address}: {worker} cannot run jointest_ros {wanted}: {found}")
        if found != wanted:
            raise WorkerError(f"--scheduler {address}: {worker} has jointest_ros {found}, but here is {wanted}")


def _call(folder: str, wanted: str, job: partial[ResultT]) -> tuple[ResultT]:
    """In a worker of a cluster, also one that came late: paths mean what they mean here, if it has the same folders.

    The result is wrapped, so that Dask never takes it for the three parts of an exception (see `_on_cluster`).
    """
    if software() != wanted:
        raise WorkerError(f"--scheduler: a worker has jointest_ros {software()}, but here is {wanted}")
    with suppress(OSError):
        os.chdir(folder)
    return (job(),)
