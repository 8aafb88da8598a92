"""Simulated hardware, estimators and a comparison in one executor: what `jointest demo` shows."""

from __future__ import annotations

import math
import os
import time
from array import array
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rich.console import Console
from rich.live import Live
from rich.table import Table
from sensor_msgs.msg import JointState

from jointest_ros.bags.cdr import decode_joint_state
from jointest_ros.bags.ground_truth import TRUTH_JOINTS
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.offline import check_topics
from jointest_ros.bags.reader import BagReader
from jointest_ros.config import Configuration
from jointest_ros.core.frame import FloatArray, Series
from jointest_ros.evaluation.metrics import errors
from jointest_ros.evaluation.truth import Truth
from jointest_ros.nodes.estimator_node import EstimatorNode
from jointest_ros.nodes.sim_hardware_node import SimHardwareNode
from jointest_ros.nodes.spin import caught_signals, make_executor

NAMESPACE = f"/jointest_demo_{os.getpid()}"  # two demos on one host do not hear each other
_REFRESH = 0.2  # s
_SETTLE = 1.0  # s, at the end: for messages under way


class JointLog:
    """The JointState messages of one topic, as arrays."""

    def __init__(self) -> None:
        self.stamps = array("q")
        self.position: dict[str, array[float]] = {}
        self.velocity: dict[str, array[float]] = {}

    def take(self, data: bytes) -> None:
        """Add one message (CDR bytes)."""
        stamp, names, position, velocity = decode_joint_state(data)
        for table, values in ((self.position, position), (self.velocity, velocity)):
            present = dict(zip(names, values, strict=False))
            for name in names:
                if name not in table:
                    table[name] = array("d", [math.nan] * len(self.stamps))
            for name, column in table.items():
                column.append(present.get(name, math.nan))
        self.stamps.append(stamp)

    def degrees(self, joint: str, stamp: int | None = None) -> float:
        """Position at the newest message, or at the newest that is not after `stamp`, deg; NaN without one."""
        row = len(self.stamps) if stamp is None else bisect_right(self.stamps, stamp)
        return math.degrees(self.position[joint][row - 1]) if row and joint in self.position else math.nan

    def column(self, table: dict[str, array[float]], joint: str) -> FloatArray:
        """One joint as an array, NaN where a message had it not."""
        return np.frombuffer(table[joint]) if joint in table else np.full(len(self.stamps), np.nan)


class Demo:
    """Context manager around the nodes, in a ROS context of their own.

    Raises:
        JointestError: on entering: in the recording, the configuration or a parameter.
    """

    def __init__(
        self, bag: Path, path: Path, configuration: Configuration, names: list[str], speed: float, namespace: str
    ) -> None:
        self._bag, self._path, self._configuration, self._names = bag, path, configuration, names
        self._speed, self._namespace = speed, namespace
        self._sensors = f"{NAMESPACE}/{namespace.strip('/')}".rstrip("/")

    def __enter__(self) -> Demo:
        with BagReader(self._bag) as reader:
            check_topics(reader, Intake(self._configuration.robot, self._configuration.timing), self._namespace)
        with ExitStack() as stack:
            context = Context()
            rclpy.init(context=context)
            stack.callback(rclpy.try_shutdown, context=context)
            self._executor = make_executor("events", context)
            self._hardware = SimHardwareNode(
                namespace=NAMESPACE, context=context, source="bag", bag=str(self._bag), speed=self._speed
            )
            self._nodes: dict[str, EstimatorNode] = {}
            stack.callback(self._end, self._hardware)
            self._truth, self._logs = JointLog(), {name: JointLog() for name in self._names}
            for name in self._names:
                node = EstimatorNode(
                    name,
                    namespace=f"{NAMESPACE}/{name}",
                    context=context,
                    config=str(self._path),
                    sensor_namespace=self._sensors,
                )
                stack.callback(self._end, node)
                self._nodes[name] = node
                self._listen("joint_states", self._logs[name], node)
            self._listen(f"{self._sensors}/{TRUTH_JOINTS}", self._truth, self._hardware)
            for one in (self._hardware, *self._nodes.values()):
                self._executor.add_node(one)
            self._stack = stack.pop_all()
        return self

    def _listen(self, topic: str, log: JointLog, node: Any) -> None:
        node.create_subscription(JointState, topic, partial(JointLog.take, log), 10000, raw=True)

    def _end(self, node: Any) -> None:
        self._executor.remove_node(node)
        node.destroy_node()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def play(self, console: Console) -> None:
        """Play the recording to its end, with a live table (a line every two seconds where there is no terminal).

        Raises:
            KeyboardInterrupt: after a SIGINT or SIGTERM.
        """
        ends = math.inf
        shown = time.monotonic()
        with (
            caught_signals() as signals,
            Live(self._table(), console=console, auto_refresh=False, transient=True) as live,
        ):
            while time.monotonic() < ends:
                self._executor.spin_once(timeout_sec=0.05)
                if signals:
                    raise KeyboardInterrupt
                now = time.monotonic()
                if self._hardware.finished and ends == math.inf:
                    ends = now + _SETTLE
                if now - shown > (_REFRESH if console.is_terminal else 2.0):
                    shown = now
                    if console.is_terminal:
                        live.update(self._table(), refresh=True)
                    else:
                        for line in self._lines():
                            console.print(line, markup=False)

    def _joints(self) -> list[tuple[str, str]]:
        return [(name, joint) for name, node in self._nodes.items() for joint in node.estimator.joints]

    def _table(self) -> Table:
        table = Table(title=f"{self._bag.name}, {self._hardware.sent} messages sent", title_justify="left")
        for heading in ("estimator", "joint"):
            table.add_column(heading)
        for heading in ("estimate, deg", "truth, deg", "error, deg"):
            table.add_column(heading, justify="right", min_width=13)
        for name, joint in self._joints():
            estimate, truth = self._both(name, joint)
            numbers = (estimate, truth, estimate - truth)
            table.add_row(name, joint, *("-" if math.isnan(v) else f"{v:.2f}" for v in numbers))
        return table

    def _lines(self) -> Iterator[str]:
        """A line for each estimator."""
        for name, node in self._nodes.items():
            cells = []
            for joint in node.estimator.joints:
                estimate, truth = self._both(name, joint)
                cells.append(f"{joint} {estimate:.1f}" + ("" if math.isnan(truth) else f" (true {truth:.1f})"))
            yield f"{name}: {'  '.join(cells)}"

    def _both(self, name: str, joint: str) -> tuple[float, float]:
        """The newest estimate of a joint, and the truth at its stamp, deg."""
        log = self._logs[name]
        return log.degrees(joint), self._truth.degrees(joint, log.stamps[-1] if log.stamps else 0)

    def errors(self) -> dict[str, dict[str, Any]]:
        """Errors of what was received, keyed as the JSON of `jointest evaluate`."""
        log = self._truth
        stamps = np.array(log.stamps, dtype=np.int64)
        truth = Truth(
            stamps,
            {joint: log.column(log.position, joint) for joint in log.position},
            {joint: log.column(log.velocity, joint) for joint in log.velocity},
        )
        continuous = {c for joint in self._configuration.robot.joints if joint.continuous for c in joint.coordinates}
        return {
            name: errors(self._series(name), node.estimator.joints, truth, 0.0, continuous)
            for name, node in self._nodes.items()
        }

    def _series(self, name: str) -> Series:
        log, joints = self._logs[name], self._nodes[name].estimator.joints
        length = len(log.stamps)
        shape = (length, len(joints))
        position, velocity = np.full(shape, np.nan), np.full(shape, np.nan)
        for column, joint in enumerate(joints):
            position[:, column] = log.column(log.position, joint)
            velocity[:, column] = log.column(log.velocity, joint)
        status = np.where(np.isfinite(position), 0, 1).astype(np.int64)
        return Series(np.array(log.stamps, dtype=np.int64), position, velocity, np.zeros(shape), status)

    def inputs(self) -> dict[str, dict[str, Any]]:
        """Messages received, used and refused by the first estimator, by topic."""
        intake = self._nodes[self._names[0]].intake
        return {topic: intake.counts(topic) for topic in intake.topics}
