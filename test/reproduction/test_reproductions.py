"""Every reproduction, cut short: what it computes, draws and writes as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

import pytest
from matplotlib.figure import Figure

from jointest_ros.core.errors import JointestError
from jointest_ros.reproduction import accel_multiples
from jointest_ros.reproduction import exoshell_trials as trials
from jointest_ros.reproduction.catalogue import REPRODUCTIONS
from jointest_ros.reproduction.result import Options, Result, ResultTable

CUT = Options(seed=5, runs=1, duration_s=12.0)


@pytest.fixture(scope="module")
def progress() -> dict[str, list[tuple[int, int]]]:
    """What each reported while `results` were computed."""
    return {name: [] for name in REPRODUCTIONS}


@pytest.fixture(scope="module")
def results(progress: dict[str, list[tuple[int, int]]]) -> Iterator[dict[str, Result]]:
    """All of them, computed once; the longest in two of its scenarios."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(accel_multiples, "CASES", accel_multiples.CASES[1:4:2])
        yield {
            name: entry.run(lambda done, total, name=name: progress[name].append((done, total)), CUT)  # type: ignore[misc]
            for name, entry in REPRODUCTIONS.items()
        }


def table(result: Result, number: int = 0) -> list[dict[str, Any]]:
    """The rows of one table by column."""
    return result.tables[number].document()["rows"]


@pytest.mark.parametrize("name", REPRODUCTIONS)
def test_it_has_a_table_a_plot_with_units_and_its_conditions(name: str, results: dict[str, Result]) -> None:
    result = results[name]
    assert REPRODUCTIONS[name].name == name
    json.dumps(result.document(), allow_nan=False)
    assert result.conditions and all(len(row) == len(t.columns) for t in result.tables for row in t.rows)
    assert all(len(set(t.columns)) == len(t.columns) for t in result.tables)
    figure = Figure(figsize=result.size, layout="constrained")
    result.draw(figure)
    assert all(axes.get_ylabel() for axes in figure.axes)
    assert sum(len(axes.lines) + len(axes.patches) for axes in figure.axes)


def test_the_seed_decides(results: dict[str, Result]) -> None:
    entry = REPRODUCTIONS["kckf-human"]
    again, other = (
        entry.run(lambda done, total: None, Options(seed=seed, runs=1, duration_s=12.0)).tables for seed in (5, 6)
    )
    assert again == results["kckf-human"].tables != other


@pytest.mark.parametrize("name", REPRODUCTIONS)
def test_progress_is_reported(
    name: str, results: dict[str, Result], progress: dict[str, list[tuple[int, int]]]
) -> None:
    done, totals = zip(*progress[name], strict=True)
    assert len(set(totals)) == 1 and len(done) > 1
    assert list(done) == sorted(set(done)) and done[-1] <= totals[0]


def test_table_1_our_rows_are_in_the_order_of_what_the_filters_know(results: dict[str, Result]) -> None:
    ours = {row["method"]: row for row in table(results["kckf-table1"]) if row["of"] == "ours"}
    joints = ("θ1x", "θ2y", "θ3x", "θ4y")
    for joint in joints:
        assert ours[trials.OURS_OFFSET][joint] < ours[trials.OURS][joint] < ours[trials.PAPER_KCKF][joint]
    for column in ("φx", "φy"):
        # (10) without correction; the paper's printed entries contradict it
        assert ours[trials.STANDARD_KF][column] == pytest.approx(ours["gyro"][column], abs=1e-9)


def test_table_1_averages_over_the_trials() -> None:
    def figures(seed: int, runs: int) -> float:
        options = Options(seed=seed, runs=runs, duration_s=10.0)
        return float(table(REPRODUCTIONS["kckf-table1"].run(lambda done, total: None, options))[1]["θ1x"])

    assert figures(1, 2) == pytest.approx((figures(1, 1) + figures(2, 1)) / 2.0, rel=1e-12)


def test_drift_grows_in_the_standard_filter_and_nowhere_else(results: dict[str, Result]) -> None:
    for row in table(results["kckf-drift"]):
        if row["filter"] == trials.STANDARD_KF:
            assert row["end"] == pytest.approx(0.1528 * CUT.duration_s, abs=0.1)
        elif row["filter"] == trials.PAPER_KCKF:
            assert row["mean"] == pytest.approx(7.0 if row["Hall"] == "off" else 0.0, abs=0.6)
    printed = [(row["filter"], row["Hall"], row["paper"]) for row in table(results["kckf-drift"]) if row["paper"]]
    assert printed == [(trials.STANDARD_KF, "exact", 550.0), (trials.PAPER_KCKF, "off", 7.0)]


def test_observability_is_as_the_paper_says_and_hinge_sensors_are_not_enough(results: dict[str, Result]) -> None:
    ranks = table(results["kckf-observability"])
    assert [row["n"] for row in ranks] == list(range(2, 9))
    for row in ranks:
        n = row["n"]
        assert row["KCKF: ours"] == row["KCKF: paper"] == 6 * n + 6
        assert row["KF: ours"] == row["KF: paper"] == 6 * n
        assert row["hinges: ours"] == row["hinges: 2n+6"] == 2 * n + 6
    hidden = {row["filter"]: row["states"] for row in table(results["kckf-observability"], 1)}
    assert hidden["KCKF (19)"] == "none"
    assert hidden["standard KF (8)"] == "φ, bφ"
    assert hidden["KCKF, hinge Halls only"].startswith("θ1yz, θ2xz")


def test_human_misalignment_stays_in_the_bending_joints(results: dict[str, Result]) -> None:
    ours = {row["method"]: row for row in table(results["kckf-human"]) if row["of"] == "ours"}
    for method in (trials.PAPER_KCKF, trials.OURS):
        assert ours[method]["θ2y"] < 0.3 < ours[method]["θ1x"]
        assert ours[method]["φx"] == pytest.approx(ours[method]["torso"], rel=0.1)
    assert [row["φx"] for row in table(results["kckf-human"]) if row["of"] == "paper"] == [4.85]


def test_float32_stays_with_float64(results: dict[str, Result]) -> None:
    figures = {row["figure"]: row for row in table(results["kckf-float32"])}
    assert figures["steps"]["float32"] == 12000
    assert figures["largest |P - Pᵀ| / |P|"]["float32"] < 1e-6
    assert figures["smallest eigenvalue of P as correlations"]["float32"] > 0.0
    assert figures["largest relative difference of a variance"]["float32"] <= 0.01


def test_options_are_checked() -> None:
    for values, reason in (
        ({"duration_s": 3.0}, "10 s or more"),
        ({"duration_s": math.inf}, "duration_s"),
        ({"runs": -1}, "runs"),
        ({"seed": -1}, "seed"),
    ):
        with pytest.raises(JointestError, match=reason):
            Options(**values)  # type: ignore[arg-type]


def test_json_has_null_where_there_is_no_number() -> None:
    made = ResultTable("t", ("a", "b"), [(math.nan, math.inf), (1.5, None)])
    assert made.document()["rows"] == [{"a": None, "b": None}, {"a": 1.5, "b": None}]
    assert [made.text(cell) for cell in (1.234, -0.001, None, 3, "x")] == ["1.23", "0.00", "", "3", "x"]
