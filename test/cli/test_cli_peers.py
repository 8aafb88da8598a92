"""`jointest evaluate --peers` and `--moving`: who appears where, and what is refused."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jointest_ros.bags.cdr import BOOL
from jointest_ros.bags.cdr_encode import encode_bool
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.rotation import between
from jointest_ros.evaluation import peers

Jointest = Callable[..., Any]
JOINTS = ("finger_mcp", "finger_pip", "finger_dip")


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """One peer, `plumb`, that takes the accelerometers for the vertical."""

    def plumb(gyro: FloatArray, accel: FloatArray, period: float) -> FloatArray:
        return np.array([between(tuple(row), (0.0, 0.0, 1.0)) for row in accel])

    monkeypatch.setattr(peers, "PEERS", {"plumb": plumb})
    monkeypatch.setattr(peers, "check_installed", lambda: None)


def test_peers_are_estimators_of_the_json(jointest: Jointest, finger: Path, finger_yaml: Path, stand_in: None) -> None:
    result = jointest("evaluate", finger, "-c", finger_yaml, "--peers", "--json", "-")
    assert (result.code, result.err) == (0, "")
    document = json.loads(result.out)
    assert list(document["estimators"]) == ["pcf", "peer:plumb"]
    pcf, peer = document["estimators"].values()
    assert set(peer) == set(pcf)
    assert tuple(peer["joints"]) == JOINTS
    assert set(peer["joints"]["finger_mcp"]) == set(pcf["joints"]["finger_mcp"])
    assert (peer["velocities"], peer["torso"], peer["nis"], peer["nees"]) == ({}, {}, None, None)
    assert peer["frames"] == pcf["frames"] and peer["ns_per_frame"] > 0.0
    without = jointest("evaluate", finger, "-c", finger_yaml, "--json", "-")
    theirs, ours = (text["estimators"]["pcf"] for text in (document, json.loads(without.out)))
    assert theirs["joints"] == ours["joints"]


def test_peers_stand_in_the_table_with_their_cost(
    jointest: Jointest, finger: Path, finger_yaml: Path, stand_in: None, tmp_path: Path
) -> None:
    picture = tmp_path / "all.svg"
    text = jointest("evaluate", finger, "-c", finger_yaml, "--peers", "--plot", picture).out
    table = text[text.index("joint angle errors") : text.index("joint velocity errors")]
    names = [line.split()[0].strip("│") for line in table.splitlines() if "%" in line]
    assert names == ["pcf"] * 3 + ["peer:plumb"] * 3
    velocities = text[text.index("joint velocity errors") : text.index("heading of")]
    assert "cost of a sample" in table and "peer" not in velocities
    assert "heading of the peers, the better of two ways each: peer:plumb " in text
    assert "peer:plumb" in picture.read_text(encoding="utf-8")


def test_without_the_packages_one_line_says_what_to_install(
    jointest: Jointest, finger: Path, finger_yaml: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(name: str) -> None:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(importlib, "import_module", nothing)
    refusal = jointest("evaluate", finger, "-c", finger_yaml, "--peers").refusal()
    assert refusal == "the peer vqf is not installed: pip install 'jointest_ros[peers]'"


def test_a_robot_without_accelerometers_is_refused(jointest: Jointest, shell: Path, stand_in: None) -> None:
    refusal = jointest("evaluate", shell, "-c", f"{shell}.yaml", "--peers").refusal()
    assert refusal.startswith("the peers need an IMU with gyro and accelerometer")


# ------------------------------------------------------------- movement


def moving(bag: Path, to: Path, changes: list[tuple[int, bool]]) -> Path:
    """A copy of a recording that says from when on it moves: (s after its start, whether)."""
    with BagReader(bag) as reader, BagWriter(to) as writer:
        for topic, kind in reader.topics.items():
            writer.add_topic(topic, kind)
        writer.add_topic("/ground_truth/movement", BOOL)
        start = None
        waiting = list(changes)
        for topic, time, data in reader.messages():
            start = time if start is None else start
            while waiting and time >= start + waiting[0][0] * 1_000_000_000:
                writer.write("/ground_truth/movement", time, encode_bool(waiting.pop(0)[1]))
            writer.write(topic, time, data)
    return to


def test_only_movement_is_judged(jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path) -> None:
    bag = moving(finger, tmp_path / "moving", [(0, False), (2, True), (4, False)])
    whole, part = (
        json.loads(jointest("evaluate", bag, "-c", finger_yaml, *options, "--json", "-").out)["estimators"]["pcf"]
        for options in ((), ("--moving",))
    )
    assert whole["joints"]["finger_mcp"]["samples"] == 500
    assert (part["joints"]["finger_mcp"]["samples"], part["joints"]["finger_mcp"]["coverage"]) == (200, 1.0)


def test_movement_of_which_nobody_tells_is_refused(jointest: Jointest, finger: Path, finger_yaml: Path) -> None:
    refusal = jointest("evaluate", finger, "-c", finger_yaml, "--moving").refusal()
    assert refusal == f"{finger}: --moving: no topic ground_truth/movement that says when it moves"
