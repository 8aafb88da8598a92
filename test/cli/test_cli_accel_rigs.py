"""Recordings of accelerometers from the command that makes them to the errors of the estimators."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PROJECT = Path(__file__).resolve().parents[2]
Jointest = Callable[..., Any]
ESTIMATORS = ["accel_analytical", "accel_ekf", "accel_ukf"]


def figures(jointest: Jointest, tmp_path: Path, bag: Path, configuration: Path) -> dict[str, Any]:
    """The JSON of `jointest evaluate` after 2 s."""
    target = tmp_path / "figures.json"
    result = jointest("evaluate", bag, "-c", configuration, "--skip", 2, "--json", target)
    assert (result.code, result.err) == (0, "")
    made: dict[str, Any] = json.loads(target.read_text(encoding="utf-8"))
    assert all(not topic["refused"] for topic in made["input"].values())
    return made["estimators"]


def test_the_shipped_recording(jointest: Jointest, tmp_path: Path) -> None:
    made = figures(jointest, tmp_path, PROJECT / "bags/two_link_accel", PROJECT / "config/two_link_accel.yaml")
    assert sorted(made) == ESTIMATORS
    angle = {name: one["joints"]["elbow"] for name, one in made.items()}
    velocity = {name: one["velocities"]["elbow"]["rmse_deg"] for name, one in made.items()}
    assert angle["accel_ekf"]["rmse_deg"] < 1.0 and velocity["accel_ekf"] < 1.0
    # a constant error is left by the sensors' biases: of the clamped link they cannot be told from the angle
    spread = {name: one["std_deg"] for name, one in angle.items()}
    assert spread["accel_ekf"] < spread["accel_ukf"] < spread["accel_analytical"]


@pytest.mark.parametrize(
    ("rig", "scenario", "joint"), [("two_link_arm", "impulse", "elbow"), ("slider_crank", "G", "crank_pin")]
)
def test_a_simulation_and_the_configuration_beside_it(
    rig: str, scenario: str, joint: str, jointest: Jointest, tmp_path: Path
) -> None:
    bag = tmp_path / "run"
    assert jointest("simulate", rig, "-o", bag, "--scenario", scenario, "--duration", 10).code == 0
    made = figures(jointest, tmp_path, bag, tmp_path / "run.yaml")
    assert sorted(made) == ESTIMATORS
    assert made["accel_ekf"]["joints"][joint]["coverage"] == 1.0


def test_the_semi_synthetic_pendulum(shared_data: Path, jointest: Jointest, tmp_path: Path) -> None:
    """Residual errors of calibration (up to 20 mg and 1 %), which only the estimator with bias states removes."""
    source = shared_data / "multiarm" / "DoublePendulumDataForParameterEstimation.mat"
    assert jointest("convert", "multiarm", source, "-o", tmp_path / "run", "--rate", 200).code == 0
    made = figures(jointest, tmp_path, tmp_path / "run", PROJECT / "config/multiarm.yaml")
    assert sorted(made) == ESTIMATORS
    angle = {name: one["joints"]["elbow"] for name, one in made.items()}
    assert angle["accel_ekf"]["rmse_deg"] < 0.5 and angle["accel_ekf"]["max_abs_deg"] < 3.0
    assert angle["accel_ekf"]["rmse_deg"] < 0.5 * min(
        angle[name]["rmse_deg"] for name in ESTIMATORS if "ekf" not in name
    )
