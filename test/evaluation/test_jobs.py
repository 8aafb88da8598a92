"""Jobs on many processes: the results of the serial run, whatever becomes of a worker."""

from __future__ import annotations

import os
import pickle
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from parallel_jobs import count, die, refuse, software, walk, walk_or_die, where

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.evaluation import jobs
from jointest_ros.evaluation.jobs import HERE, WorkerError, Workers
from jointest_ros.evaluation.kept_results import KeptResultsError

SEEDS = range(12)
WALKS = [partial(walk, seed) for seed in SEEDS]


@pytest.fixture(params=["pool", "cluster"])
def two(request: pytest.FixtureRequest) -> Workers:
    """Two worker processes."""
    return Workers(2) if request.param == "pool" else Workers(scheduler=request.getfixturevalue("cluster"))


def test_results_are_those_of_the_serial_run_in_its_order(two: Workers) -> None:
    seen: list[tuple[int, int]] = []
    assert list(jobs.run(WALKS, two, lambda *now: seen.append(now))) == [walk(seed) for seed in SEEDS]
    assert list(jobs.run(WALKS, HERE)) == [walk(seed) for seed in SEEDS]
    assert seen == [(done, 12) for done in range(13)]


def test_a_worker_that_is_killed_costs_nothing(two: Workers, tmp_path: Path) -> None:
    results = list(jobs.run([partial(walk_or_die, seed, str(tmp_path)) for seed in SEEDS], two))
    assert (tmp_path / "died").exists()
    assert results == [walk(seed) for seed in SEEDS]


def test_a_result_that_is_lost_on_its_way_is_computed_again(cluster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What Dask makes of a result whose worker dies at that moment."""
    outcome, seen = jobs._outcome, []

    def losing(future: Future[Any]) -> Any:
        seen.append(future)
        return ValueError("not enough values to unpack (expected 3, got 1)") if len(seen) == 2 else outcome(future)

    monkeypatch.setattr(jobs, "_outcome", losing)
    assert list(jobs.run(WALKS, Workers(scheduler=cluster))) == [walk(seed) for seed in SEEDS]
    assert len(seen) == len(WALKS) + 1


def test_a_job_that_kills_every_worker_is_told(two: Workers) -> None:
    with pytest.raises(WorkerError, match="died"):
        list(jobs.run([partial(die, 0), partial(die, 1)], two))


def test_an_error_of_a_job_comes_when_its_turn_has_come(two: Workers) -> None:
    for workers in (HERE, two):
        results = jobs.run([partial(refuse, seed) for seed in range(5)], workers)
        assert [next(results), next(results)] == [0, 1]
        with pytest.raises(ConfigurationError, match="job 2"):
            next(results)


def test_one_job_or_one_process_needs_no_worker() -> None:
    for workers, number in ((Workers(4), 1), (HERE, 3)):
        assert {found[0] for found in jobs.run([partial(where)] * number, workers)} == {os.getpid()}


def test_workers_are_in_this_folder_with_one_thread_each(
    two: Workers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for process, folder, threads in jobs.run([partial(where)] * 2, two):
        assert (process != os.getpid(), Path(folder), threads) == (True, tmp_path.resolve(), "1")


def test_a_run_goes_on_where_it_was_broken_off(two: Workers, tmp_path: Path) -> None:
    calls, folder = tmp_path / "calls", tmp_path / "new" / "kept"
    calls.mkdir()
    wanted = [partial(count, seed, str(calls)) for seed in SEEDS]
    first = jobs.run(wanted, Workers(1, kept=folder))
    assert [next(first) for _ in range(5)] == [0, 1, 4, 9, 16]
    first.close()
    seen: list[int] = []
    workers = Workers(two.count, two.scheduler, folder)
    assert list(jobs.run(wanted, workers, lambda done, _: seen.append(done))) == [seed**2 for seed in SEEDS]
    assert seen == list(range(5, 13))
    assert sorted(file.name for file in calls.iterdir()) == sorted(f"{seed}-0" for seed in SEEDS)  # each once


def test_what_is_damaged_or_does_not_hold_is_computed_again(tmp_path: Path) -> None:
    calls, workers = tmp_path / "calls", Workers(1, kept=tmp_path / "kept")
    calls.mkdir()
    wanted = [partial(count, seed, str(calls)) for seed in range(4)]
    list(jobs.run(wanted, workers))
    damaged = next(file for file in (tmp_path / "kept").iterdir() if pickle.loads(file.read_bytes()) == 9)
    damaged.write_bytes(damaged.read_bytes()[:-3])
    assert list(jobs.run(wanted, workers, valid=lambda job, result: result != 4)) == [0, 1, 4, 9]
    assert {file.name for file in calls.iterdir()} == {"0-0", "1-0", "2-0", "2-1", "3-0", "3-1"}


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(KeptResultsError, match="cannot be written"):
        list(jobs.run(WALKS, Workers(1, kept=file)))


@pytest.mark.parametrize("address", ["nonsense://1", "foo", "foo:bar"])
def test_no_scheduler_there(address: str) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(WorkerError, match=f"no Dask scheduler at '{address}': .+"):
        list(jobs.run(WALKS, Workers(scheduler=address)))


def test_workers_with_other_software_are_refused(cluster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "software", software)
    with pytest.raises(WorkerError, match=rf"has jointest_ros 0\.0\.9 of \d+, but here is 0\.0\.9 of {os.getpid()}"):
        list(jobs.run(WALKS, Workers(scheduler=cluster)))


def test_workers_that_come_later_are_refused_as_well(cluster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """When the software of those before them has been found right."""
    monkeypatch.setattr(jobs, "_check_software", lambda client, address: None)
    monkeypatch.setattr(jobs, "software", software)
    with pytest.raises(WorkerError, match=rf"a worker has jointest_ros .+, but here is 0\.0\.9 of {os.getpid()}"):
        list(jobs.run(WALKS, Workers(scheduler=cluster)))
