"""docs/your_robot.md stays true: its commands run, in their order, and print what stands there."""

from __future__ import annotations

import re
import shlex
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from jointest_ros.cli import common

PROJECT = Path(__file__).resolve().parents[2]


def commands() -> Iterator[tuple[str, int, list[str]]]:
    """(command, exit code, lines that are shown) of the page."""
    page = (PROJECT / "docs" / "your_robot.md").read_text(encoding="utf-8")
    for block in re.findall(r"```console\n(.*?)```", page, re.DOTALL):
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            command, *shown = part.splitlines()
            code = 0
            if shown and (stated := re.fullmatch(r"# exit code (\d)", shown[0])):
                code, shown = int(stated[1]), shown[1:]
            yield command, code, shown


def words(line: str) -> list[str]:
    """A line without the frame of a table."""
    return line.replace("│", " ").split()


def test_every_command_does_what_the_page_shows(
    jointest: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(common.out, "width", 160)  # as into a pipe: pytest-xdist sets COLUMNS to 80
    (tmp_path / "bags").symlink_to(PROJECT / "bags")
    tried = list(commands())
    for command, code, shown in tried:
        if command.startswith("jointest "):
            result = jointest(*shlex.split(command)[1:])
            printed = result.out
            assert result.code == code, (command, result)
        else:
            printed = subprocess.run(command, shell=True, check=True, capture_output=True, text=True).stdout
        lines = [words(line) for line in printed.splitlines()]
        for line in shown:
            wanted = words(line)
            assert any(has[: len(wanted)] == wanted or line in " ".join(has) for has in lines), (command, line, printed)
    for name in ("init", "inspect", "calibrate axis", "calibrate zero", "evaluate", "estimate"):
        assert any(command.startswith(f"jointest {name} ") for command, *_ in tried)
