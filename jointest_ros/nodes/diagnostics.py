"""What a node tells of its inputs, its joints and itself: /diagnostics once a second, and the log where that is bad.

Who reads them must be able to tell a bad sensor from a bad filter: an input that is not OK names what is wrong with its
sensor; where all of them are, and the innovations still do not suit the noise model, the estimator says that.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timezone
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from jointest_ros.bags.intake import Intake
from jointest_ros.config import Configuration
from jointest_ros.core.errors import counted
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate
from jointest_ros.core.pcf.pair_checks import PairCheck, verdict
from jointest_ros.nodes.arrival import arrivals
from jointest_ros.nodes.estimate_status import (
    Entry,
    Innovations,
    joint_entry,
    lacking,
    links_at_rest,
    pairs_entry,
    suspicion,
    unsound_readings,
    yes_no,
)
from jointest_ros.nodes.input_status import Input

PERIOD = 1.0  # s
LOOK = 20_000_000  # ns, between frames whose innovations are looked at: enough to judge, at a cost that does not count
_LATENCIES = 20_000  # kept at most between two reports


class Diagnostics:
    """Publishes on /diagnostics by a timer of the node, in real time whatever the node's clock; estimates do without.

    Args:
        intake: whose counters are reported.
        inputs: topic as configured -> what is told of it.
        estimator: that estimates at present: it is replaced when it is tuned.
        configuration: with the calibration file.

    Attributes:
        estimate: the newest one. The node sets it.
        estimates: how many there were. The node counts them.
        latencies: of the estimates since the latest report: from receipt of the newest input to publication, ns. The
            node appends.
        next_look: stamp from which on the node gives the next frame to `look`.
    """

    def __init__(
        self,
        node: Node,
        intake: Intake,
        inputs: Mapping[str, Input],
        estimator: Callable[[], Estimator],
        configuration: Configuration,
    ) -> None:
        self._node, self._intake, self._inputs, self._estimator_of = node, intake, inputs, estimator
        self._configuration = configuration
        self._calibration_written = _written(configuration)
        self.estimate: Estimate | None = None
        self.estimates = 0
        self.latencies: deque[int] = deque(maxlen=_LATENCIES)
        self.next_look = -(1 << 62)
        self._innovations = Innovations()
        self._reported: tuple[Estimate | None, int] = (None, 0)  # the newest and their number, of the latest report
        self._reported_at = time.monotonic()
        self._resets = 0
        self._complaints: dict[str, str] = {}  # what was last in the log about pairs and innovations
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._timer = node.create_timer(PERIOD, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def look(self, stamp: int) -> None:
        """Take the innovations of a frame into account."""
        self.next_look = stamp + LOOK
        self._innovations.add(self._estimator_of())

    def publish(self) -> None:
        """One report."""
        now = time.monotonic()
        elapsed, self._reported_at = max(now - self._reported_at, 1e-3), now
        estimator, estimate = self._estimator_of(), self.estimate
        new = estimate is not self._reported[0]
        silent = {one.name for one in self._inputs.values() if one.silent}
        inputs = {f"input {one.name}": one.entry(elapsed) for one in self._inputs.values()}
        ratios = self._innovations.take()
        quality = self._intake.assembler.quality
        rest, unsound = links_at_rest(estimator, quality.at_rest), unsound_readings(estimator, quality.findings)
        checks: Callable[[], list[PairCheck]] = getattr(estimator, "pair_checks", list)
        pairs = checks()
        entries: dict[str, Entry] = {"estimator": self._estimator(inputs, ratios, pairs, new, elapsed), **inputs}
        for number, name in enumerate(estimator.joints):
            entries[f"joint {name}"] = joint_entry(
                estimator, number, estimate, new, ratios.get(name), rest[number], unsound[number]
            )
        if pairs:
            entries["IMU pairs"] = pairs_entry(pairs, estimate, new)
            self._complain("pairs", verdict(pairs))
        array = DiagnosticArray(status=[self._status(what, *entry) for what, entry in entries.items()])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
        self._reported = estimate, self.estimates
        self._log(silent)
        arrivals.done()

    def _estimator(
        self,
        inputs: Mapping[str, Entry],
        ratios: Mapping[str, float],
        pairs: Sequence[PairCheck],
        new: bool,
        elapsed: float,
    ) -> Entry:
        """The estimator as a whole; OK only when it is ready: calibrated, and all sensors alive and sound."""
        estimator, assembler = self._estimator_of(), self._intake.assembler
        unsound = [what.removeprefix("input ") for what, (level, *_) in inputs.items() if level != DiagnosticStatus.OK]
        missing = [f"look at the inputs {', '.join(unsound)}"] if unsound else []
        missing += lacking(estimator, self.estimate, new)
        doubt = suspicion(estimator, ratios, pairs, inputs_sound=not unsound)
        self._complain("innovations", doubt)
        damage = self._configuration.calibration_damage
        texts = [f"not ready: {'; '.join(missing)}"] if missing else []
        texts += [doubt] if doubt else []
        texts += [f"calibration file ignored: {damage}"] if damage else []
        texts += [estimator.unfit] if estimator.unfit else []
        rate = (self.estimates - self._reported[1]) / elapsed
        squares = [ratio * ratio for ratio in ratios.values()]
        learned = estimator.robot.learned.get(estimator.name)
        values = {
            "ready": yes_no(not missing),
            "rate (Hz)": f"{rate:.1f}",
            "estimates": self.estimates,
            "partial frames": assembler.partial,
            "gaps": assembler.gaps,
            "resets": assembler.resets,
            **self._latency(),
            "innovations / noise model": f"{(sum(squares) / len(squares)) ** 0.5:.2f}" if squares else "",
            "calibration file": self._configuration.calibration_file or "none",
            "calibration written": self._calibration_written,
            "warm start": "no" if learned is None or estimator.unfit else f"from what was saved {learned.saved}",
        }
        level = DiagnosticStatus.WARN if texts else DiagnosticStatus.OK
        return level, "; ".join(texts) or f"ready, {rate:.0f} estimates/s", values

    def _latency(self) -> dict[str, str]:
        """From the receipt of the newest input, that is when the executor hands it over, to the publication."""
        latencies = sorted(self.latencies)
        self.latencies.clear()
        if not latencies:
            return dict.fromkeys(("latency p50 (ms)", "latency p99 (ms)", "latency max (ms)"), "")
        last = len(latencies) - 1
        ranks = {"p50": last // 2, "p99": round(0.99 * last), "max": last}
        return {f"latency {what} (ms)": f"{latencies[rank] * 1e-6:.3f}" for what, rank in ranks.items()}

    def _status(self, what: str, level: bytes, text: str, values: Mapping[str, Any]) -> DiagnosticStatus:
        name = self._node.get_fully_qualified_name().lstrip("/")
        pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        return DiagnosticStatus(level=level, name=f"{name}: {what}", hardware_id=name, message=text, values=pairs)

    # ------------------------------------------------------------- log

    def _complain(self, what: str, text: str) -> None:
        """When it begins."""
        if text and not self._complaints.get(what):
            self._node.get_logger().warning(text)
        self._complaints[what] = text

    def _log(self, silent_before: set[str]) -> None:
        logger = self._node.get_logger()
        for one in self._inputs.values():
            for text in one.log:
                logger.warning(text)
        before, self._resets = self._resets, self._intake.assembler.resets
        if self._resets > before:
            times = counted(self._resets, "time")
            logger.warning(f"the stamps of the inputs jumped ({times} so far): a clock, or a looping bag?")
        now = {one.name for one in self._inputs.values() if one.silent}
        if now - silent_before:
            logger.warning(f"no messages on {', '.join(sorted(now - silent_before))}")
        if silent_before - now:
            logger.info(f"messages on {', '.join(sorted(silent_before - now))}")


def _written(configuration: Configuration) -> str:
    """When the calibration file that is in force was written."""
    file = configuration.calibration_file
    if configuration.calibration_damage:
        return "ignored"
    try:
        seconds = file.stat().st_mtime if file is not None else None
    except OSError:
        seconds = None
    return "never" if seconds is None else f"{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S} UTC"
