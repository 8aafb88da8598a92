"""`jointest inspect`: what a recording holds, whether a configuration is sound, and whether the two fit."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jointest_ros import config
from jointest_ros.bags.matching import match, match_fields
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.survey import Survey, survey
from jointest_ros.cli.common import Parsers, complain, out, progress, write_json
from jointest_ros.cli.inspect_report import advice_lines, joint_table, sensor_table, show_findings, topic_table, verdict
from jointest_ros.config import Configuration
from jointest_ros.config.soundness import soundness
from jointest_ros.core.errors import ConfigurationError, counted
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.evaluation.inspection.findings import WRONG, Finding, worst
from jointest_ros.evaluation.inspection.recording import Inspection, Setup, inspect
from jointest_ros.evaluation.inspection.stream import Stream

SCHEMA = 1
UNSOUND = 1


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "inspect",
        description="Look at a recording, a configuration, or both, before anything runs: topics, rates, gaps, units, "
        "polarity and mounting of each sensor, axes, stillness, which joints the recording shows, and what to do.",
        epilog="levels: wrong: estimates would be wrong; look: may be as it should be; ok. Exit code 0: nothing is "
        "wrong, 1: something is, 2: bad input. advice: settings that suit the recording better.",
    )
    parser.add_argument("bag", nargs="?", type=Path, metavar="BAG", help="rosbag2 directory, or a .mcap or .db3 file")
    parser.add_argument("--config", "-c", type=Path, metavar="YAML", help="the robot's configuration")
    parser.add_argument("--namespace", default="", metavar="NS", help="namespace of the topics in the recording")
    parser.add_argument("--json", metavar="FILE", help="findings and figures; '-' for standard output")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of the command."""
    if arguments.bag is None and arguments.config is None:
        raise ConfigurationError("give a recording, --config YAML, or both")
    configuration = None if arguments.config is None else config.load(arguments.config)
    findings = [] if configuration is None else list(soundness(configuration))
    seen: Survey | None = None
    inspection = Inspection()
    if arguments.bag is not None:
        with BagReader(arguments.bag) as reader, progress(f"inspect {arguments.bag}") as report:
            seen = survey(reader, arguments.namespace, report)
        inspection = _inspect(seen, configuration, arguments.namespace)
    findings += inspection.findings
    if arguments.json != "-":
        _show(arguments.bag, seen, inspection, findings)
    if arguments.json:
        write_json(arguments.json, _document(arguments, seen, inspection, findings))
    if seen is not None and seen.damage:
        complain("inspect", f"{seen.damage}; the findings rest on what came before")
        return 2
    return UNSOUND if worst(findings) == WRONG else 0


def _inspect(seen: Survey, configuration: Configuration | None, namespace: str) -> Inspection:
    findings = [
        Finding(WRONG, topic, "undecodable", f"{messages} cannot be decoded", "is the publisher of that type?")
        for topic, messages in ((topic, counted(number, "message")) for topic, number in seen.undecodable.items())
    ]
    if configuration is None:
        streams, fields = _by_topic(seen.streams), _by_topic(seen.fields)
        setup = Setup()
        if not streams:
            text = "no sensor_msgs/Imu in the recording"
            findings.append(Finding(WRONG, "topics", "topic", text, "record the topics of your IMUs"))
    else:
        streams, unfit = match(seen, configuration.robot, namespace)
        findings += unfit
        fields = match_fields(seen, configuration.robot, namespace)
        pcf = configuration.estimators.get("pcf")
        setup = Setup(
            configuration.robot,
            configuration.timing,
            pcf if isinstance(pcf, PcfParams) else None,
            any(any(sensor.position) for sensor in configuration.robot.sensors)
            and any(any(joint.origin) for joint in configuration.robot.joints),
        )
    with progress("sensors") as report:
        inspection = inspect(streams, setup, seen.span, seen.truth, seen.hall, fields, report)
    inspection.findings = findings + inspection.findings
    return inspection


def _by_topic(found: Sequence[Stream]) -> dict[str, Stream]:
    """The streams by topic, and frame id where a topic has several."""
    topics = [stream.topic for stream in found]
    return {
        stream.topic if topics.count(stream.topic) == 1 else f"{stream.topic} [{stream.frame_id}]": stream
        for stream in found
    }


def _show(bag: Path | None, seen: Survey | None, inspection: Inspection, findings: list[Finding]) -> None:
    if seen is not None:
        out.print(topic_table(f"{bag}: {seen.duration:.1f} s", seen))
        if inspection.sensors:
            out.print(sensor_table(inspection))
        if inspection.joints:
            out.print(joint_table(inspection))
    show_findings(findings)
    for line in advice_lines(inspection.advice):
        out.print(line)
    out.print(verdict(findings), style="bold")


def _document(
    arguments: argparse.Namespace, seen: Survey | None, inspection: Inspection, findings: list[Finding]
) -> dict[str, Any]:
    """The stable form: {"schema", "bag", "config", "level", "findings", "advice", "topics", "sensors", "joints"}."""
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "bag": None if arguments.bag is None else str(arguments.bag),
        "config": None if arguments.config is None else str(arguments.config),
        "level": worst(findings),
        "findings": [vars(finding) for finding in findings],
        "advice": [vars(one) for one in inspection.advice],
    }
    if seen is not None:
        document["duration_s"] = seen.duration
        document["still_start_s"] = inspection.still_start
        document["topics"] = {topic: {"type": kind, "messages": n} for topic, (kind, n) in seen.topics.items()}
        document["sensors"] = {report.name: _figures(report) for report in inspection.sensors}
        document["joints"] = {
            joint.name: {
                "rate_dps": math.degrees(joint.motion.joint_rate),
                "off_deg": [_number(off) for off in joint.off_deg],
                "zero_deg": _number(joint.zero_deg),
            }
            for joint in inspection.joints
        }
    return document


def _figures(report: Any) -> dict[str, Any]:
    stream, rest, both = report.stream, report.rest, report.agreement
    figures = {
        "topic": stream.topic,
        "frame_id": stream.frame_id,
        "rate_hz": _number(1.0 / stream.period),
        "jitter_s": _number(stream.jitter),
        "longest_interval_s": _number(float(stream.intervals.max())),
        "gravity": _number(report.norm),
        "agreement": None if both is None or not both.judged else _number(both.explained),
    }
    if rest is not None:
        figures["rest"] = {
            "duration_s": rest.duration,
            "gyro_bias_dps": [math.degrees(float(b)) for b in rest.gyro_bias],
            "gyro_noise_dps": _number(math.degrees(rest.gyro_noise)),
            "accel_noise": _number(rest.accel_noise),
        }
    return figures


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
