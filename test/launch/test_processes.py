"""The executables at work, and how a signal ends them."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from processes import TIMEOUT, Process, finish, run
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState

from jointest_ros import config
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.core.catalogue import ESTIMATORS

Launch = Callable[..., Process]


class Listener:
    """Hears joint states; `until` waits."""

    def __init__(self) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.node = Node("listener", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.states: list[JointState] = []
        self.node.create_subscription(JointState, "joint_states", self.states.append, 10_000)

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Spin until `condition()` is true."""
        end = time.monotonic() + TIMEOUT
        while not condition():
            assert time.monotonic() < end, f"waited in vain for {what}"
            self.executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        """Free everything."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def listener() -> Iterator[Listener]:
    one = Listener()
    yield one
    one.close()


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
    for done in map(finish, (sim, pcf)):
        assert done.returncode == 0
        assert not trouble(done.stdout + done.stderr)
        assert "finished: 7500 messages" in done.stderr or "pcf: finger_mcp" in done.stderr

    configuration = config.load(finger_config)
    intake = Intake(configuration.robot, configuration.timing)
    offline = ESTIMATORS["pcf"](configuration.robot, configuration.estimators["pcf"], configuration.timing)
    with BagReader(finger_bag) as reader:
        expected = [
            offline.update(frame)
            for topic, _, data in reader.messages([f"/{topic}" for topic in intake.topics])
            for frame in intake.handlers[topic.lstrip("/")](data, 0)
        ]
    assert len(listener.states) == len(expected) == 1500
    for state, estimate in zip(listener.states, expected, strict=True):
        assert state.header.stamp.sec * 10**9 + state.header.stamp.nanosec == estimate.stamp
        assert list(state.position) == pytest.approx(list(estimate.position), rel=0.0, abs=1e-9)


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
    assert re.search(r"^finger_mcp -?\d+\.\d \(true -?\d+\.\d\) ", out, re.MULTILINE)  # live
    row = re.search(r"pcf[│ ]+finger_pip[│ ]+(\d+\.\d+) ", out)
    assert row is not None
    assert float(row[1]) < 0.5  # deg
    assert re.search(r"imu/distal[│ ]+1500[│ ]+1500[│ ]+none", out)
    assert f"ros2 run jointest_ros sim_hardware_node --ros-args -p source:=bag -p bag:={finger_bag}" in out
    assert f"ros2 run jointest_ros pcf_node --ros-args -p config:={finger_config}" in out


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
    assert line.startswith(f"jointest demo: error: {finger_bag}: no matching topic; the configuration wants imu/a, imu/b")
