"""What a node tells of its inputs and joints: /diagnostics once a second, and a warning in the log on refused data."""

from __future__ import annotations

import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from jointest_ros.bags.intake import Intake
from jointest_ros.core.frame import Estimate, Status

PERIOD = 1.0  # s
_WORDS = {
    Status.STARTING: "no estimate yet",
    Status.NO_DATA: "a sensor is missing",
    Status.GAP: "predicted over a gap",
    Status.UNOBSERVABLE: "axis near gravity: gyro only",
    Status.STALE: "stale: not published",
    Status.DISTURBED: "correction suspended",
}


class Diagnostics:
    """Publishes on /diagnostics; a timer of the node calls it, the estimates do not depend on it."""

    def __init__(self, node: Node, intake: Intake, joints: tuple[str, ...]) -> None:
        self._node, self._intake, self._joints = node, intake, joints
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._timer = node.create_timer(PERIOD, self.publish)
        self._before: dict[str, dict[str, Any]] = {topic: intake.counts(topic) for topic in intake.topics}
        self.estimate: Estimate | None = None

    def publish(self) -> None:
        """One report."""
        array = DiagnosticArray()
        array.header.stamp = self._node.get_clock().now().to_msg()
        array.status = [self._input(topic) for topic in self._intake.topics]
        array.status += [self._joint(number, name) for number, name in enumerate(self._joints)]
        self._publisher.publish(array)

    def _input(self, topic: str) -> DiagnosticStatus:
        counts, before = self._intake.counts(topic), self._before[topic]
        self._before[topic] = counts
        received = counts["messages"] - before["messages"]
        refused = {cause: n for cause, n in counts["refused"].items() if n > before["refused"].get(cause, 0)}
        if refused:
            causes = ", ".join(f"{cause} ({n} in all)" for cause, n in sorted(refused.items()))
            level, text = DiagnosticStatus.WARN, f"messages refused: {causes}"
            self._node.get_logger().warning(f"{topic}: {text}", throttle_duration_sec=5.0)
        elif not received:
            level, text = DiagnosticStatus.STALE, "no messages" if counts["messages"] else "never received"
        else:
            level, text = DiagnosticStatus.OK, f"{received / PERIOD:.0f} messages/s"
        values = {"messages": counts["messages"], "used": counts["used"]}
        values |= {f"refused: {cause}": n for cause, n in counts["refused"].items()}
        return self._status(f"input {topic}", level, text, values)

    def _joint(self, number: int, name: str) -> DiagnosticStatus:
        if self.estimate is None:
            return self._status(f"joint {name}", DiagnosticStatus.STALE, _WORDS[Status.STARTING], {})
        flags = Status(self.estimate.status[number])
        words = [text for flag, text in _WORDS.items() if flags & flag]
        deviation = math.degrees(math.sqrt(self.estimate.variance[number]))
        level = DiagnosticStatus.WARN if words else DiagnosticStatus.OK
        values = {
            "standard deviation (deg)": f"{deviation:.3f}",
            "gyro bias calibrated": "no" if flags & Status.UNCALIBRATED else "yes",
        }
        return self._status(f"joint {name}", level, "; ".join(words) or f"+-{deviation:.2f} deg", values)

    def _status(self, what: str, level: bytes, text: str, values: dict[str, Any]) -> DiagnosticStatus:
        name = self._node.get_fully_qualified_name().lstrip("/")
        pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        return DiagnosticStatus(level=level, name=f"{name}: {what}", hardware_id=name, message=text, values=pairs)
