"""The executables at work, and how a signal ends them."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from listener import Listener
from processes import Process, finish, run

from jointest_ros import config
from jointest_ros.bags import offline
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.core.pcf.pcf import Pcf

Launch = Callable[..., Process]


def trouble(text: str) -> str | None:
    """The first sign of trouble in a log."""
    found = re.search(r"Traceback|\[ERROR\]|\[FATAL\]|Exception|Warning.*", text)
    return found and f"{found[0]} in:\n{text}"


def test_hardware_and_estimator(launch: Launch, listener: Listener, finger_bag: Path, finger_config: Path) -> None:
    """Two processes and a listener: what the offline evaluation gives is heard here."""
    pcf = launch("pcf_node", "--ros-args", "-p", f"config:={finger_config}", "-p", "kp:=1")
    listener.until(lambda: bool(listener.node.count_publishers("joint_states")), "the estimator")
    sim = launch("sim_hardware_node", "--ros-args", "-p", f"bag:={finger_bag}", "-p", "speed:=10.0")
    listener.until(lambda: sim.poll() is not None and len(listener.states) >= 1500, "the joint states")
    pcf.send_signal(signal.SIGINT)
    for done, said in (
        (finish(sim), "finished: 7500 messages"),
        (finish(pcf), "pcf: finger_mcp, finger_pip, finger_dip"),
    ):
        assert done.returncode == 0
        assert not trouble(done.stdout + done.stderr)
        assert said in done.stderr

    configuration = config.load(finger_config)
    offline_pcf = Pcf(configuration.robot, configuration.estimators["pcf"], configuration.timing)
    sink = offline.SeriesSink({"pcf": offline_pcf})
    with BagReader(finger_bag) as reader:
        offline.run(reader, Intake(configuration.robot, configuration.timing), {"pcf": offline_pcf}, sink)
    expected = sink.series("pcf")
    stamps = [state.header.stamp.sec * 1_000_000_000 + state.header.stamp.nanosec for state in listener.states]
    assert stamps == expected.stamps.tolist()
    position = [state.position for state in listener.states]
    np.testing.assert_allclose(position, expected.position, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("number", "executor"), [(signal.SIGINT, "events"), (signal.SIGTERM, "events"), (signal.SIGTERM, "single")]
)
def test_signals(
    number: signal.Signals, executor: str, launch: Launch, listener: Listener, finger_config: Path
) -> None:
    """In the middle of their work."""
    running = ("--ros-args", "-p", f"executor:={executor}")
    processes = [
        launch("pcf_node", *running, "-p", f"config:={finger_config}"),
        launch("sim_hardware_node", *running, "-p", "source:=finger", "-p", "rate_hz:=500.0", "-p", "loop:=true"),
    ]
    listener.until(lambda: len(listener.states) > 100, "joint states")
    for process in processes:
        process.send_signal(number)
    for done in map(finish, processes):
        assert done.returncode == 0
        assert not trouble(done.stdout + done.stderr)


def test_demo_without_a_terminal(finger_bag: Path, finger_config: Path) -> None:
    done = run("jointest", "demo", "--speed", "3")
    assert done.returncode == 0, done.stderr
    assert not trouble(done.stdout + done.stderr)
    out = done.stdout
    assert "\x1b" not in out
    assert re.search(r"^pcf: finger_mcp -?\d+\.\d \(true -?\d+\.\d\) ", out, re.MULTILINE)  # live
    row = re.search(r"pcf[│ ]+finger_pip[│ ]+(\d+\.\d+) ", out)
    assert row is not None
    assert float(row[1]) < 0.5  # deg
    assert re.search(r"imu/distal[│ ]+1500[│ ]+1500[│ ]+none", out)
    assert f"ros2 run jointest_ros sim_hardware_node --ros-args -p source:=bag -p bag:={finger_bag}" in out
    assert f"ros2 run jointest_ros pcf_node --ros-args -p config:={finger_config}" in out


def test_demo_of_the_exoshell_compares_four_estimators() -> None:
    done = run("jointest", "demo", "--robot", "exoshell", "--speed", "3")
    assert done.returncode == 0, done.stderr
    assert not trouble(done.stdout + done.stderr)
    rmse = {name: float(e) for name, e in re.findall(r"(kckf|gyro)[│ ]+joint_1[│ ]+(\d+\.\d+) ", done.stdout)[:2]}
    assert rmse["kckf"] < 0.5 < rmse["gyro"]  # deg
    assert "ros2 run jointest_ros kckf_node --ros-args -p config:=" in done.stdout


def test_demo_is_interrupted(launch: Launch, listener: Listener) -> None:
    demo = launch("jointest", "demo")
    listener.until(lambda: any(topic.endswith("/pcf/joint_states") for topic in listener.topics()), "the demo")
    listener.spin_for(1.0)  # in the middle of it, at a random place
    demo.send_signal(signal.SIGINT)
    done = finish(demo)
    assert done.returncode == 130
    assert not trouble(done.stdout + done.stderr)
    assert done.stderr.splitlines()[-1] == "jointest demo: interrupted"


def test_demo_with_a_configuration_that_does_not_fit(finger_bag: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(
        "robot: {links: [a, b], joints: {ab: {parent: a, child: b, axis: x}}}\n"
        "sensors: {a: {}, b: {}}\nestimators: {pcf: {}}\n",
        encoding="utf-8",
    )
    done = run("jointest", "demo", "--bag", str(finger_bag), "--config", str(other))
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith(
        f"jointest demo: error: {finger_bag}: no matching topic; the configuration wants imu/a, imu/b"
    )
