"""What the processes of `jointest bench nodes` do: simulated hardware, a node under test, a plain one, an observer."""

from __future__ import annotations

import struct
import time
from array import array
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from jointest_ros.bags.cdr import NANOSECONDS
from jointest_ros.nodes.bench_processes import Link, Meter
from jointest_ros.nodes.estimator_node import EstimatorNode
from jointest_ros.nodes.messages import CLASSES
from jointest_ros.nodes.sim_hardware_node import SimHardwareNode

_PLAIN_DEPTH = 10  # what every tutorial has
_stamp = struct.Struct("<4xiI").unpack_from

Times = NDArray[np.int64]


def _numbers(values: array[int]) -> Times:
    return np.frombuffer(values, dtype=np.int64).copy() if values else np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class Sent:
    """By the hardware: CPU (% of a core); of each frame its stamp and when its last input went out, monotonic ns."""

    cpu: float
    stamps: Times
    times: Times


@dataclass(frozen=True)
class Received:
    """By a node: CPU (% of a core), messages by topic and how many of them it refused.

    `latencies`: from the receipt of the input that made an estimate to the end of its publication, ns.
    """

    cpu: float
    messages: dict[str, int]
    refused: int = 0
    latencies: Times | None = None


@dataclass(frozen=True)
class Seen:
    """By the observer: stamps of the joint states and when they came, monotonic ns."""

    stamps: Times
    times: Times


class _TimedHardware(SimHardwareNode):
    """Notes when the last input of each frame goes out."""

    def __init__(self, newest: str, **options: Any) -> None:
        super().__init__(**options)
        self.stamps, self.times = array("q"), array("q")
        self._publish = self._send[newest]
        self._send[newest] = self._timed

    def _timed(self, data: bytes) -> None:
        assert self._next is not None
        self.stamps.append(self._next[0])
        self.times.append(time.monotonic_ns())
        self._publish(data)


def hardware(link: Link, namespace: str, newest: str, parameters: dict[str, Any]) -> Sent:
    """Plays a simulation to its end, once told; `newest` is the topic of a frame's last input."""
    link.told.wait()
    node = _TimedHardware(newest, namespace=namespace, **parameters)
    meter = Meter(lambda: node.sent)
    link.work(node, "events", meter, until=lambda: node.finished)
    return Sent(meter.percent, _numbers(node.stamps), _numbers(node.times))


class _TimedEstimator(EstimatorNode):
    """Notes how long after its newest input an estimate is published."""

    def __init__(self, estimator: str, **options: Any) -> None:
        self.latencies = array("q")
        super().__init__(estimator, **options)

    def _receive(self, *arguments: Any) -> None:
        begin, before = time.monotonic_ns(), self.estimates
        super()._receive(*arguments)
        if self.estimates != before:
            self.latencies.append(time.monotonic_ns() - begin)


def estimator(link: Link, namespace: str, name: str, config: str) -> Received:
    """An estimator node, as its executable has it; ready when somebody hears its joint states."""
    node = _TimedEstimator(name, namespace=namespace, config=config)
    topics = node.intake.topics
    meter = Meter(lambda: node.estimates)
    (states,) = (one for one in node.publishers if one.topic_name.endswith("/joint_states"))
    link.work(node, "events", meter, ready=lambda: states.get_subscription_count() > 0)
    node.intake.flush()
    counts = {topic: node.intake.counts(topic) for topic in topics}
    return Received(
        meter.percent,
        {topic: one["messages"] for topic, one in counts.items()},
        sum(one["messages"] - one["used"] for one in counts.values()),
        _numbers(node.latencies),
    )


def receiver(link: Link, namespace: str, topics: dict[str, str], executor: str) -> Received:
    """A plain rclpy node that only subscribes, with deserialised messages and queues of 10."""
    node = Node("receiver", namespace=namespace)
    qos = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=_PLAIN_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
    messages = dict.fromkeys(topics, 0)

    def count(topic: str, _message: Any) -> None:
        messages[topic] += 1

    for topic, msgtype in topics.items():
        node.create_subscription(CLASSES[msgtype], topic, partial(count, topic), qos)
    meter = Meter(lambda: sum(messages.values()))
    link.work(node, executor, meter)
    return Received(meter.percent, messages)


def observer(link: Link, namespace: str) -> Seen:
    """Takes what an estimator publishes, as bytes."""
    node = Node("observer", namespace=namespace)
    stamps, times = array("q"), array("q")

    def state(data: bytes) -> None:
        times.append(time.monotonic_ns())
        sec, nanosec = _stamp(data)
        stamps.append(sec * NANOSECONDS + nanosec)

    node.create_subscription(JointState, "joint_states", state, 1000, raw=True)
    node.create_subscription(Vector3Stamped, "torso_angle", lambda _data: None, 1000, raw=True)
    link.work(node, "events", Meter(lambda: len(stamps)))
    return Seen(_numbers(stamps), _numbers(times))
