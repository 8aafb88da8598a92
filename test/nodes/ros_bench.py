"""What the tests of the nodes share: nodes in one executor, waiting for conditions, the same evaluated without ROS."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Log
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from jointest_ros import config
from jointest_ros.bags import offline, synthetic
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, Series, Status
from jointest_ros.nodes.estimator_node import EstimatorNode
from jointest_ros.nodes.messages import CLASSES
from jointest_ros.nodes.sim_hardware_node import SimHardwareNode
from jointest_ros.nodes.spin import make_executor
from jointest_ros.sim.scenarios import SCENARIOS

TIMEOUT = 20.0  # s, far more than anything takes
DEPTH = 100_000  # of queues, so that a slow machine loses nothing
_HIDDEN = Status.STARTING | Status.STALE
_numbers = itertools.count()

Message = tuple[str, bytes]  # topic, CDR bytes
Report = dict[str, DiagnosticStatus]  # what is reported on -> status


def queue(reliability: ReliabilityPolicy = ReliabilityPolicy.BEST_EFFORT) -> QoSProfile:
    """A quality of service with a long queue."""
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=DEPTH, reliability=reliability)


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

    def listen(self, topic: str = "joint_states", kind: Any = JointState, **options: Any) -> list[Any]:
        """A list that the messages of a topic are put into."""
        received: list[Any] = []
        qos = options.pop("qos", queue(ReliabilityPolicy.BEST_EFFORT))
        self.probe.create_subscription(kind, topic, received.append, qos, **options)
        return received

    def log(self, node: Node) -> list[Log]:
        """What a node logs from now on."""
        return _Only(self.listen("/rosout", Log), lambda log: log.name == node.get_logger().name)

    def diagnostics(self, node: Node) -> Diagnoses:
        """What a node reports from now on."""
        name = node.get_fully_qualified_name().lstrip("/")
        return Diagnoses(self, self.listen("/diagnostics", DiagnosticArray), name)

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
                self.until(partial(_has_received, node, expected))
        self.until(partial(_has_received, node, expected), f"{expected} messages to be received")
        for publisher in publishers.values():
            self.probe.destroy_publisher(publisher)


def received(node: EstimatorNode) -> int:
    """Number of messages that a node has had on all its topics."""
    return sum(node.intake.counts(topic)["messages"] for topic in node.intake.topics)


def _has_received(node: EstimatorNode, number: int) -> bool:
    return received(node) >= number


class _Only(list[Any]):
    """A view of a growing list: what `wanted` says."""

    def __init__(self, source: list[Any], wanted: Callable[[Any], bool]) -> None:
        super().__init__()
        self._source, self._wanted = source, wanted

    def __iter__(self) -> Any:
        return filter(self._wanted, list(self._source))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __bool__(self) -> bool:
        return len(self) > 0


class Diagnoses:
    """The reports of one node."""

    def __init__(self, bench: Bench, arrays: list[DiagnosticArray], node: str) -> None:
        self._bench, self._arrays, self._node, self._seen = bench, arrays, node, 0

    def next(self) -> Report:
        """The next report from now on."""
        self._seen = len(self._mine())
        return self.until(lambda report: True)

    def until(self, wanted: Callable[[Report], bool]) -> Report:
        """The first report as wanted after the one that was last returned."""

        found: list[Report] = []

        def look() -> bool:
            for report in self._mine()[self._seen :]:
                self._seen += 1
                if wanted(report):
                    found.append(report)
                    break
            return bool(found)

        self._bench.until(look, f"diagnostics of {self._node}")
        return found[0]

    def _mine(self) -> list[Report]:
        mine = [array for array in self._arrays if array.status and array.status[0].hardware_id == self._node]
        return [{status.name.removeprefix(f"{self._node}: "): status for status in array.status} for array in mine]


def values(status: DiagnosticStatus) -> dict[str, str]:
    """The key-value pairs of a status."""
    return {pair.key: pair.value for pair in status.values}


# ----------------------------------------------------------------- the same without ROS


def simulated(source: str = "finger", **options: Any) -> list[Message]:
    """The sensor messages of a simulation, in the order of their stamps."""
    rig = SCENARIOS[source]
    messages = synthetic.messages(rig.stretches(rig.options(**options)))
    return [(topic, data) for _, topic, data in messages if not topic.startswith("ground_truth/")]


def make(path: Path, name: str = "pcf", **parameters: Any) -> tuple[Estimator, Intake]:
    """The estimator and the intake that a node has with this configuration."""
    configuration = config.load(path)
    kind = ESTIMATORS[name]
    section = configuration.estimators.get(name) or kind.Params()
    chosen = kind.Params.from_mapping({**vars(section), **parameters})
    return kind(configuration.robot, chosen, configuration.timing), Intake(configuration.robot, configuration.timing)


def evaluate(bag: Path, path: Path, name: str = "pcf") -> tuple[Series, tuple[str, ...]]:
    """What the offline evaluation of a recording gives, and the names of the joints."""
    estimator, intake = make(path, name)
    sink = offline.SeriesSink({name: estimator})
    with BagReader(bag) as reader:
        offline.run(reader, intake, {name: estimator}, sink)
    return sink.series(name), estimator.joints


def estimate(messages: Iterable[Message], path: Path, **parameters: Any) -> tuple[Series, tuple[str, ...]]:
    """What the messages give when they are handled one after the other, and the names of the joints."""
    estimator, intake = make(path, **parameters)
    estimates: list[Estimate] = []
    for topic, data in messages:
        estimates += map(estimator.update, intake.handlers[topic](data, 0))
    return Series.from_estimates(estimates, len(estimator.joints)), estimator.joints


def stamp(message: Any) -> int:
    """Stamp of a message, ns."""
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def shown(series: Series) -> int:
    """How many estimates have something to publish."""
    return int(((series.status & _HIDDEN) == 0).any(axis=1).sum())


def assert_same(states: list[JointState], expected: tuple[Series, tuple[str, ...]]) -> None:
    """The messages are the estimates, all of them, with the joints that have current data, to 1e-9 rad and rad/s."""
    series, joints = expected
    visible = (series.status & _HIDDEN) == 0
    rows = np.flatnonzero(visible.any(axis=1))
    assert [stamp(state) for state in states] == series.stamps[rows].tolist()
    for state, row in zip(states, rows, strict=True):
        columns = np.flatnonzero(visible[row])
        assert list(state.name) == [joints[column] for column in columns]
        np.testing.assert_allclose(state.position, series.position[row, columns], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(state.velocity, series.velocity[row, columns], rtol=0.0, atol=1e-9)
        assert len(state.effort) == 0
