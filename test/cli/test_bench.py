"""`jointest bench` as a user meets it. Nothing is said of how long anything may take."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from jointest_ros.benchmark.part import Options, PartResult
from jointest_ros.cli import bench
from jointest_ros.reproduction.result import Report, ResultTable

Jointest = Callable[..., Any]


def one_row(failures: tuple[str, ...] = ()) -> Callable[[Options, Report], PartResult]:
    """A part that costs nothing."""

    def run(options: Options, report: Report) -> PartResult:
        report(1, 1)
        cost = 1.0 if options.quick else 2.0
        table = ResultTable("costs", ("step", "us"), [("ours", cost), ("theirs", float("nan"))])
        return PartResult((table,), ("measured nowhere",), failures)

    return run


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """`steps` costs nothing, `soak` fails."""
    monkeypatch.setitem(bench.PARTS, "steps", bench.Part("steps of nothing", one_row()))
    monkeypatch.setitem(bench.PARTS, "soak", bench.Part("hours of nothing", one_row(("memory grew by 8 %",)), False))


@pytest.mark.usefixtures("parts")
def test_table_and_json_have_the_same_rows(jointest: Jointest, tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    result = jointest("bench", "steps", "--quick", "--json", file)
    assert result.code == 0
    assert all(text in result.out for text in ("steps of nothing", "ours", "theirs", "measured nowhere", str(file)))
    document = json.loads(file.read_text(encoding="utf-8"))
    assert list(document) == ["schema", "quick", "machine", "parts"]
    assert document["schema"] == 1 and document["quick"] is True
    assert {"python", "numpy", "cpus"} <= set(document["machine"])
    assert document["parts"] == {
        "steps": {
            "conditions": ["measured nowhere"],
            "failures": [],
            "tables": [{"title": "costs", "rows": [{"step": "ours", "us": 1.0}, {"step": "theirs", "us": None}]}],
        }
    }


@pytest.mark.usefixtures("parts")
def test_a_failure_is_said_in_one_line_and_by_the_exit_code(jointest: Jointest, tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    result = jointest("bench", "steps", "soak", "--hours", 0.5, "--json", file)
    assert result.code == 1
    assert result.err == "jointest bench soak: error: memory grew by 8 %\n"
    assert json.loads(file.read_text(encoding="utf-8"))["parts"]["soak"]["failures"] == ["memory grew by 8 %"]


def test_unknown_parts_and_options_without_effect_are_refused(jointest: Jointest, tmp_path: Path) -> None:
    text = jointest("bench", "steps", "nods").refusal()
    assert "'nods'" in text and all(name in text for name in bench.PARTS)
    assert "--hours" in jointest("bench", "steps", "--hours", 3).refusal()
    assert "hours: -1" in jointest("bench", "soak", "--hours", -1).refusal()
    assert "cannot be written" in jointest("bench", "steps", "--json", tmp_path / "none" / "f.json").refusal()


def test_help_names_every_part(jointest: Jointest) -> None:
    result = jointest("bench", "--help")
    assert result.code == 0 and all(f"  {name} " in result.out for name in bench.PARTS)
