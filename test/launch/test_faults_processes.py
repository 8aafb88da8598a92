"""Every estimator as a process that is killed and started again: it is as good as at its first start."""

from __future__ import annotations

import itertools
import math
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from faults import MS, RIGS, START, Errors, Rig, S, Simulation, Stream, rms, simulate, since
from processes import TIMEOUT, Process, finish
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float32MultiArray
from std_srvs.srv import Trigger

from jointest_ros.bags.cdr import decode_joint_state
from jointest_ros.bags.intake import HALL_TOPIC

Launch = Callable[..., Process]
QOS = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_EFFORT)
SETTLED = 2 * S  # ns after a start
LEAST = math.radians(0.05)  # `floor_deg` of pcf: it trusts saved gyro biases less than new ones
REST = START + 1_900 * MS  # until then the finger is at rest, and learns its gyro biases


class Hardware:
    """The sensors of a rig: publishes tick after tick, when the estimators have answered to the one before."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.made: Simulation = simulate(rig, seed=1)
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.node = Node("hardware", namespace=f"/{rig.source}", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        topics = sorted({topic for _, topic, _ in self.made.messages})
        self.publishers: dict[str, Any] = {
            topic: self.node.create_publisher(Float32MultiArray if topic == HALL_TOPIC else Imu, topic, QOS)
            for topic in topics
        }
        self.known: set[bytes] = set()  # endpoints of estimators that were connected
        self.heard: dict[str, list[bytes]] = {name: [] for name in rig.estimators}
        for name, states in self.heard.items():
            self.node.create_subscription(JointState, f"{name}/joint_states", states.append, QOS, raw=True)

    def close(self) -> None:
        """Free everything."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def until(self, condition: Callable[[], Any], what: str, patience: float = TIMEOUT) -> bool:
        """Spin until `condition()` is true; whether it was in time."""
        end = time.monotonic() + patience
        while not condition():
            if time.monotonic() >= end:
                assert patience < TIMEOUT, f"waited in vain for {what}"
                return False
            self.executor.spin_once(timeout_sec=0.05)
        return True

    def connect(self) -> None:
        """Wait until all estimators that were started last hear all topics, and are heard."""
        expected = len(self.heard) * (len(self.publishers) + 1)
        self.until(lambda: len(self._endpoints() - self.known) == expected, "estimators")
        self.known |= self._endpoints()

    def _endpoints(self) -> set[bytes]:
        """Identifiers of what hears this hardware and of what it hears; a killed process is there for 20 s more."""
        found = [self.node.get_subscriptions_info_by_topic(topic) for topic in self.publishers]
        found += [self.node.get_publishers_info_by_topic(f"{name}/joint_states") for name in self.heard]
        return {bytes(one.endpoint_gid) for infos in found for one in infos}

    def play(self, stream: Stream) -> None:
        """Publish; a tick that none or only some estimators answer, because they only begin, costs a moment."""
        for _, messages in itertools.groupby(stream, key=lambda message: message[0]):
            before = {name: len(states) for name, states in self.heard.items()}
            for _, topic, data in messages:
                self.publishers[topic].publish(data)
            self.until(lambda before=before: self._answered(before), "answers", patience=0.05)

    def _answered(self, before: dict[str, int]) -> bool:
        return all(len(states) > before[name] for name, states in self.heard.items())

    def call(self, service: str) -> tuple[bool, str]:
        """The answer of a Trigger service."""
        client = self.node.create_client(Trigger, service)
        self.until(client.service_is_ready, service)
        future = client.call_async(Trigger.Request())
        self.until(future.done, service)
        response = future.result()
        self.node.destroy_client(client)
        return response.success, response.message

    def errors(self, name: str) -> Errors:
        """Of all whole states that were heard so far; forgets them."""
        heard, errors = [decode_joint_state(data) for data in self.heard[name]], {}
        joints = max((names for _, names, _, _ in heard), key=len)
        for stamp, names, position, _ in heard:
            if names == joints:
                errors[stamp] = self.made.error(stamp, joints, position)
        self.heard[name].clear()
        return errors


@pytest.fixture(params=RIGS)
def hardware(request: pytest.FixtureRequest) -> Iterator[Hardware]:
    one = Hardware(RIGS[request.param])
    yield one
    one.close()


def start(launch: Launch, rig: Rig, folder: Path) -> dict[str, Process]:
    """All estimators of a rig."""

    def arguments(name: str) -> Iterable[str]:
        yield from ("--ros-args", "-r", f"__ns:=/{rig.source}/{name}")
        for parameter in (
            f"config:={rig.path}",
            f"sensor_namespace:=/{rig.source}",
            f"calibration_file:={folder / name}.yaml",
            *(["zero_at_start:=false"] if name == "pcf" else []),  # it would be taken in the middle of motion
        ):
            yield from ("-p", parameter)

    return {name: launch(f"{name}_node", *arguments(name)) for name in rig.estimators}


def test_killed_and_started_again(hardware: Hardware, launch: Launch, tmp_path: Path) -> None:
    """In the middle of motion; SIGINT and SIGTERM end them with code 0 and without a complaint."""
    stream, rig = hardware.made.messages, hardware.rig
    killed = START + 5_250 * MS  # in the middle
    nodes = start(launch, rig, tmp_path)
    hardware.connect()
    hardware.play([message for message in stream if message[0] < REST])
    if "pcf" in nodes:  # the next start, in motion, is warm
        for service in ("calibrate_zero", "save_calibration"):
            done, message = hardware.call(f"/{rig.source}/pcf/pcf_node/{service}")
            assert done, message
    hardware.play([message for message in stream if REST <= message[0] < killed])
    free = {name: since(hardware.errors(name), START + SETTLED) for name in nodes}
    for process in nodes.values():
        process.kill()
    for process in nodes.values():
        assert finish(process).returncode == -signal.SIGKILL
    nodes = start(launch, rig, tmp_path)
    hardware.connect()
    hardware.play([message for message in stream if message[0] >= killed])
    for name in nodes:
        heard = hardware.errors(name)
        begin = min(heard) + SETTLED  # on a busy machine the new process misses the first messages
        found = since(heard, begin)
        assert len(found) > 0.9 * (max(heard) - begin) / (10 * MS) > 100
        if name != "gyro":  # begins at zero, wherever the joints are
            assert rms(found) < max(2.0 * rms(free[name]), LEAST), name
    for process, number in zip(nodes.values(), itertools.cycle((signal.SIGINT, signal.SIGTERM)), strict=False):
        process.send_signal(number)
    for process in nodes.values():
        done = finish(process)
        assert done.returncode == 0
        assert "Traceback" not in done.stderr and "[ERROR]" not in done.stderr
