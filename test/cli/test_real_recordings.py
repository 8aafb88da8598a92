"""Real recordings through `jointest convert` and `jointest evaluate`: the figures of the specification, section 4."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Evaluate = Callable[..., Any]
CONFIGURATIONS = Path(__file__).resolve().parents[2] / "config"


@pytest.fixture(scope="module")
def evaluate(
    jointest: Callable[..., Any], published: Callable[[str, str], Path], tmp_path_factory: pytest.TempPathFactory
) -> Evaluate:
    """A function that converts a file and evaluates it; returns the figures of `pcf`."""
    figures = tmp_path_factory.mktemp("real") / "figures.json"

    def run(form: str, source: str, configuration: Path, *options: object) -> Any:
        result = jointest("evaluate", published(form, source), "-c", configuration, *options, "--json", figures)
        assert (result.code, result.err) == (0, "")
        document = json.loads(figures.read_text(encoding="utf-8"))
        for counts in document["input"].values():
            assert counts["used"] > 0.99 * counts["messages"]
            assert counts["messages"] == counts["used"] + sum(counts["refused"].values())
        return document["estimators"]["pcf"]

    return run


@pytest.mark.parametrize(
    ("source", "configuration", "largest_std_deg"),
    [("raw_pitch_slow.mat", "song_pitch.yaml", 1.0), ("raw_roll_medium.mat", "song_roll.yaml", 1.5)],
)
def test_a_hinge_against_its_encoder_for_25_minutes(
    source: str, configuration: str, largest_std_deg: float, evaluate: Evaluate
) -> None:
    shaft = evaluate("song", source, CONFIGURATIONS / configuration, "--skip", 20)["joints"]["shaft"]
    print(f"{source}: std {shaft['std_deg']:.3f}, max {shaft['max_abs_deg']:.2f} deg")
    assert shaft["std_deg"] <= largest_std_deg
    assert shaft["coverage"] > 0.99
    assert shaft["samples"] > 140_000


def test_the_relative_formulation_drifts_where_the_hinge_does_not(evaluate: Evaluate, tmp_path: Path) -> None:
    """The comparison is a meaningful one: without the constraint, rotation about gravity is integrated gyro."""
    text = (CONFIGURATIONS / "song_roll.yaml").read_text(encoding="utf-8")
    (tmp_path / "relative.yaml").write_text(text.replace("formulation: hinge", "formulation: relative"), "utf-8")
    shaft = evaluate("song", "raw_roll_medium.mat", tmp_path / "relative.yaml", "--skip", 20)["joints"]["shaft"]
    print(f"relative: std {shaft['std_deg']:.1f} deg")
    assert shaft["std_deg"] > 12.0


# The vertical from an accelerometer of some 10 mg bias: .6 deg. An IMU carried about quickly measures its own
# acceleration of several m/s^2 too, which is averaged out in the frame of its gyro (accel_time).
@pytest.mark.parametrize(
    ("source", "largest_rmse_deg"),
    [
        ("02_undisturbed_slow_rotation_B.hdf5", 1.0),
        ("16_undisturbed_fast_translation_B.hdf5", 2.0),
    ],
)
def test_the_inclination_of_one_imu_under_optical_tracking(
    source: str, largest_rmse_deg: float, evaluate: Evaluate
) -> None:
    figures = evaluate("broad", source, CONFIGURATIONS / "broad.yaml")
    inclination = figures["orientation"]["imu"]["inclination"]
    print(f"{source}: rmse {inclination['rmse_deg']:.3f}, max {inclination['max_abs_deg']:.2f} deg")
    assert figures["joints"] == {}
    assert inclination["coverage"] == 1.0
    assert 0.1 < inclination["rmse_deg"] < largest_rmse_deg


def test_the_heading_of_one_imu_with_its_magnetometer(evaluate: Evaluate, tmp_path: Path) -> None:
    """The recorded room has iron in it: a few degrees."""
    text = (CONFIGURATIONS / "broad.yaml").read_text(encoding="utf-8")
    text = text.replace("imu: {}", "imu: {mag: true}").replace("mag_weight: 0 ", "mag_weight: 1 ")
    (tmp_path / "mag.yaml").write_text(text, encoding="utf-8")
    source = "02_undisturbed_slow_rotation_B.hdf5"
    figures = evaluate("broad", source, tmp_path / "mag.yaml", "--moving")["orientation"]["imu"]
    print({name: f"{figures[name]['rmse_deg']:.3f}" for name in figures})
    assert figures["inclination"]["rmse_deg"] < 1.0
    assert figures["heading"]["rmse_deg"] < 3.0
