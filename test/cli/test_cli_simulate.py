"""`jointest simulate`: recordings that evaluate without a further word, and options that are checked."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from jointest_ros import config
from jointest_ros.bags.reader import BagReader
from jointest_ros.core.params import allowed_text
from jointest_ros.sim.scenarios import SCENARIOS

Jointest = Callable[..., Any]
QUICK = ("--rate", 100, "--duration", 1)


@pytest.mark.parametrize(
    ("rig", "scenario"), [(rig.name, name) for rig in SCENARIOS.values() for name in rig.scenarios]
)
def test_every_scenario(rig: str, scenario: str, jointest: Jointest, tmp_path: Path) -> None:
    bag = tmp_path / "run"
    result = jointest("simulate", rig, "-o", bag, "--scenario", scenario, *QUICK)
    assert (result.code, result.err) == (0, "")
    with BagReader(bag) as reader:
        assert set(reader.counts.values()) == {100}
        assert reader.duration_s == pytest.approx(0.99)
        assert f"1 s at 100 Hz, {reader.message_count} messages" in result.out
    read = config.load(tmp_path / "run.yaml")
    assert read.robot.name == rig
    assert list(read.estimators) == list(SCENARIOS[rig].estimators)
    then = "calibrate accel" if scenario.startswith("poses") else "evaluate"
    assert f"next: jointest {then} {bag} --config {bag}.yaml" in result.out


def test_the_configuration_says_how_it_was_made(jointest: Jointest, tmp_path: Path) -> None:
    options = ("--scenario", "PC", "--seed", 5, "--no-bias", "--mag", "--mounting", "mounted")
    jointest("simulate", "finger", "-o", tmp_path / "run", *QUICK, *options)
    heading = (tmp_path / "run.yaml").read_text(encoding="utf-8").splitlines()[1]
    assert heading.startswith("# jointest simulate finger -o run ")
    again = heading.removeprefix("# jointest ").replace(" run ", f" {tmp_path / 'again'} ").split()
    assert jointest(*again).code == 0
    with BagReader(tmp_path / "run") as one, BagReader(tmp_path / "again") as two:
        assert list(one.messages()) == list(two.messages())
    assert config.load(tmp_path / "again.yaml").robot == config.load(tmp_path / "run.yaml").robot


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_storages(storage: str, jointest: Jointest, tmp_path: Path) -> None:
    assert jointest("simulate", "finger", "-o", tmp_path / "run", *QUICK, "--storage", storage).code == 0
    suffixes = {file.suffix for file in (tmp_path / "run").iterdir()}
    assert suffixes == {".yaml", {"mcap": ".mcap", "sqlite3": ".db3"}[storage]}


@pytest.mark.parametrize("rig", SCENARIOS.values(), ids=lambda rig: rig.name)
def test_help_lists_scenarios_and_ranges(rig: Any, jointest: Jointest) -> None:
    text = re.sub(r"\s+", " ", jointest("simulate", rig.name, "--help").out)
    assert "length of the recording (0.1 to 86400 s; default:" in text
    for spec in dataclasses.fields(rig.options):
        assert spec.metadata["description"] in text
        assert isinstance(spec.default, bool) or f"({allowed_text(spec)}; default: {spec.default})" in text
    for name, description in rig.scenarios.items():
        assert f"{name} {description}" in text


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--scenario", "PX"), "scenario: 'PX' is not allowed; give one of PA, PC, PD, PE, still"),
        (("--rate", 50), "rate_hz: 50.0 is not allowed; give 100 to 1000 Hz"),
        (("--rate", "nan"), "rate_hz: nan is not allowed"),
        (("--duration", -1), "duration_s: -1.0 is not allowed"),
        (("--duration", "inf"), "duration_s: inf is not allowed"),
        (("--seed", -1), "seed: -1 is not allowed; give a whole number, 0 or more"),
        (("--seed", 10**400), "seed: 1000"),
        (("--elevation", 100), "elevation_deg: 100.0 is not allowed; give 0 to 90 deg"),
        (("--mounting", "loose"), "mounting: 'loose' is not allowed; give one of ideal, mounted"),
        (("--zero-pose", "1e400"), "zero_pose_s: inf is not allowed"),
    ],
)
def test_values_that_are_not_allowed(options: Any, expected: str, jointest: Jointest, tmp_path: Path) -> None:
    result = jointest("simulate", "finger", "-o", tmp_path / "run", *options)
    assert result.refusal().startswith(expected)
    assert list(tmp_path.iterdir()) == []


def test_what_exists_is_kept_unless_told_otherwise(jointest: Jointest, tmp_path: Path) -> None:
    bag, beside = tmp_path / "run", tmp_path / "run.yaml"
    assert jointest("simulate", "finger", "-o", bag, *QUICK).code == 0
    beside.write_text("edited", encoding="utf-8")
    assert "run.yaml: exists already" in jointest("simulate", "finger", "-o", bag, *QUICK).refusal()
    beside.unlink()
    assert f"{bag}: exists already" in jointest("simulate", "finger", "-o", bag, *QUICK).refusal()
    assert not beside.exists()
    assert jointest("simulate", "finger", "-o", bag, "--overwrite", "--rate", 200, "--duration", 1).code == 0
    with BagReader(bag) as reader:
        assert set(reader.counts.values()) == {200}
    assert jointest("simulate", "finger", "-o", bag, "--overwrite", *QUICK).code == 0
    assert sorted(file.name for file in tmp_path.iterdir()) == ["run", "run.yaml"]


def test_where_nothing_can_be_written(jointest: Jointest, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder.yaml").mkdir()
    for target, overwrite, expected in (
        (tmp_path / "file/run", (), f"{tmp_path}/file/run: cannot be written: "),
        (tmp_path / "folder", ("--overwrite",), f"{tmp_path}/folder.yaml: cannot be written: Is a directory"),
        (".", (), ".: exists already"),
        ("/", (), "/: exists already"),
    ):
        assert jointest("simulate", "finger", "-o", target, *QUICK, *overwrite).refusal().startswith(expected)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["file", "folder.yaml"]
    text = jointest("simulate", "finger", "-o", tmp_path, "--overwrite", *QUICK).refusal()
    assert text == f"{tmp_path}: exists already and is not a bag; it is not overwritten"


# ----------------------------------------------------------------- one's own robot

OWN = """
robot:
  links: [a, b, c]
  joints: {ab: {parent: a, child: b, axis: x, limits_deg: [0, 80]}, bc: {parent: b, child: c, axis: [0, 1, 1]}}
sensors:
  a: {topic: /imus, frame_id: a, mounting: {rpy_deg: [0, 0, 90]}}
  b: {topic: /imus, frame_id: b, mag: true}
  c: {topic: hand/c, delay_ms: 10}
hall: [{joint: ab}, {joint: ab, mirrored: true}, {joint: bc}]
estimators: {pcf: {zero_at_start: true}}
"""
OWN_QUICK = ("--rate", 100, "--duration", 12, "--zero-pose", 2)


def test_own_robot(jointest: Jointest, tmp_path: Path) -> None:
    path, bag = tmp_path / "own.yaml", tmp_path / "run"
    path.write_text(OWN, encoding="utf-8")
    result = jointest("simulate", "config", path, "-o", bag, *OWN_QUICK)
    assert (result.code, result.err) == (0, "")
    assert "12 s at 100 Hz, 7200 messages" in result.out
    assert f"next: jointest evaluate {bag} --config {path}" in result.out
    assert sorted(file.name for file in tmp_path.iterdir()) == ["own.yaml", "run"]
    with BagReader(bag) as reader:
        assert reader.counts == {
            "/imus": 2400,
            "/hand/c": 1200,
            "/mag/b": 1200,
            "/hall_voltages": 1200,
            "/ground_truth/joint_states": 1200,
        }
    found = json.loads(jointest("evaluate", bag, "--config", path, "--skip", 2, "--json", "-").out)
    assert {name: joint["rmse_deg"] < 0.5 for name, joint in found["estimators"]["pcf"]["joints"].items()} == {
        "ab": True,
        "bc": True,
    }
    inspected = jointest("inspect", bag, "--config", path)
    assert inspected.code == 0, inspected.out


@pytest.mark.parametrize(
    ("text", "options", "expected"),
    [
        (None, (), "{path}: no such configuration file"),
        ("robot: {links: [a]}", (), "robot.joints: none; "),
        (OWN.replace("[0, 80]", "[5, 80]"), (), "robot.joints.ab.limits_deg: 5 to 80 is not allowed; "),
        (OWN, ("--up", "w"), "up: 'w' is not allowed; give one of z, -z"),
        (OWN, ("--rate", 5), "rate_hz: 5.0 is not allowed; give 10 to 1000 Hz"),
    ],
)
def test_own_robots_that_are_refused(
    text: str | None, options: Any, expected: str, jointest: Jointest, tmp_path: Path
) -> None:
    path = tmp_path / "own.yaml"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    result = jointest("simulate", "config", path, "-o", tmp_path / "run", *options)
    assert result.refusal().startswith(expected.format(path=path))
    assert not (tmp_path / "run").exists()
