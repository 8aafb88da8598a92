"""`jointest inspect` on joints of two and three axes: gravity and gyros must say the same of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from inspect_bags import exchanged, inspected, not_ok, readings, rewrite
from scipy.spatial.transform import Rotation

Jointest = Callable[..., Any]
ROBOT = """
robot:
  links: [arm, hand]
  joints:
    wrist: {{parent: arm, child: hand, axes: {axes}, limits_deg: {limits}}}
sensors: {{arm: {{mounting: {{rpy_deg: [{mounting}]}}}}, hand: {{}}}}
estimators: {{pcf: {{zero_at_start: true}}}}
"""


def recorded(
    jointest: Jointest, folder: Path, axes: str, limits: str, tempo: float = 1.0, mounting: str = "0, 0, 0"
) -> tuple[Path, Path]:
    """(recording, configuration) of an arm with a wrist; both links turn."""
    file = folder / "wrist.yaml"
    file.write_text(ROBOT.format(axes=axes, limits=limits, mounting=mounting), encoding="utf-8")
    chosen = ("--rate", 100, "--duration", 20, "--seed", 3, "--tempo", tempo)
    assert jointest("simulate", "config", file, "-o", folder / "bag", *chosen).code == 0
    return folder / "bag", file


@pytest.fixture
def wrist(jointest: Jointest, tmp_path: Path) -> tuple[Path, Path]:
    return recorded(jointest, tmp_path, "[y, x]", "[[-50, 50], [-40, 60]]")


@pytest.mark.parametrize(
    ("axes", "limits", "mounting"),
    [
        ("[y, x]", "[[-50, 50], [-40, 60]]", "0, 0, 0"),
        ("[z, x]", "[[-30, 30], [-60, 10]]", "0, 70, 0"),
        ("[x, [0, 0.6, 0.8]]", "[[-50, 50], [-40, 60]]", "90, 0, 90"),
        ("[x, [0.6, 0.8, 0]]", "[[-50, 50], [-40, 60]]", "0, 0, 0"),
    ],
)
def test_sound_joints_of_two_axes(axes: str, limits: str, mounting: str, jointest: Jointest, tmp_path: Path) -> None:
    bag, file = recorded(jointest, tmp_path, axes, limits, mounting=mounting)
    code, findings = inspected(jointest, tmp_path, bag, "--config", file)
    assert (code, not_ok(findings)) == (0, [])
    assert ("wrist", "axis") in {(one["subject"], one["kind"]) for one in findings}


@pytest.mark.parametrize(
    ("sensor", "axis"), [("arm", "x"), ("arm", "z"), ("hand", "y"), ("hand", "z")]
)  # about y of the arm and x of the hand, which are axes of the wrist, it is an offset of an angle
def test_a_sensor_that_is_mounted_otherwise(
    sensor: str, axis: str, wrist: tuple[Path, Path], jointest: Jointest, tmp_path: Path
) -> None:
    matrix = Rotation.from_euler(axis, 90.0, degrees=True).as_matrix()
    bag = rewrite(wrist[0], tmp_path / "turned", readings(sensor, matrix, matrix))
    code, findings = inspected(jointest, tmp_path, bag, "--config", wrist[1])
    wrong = [(one["subject"], one["kind"]) for one in findings if one["level"] == "wrong"]
    assert (code, wrong) == (1, [(sensor, "mounting")])


def test_exchanged_sensors(wrist: tuple[Path, Path], jointest: Jointest, tmp_path: Path) -> None:
    bag = rewrite(wrist[0], tmp_path / "exchanged", exchanged("arm", "hand"))
    code, findings = inspected(jointest, tmp_path, bag, "--config", wrist[1])
    assert (code, not_ok(findings)) == (1, [("wrong", "wrist", "exchanged")])
    assert all(not finding["text"].startswith("wrist") for finding in findings)  # the subject is told before it


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_sensor_the_other_way_round_is_seen_in_the_zero_pose(
    axis: str, wrist: tuple[Path, Path], jointest: Jointest, tmp_path: Path
) -> None:
    matrix = Rotation.from_euler(axis, 180.0, degrees=True).as_matrix()
    bag = rewrite(wrist[0], tmp_path / "reversed", readings("hand", matrix, matrix))
    _, findings = inspected(jointest, tmp_path, bag, "--config", wrist[1])
    (told,) = [one for one in findings if one["level"] != "ok"]
    assert (told["subject"], told["kind"]) == ("wrist", "zero") and "180 deg apart" in told["text"]


def test_an_axis_that_did_not_move(jointest: Jointest, tmp_path: Path) -> None:
    bag, file = recorded(jointest, tmp_path, "[y, x]", "[[-50, 50], [-0.5, 0.5]]")
    code, findings = inspected(jointest, tmp_path, bag, "--config", file)
    assert (code, not_ok(findings)) == (0, [("look", "wrist_x", "motion")])


def test_a_joint_that_did_not_move(jointest: Jointest, tmp_path: Path) -> None:
    bag, file = recorded(jointest, tmp_path, "[y, x]", "[[-50, 50], [-40, 60]]", tempo=0.0)
    code, findings = inspected(jointest, tmp_path, bag, "--config", file)
    assert (code, not_ok(findings)) == (0, [("look", "wrist", "motion")])


def test_three_axes(jointest: Jointest, tmp_path: Path) -> None:
    bag, file = recorded(jointest, tmp_path, "[z, y, x]", "[[-30, 30], [-30, 30], [-30, 30]]")
    code, findings = inspected(jointest, tmp_path, bag, "--config", file)
    assert (code, not_ok(findings)) == (0, [("look", "wrist", "unjudged")])
