"""`jointest calibrate gyro`: from a recording of motion to the scales of gyros that every estimator uses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from jointest_ros import config

Jointest = Callable[..., Any]
SENSORS = ("palm", "proximal", "middle", "distal")


@pytest.fixture(scope="module")
def run(jointest: Jointest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording whose gyros are off by up to 3 %. Not to be changed."""
    bag = tmp_path_factory.mktemp("gyro") / "run"
    options = ("--rate", 100, "--duration", 50, "--zero-pose", 4, "--gyro-scale", 0.03, "--seed", 70)
    assert jointest("simulate", "finger", "-o", bag, "--scenario", "PC", *options).code == 0
    return bag


@pytest.fixture
def robot(run: Path, tmp_path: Path) -> Path:
    """Its configuration in a folder of its own, without a calibration as yet."""
    document = yaml.safe_load(run.with_name("run.yaml").read_text(encoding="utf-8"))
    path = tmp_path / "robot.yaml"
    path.write_text(
        yaml.safe_dump({"calibration_file": "calibrated.yaml", **document}, sort_keys=False), encoding="utf-8"
    )
    return path


def worst_error(jointest: Jointest, bag: Path, robot: Path) -> float:
    """Largest root mean square error of a joint, deg."""
    figures = robot.with_name("figures.json")
    assert jointest("evaluate", bag, "-c", robot, "--skip", 8, "--json", figures).code == 0
    joints = json.loads(figures.read_text(encoding="utf-8"))["estimators"]["pcf"]["joints"]
    return max(joint["rmse_deg"] for joint in joints.values())


def test_the_estimators_use_what_it_writes(jointest: Jointest, run: Path, robot: Path) -> None:
    before = worst_error(jointest, run, robot)
    result = jointest("calibrate", "gyro", run, "--config", robot)
    assert (result.code, result.err) == (0, "")
    assert worst_error(jointest, run, robot) < 0.3 * before
    assert all(name in result.out for name in SENSORS)
    text = robot.with_name("calibrated.yaml").read_text(encoding="utf-8")
    assert text.startswith("# Gyro scales by: jointest calibrate gyro run --config robot.yaml\n")
    assert yaml.safe_load(text)["gyro"].keys() == set(SENSORS)
    told = jointest("evaluate", run.with_name("missing"), "-c", robot).err
    assert "calibrated.yaml: calibration in use (gyro)" in told


def test_a_calibration_that_is_there_already_makes_no_difference(jointest: Jointest, run: Path, robot: Path) -> None:
    assert jointest("calibrate", "gyro", run, "-c", robot).code == 0
    first = config.load(robot).robot.sensors
    assert jointest("calibrate", "gyro", run, "-c", robot).code == 0
    assert config.load(robot).robot.sensors == first


def test_a_stretch_of_the_recording_can_be_used(jointest: Jointest, run: Path, robot: Path) -> None:
    assert jointest("calibrate", "gyro", run, "-c", robot, "--skip", 5, "--duration", 30).code == 0
    text = robot.with_name("calibrated.yaml").read_text(encoding="utf-8")
    assert "--skip 5 --duration 30\n" in text
    refusal = jointest("calibrate", "gyro", run, "-c", robot, "--skip", 49).refusal()
    assert "gave readings together for" in refusal and "at least" in refusal


@pytest.mark.parametrize(("option", "value"), [("--skip", -1), ("--skip", "nan"), ("--duration", 0)])
def test_a_stretch_that_is_none_is_refused(
    option: str, value: object, jointest: Jointest, run: Path, robot: Path
) -> None:
    refusal = jointest("calibrate", "gyro", run, "-c", robot, option, value).refusal()
    assert refusal.startswith(f"{option}: {value} is not allowed")


def test_motion_that_tells_nothing_is_refused(jointest: Jointest, run: Path, robot: Path) -> None:
    refusal = jointest("calibrate", "gyro", run, "-c", robot, "--duration", 4).refusal()
    assert "scale not found: its link hardly turns" in refusal and refusal.endswith("; nothing was written")
    assert not robot.with_name("calibrated.yaml").exists()
