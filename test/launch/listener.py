"""Hears what other processes publish."""

from __future__ import annotations

import time
from collections.abc import Callable

import rclpy
from processes import TIMEOUT
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState


class Listener:
    """Hears joint states; `until` waits."""

    def __init__(self) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.node = Node("listener", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.states = self.hear("joint_states")

    def hear(self, topic: str) -> list[JointState]:
        """The joint states of a topic, as they come."""
        states: list[JointState] = []
        self.node.create_subscription(JointState, topic, states.append, 10_000)
        return states

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Spin until `condition()` is true."""
        end = time.monotonic() + TIMEOUT
        while not condition():
            assert time.monotonic() < end, f"waited in vain for {what}"
            self.executor.spin_once(timeout_sec=0.05)

    def spin_for(self, seconds: float) -> None:
        """Spin for a while."""
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() >= end, "the time to pass")

    def topics(self) -> list[str]:
        """Names of all topics that are known."""
        return [topic for topic, _ in self.node.get_topic_names_and_types()]

    def close(self) -> None:
        """Free everything."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)
