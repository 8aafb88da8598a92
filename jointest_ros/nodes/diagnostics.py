"""What a node tells of its inputs and joints: /diagnostics once a second, and the log where that is bad news."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from jointest_ros.bags.intake import Intake
from jointest_ros.core.frame import Estimate, Status
from jointest_ros.nodes.arrival import arrivals

PERIOD = 1.0  # s
_WARN_AGAIN = 5.0  # s between warnings about the same topic
_WORDS = {
    Status.STARTING: "no estimate yet",
    Status.NO_DATA: "a sensor is missing",
    Status.GAP: "predicted over a gap",
    Status.UNOBSERVABLE: "axis near gravity: gyro only",
    Status.STALE: "stale: not published",
    Status.DISTURBED: "correction suspended",
}


@dataclass
class _Input:
    """One topic: what was known of it at the last report."""

    name: str
    messages: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    silent: bool = False
    warned: float = -math.inf  # monotonic s
    warned_of: int = 0  # refused messages


class Diagnostics:
    """Publishes on /diagnostics by a timer of the node, in real time whatever the node's clock; estimates do without.

    Args:
        intake: whose counters are reported.
        topics: topic as configured -> its name in ROS.
        joints: of the estimates.
    """

    def __init__(self, node: Node, intake: Intake, topics: Mapping[str, str], joints: tuple[str, ...]) -> None:
        self._node, self._intake, self._joints = node, intake, joints
        self._inputs = {topic: _Input(name) for topic, name in topics.items()}
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._timer = node.create_timer(PERIOD, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.estimate: Estimate | None = None
        self._reported: Estimate | None = None

    def publish(self) -> None:
        """One report."""
        array = DiagnosticArray()
        array.header.stamp = self._node.get_clock().now().to_msg()
        silent = {one.name for one in self._inputs.values() if one.silent}
        array.status = [self._input(topic) for topic in self._inputs]
        array.status += [self._joint(number, name) for number, name in enumerate(self._joints)]
        self._publisher.publish(array)
        self._reported = self.estimate
        self._log_silence(silent)
        arrivals.done()

    def _input(self, topic: str) -> DiagnosticStatus:
        one, counts = self._inputs[topic], self._intake.counts(topic)
        received = counts["messages"] - one.messages
        refused = {cause: n for cause, n in counts["refused"].items() if n > one.refused.get(cause, 0)}
        if refused:
            level, text = DiagnosticStatus.WARN, f"messages refused: {_causes(refused)}"
        elif not received:
            level, text = DiagnosticStatus.STALE, "no messages" if counts["messages"] else "never received"
        else:
            level, text = DiagnosticStatus.OK, f"{received / PERIOD:.0f} messages/s"
        one.messages, one.refused, one.silent = counts["messages"], counts["refused"], not received
        self._log_refused(one)
        values = {"messages": counts["messages"], "used": counts["used"]}
        values |= {f"refused: {cause}": n for cause, n in counts["refused"].items()}
        return self._status(f"input {one.name}", level, text, values)

    def _joint(self, number: int, name: str) -> DiagnosticStatus:
        if self.estimate is None:
            return self._status(f"joint {name}", DiagnosticStatus.STALE, _WORDS[Status.STARTING], {})
        flags = Status(self.estimate.status[number])
        words = [text for flag, text in _WORDS.items() if flags & flag]
        deviation = math.degrees(math.sqrt(self.estimate.variance[number]))
        level = DiagnosticStatus.WARN if words else DiagnosticStatus.OK
        if self.estimate is self._reported:
            level, words = DiagnosticStatus.STALE, ["no new estimate"]
        values = {
            "standard deviation (deg)": f"{deviation:.3f}",
            "gyro bias calibrated": "no" if flags & Status.UNCALIBRATED else "yes",
        }
        return self._status(f"joint {name}", level, "; ".join(words) or f"+-{deviation:.2f} deg", values)

    def _status(self, what: str, level: bytes, text: str, values: dict[str, Any]) -> DiagnosticStatus:
        name = self._node.get_fully_qualified_name().lstrip("/")
        pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        return DiagnosticStatus(level=level, name=f"{name}: {what}", hardware_id=name, message=text, values=pairs)

    # ------------------------------------------------------------- log

    def _log_refused(self, one: _Input) -> None:
        """Sooner or later every refused message is told of."""
        refused, now = sum(one.refused.values()), time.monotonic()
        if refused > one.warned_of and now - one.warned >= _WARN_AGAIN:
            one.warned, one.warned_of = now, refused
            self._node.get_logger().warning(f"{one.name}: messages refused: {_causes(one.refused)}")

    def _log_silence(self, before: set[str]) -> None:
        now = {one.name for one in self._inputs.values() if one.silent}
        if now - before:
            self._node.get_logger().warning(f"no messages on {', '.join(sorted(now - before))}")
        if before - now:
            self._node.get_logger().info(f"messages on {', '.join(sorted(before - now))}")


def _causes(refused: Mapping[str, int]) -> str:
    return ", ".join(f"{cause} ({n} in all)" for cause, n in sorted(refused.items()))
