"""`--smooth` of `jointest estimate` and `jointest evaluate`."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Jointest = Callable[..., Any]
PROJECT = Path(__file__).resolve().parents[2]
BAG, CONFIG = PROJECT / "bags" / "two_link_accel", PROJECT / "config" / "two_link_accel.yaml"


def test_evaluate_has_the_smoother_beside_the_filter(jointest: Jointest, tmp_path: Path) -> None:
    out = tmp_path / "figures.json"
    result = jointest("evaluate", BAG, "--config", CONFIG, "--skip", 2, "--smooth", "--json", out)
    assert result.code == 0
    estimators = json.loads(out.read_text())["estimators"]
    filtered, smoothed = (estimators[name]["velocities"]["elbow"] for name in ("accel_ekf", "accel_ekf_smoothed"))
    assert smoothed["std_deg"] < 0.9 * filtered["std_deg"]
    assert smoothed["samples"] == filtered["samples"]
    assert "accel_ukf_smoothed" not in estimators


def test_estimate_writes_the_smoothed_angles(jointest: Jointest, tmp_path: Path) -> None:
    rows = {}
    for name, options in (("filtered", ()), ("smoothed", ("--smooth",))):
        out = tmp_path / f"{name}.csv"
        arguments = ("--config", CONFIG, "--estimator", "accel_ekf", "-o", out)
        assert jointest("estimate", BAG, *arguments, *options).code == 0
        with out.open(newline="") as file:
            rows[name] = list(csv.reader(file))
    assert rows["smoothed"][0] == rows["filtered"][0]
    assert len(rows["smoothed"]) == len(rows["filtered"])
    last = [[float(value) for value in rows[name][-1]] for name in rows]
    assert last[0] == pytest.approx(last[1], rel=1e-9)  # nothing comes after it
    assert rows["smoothed"][500] != rows["filtered"][500]


@pytest.mark.parametrize("command", ["evaluate", "estimate"])
def test_estimators_that_cannot_smooth(command: str, jointest: Jointest, tmp_path: Path) -> None:
    options = ("-o", tmp_path / "out.csv") if command == "estimate" else ()
    result = jointest(command, BAG, "--config", CONFIG, "--estimator", "accel_ukf", "--smooth", *options)
    assert result.refusal().startswith("--smooth: accel_ukf cannot smooth")
