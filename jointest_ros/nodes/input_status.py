"""What /diagnostics say of one input topic: its sensors, its publishers, and what is wrong with either."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from jointest_ros.bags.intake import Intake
from jointest_ros.core.assembler_inputs import NEVER
from jointest_ros.nodes.estimate_status import Entry, yes_no
from jointest_ros.nodes.publishers import InputTopic

_MISSING = 0.2  # share of the samples: estimates suffer
_FEWEST = 10  # samples that a share is told of
_WARN_AGAIN = 5.0  # s between warnings about refused messages of the same topic


class Input:
    """One topic: what was known of it at the latest report.

    Attributes:
        name: in ROS.
        arrived: when its newest message was received, monotonic ns; 0: never. The node sets it.
        silent: nothing came since the report before.
        log: what a report found that should be in the log, a line each.
    """

    def __init__(self, intake: Intake, topic: str, graph: InputTopic) -> None:
        self.name = graph.name
        self.arrived = 0
        self.silent = False
        self.log: list[str] = []
        self._intake, self._topic, self._graph = intake, topic, graph
        self._received = 0
        self._refused: dict[str, int] = {}
        self._used = dict.fromkeys(intake.sources(topic), 0)
        self._stamps = {sensor: (source.last, source.received) for sensor, source in intake.sources(topic).items()}
        self._resets = 0
        self._saturated: dict[str, int] = {}
        self._conspicuous = False
        self._told: set[str] = set()  # of the publishers
        self._warned = (-math.inf, 0)  # when (monotonic s), and of how many refused messages

    def entry(self, elapsed: float) -> Entry:
        """The report, `elapsed` s after the one before."""
        self.log = []
        counts = self._intake.counts(self._topic)
        received, self._received = counts["messages"] - self._received, counts["messages"]
        refused = {cause: n for cause, n in counts["refused"].items() if n > self._refused.get(cause, 0)}
        self._refused = counts["refused"]
        self.silent = not received
        saturated = self._intake.saturated(self._topic)
        findings = [*self._intake.findings(self._topic), *self._missing()]
        self._log_findings(findings)
        for what, n in saturated.items():
            if new := n - self._saturated.get(what, 0):
                findings.append(self._intake.assembler.quality.saturation_text(what, new))
        self._saturated = saturated
        self._log_refused()
        values = {"messages": counts["messages"], "used": counts["used"]}
        values |= {f"refused: {cause}": n for cause, n in counts["refused"].items()}
        values |= {f"saturated: {what}": n for what, n in saturated.items()}
        values |= self._by_sensor(elapsed)
        values["age of the last message (s)"] = self._age()
        self._graph.look()
        publishers, unheard, surplus = self._graph.publishers, self._graph.unheard, self._graph.surplus
        values["publishers"] = ", ".join(publishers) or "none"
        odd = [text for text in (unheard, surplus) if text]
        self._log_publishers(odd)
        findings += odd
        if refused:
            text = "; ".join([f"messages refused: {_causes(refused)}", *findings])
            return DiagnosticStatus.WARN, text, values
        if not received:
            text = "no messages" if counts["messages"] else "never received"
            if unheard:
                return DiagnosticStatus.ERROR, f"{text}: {unheard}", values
            heard = f"{', '.join(publishers)} sends nothing" if publishers else f"no publisher{self._graph.elsewhere}"
            return DiagnosticStatus.STALE, f"{text}: {heard}", values
        if findings:
            return DiagnosticStatus.WARN, "; ".join(findings), values
        return DiagnosticStatus.OK, f"{received / elapsed:.0f} messages/s", values

    def _by_sensor(self, elapsed: float) -> dict[str, Any]:
        """Figures of each sensor; without its name where the topic has but one."""
        sources, frozen = self._intake.sources(self._topic), self._intake.assembler.quality.frozen
        values: dict[str, Any] = {}
        for sensor, source in sources.items():
            ending = f": {sensor}" if len(sources) > 1 else ""
            rate = (source.used - self._used[sensor]) / elapsed
            self._used[sensor] = source.used
            values[f"rate (Hz){ending}"] = f"{rate:.1f}"
            values[f"gaps{ending}"] = source.gaps
            values[f"out of order{ending}"] = source.refused["older stamp"] + source.refused["late"]
            values[f"not finite{ending}"] = source.refused["not finite"]
            values[f"frozen{ending}"] = yes_no(sensor in frozen)
        return values

    def _missing(self) -> Iterator[str]:
        """Which sensors have lost many of their samples since the report before, by the stamps of those that came."""
        before, self._resets = self._resets, self._intake.assembler.resets
        for sensor, source in self._intake.sources(self._topic).items():
            (last, received), self._stamps[sensor] = self._stamps[sensor], (source.last, source.received)
            if not source.period or last == NEVER or before != self._resets:
                continue
            due = (source.last - last) / source.period
            share = 1.0 - (source.received - received) / due if due >= _FEWEST else 0.0
            if share > _MISSING:
                yield f"{share:.0%} of the samples of {sensor} are missing"

    def _age(self) -> str:
        return f"{(time.monotonic_ns() - self.arrived) * 1e-9:.2f}" if self.arrived else "never received"

    # ------------------------------------------------------------- log

    def _log_refused(self) -> None:
        """Sooner or later every refused message is told of."""
        refused, now = sum(self._refused.values()), time.monotonic()
        when, told = self._warned
        if refused > told and now - when >= _WARN_AGAIN:
            self._warned = now, refused
            self.log.append(f"{self.name}: messages refused: {_causes(self._refused)}")

    def _log_findings(self, findings: list[str]) -> None:
        """When it begins."""
        if findings and not self._conspicuous:
            self.log.append(f"{self.name}: {'; '.join(findings)}")
        self._conspicuous = bool(findings)

    def _log_publishers(self, findings: list[str]) -> None:
        """When each begins."""
        self.log += [f"{self.name}: {text}" for text in findings if text not in self._told]
        self._told = set(findings)


def _causes(refused: Mapping[str, int]) -> str:
    return ", ".join(f"{cause} ({n} in all)" for cause, n in sorted(refused.items()))
