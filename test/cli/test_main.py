"""What holds for every command: help, exit codes, one line for what a user did wrong."""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from jointest_ros import __version__
from jointest_ros.bags import synthetic
from jointest_ros.cli import common, convert
from jointest_ros.core.errors import JointestError

Jointest = Callable[..., Any]
COMMANDS = ("demo", "simulate", "convert", "estimate", "evaluate")


def test_without_arguments_it_prints_its_help(jointest: Jointest) -> None:
    result = jointest()
    assert (result.code, result.err) == (0, "")
    assert result.out == jointest("--help").out
    assert "First steps:" in result.out
    assert all(f"\n    {command} " in result.out for command in COMMANDS)


def test_version(jointest: Jointest) -> None:
    assert jointest("--version") == (0, f"jointest {__version__}\n", "")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_a_help_that_says_what_it_does(command: str, jointest: Jointest) -> None:
    result = jointest(command, "--help")
    assert (result.code, result.err) == (0, "")
    assert result.out.startswith(f"usage: jointest {command}")
    assert len(result.out) > 400


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["frobnicate"], "invalid choice: 'frobnicate'"),
        (["evalute", "bag"], "invalid choice: 'evalute'; did you mean 'evaluate'?"),
        (["evaluate", "bag", "--confg", "x.yaml"], "unrecognized arguments: --confg; did you mean '--config'?"),
        (["simulate", "finger", "--ratte=5"], "unrecognized arguments: --ratte; did you mean '--rate'?"),
        (["--frobnicate", "demo"], "unrecognized arguments: --frobnicate"),
        (["simulate"], "the following arguments are required: RIG"),
        (["simulate", "octopus", "-o", "x"], "invalid choice: 'octopus'"),
        (["simulate", "finger"], "the following arguments are required: -o/--output"),
        (["simulate", "finger", "-o", "x", "--rate", "fast"], "--rate: invalid float value: 'fast'"),
        (["simulate", "finger", "-o", "x", "--storage", "tape"], "--storage: invalid choice: 'tape'"),
        (["convert", "video", "a", "-o", "b"], "invalid choice: 'video'"),
        (["estimate", "bag", "-o", "x.csv"], "the following arguments are required: --config/-c"),
        (["evaluate", "-c", "x.yaml"], "the following arguments are required: BAG"),
        (["evaluate", "bag", "-c", "x.yaml", "--skip", "a while"], "--skip: invalid float value: 'a while'"),
        (["evaluate", "bag", "-c", "x.yaml", "--json"], "--json: expected one argument"),
    ],
)
def test_arguments_that_are_none(arguments: list[str], expected: str, jointest: Jointest) -> None:
    """The usage, then one line that names the argument."""
    result = jointest(*arguments)
    assert (result.code, result.out) == (2, "")
    assert result.err.startswith("usage: jointest")
    assert expected in result.err.splitlines()[-1]


def failing(error: BaseException) -> object:
    def run(_arguments: argparse.Namespace) -> int:
        raise error

    return run


def test_what_a_user_caused_is_one_line(jointest: Jointest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convert, "run", failing(JointestError("[red]first[/red] :smile:\nsecond, " + "long " * 50)))
    assert jointest("convert", "song", "a", "-o", "b").refusal() == (
        "[red]first[/red] :smile: second, " + ("long " * 50).strip()
    )


def test_an_interruption_is_one_line_and_code_130(jointest: Jointest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convert, "run", failing(KeyboardInterrupt()))
    assert jointest("convert", "song", "a", "-o", "b") == (130, "", "jointest convert: interrupted\n")


def test_ctrl_c_leaves_nothing_behind(jointest: Jointest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    whole = synthetic.messages

    def messages(stretches: Any) -> Iterator[Any]:
        for number, message in enumerate(whole(stretches)):
            if number == 5000:
                signal.raise_signal(signal.SIGINT)
            yield message

    monkeypatch.setattr(synthetic, "messages", messages)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a worker of pytest-xdist ignores it
    try:
        result = jointest("simulate", "finger", "-o", tmp_path / "run", "--duration", 86400)
    finally:
        signal.signal(signal.SIGINT, before)
    assert result == (130, "", "jointest simulate: interrupted\n")
    assert list(tmp_path.iterdir()) == []


def test_a_mistake_of_ours_is_not_hidden(jointest: Jointest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convert, "run", failing(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        jointest("convert", "song", "a", "-o", "b")


@pytest.mark.parametrize("command", ["inspect", "evaluate"])
def test_a_narrow_terminal_cuts_no_figure(
    command: str, jointest: Jointest, finger: Path, finger_yaml: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = []
    for width in (200, 80, 40):
        monkeypatch.setattr(common.out, "_width", width)
        text = jointest(command, finger, "-c", finger_yaml).out
        assert "…" not in text
        shown.append(re.findall(r"(?<= )-?[0-9.]+%?(?= )", text))
    assert len(shown[0]) > 20
    assert shown == shown[:1] * 3


# -------------------------------------------------------------------- as processes

PROGRAM = [sys.executable, "-c", "import sys; from jointest_ros.cli.main import main; sys.exit(main())"]
PROJECT = Path(__file__).resolve().parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": f"{PROJECT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}


def test_as_a_process(finger: Path, finger_yaml: Path) -> None:
    command = [*PROGRAM, "evaluate", str(finger), "-c", str(finger_yaml)]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    assert "finger_mcp" in done.stdout
    done = subprocess.run([*command, "--skip", "-1"], env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "jointest evaluate: error: --skip: -1.0 is not allowed; give 0 or more seconds\n"


def test_a_reader_that_goes_away_gets_no_traceback(finger: Path, finger_yaml: Path) -> None:
    command = [*PROGRAM, "evaluate", str(finger), "-c", str(finger_yaml)]
    process = subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    assert process.stderr.read() == ""
    process.stderr.close()
    process.wait(timeout=60)
