"""Plays faulty streams to estimator nodes over DDS as fast as they take them, and compares with the truth."""

from __future__ import annotations

import itertools
from functools import cache
from typing import Any

import numpy as np
import pytest
from faults import BEGIN, END, RECOVERED, RIGS, Errors, Rig, Simulation, Stream, simulate
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_bench import Bench, queue, received
from sensor_msgs.msg import JointState
from without_ros import make

from jointest_ros.bags.cdr import decode_imu, decode_joint_state
from jointest_ros.core.frame import Status
from jointest_ros.nodes.arrival import arrivals
from jointest_ros.nodes.messages import CLASSES

SEED = 1
_HIDDEN = Status.STARTING | Status.STALE


@cache
def simulation(rig: str) -> Simulation:
    """Of one rig, once for all tests."""
    return simulate(RIGS[rig], SEED)


@cache
def faultless(rig: str, estimator: str) -> Errors:
    """Errors of an estimator that gets all messages as they were sent."""
    made, (one, intake) = simulation(rig), make(RIGS[rig].path, estimator)
    errors: Errors = {}
    for time, topic, data in made.messages:
        for estimate in map(one.update, intake.handlers[topic](data, time)):
            if not any(flags & _HIDDEN for flags in estimate.status):
                errors[estimate.stamp] = made.error(estimate.stamp, one.joints, estimate.position)
    return errors


class FaultBench:
    """The estimators of a rig side by side on one stream, in a `Bench`.

    Messages that are published at the same time arrive together, and the time passes as the stream has it, not as fast
    as this machine is: Hall messages are paired by arrival.
    """

    def __init__(
        self, bench: Bench, name: str, monkeypatch: pytest.MonkeyPatch, reliability: str = "best_effort"
    ) -> None:
        self.bench, self.rig, self.made = bench, RIGS[name], simulation(name)
        chosen = {"sensor_namespace": bench.namespace, "reliability": reliability}
        self.nodes = {one: bench.estimator(self.rig.path, one, one, **chosen) for one in self.rig.estimators}
        self._heard = {one: bench.listen(f"{one}/joint_states", JointState, raw=True) for one in self.nodes}
        self._now = 0
        real = arrivals.now
        start = real()

        def now() -> int:
            real()
            return start + self._now

        monkeypatch.setattr(arrivals, "now", now)

    def play(self, stream: Stream, drivers: int = 1, restarted: bool = False, reliable: bool = False) -> None:
        """Publish a stream.

        Args:
            drivers: so many publishers of each topic take turns from BEGIN to END.
            restarted: the publishers are destroyed at END, and others made.
            reliable: so they are.
        """
        qos = queue()
        if reliable:
            qos.reliability = ReliabilityPolicy.RELIABLE
        publishers = self._publishers(drivers, qos)
        turns = itertools.cycle(range(drivers))
        expected = {node: received(node) for node in self.nodes.values()}
        for time, messages in itertools.groupby(stream, key=lambda message: message[0]):
            if restarted and time >= END:
                self._destroy(publishers)
                publishers, restarted = self._publishers(drivers, qos), False
            self._now = time
            for _, topic, data in messages:
                one = publishers[topic][next(turns) if BEGIN <= time < END else 0]
                one.publish(data)
                for node in expected:
                    expected[node] += topic in node.intake.topics
            self.bench.receive(expected)
        self._destroy(publishers)

    def _publishers(self, drivers: int, qos: QoSProfile) -> dict[str, list[Any]]:
        topics = {topic: kind for node in self.nodes.values() for topic, kind in node.intake.topics.items()}
        probe = self.bench.probe
        publishers = {
            topic: [probe.create_publisher(CLASSES[kind], topic, qos) for _ in range(drivers)]
            for topic, kind in topics.items()
        }
        listeners = {topic: sum(topic in node.intake.topics for node in self.nodes.values()) for topic in topics}
        wanted = [(one, listeners[topic]) for topic, row in publishers.items() for one in row]
        self.bench.until(lambda: all(one.get_subscription_count() >= n for one, n in wanted), "subscriptions")
        return publishers

    def _destroy(self, publishers: dict[str, list[Any]]) -> None:
        for one in itertools.chain(*publishers.values()):
            self.bench.probe.destroy_publisher(one)

    def errors(self, estimator: str, newest: int) -> Errors:
        """Errors of what it has published up to the stamp `newest`, after the last jump back; whole states only."""
        node, heard = self.nodes[estimator], self._heard[estimator]
        joints = node.estimator.joints
        self.bench.until(lambda: heard and decode_joint_state(heard[-1])[0] >= newest, f"the states of {estimator}")
        errors: Errors = {}
        last = 0
        for stamp, names, position, velocity in map(decode_joint_state, heard):
            assert np.isfinite(position + velocity).all()
            if stamp < last:
                errors.clear()
            last = stamp
            if names == joints and stamp in self.made.truth:
                errors[stamp] = self.made.error(stamp, joints, position)
        return errors


def good_from(rig: Rig, stream: Stream) -> int:
    """Stamp of the first message that is published at RECOVERED or later."""
    return next(decode_imu(data)[0] for time, topic, data in stream if time >= RECOVERED and topic == rig.victim)
