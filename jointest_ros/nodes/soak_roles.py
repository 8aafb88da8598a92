"""What the processes of `jointest bench soak` do: hardware that sends as fast as a node takes, and that node."""

from __future__ import annotations

import itertools
import time
from array import array
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState

from jointest_ros.bags.cdr import IMU, decode_joint_state
from jointest_ros.bags.ground_truth import TRUTH_JOINTS
from jointest_ros.bags.synthetic import FIRST_STAMP
from jointest_ros.benchmark.memory import memory
from jointest_ros.core.frame import FloatArray
from jointest_ros.nodes.bench_processes import Link, Meter
from jointest_ros.nodes.estimator_node import EstimatorNode
from jointest_ros.nodes.sim_hardware_node import SimHardwareNode

UNDER_WAY = 100  # messages that the hardware is ahead before it goes on; Fast DDS has room for 512 in shared memory
FAULT_EVERY = 1000  # messages of each IMU, after which one is sent again, then one that cannot be decoded
_LOST = 2.0  # s: what the node has not taken by then it will not
MINUTE = 60_000_000_000  # ns
_NONSENSE = b"\0\1\0\0" + b"\xff" * 40


@dataclass(frozen=True)
class Sent:
    """By the hardware.

    Attributes:
        messages: sent by topic, with the faults.
        faults: how many messages a node must refuse, by cause.
        states: joint states that came back.
        names: columns of the errors: the joints, and their sum (the torso of a chain with one axis).
        mean, rms, largest: (minutes, columns) error of each simulated minute, estimate minus truth, rad.
        memory: (minutes) at the end of each, MB.
    """

    messages: dict[str, int]
    faults: dict[str, int]
    states: int
    names: tuple[str, ...]
    mean: FloatArray
    rms: FloatArray
    largest: FloatArray
    memory: FloatArray


@dataclass(frozen=True)
class Taken:
    """By the node: `Intake.counts` by topic, number of estimates, memory after each minute of messages, MB."""

    counts: dict[str, dict[str, Any]]
    estimates: int
    memory: FloatArray


class _Errors:
    """Errors of joint states by simulated minute."""

    def __init__(self) -> None:
        self.joints: tuple[str, ...] = ()
        self.states = 0
        self.rows: list[FloatArray] = []  # (3, columns): mean, rms, largest
        self.memory = array("d")
        self._awaited: dict[int, tuple[float, ...]] = {}
        self._minute, self._errors = 0, array("d")

    def truth(self, data: bytes) -> None:
        """It was sent."""
        stamp, self.joints, position, _ = decode_joint_state(data)
        self._awaited[stamp] = position

    def estimate(self, data: bytes) -> None:
        """It came back."""
        self.states += 1
        stamp, names, position, _ = decode_joint_state(data)
        for older in list(itertools.takewhile(lambda one: one < stamp, self._awaited)):
            del self._awaited[older]
        truth = self._awaited.pop(stamp, None)
        if truth is None or names != self.joints:
            return
        minute = (stamp - FIRST_STAMP) // MINUTE
        if minute != self._minute:
            self.close()
            self._minute = minute
        errors = [ours - true for ours, true in zip(position, truth, strict=True)]
        self._errors.extend([*errors, sum(errors)])

    def close(self) -> None:
        """The end of a minute."""
        if self._errors:
            errors = np.array(self._errors).reshape(-1, len(self.joints) + 1)
            mean, rms = errors.mean(axis=0), np.sqrt((errors**2).mean(axis=0))
            self.rows.append(np.array([mean, rms, np.abs(errors).max(axis=0)]))
            self.memory.append(memory())
            self._errors = array("d")


class _PacedHardware(SimHardwareNode):
    """Sends what is due as long as not too much is under way, with faults in between, and takes the estimates."""

    def __init__(self, taken: Any, **options: Any) -> None:
        super().__init__(**options)
        self.errors = _Errors()
        self.messages: Counter[str] = Counter()
        self.faults: Counter[str] = Counter()
        self._taken, self._given = taken, 0
        self._seen, self._since = 0, time.monotonic()  # messages taken, and since when it is so many
        assert self._playback is not None
        for topic, msgtype in self._playback.topics.items():
            if topic == TRUTH_JOINTS:
                self._send[topic] = self.errors.truth
            else:
                self._send[topic] = partial(self._paced, topic, msgtype == IMU, self._send[topic])
        self.create_subscription(JointState, "joint_states", self.errors.estimate, 1000, raw=True)

    def _paced(self, topic: str, faulty: bool, publish: Callable[[bytes], None], data: bytes) -> None:
        publish(data)
        self.messages[topic] += 1
        self._given += 1
        if faulty and self.messages[topic] % FAULT_EVERY == 0:
            for cause, fault in (("repeated stamp", data), ("undecodable", _NONSENSE)):
                publish(fault)
                self.messages[topic] += 1
                self._given += 1
                self.faults[cause] += 1

    def _send_due(self, due: int) -> int | None:
        taken, now = int(self._taken.value), time.monotonic()
        if taken != self._seen:
            self._seen, self._since = taken, now
        elif now - self._since > _LOST:
            self._given = taken
        return None if self._given - taken > UNDER_WAY else super()._send_due(due)


def hardware(link: Link, namespace: str, taken: Any, parameters: dict[str, Any]) -> Sent:
    """Plays a simulation to its end, no faster than `taken`, the number of messages that the node had, grows."""
    node = _PacedHardware(taken, namespace=namespace, **parameters)
    errors = node.errors
    meter = Meter(lambda: errors.states)
    link.work(node, "events", meter, until=lambda: node.finished and meter.idle > 1)
    errors.close()
    rows = np.array(errors.rows)
    mean, rms, largest = (rows[:, k] for k in range(3)) if len(rows) else (np.empty((0, 0)),) * 3
    names = (*errors.joints, "sum of all")
    usage = np.array(errors.memory)
    return Sent(dict(node.messages), dict(node.faults), errors.states, names, mean, rms, largest, usage)


class _CountingEstimator(EstimatorNode):
    """Tells how many messages it has had, and notes its memory once in so many."""

    def __init__(self, estimator: str, taken: Any, every: int, **options: Any) -> None:
        self.memory, self._taken, self._every = array("d"), taken, every
        super().__init__(estimator, **options)

    def _receive(self, *arguments: Any) -> None:
        super()._receive(*arguments)
        taken = self._taken.value = self._taken.value + 1
        if taken % self._every == 0:
            self.memory.append(memory())


def estimator(link: Link, namespace: str, name: str, config: str, taken: Any, per_minute: int) -> Taken:
    """A node; `per_minute` of its messages are a simulated minute."""
    node = _CountingEstimator(name, taken, per_minute, namespace=namespace, config=config)
    link.work(node, "events", Meter(lambda: int(taken.value)))
    node.intake.flush()
    counts = {topic: node.intake.counts(topic) for topic in node.intake.topics}
    return Taken(counts, node.estimates, np.array(node.memory))
