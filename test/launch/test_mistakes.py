"""What an executable says when it is started wrongly: exit code 2 and one line."""

from __future__ import annotations

import dataclasses
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from processes import Completed, run

from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.nodes.estimator_node import NodeParams
from jointest_ros.nodes.sim_hardware_node import PlayParams
from jointest_ros.sim.finger import FingerOptions

CONFIG = "config:={config}"

# (executable, parameters, what the line begins with)
PARAMETERS: list[tuple[str, tuple[str, ...], str]] = [
    ("pcf_node", (), "config: '' is not allowed; give the path of a configuration: -p config:=robot.yaml"),
    ("pcf_node", ("config:=nowhere.yaml",), "nowhere.yaml: no such configuration file"),
    ("pcf_node", (CONFIG, "kp:=-1"), "kp: -1 is not allowed; give 0 to 100 1/s"),
    ("pcf_node", (CONFIG, "kp:=text"), "kp: 'text' is not allowed; give 0 to 100 1/s"),
    (
        "pcf_node",
        (CONFIG, "formulation:=foo"),
        "formulation: 'foo' is not allowed; give one of hinge, relative, absolute",
    ),
    ("pcf_node", (CONFIG, "kpp:=1"), "kpp: unknown parameter; did you mean 'kp'?"),
    ("pcf_node", (CONFIG, "use_sim_time:=5"), "Trying to set parameter 'use_sim_time' to '5'"),
    (
        "pcf_node",
        ("config:={thumb}",),
        "{thumb}: joint 'base': link 'thumb' carries no sensor with gyro and accelerometer",
    ),
    ("sim_hardware_node", (), "bag: '' is not allowed with source bag; give the path of a recording: -p bag:=PATH"),
    ("sim_hardware_node", ("bag:=nowhere",), "nowhere: no such bag"),
    ("sim_hardware_node", ("source:=elbow",), "source: 'elbow' is not allowed; give one of bag, finger"),
    ("sim_hardware_node", ("source:=finger", "scenario:=PX"), "scenario: 'PX' is not allowed; give one of PA, PC"),
]
ARGUMENTS: list[tuple[tuple[str, ...], str]] = [
    (("-p", "kp:=2"), "unknown argument '-p'; parameters are given as --ros-args -p NAME:=VALUE"),
    (("--ros-args", "--what"), "ROS cannot start: unknown arguments ['--what']"),
    (("--ros-args", "-p", "kp"), "ROS cannot start: Couldn't parse parameter override rule: '-p kp'."),
    (("--ros-args", "--params-file", "nowhere.yaml"), "ROS cannot start: Couldn't parse params file"),
]
HELP = {"pcf_node": (NodeParams, PcfParams), "sim_hardware_node": (PlayParams, FingerOptions)}

Outcomes = dict[tuple[str, ...], Completed]


@pytest.fixture(scope="module")
def thumb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A configuration in which a link has no sensor."""
    thumb = tmp_path_factory.mktemp("robot") / "thumb.yaml"
    thumb.write_text(
        "robot: {links: [palm, thumb], joints: {base: {parent: palm, child: thumb, axis: x}}}\nsensors: {palm: {}}\n",
        encoding="utf-8",
    )
    return thumb


@pytest.fixture(scope="module")
def outcomes(thumb: Path, finger_config: Path) -> Outcomes:
    """How all of them end, by command line: run side by side, since each takes its time to load."""
    lines = [(name, *as_arguments(parameters)) for name, parameters, _ in PARAMETERS]
    lines += [("pcf_node", *arguments) for arguments, _ in ARGUMENTS]
    lines += [(name, "--help") for name in HELP]

    def end(line: tuple[str, ...]) -> Completed:
        return run(*(word.format(config=finger_config, thumb=thumb) for word in line))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return dict(zip(lines, pool.map(end, lines), strict=True))


def as_arguments(parameters: tuple[str, ...]) -> tuple[str, ...]:
    return ("--ros-args", *(word for parameter in parameters for word in ("-p", parameter)))


@pytest.mark.parametrize(("name", "parameters", "message"), PARAMETERS)
def test_parameters(name: str, parameters: tuple[str, ...], message: str, outcomes: Outcomes, thumb: Path) -> None:
    done = outcomes[(name, *as_arguments(parameters))]
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"{name}: error: {message.replace('{thumb}', str(thumb))}")


@pytest.mark.parametrize(("arguments", "message"), ARGUMENTS)
def test_arguments(arguments: tuple[str, ...], message: str, outcomes: Outcomes) -> None:
    done = outcomes[("pcf_node", *arguments)]
    assert (done.returncode, done.stdout) == (2, "")
    *by_rcl, line = done.stderr.splitlines()
    assert line.startswith(f"pcf_node: error: {message}")
    assert all("[rcl]: " in other for other in by_rcl)  # it logs lines of its own before


@pytest.mark.parametrize("name", HELP)
def test_help(name: str, outcomes: Outcomes) -> None:
    done = outcomes[(name, "--help")]
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"usage: {name} --ros-args ")
    for kind in HELP[name]:
        for spec in dataclasses.fields(kind):
            assert f"  {spec.name}: " in done.stdout
            assert spec.metadata["description"] in done.stdout


@pytest.mark.parametrize("enclave", ["/jointest/pcf_node", "/nowhere"])
def test_security_that_cannot_start(
    enclave: str, tmp_path: Path, finger_config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An enclave without keys or without a folder, or no security in the middleware: no traceback."""
    (tmp_path / "enclaves" / "jointest" / "pcf_node").mkdir(parents=True)
    for name, value in (("KEYSTORE", str(tmp_path)), ("ENABLE", "true"), ("STRATEGY", "Enforce")):
        monkeypatch.setenv(f"ROS_SECURITY_{name}", value)
    done = run("pcf_node", "--ros-args", "--enclave", enclave, "-p", f"config:={finger_config}")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines()[-1].startswith("pcf_node: error: ROS cannot start: ")
    assert "Traceback" not in done.stderr
