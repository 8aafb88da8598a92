"""`jointest demo`: what it refuses before any node is made. What it shows is tested with the nodes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from jointest_ros.cli.main import main

Jointest = Callable[..., Any]


@pytest.fixture
def no_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where ROS 2 is not installed."""
    monkeypatch.setitem(sys.modules, "rclpy", None)
    for name in [name for name in sys.modules if name.startswith("jointest_ros.nodes")]:
        monkeypatch.delitem(sys.modules, name)
    for part in ("nodes", "nodes.demo"):
        parent, _, attribute = f"jointest_ros.{part}".rpartition(".")
        if hasattr(sys.modules.get(parent), attribute):
            monkeypatch.delattr(f"{parent}.{attribute}")


@pytest.mark.usefixtures("no_ros")
def test_without_ros_it_says_what_to_do(jointest: Jointest, finger: Path, finger_yaml: Path) -> None:
    for arguments in ((), ("--bag", finger, "--config", finger_yaml)):
        text = jointest("demo", *arguments).refusal()
        assert text.startswith("ROS 2 is not at hand (")
        assert text.endswith("source your ROS 2 installation, or pip install 'jointest_ros[ros]'")


@pytest.mark.usefixtures("no_ros")
@pytest.mark.parametrize("node", ["pcf_node", "sim_hardware_node"])
def test_without_ros_a_node_says_so_too(
    node: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [f"bin/{node}"])
    assert import_module("jointest_ros.nodes.start").main() == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"{node}: error: ROS 2 is not at hand (")


@pytest.mark.usefixtures("no_ros")
def test_every_other_command_does_without_ros(
    jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    assert jointest("simulate", "finger", "-o", tmp_path / "run", "--duration", 1, "--rate", 100).code == 0
    assert jointest("evaluate", finger, "-c", finger_yaml).code == 0
    assert jointest("estimate", finger, "-c", finger_yaml, "-o", tmp_path / "x.csv").code == 0


@pytest.mark.usefixtures("no_ros")
@pytest.mark.parametrize("given", ["bag", "config"])
def test_bag_and_config_go_together(given: str, jointest: Jointest, finger: Path, finger_yaml: Path) -> None:
    text = jointest("demo", f"--{given}", {"bag": finger, "config": finger_yaml}[given]).refusal()
    assert text == "--bag and --config go together: the recording, and the configuration of its robot"


@pytest.mark.usefixtures("no_ros")
def test_configurations_and_estimators_that_are_none(
    jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    absent = tmp_path / "absent.yaml"
    assert jointest("demo", "--bag", finger, "--config", absent).refusal() == f"{absent}: no such configuration file"
    text = jointest("demo", "--bag", finger, "--config", finger_yaml, "-e", "pfc").refusal()
    assert text.startswith("--estimator: 'pfc' is not allowed")
    assert "--speed: invalid float value: 'fast'" in jointest("demo", "--speed", "fast").err


@pytest.fixture
def refused(capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """A function that expects a refusal where ROS 2 is at hand, whose executor wants a real standard error."""
    pytest.importorskip("rclpy")

    def run(*arguments: object) -> str:
        assert main(["demo", *map(str, arguments)]) == 2
        out, err = capfd.readouterr()
        assert out == ""
        (line,) = err.splitlines()
        return line.removeprefix("jointest demo: error: ")

    return run


def test_recordings_that_are_none(refused: Callable[..., str], finger_yaml: Path, tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").touch()
    for name, expected in (("absent", "no such bag"), ("empty.mcap", "empty file")):
        text = refused("--bag", tmp_path / name, "--config", finger_yaml)
        assert text.endswith(f"{tmp_path / name}: {expected}")


@pytest.mark.parametrize("speed", ["0", "-1", "nan", "inf"])
def test_speeds_that_are_none(speed: str, refused: Callable[..., str], finger: Path, finger_yaml: Path) -> None:
    text = refused("--bag", finger, "--config", finger_yaml, f"--speed={speed}")
    assert f"speed: {float(speed)} is not allowed" in text
