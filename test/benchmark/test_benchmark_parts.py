"""The parts of `jointest bench` that need no ROS, run quickly: rows are complete and finite, whatever the cost."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from jointest_ros.benchmark import joints, peers, recordings, steps
from jointest_ros.benchmark.cost import REFERENCE
from jointest_ros.benchmark.evaluation import BY, in_a_process
from jointest_ros.benchmark.part import BenchError, Options, PartResult
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.reproduction.result import Cell, Report

QUICK = Options(quick=True)


def rows(run: Callable[[Options, Report], PartResult]) -> list[dict[str, Cell]]:
    """The rows of a part's only table; its progress must reach the end, and its numbers be finite and positive."""
    reports: list[tuple[int, int]] = []
    result = run(QUICK, lambda done, total: reports.append((done, total)))
    assert reports == sorted(reports) and reports[0][0] == 0 and len({total for _, total in reports}) == 1
    (table,) = result.tables
    assert result.conditions and not result.failures
    found = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    for row in found:
        for name, value in row.items():
            if isinstance(value, float):
                assert math.isfinite(value) and value >= 0.0, (row, name)
                assert value > 0.0 or name.endswith("spread_us") or name == "peak_mb"
    return found


def test_steps_has_every_estimator_and_every_installed_peer_by_update_and_by_arrays() -> None:
    found = {row["step"]: row for row in rows(steps.run)}
    ours = {name for name, kind in ESTIMATORS.items() if kind.__module__.startswith("jointest_ros.")}
    assert {case.estimator for case in steps.CASES} == ours
    assert [*found][: len(steps.CASES)] == [case.label for case in steps.CASES]
    assert all(found[case.label]["arrays_us"] for case in steps.CASES)
    assert ("vqf" in found) == ("vqf" not in peers.absent())
    assert found[REFERENCE]["ratio"] == 1.0
    assert found["kckf composed, 4 three-axis"]["joints"] == 12
    assert [found[label]["budget_us"] for label in ("pcf hinge, a pair", "kckf additive, 4 hinges")] == [5.0, 25.0]


def test_joints_has_every_estimator_with_every_number_of_joints() -> None:
    found = rows(joints.run)
    labels = {str(row["estimator"]) for row in found}
    assert {re.split("[ ,]", label)[0] for label in labels} == {"pcf", "kckf", "accel_ekf"}
    for label in labels:
        counts = [row["joints"] for row in found if row["estimator"] == label]
        assert counts == [*joints.QUICK_COUNTS]
    for row in found:
        axes = 3 if "three-axis" in str(row["estimator"]) else 1
        assert row["angles"] == axes * int(str(row["joints"]))
        assert row["growth"] == pytest.approx(1.0) or row["joints"] != joints.QUICK_COUNTS[0]


def test_offline_has_every_storage_and_the_frames_of_the_recording() -> None:
    found = rows(recordings.run)
    assert [(row["storage"], row["recording_s"], row["by"]) for row in found] == [
        (storage, seconds, by)
        for seconds in recordings.QUICK_DURATIONS_S
        for storage in recordings.STORAGES
        for by in BY
    ]
    for row in found:
        assert row["frames"] == row["recording_s"] * recordings.RATE_HZ  # type: ignore[operator]


def test_an_evaluation_that_fails_says_why_in_one_line(tmp_path: Path, finger_config: Path) -> None:
    with pytest.raises(BenchError, match=r"^the evaluation of none failed: .*Hall sensors; give at least one$"):
        in_a_process(tmp_path / "none", finger_config, "update")
