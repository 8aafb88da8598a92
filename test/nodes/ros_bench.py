"""What the tests of the nodes share: nodes in one executor, and waiting for conditions."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Log
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from without_ros import Message

from jointest_ros.nodes.estimator_node import EstimatorNode
from jointest_ros.nodes.messages import CLASSES
from jointest_ros.nodes.sim_hardware_node import SimHardwareNode
from jointest_ros.nodes.spin import make_executor

TIMEOUT = 60.0  # s, far more than anything takes
DEPTH = 100_000  # of queues, so that a slow machine loses nothing
_numbers = itertools.count()

Wanted = Callable[[Any], bool]
Report = dict[str, DiagnosticStatus]  # what is reported on -> status


def queue() -> QoSProfile:
    """A quality of service with a long queue that suits every publisher."""
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)


class Bench:
    """Nodes in one executor and one ROS context, in a namespace that no other test has."""

    def __init__(self, executor: str) -> None:
        self.namespace = f"/test_{os.getpid()}_{next(_numbers)}"
        self._kind = executor

    def __enter__(self) -> Bench:
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.executor = make_executor(self._kind, self.context)
        self.nodes: list[Node] = []
        self.probe = self.add(Node("probe", namespace=self.namespace, context=self.context))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for node in list(self.nodes):
            self.remove(node)
        rclpy.try_shutdown(context=self.context)

    # ------------------------------------------------------------- nodes

    def add(self, node: Any) -> Any:
        """Put a node into the executor."""
        self.nodes.append(node)
        self.executor.add_node(node)
        self.executor.spin_once(timeout_sec=0.0)  # the EventsExecutor does not look at what came before its first spin
        return node

    def remove(self, node: Node) -> None:
        """Take a node out of the executor and destroy it."""
        self.nodes.remove(node)
        self.executor.remove_node(node)
        node.destroy_node()

    def estimator(self, path: Path, name: str = "pcf", namespace: str = "", **parameters: Any) -> EstimatorNode:
        """An estimator node with long queues."""
        return self.add(
            EstimatorNode(
                name,
                namespace=f"{self.namespace}/{namespace}".rstrip("/"),
                context=self.context,
                config=str(path),
                **{"depth": DEPTH, **parameters},
            )
        )

    def hardware(self, **parameters: Any) -> SimHardwareNode:
        """Simulated hardware that starts at once: what listens in this process is known already."""
        chosen = {"wait_for_subscribers": 0, **parameters}
        return self.add(SimHardwareNode(namespace=self.namespace, context=self.context, **chosen))

    # ------------------------------------------------------------- waiting

    def until(self, condition: Callable[[], Any], what: str = "") -> Any:
        """Spin until `condition()` is true; what it returned."""
        end = time.monotonic() + TIMEOUT
        while not (result := condition()):
            assert time.monotonic() < end, f"waited in vain for {what or condition}"
            self.executor.spin_once(timeout_sec=0.05)
        return result

    def spin_for(self, seconds: float) -> None:
        """Spin for a while, to see that nothing happens."""
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() >= end)

    def call(self, kind: Any, name: str, request: Any = None) -> Any:
        """The response of a service."""
        client = self.probe.create_client(kind, name)
        self.until(client.service_is_ready, f"service {name}")
        future = client.call_async(request or kind.Request())
        self.until(future.done, f"response of {name}")
        self.probe.destroy_client(client)
        return future.result()

    def trigger(self, node: Node, name: str) -> tuple[bool, str]:
        """Success and message of one of a node's services without arguments."""
        response = self.call(Trigger, f"{node.get_fully_qualified_name()}/{name}")
        return response.success, response.message

    # ------------------------------------------------------------- messages

    def listen(
        self, topic: str = "joint_states", kind: Any = JointState, wanted: Wanted = lambda message: True, **options: Any
    ) -> list[Any]:
        """A list that the messages of a topic, or the wanted ones of them, are put into."""
        received: list[Any] = []
        callback = partial(_keep, received, wanted)
        self.probe.create_subscription(kind, topic, callback, queue(), **options)
        return received

    def log(self, node: Node) -> list[Log]:
        """What a node logs from now on."""
        name = node.get_logger().name
        return self.listen("/rosout", Log, lambda log: log.name == name)

    def diagnostics(self, node: Node) -> Diagnoses:
        """What a node reports from now on."""
        name = node.get_fully_qualified_name().lstrip("/")
        mine = self.listen("/diagnostics", DiagnosticArray, lambda array: array.status[0].hardware_id == name)
        return Diagnoses(self, mine, name)

    def send(self, node: EstimatorNode, messages: Iterable[Message]) -> None:
        """Publish messages, in this order, on the topics of a node, until it has them all."""
        publishers = {
            topic: self.probe.create_publisher(CLASSES[msgtype], topic, queue())
            for topic, msgtype in node.intake.topics.items()
        }
        self.until(lambda: all(p.get_subscription_count() for p in publishers.values()), "subscriptions")
        expected = received(node)
        for number, (topic, data) in enumerate(messages, 1):
            publishers[topic].publish(data)
            expected += 1
            if number % 100 == 0:
                self.receive({node: expected})
        self.receive({node: expected})
        for publisher in publishers.values():
            self.probe.destroy_publisher(publisher)

    def receive(self, expected: Mapping[EstimatorNode, int]) -> None:
        """Spin until nodes have had so many messages on all their topics."""
        for node, number in expected.items():
            for _ in range(number - received(node)):  # looking each time would take longer than what is done
                self.executor.spin_once(timeout_sec=0.0)
        self.until(
            lambda: all(received(node) >= number for node, number in expected.items()),
            f"{sum(expected.values())} messages to be received",
        )


def _keep(received: list[Any], wanted: Wanted, message: Any) -> None:
    if wanted(message):
        received.append(message)


def received(node: EstimatorNode) -> int:
    """Number of messages that a node has had on all its topics."""
    return sum(node.intake.counts(topic)["messages"] for topic in node.intake.topics)


class Diagnoses:
    """The reports of one node."""

    def __init__(self, bench: Bench, arrays: list[DiagnosticArray], node: str) -> None:
        self._bench, self._arrays, self._node, self._seen = bench, arrays, node, 0

    def next(self) -> Report:
        """The next report from now on."""
        self._seen = len(self._arrays)
        return self.until(lambda report: True)

    def until(self, wanted: Callable[[Report], bool]) -> Report:
        """The first report as wanted after the one that was last returned."""

        found: list[Report] = []

        def look() -> bool:
            for array in self._arrays[self._seen :]:
                self._seen += 1
                report = {status.name.removeprefix(f"{self._node}: "): status for status in array.status}
                if wanted(report):
                    found.append(report)
                    break
            return bool(found)

        self._bench.until(look, f"diagnostics of {self._node}")
        return found[0]


def values(status: DiagnosticStatus) -> dict[str, str]:
    """The key-value pairs of a status."""
    return {pair.key: pair.value for pair in status.values}
