"""`jointest view`: URDF and layout of a robot, and those that are shipped."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PROJECT = Path(__file__).resolve().parents[2]
SHIPPED = sorted(file.stem for file in (PROJECT / "urdf").glob("*.urdf"))

Jointest = Callable[..., Any]


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_files_are_what_it_writes(name: str, jointest: Jointest, tmp_path: Path) -> None:
    urdf, layout = tmp_path / "robot.urdf", tmp_path / "layout.json"
    result = jointest("view", PROJECT / "config" / f"{name}.yaml", "--urdf", urdf, "--foxglove", layout)
    assert (result.code, result.err) == (0, "")
    assert urdf.read_text(encoding="utf-8") == (PROJECT / "urdf" / f"{name}.urdf").read_text(encoding="utf-8")
    assert layout.read_text(encoding="utf-8") == (PROJECT / "foxglove" / f"{name}.json").read_text(encoding="utf-8")


def test_the_layout_is_that_of_the_estimator_asked_for(jointest: Jointest, tmp_path: Path) -> None:
    layout = tmp_path / "layout.json"
    assert jointest("view", PROJECT / "config/exoshell.yaml", "--foxglove", layout, "-e", "hall").code == 0
    text = layout.read_text(encoding="utf-8")
    assert "/hall/joint_states" in text and "/kckf/" not in text


def test_a_file_that_exists_is_only_replaced_on_request(jointest: Jointest, tmp_path: Path) -> None:
    finger, mine, layout = PROJECT / "config/finger.yaml", tmp_path / "robot.urdf", tmp_path / "layout.json"
    mine.write_text("<robot/>", encoding="utf-8")
    refusal = jointest("view", finger, "--foxglove", layout, "--urdf", mine).refusal()
    assert refusal == f"{mine}: exists already; remove it, choose another name or give --overwrite"
    assert mine.read_text(encoding="utf-8") == "<robot/>" and not layout.exists()
    assert jointest("view", finger, "--urdf", mine, "--overwrite").code == 0
    assert "finger_pip" in mine.read_text(encoding="utf-8")


def test_mistakes_are_one_line(jointest: Jointest, tmp_path: Path) -> None:
    finger = PROJECT / "config/finger.yaml"
    assert jointest("view", finger).refusal() == "nothing to write: give --urdf FILE, --foxglove FILE or both"
    missing = tmp_path / "nowhere" / "robot.urdf"
    assert (
        jointest("view", finger, "--urdf", missing).refusal()
        == f"{missing}: cannot be written: No such file or directory"
    )
    refusal = jointest("view", finger, "--foxglove", tmp_path / "layout.json", "-e", "vqf").refusal()
    assert refusal.startswith("--estimator: 'vqf' is not allowed; give one of pcf, ")
