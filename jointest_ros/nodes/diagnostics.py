"""What a node tells of its inputs and joints: /diagnostics once a second, and the log where that is bad news."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from jointest_ros.bags.intake import Intake
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, Status
from jointest_ros.core.pcf.pair_checks import PairCheck, verdict
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
    saturated: dict[str, int] = field(default_factory=dict)
    conspicuous: bool = False
    silent: bool = False
    warned: float = -math.inf  # monotonic s
    warned_of: int = 0  # refused messages


class Diagnostics:
    """Publishes on /diagnostics by a timer of the node, in real time whatever the node's clock; estimates do without.

    Args:
        intake: whose counters are reported.
        topics: topic as configured -> its name in ROS.
        estimator: whose estimates are reported.
    """

    def __init__(self, node: Node, intake: Intake, topics: Mapping[str, str], estimator: Estimator) -> None:
        self._node, self._intake, self._estimator = node, intake, estimator
        self._pairs_of: Callable[[], list[PairCheck]] = getattr(estimator, "pair_checks", list)
        self._pairs_verdict = ""
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
        array.status += [self._joint(number, name) for number, name in enumerate(self._estimator.joints)]
        if pairs := self._pairs_of():
            array.status.append(self._pairs(pairs))
        self._publisher.publish(array)
        self._reported = self.estimate
        self._log_silence(silent)
        arrivals.done()

    def _input(self, topic: str) -> DiagnosticStatus:
        one, counts = self._inputs[topic], self._intake.counts(topic)
        received = counts["messages"] - one.messages
        refused = {cause: n for cause, n in counts["refused"].items() if n > one.refused.get(cause, 0)}
        saturated = self._intake.saturated(topic)
        findings = self._intake.findings(topic)
        self._log_findings(one, findings)
        for sensor, n in saturated.items():
            if new := n - one.saturated.get(sensor, 0):
                findings.append(self._intake.assembler.quality.saturation_text(sensor, new))
        if refused:
            level, text = DiagnosticStatus.WARN, "; ".join([f"messages refused: {_causes(refused)}", *findings])
        elif not received:
            level, text = DiagnosticStatus.STALE, "no messages" if counts["messages"] else "never received"
        elif findings:
            level, text = DiagnosticStatus.WARN, "; ".join(findings)
        else:
            level, text = DiagnosticStatus.OK, f"{received / PERIOD:.0f} messages/s"
        one.messages, one.refused, one.silent = counts["messages"], counts["refused"], not received
        one.saturated = saturated
        self._log_refused(one)
        values = {"messages": counts["messages"], "used": counts["used"]}
        values |= {f"refused: {cause}": n for cause, n in counts["refused"].items()}
        values |= {f"saturated: {sensor}": n for sensor, n in saturated.items()}
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
        }
        if hasattr(self._estimator, "calibrate_gyro_bias"):
            values["gyro bias calibrated"] = "no" if flags & Status.UNCALIBRATED else "yes"
        return self._status(f"joint {name}", level, "; ".join(words) or f"+-{deviation:.2f} deg", values)

    def _pairs(self, pairs: list[PairCheck]) -> DiagnosticStatus:
        """Whether the IMUs agree with each other."""
        if self.estimate is None:
            return self._status("IMU pairs", DiagnosticStatus.STALE, _WORDS[Status.STARTING], {})
        text = verdict(pairs)
        if text and not self._pairs_verdict:
            self._node.get_logger().warning(text)
        self._pairs_verdict = text
        values: dict[str, str] = {}
        for pair in pairs:
            name = f"{' + '.join(pair.joints)} ({' to '.join(pair.sensors)})"
            figures = {"residual": pair.residual, "tilt": pair.tilt} | ({"turned": pair.turned} if pair.turned else {})
            values |= {f"{name}: {what} (deg)": f"{math.degrees(value):.2f}" for what, value in figures.items()}
        largest = math.degrees(max(max(abs(pair.residual), abs(pair.tilt)) for pair in pairs))
        level, text = (
            (DiagnosticStatus.WARN, text) if text else (DiagnosticStatus.OK, f"agree within {largest:.1f} deg")
        )
        if self.estimate is self._reported:
            level, text = DiagnosticStatus.STALE, "no new estimate"
        return self._status("IMU pairs", level, text, values)

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

    def _log_findings(self, one: _Input, findings: list[str]) -> None:
        """When it begins."""
        if findings and not one.conspicuous:
            self._node.get_logger().warning(f"{one.name}: {'; '.join(findings)}")
        one.conspicuous = bool(findings)

    def _log_silence(self, before: set[str]) -> None:
        now = {one.name for one in self._inputs.values() if one.silent}
        if now - before:
            self._node.get_logger().warning(f"no messages on {', '.join(sorted(now - before))}")
        if before - now:
            self._node.get_logger().info(f"messages on {', '.join(sorted(before - now))}")


def _causes(refused: Mapping[str, int]) -> str:
    return ", ".join(f"{cause} ({n} in all)" for cause, n in sorted(refused.items()))
