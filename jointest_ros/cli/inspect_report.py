"""An inspection for the eyes: what the recording holds as tables, then the findings, the worst first."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from rich.table import Table
from rich.text import Text

from jointest_ros.bags.cdr import IMU, MAGNETIC_FIELD
from jointest_ros.bags.survey import Survey
from jointest_ros.cli.common import out
from jointest_ros.cli.tables import columns
from jointest_ros.core.robot import STANDARD_GRAVITY
from jointest_ros.evaluation.inspection.findings import LEVELS, LOOK, OK, WRONG, Advice, Finding
from jointest_ros.evaluation.inspection.recording import Inspection
from jointest_ros.evaluation.inspection.stream import Stream, lags
from jointest_ros.evaluation.measures import rms_length

_STYLES = {OK: "green", LOOK: "yellow", WRONG: "red"}


def topic_table(title: str, seen: Survey) -> Table:
    """Every topic; a row for each frame id on those of sensors."""
    table = Table(title=title, title_justify="left")
    for heading in ("topic", "type", "frame_id"):
        table.add_column(heading, overflow="fold")  # a name is shown whole
    for heading in ("messages", "Hz", "jitter\nms", "longest\ngap, s", "recorded\nlater, ms"):
        table.add_column(heading, justify="right", no_wrap=True)
    for topic, (kind, number) in seen.topics.items():
        short = kind.replace("/msg/", "/")
        own = [s for s in (*seen.streams, *seen.fields) if s.topic == topic] if kind in (IMU, MAGNETIC_FIELD) else []
        if not own:
            rate = f"{number / seen.duration:.4g}" if seen.duration else "-"
            table.add_row(topic, short, "", str(number), rate)
        for stream in own:
            table.add_row(topic, short, stream.frame_id, str(len(stream)), *_timing(stream))
    return table


def _timing(stream: Stream) -> list[str]:
    if math.isnan(stream.period):
        return ["-"] * 4
    lag = lags(stream)
    late = f"{lag * 1e3:.1f}" if abs(lag) < 10.0 else f"{lag:.0f} s"
    return [f"{1.0 / stream.period:.4g}", f"{stream.jitter * 1e3:.2f}", f"{stream.intervals.max():.3g}", late]


def sensor_table(inspection: Inspection) -> Table:
    """What each sensor reads."""
    heads = ["gravity\n", "still\ns", "gyro bias\ndeg/s", "gyro noise\ndeg/s/√Hz", "accel noise\nug/√Hz"]
    table = columns("sensors", ["sensor"], [*heads, "gyro and\naccel agree", "moves\ndeg/s rms"])
    for report in inspection.sensors:
        rest = report.rest
        at_rest = ["-"] * 4
        if rest is not None:
            bias = math.degrees(float(np.linalg.norm(rest.gyro_bias)))
            noise = f"{rest.accel_noise / STANDARD_GRAVITY * 1e6:.0f}" if report.accel else "-"
            at_rest = [f"{rest.duration:.1f}", f"{bias:.2f}", f"{math.degrees(rest.gyro_noise):.4f}", noise]
        both = report.agreement
        agree = f"{both.explained:.0%}" if both is not None and both.judged else "-"
        gravity = "-" if math.isnan(report.norm) else f"{report.norm:.4g}"
        rate = math.degrees(rms_length(report.si.gyro)) if report.gyro else math.nan
        table.add_row(report.name, gravity, *at_rest, agree, "-" if math.isnan(rate) else f"{rate:.1f}")
    table.caption = "-: it cannot be told (never still, not moved, shaken, or no such chip)"
    table.caption_justify = "left"
    return table


def joint_table(inspection: Inspection) -> Table:
    """What each hinge does."""
    heads = ["moves\ndeg/s rms", "from\ndeg", "to\ndeg", "axis off, deg\nparent", "\nchild", "at the start\nreads, deg"]
    table = columns("joints", ["joint"], [*heads, "axis from\nvertical, deg"])
    for joint in inspection.joints:
        low, high = np.degrees(np.quantile(joint.motion.angle, [0.01, 0.99])).tolist()
        table.add_row(
            joint.name,
            f"{math.degrees(joint.motion.joint_rate):.1f}",
            f"{low:.0f}",
            f"{high:.0f}",
            *(_or_dash(off) for off in (*joint.off_deg, joint.zero_deg)),
            f"{math.degrees(float(np.median(joint.motion.gravity))):.0f}",
        )
    return table


def _or_dash(value: float) -> str:
    return "-" if math.isnan(value) else f"{round(value, 1) + 0.0:.1f}"


def show_findings(findings: Sequence[Finding]) -> None:
    """The findings, the worst first; the same one of several subjects once."""
    subjects: dict[tuple[str, str, str], list[str]] = {}
    for finding in findings:
        subjects.setdefault((finding.level, finding.text, finding.action), []).append(finding.subject)
    for level in LEVELS:
        for (own, text, action), names in subjects.items():
            if own == level:
                out.print(Text.assemble((f"{level:5}  ", _STYLES[level]), f"{', '.join(names)}: {text}"))
                if action:
                    out.print(f"         -> {action}")


def advice_lines(advice: Sequence[Advice]) -> Iterator[str]:
    """The advice, a line each."""
    for one in advice:
        yield f"advice  {one.key}: {one.value}  ({one.reason})"


def verdict(findings: Sequence[Finding]) -> str:
    """The last line."""
    counts = {level: sum(finding.level == level for finding in findings) for level in LEVELS}
    if not counts[WRONG]:
        return f"nothing wrong found, {counts[LOOK]} to look at"
    return f"not sound: {counts[WRONG]} wrong, {counts[LOOK]} to look at"
