"""`jointest evaluate --against`: what changed, told, and judged where asked for."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Jointest = Callable[..., Any]


@pytest.fixture(scope="module")
def earlier(
    jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Any]:
    """The document of an evaluation."""
    out = tmp_path_factory.mktemp("earlier") / "old.json"
    assert jointest("evaluate", finger, "-c", finger_yaml, "--json", out).code == 0
    found: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return found


@pytest.fixture
def old(earlier: dict[str, Any], tmp_path: Path) -> Callable[..., Path]:
    """A function that writes the earlier evaluation after a change, and returns the file."""

    def write(change: Callable[[dict[str, Any]], None] = lambda document: None) -> Path:
        document = json.loads(json.dumps(earlier))
        change(document)
        path = tmp_path / "old.json"
        path.write_text(json.dumps(document), encoding="utf-8")
        return path

    return write


def scaled(joint: str, factor: float) -> Callable[[dict[str, Any]], None]:
    """A change of one rms error."""

    def change(document: dict[str, Any]) -> None:
        document["estimators"]["pcf"]["joints"][joint]["rmse_deg"] *= factor

    return change


def rows(text: str) -> dict[tuple[str, str], list[str]]:
    """The cells of the table of changes by kind and joint."""
    found = {}
    for line in text.splitlines()[
        text.splitlines().index(next(filter(lambda one: "since" in one, text.splitlines()))) :
    ]:
        cells = [cell.strip() for cell in line.split("│")[1:-1]]
        if len(cells) == 7:
            found[cells[1], cells[2]] = cells[3:]
    return found


def test_nothing_changed(jointest: Jointest, finger: Path, finger_yaml: Path, old: Callable[..., Path]) -> None:
    result = jointest("evaluate", finger, "-c", finger_yaml, "--against", old(), "--fail-worse", 0)
    assert (result.code, result.err) == (0, "")
    found = rows(result.out)
    assert len(found) == 6  # angles and velocities of three joints
    assert all(cells[3] == "" and cells[0] == cells[1] for cells in found.values())


def test_worse_better_new_and_gone(
    jointest: Jointest, finger: Path, finger_yaml: Path, earlier: dict[str, Any], old: Callable[..., Path]
) -> None:
    def change(document: dict[str, Any]) -> None:
        scaled("finger_mcp", 0.5)(document)
        scaled("finger_pip", 2.0)(document)
        pcf = document["estimators"]["pcf"]
        del pcf["joints"]["finger_dip"]
        pcf["joints"]["thumb"] = pcf["joints"]["finger_mcp"]
        document["estimators"]["vanished"] = pcf
        document["settings"]["estimators"]["pcf"]["floor_deg"] = 7.0
        document["settings"]["skip_s"] = 1.0
        document["versions"]["numpy"] = "1.0"

    result = jointest("evaluate", finger, "-c", finger_yaml, "--against", old(change))
    assert result.code == 0
    found = rows(result.out)
    rmse = earlier["estimators"]["pcf"]["joints"]["finger_mcp"]["rmse_deg"]
    assert found["joints", "finger_mcp"] == [
        f"{0.5 * rmse:.3f}", f"{rmse:.3f}", f"{0.5 * rmse:+.3f} (+100.0 %)", "worse"
    ]  # fmt: skip
    assert found["joints", "finger_pip"][3] == "better"
    assert found["joints", "finger_dip"][3] == "new"
    assert found["joints", "thumb"][1:] == ["-", "-", "gone"]
    lines = result.out.splitlines()
    assert "not evaluated now: vanished" in lines
    assert "estimators.pcf.floor_deg: 7.0 -> 0.05" in lines
    assert "skip_s: 1.0 -> 0.0" in lines
    assert any(line.startswith("numpy: 1.0 -> ") for line in lines)


def test_fail_worse_judges_by_its_percentage(
    jointest: Jointest, finger: Path, finger_yaml: Path, old: Callable[..., Path]
) -> None:
    against = old(scaled("finger_mcp", 0.9))  # now 11 % worse
    result = jointest("evaluate", finger, "-c", finger_yaml, "--against", against, "--fail-worse", 5)
    assert result.code == 1
    assert result.err == f"jointest evaluate: error: --fail-worse: 1 rms errors are worse than in {against}\n"
    assert jointest("evaluate", finger, "-c", finger_yaml, "--against", against, "--fail-worse", 20).code == 0


def test_the_json_on_standard_output_stays_json(
    jointest: Jointest, finger: Path, finger_yaml: Path, earlier: dict[str, Any], old: Callable[..., Path]
) -> None:
    result = jointest("evaluate", finger, "-c", finger_yaml, "--against", old(), "--json", "-")
    assert set(json.loads(result.out)) == set(earlier)
    assert "rms errors since" in result.err


def test_recordings_are_compared_by_name(
    jointest: Jointest, finger: Path, finger_yaml: Path, earlier: dict[str, Any], tmp_path: Path
) -> None:
    other = shutil.copytree(finger, tmp_path / "other")
    documents = [{**earlier, "bag": "elsewhere/run"}, {**earlier, "bag": "elsewhere/third"}]
    against = tmp_path / "old.json"
    against.write_text(json.dumps(documents), encoding="utf-8")
    result = jointest("evaluate", finger, other, "-c", finger_yaml, "--against", against)
    assert result.code == 0
    assert result.out.count("rms errors since") == 1
    assert f"recording: elsewhere/run -> {finger}" in result.out
    assert f"warning: {other}: not in {against}" in result.err


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, "cannot be read: No such file or directory"),
        ("estimators: {}", "not a JSON file; give what evaluate --json wrote"),
        ("[" * 100_000, "not a JSON file; give what evaluate --json wrote"),
        ("[1]", "not a JSON of evaluate with schema 1"),
        ('{"schema": 2}', "not a JSON of evaluate with schema 1"),
        ('{"schema": 1, "bag": "x"}', "damaged: figures of evaluate --json are missing in it"),
        ('{"schema": 1, "bag": "x", "estimators": {"pcf": {"joints": {"a": {}}}}}', "damaged: figures"),
        ('{"schema": 1, "bag": "x", "estimators": {}}', "damaged: figures"),
        ('{"schema": 1, "bag": "x", "estimators": {}, "duration_s": 1, "versions": 2}', "damaged: figures"),
        ('{"schema": 1, "bag": "x", "estimators": {}, "duration_s": NaN}', "not a JSON file"),
    ],
)
def test_what_is_no_earlier_evaluation(
    content: str | None, reason: str, jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    against = tmp_path / "old.json"
    if content is not None:
        against.write_text(content, encoding="utf-8")
    result = jointest("evaluate", finger, "-c", finger_yaml, "--against", against)
    assert result.refusal().startswith(f"--against: {against}: {reason}")
    assert result.out == ""


def test_a_figure_that_is_no_number_is_told(
    jointest: Jointest, finger: Path, finger_yaml: Path, old: Callable[..., Path]
) -> None:
    def damage(document: dict[str, Any]) -> None:
        document["estimators"]["pcf"]["joints"]["finger_mcp"]["rmse_deg"] = "1"

    assert "damaged: figures" in jointest("evaluate", finger, "-c", finger_yaml, "--against", old(damage)).refusal()


def test_fail_worse_never_passes_without_a_comparison(
    jointest: Jointest, finger: Path, finger_yaml: Path, old: Callable[..., Path]
) -> None:
    """Another estimator, other recordings, none at all: told, since a gate in CI would stay open."""
    against = old(lambda document: document.update(estimators={"kckf": document["estimators"]["pcf"]}))
    options = ("evaluate", finger, "-c", finger_yaml, "--against", against)
    assert jointest(*options).code == 0
    result = jointest(*options, "--fail-worse", 5)
    assert result.code == 2
    assert f"--fail-worse: {against} has no rms error of these recordings and estimators" in result.err
    against.write_text("[]", encoding="utf-8")
    result = jointest(*options, "--fail-worse", 5)
    assert result.code == 2 and f"warning: {finger}: not in {against}" in result.err


def test_fail_worse_needs_an_earlier_evaluation(
    jointest: Jointest, finger: Path, finger_yaml: Path, old: Callable[..., Path]
) -> None:
    text = jointest("evaluate", finger, "-c", finger_yaml, "--fail-worse", 5).refusal()
    assert text == "--fail-worse: give an earlier evaluation by --against"
    for percent in ("-1", "nan", "inf"):
        result = jointest("evaluate", finger, "-c", finger_yaml, "--against", old(), f"--fail-worse={percent}")
        assert result.refusal() == f"--fail-worse: {float(percent)} is not allowed; give 0 or more percent"
