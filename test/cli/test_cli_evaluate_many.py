"""`jointest evaluate` and `jointest reproduce` with many processes: what the serial run says, and where it goes on."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Jointest = Callable[..., Any]
MAIN = "import sys; from jointest_ros.cli.main import main; sys.exit(main())"


@pytest.fixture(params=["pool", "cluster"])
def two(request: pytest.FixtureRequest) -> tuple[str, ...]:
    """The option for two worker processes."""
    if request.param == "pool":
        return "--jobs", "2"
    return "--scheduler", request.getfixturevalue("cluster")


@pytest.fixture
def bags(finger: Path, tmp_path: Path) -> list[Path]:
    """A recording, one that is missing, and another one."""
    for name in "ac":
        shutil.copytree(finger, tmp_path / name)
    return [tmp_path / name for name in "abc"]


def figures(file: Path) -> list[dict[str, Any]]:
    """Without what a clock has measured."""
    documents: list[dict[str, Any]] = json.loads(file.read_text(encoding="utf-8"))
    for document in documents:
        for table in document["estimators"].values():
            del table["ns_per_frame"]
    return documents


def test_evaluate_says_what_the_serial_run_says(
    two: tuple[str, ...],
    jointest: Jointest,
    bags: list[Path],
    finger_yaml: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    names = [bag.name for bag in bags]  # relative: the workers have to find them too
    wanted, found = (
        jointest("evaluate", *names, "-c", finger_yaml, "--json", folder, "--plot", tmp_path / "p.svg", *options)
        for folder, options in (("1.json", ("--jobs", "1")), ("2.json", two))
    )
    assert found.out == wanted.out.replace("1.json", "2.json")
    assert found.err == wanted.err
    assert found.code == wanted.code == 2 and "error: b: " in found.err
    assert figures(tmp_path / "2.json") == figures(tmp_path / "1.json")
    assert [one["bag"] for one in figures(tmp_path / "2.json")] == ["a", "c"]


def test_reproduce_gives_the_figures_of_the_serial_run(
    two: tuple[str, ...], jointest: Jointest, tmp_path: Path
) -> None:
    for folder, options in (("one", ("--jobs", "1")), ("two", two)):
        name = ("kckf-human", "--runs", 3, "--duration", 10)
        assert jointest("reproduce", *name, "-o", tmp_path / folder, *options).code == 0
    for kind in ("json", "png"):
        one, other = ((tmp_path / folder / f"kckf-human.{kind}").read_bytes() for folder in ("one", "two"))
        assert one == other


def test_what_was_done_is_not_done_again_unless_its_recording_or_its_picture_changed(
    jointest: Jointest, bags: list[Path], finger_yaml: Path, tmp_path: Path
) -> None:
    def times(*options: object) -> list[int]:
        file = tmp_path / "figures.json"
        command = ("evaluate", bags[0], bags[2], "-c", finger_yaml, "--json", file, "--resume", tmp_path / "kept")
        assert jointest(*command, "--plot", tmp_path / "p.svg", *options).code == 0
        return [next(iter(one["estimators"].values()))["ns_per_frame"] for one in json.loads(file.read_text())]

    def new(*options: object) -> tuple[bool, ...]:
        """Of which recordings the clock has measured something else."""
        nonlocal before
        before, last = times(*options), before
        return tuple(now != then for now, then in zip(before, last, strict=True))

    before = times()
    assert new() == (False, False)
    assert new("--skip", 1) == (True, True)
    (tmp_path / "p_c.svg").unlink()
    assert new("--skip", 1) == (False, True)
    (recording,) = bags[0].glob("*.mcap")
    os.utime(recording)
    assert new("--skip", 1) == (True, False)
    changed = tmp_path / "changed.yaml"
    changed.write_text(finger_yaml.read_text(encoding="utf-8").replace("lever_arms: true", "lever_arms: false"))
    assert new("--skip", 1, "-c", changed) == (True, True)


def test_an_interrupted_run_ends_at_once_in_one_line_and_goes_on(
    jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    others = [tmp_path / f"other_{number}" for number in range(10)]
    rig = ("finger", "-o", others[0], "--rate", 200, "--duration", 60, "--zero-pose", 2)
    assert jointest("simulate", *rig).code == 0
    for other in others[1:]:
        shutil.copytree(others[0], other)
    bags = [str(bag) for bag in (finger, *others)]
    command = [sys.executable, "-c", MAIN, "evaluate", *bags, "-c", str(finger_yaml)]
    command += ["--jobs", "2", "--resume", str(tmp_path / "kept")]
    # where this process ignores SIGINT, as in the background of a shell, its children would as well
    before_it = signal.signal(signal.SIGINT, signal.default_int_handler)
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        signal.signal(signal.SIGINT, before_it)
        assert process.stdout
        assert str(finger) in process.stdout.readline()  # the first is done, many others are not
        os.killpg(process.pid, signal.SIGINT)  # as the terminal does
        _, err = process.communicate(timeout=30)  # returns when the workers have ended, too
    assert process.returncode == 130
    assert err == "jointest evaluate: interrupted\n"
    before = {kept: kept.stat().st_mtime_ns for kept in (tmp_path / "kept").iterdir()}
    assert 1 <= len(before) < len(bags)
    assert jointest(*command[3:]).code == 0
    assert len(list((tmp_path / "kept").iterdir())) == len(bags)
    assert {kept: kept.stat().st_mtime_ns for kept in before} == before


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--jobs", 0), "--jobs: 0 is not allowed"),
        (("--jobs", 2, "--scheduler", "tcp://127.0.0.1:1"), "--jobs: of no use with --scheduler"),
        (("--resume", __file__), "--resume"),
        (("--scheduler", "nonsense://1"), "--scheduler: no Dask scheduler at 'nonsense://1'"),
    ],
)
def test_bad_options_are_refused_in_one_line(
    options: tuple[object, ...], reason: str, jointest: Jointest, finger: Path, finger_yaml: Path
) -> None:
    assert reason in jointest("evaluate", finger, "-c", finger_yaml, *options).refusal()
