"""`jointest bench nodes`: CPU, losses and latency of nodes at work, beside a plain rclpy node that only receives."""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jointest_ros.bags import synthetic
from jointest_ros.bags.ground_truth import TRUTH_JOINTS
from jointest_ros.benchmark.part import Options, PartResult, Report, ResultTable
from jointest_ros.config.text import robot_yaml
from jointest_ros.core.robot import Robot
from jointest_ros.nodes import bench_roles
from jointest_ros.nodes.bench_processes import Process, namespace
from jointest_ros.nodes.bench_roles import Received, Seen, Sent
from jointest_ros.sim.scenarios import SCENARIOS

RATES_HZ = (100.0, 200.0, 500.0, 1000.0)
QUICK_RATES_HZ = (200.0, 1000.0)
SECONDS, QUICK_SECONDS = 5.0, 2.0
BUDGET_SECONDS = 60.0
BUDGET_CPU, BUDGET_P99_MS = 35.0, 3.0
PLAIN = {"plain, events": "events", "plain, single": "single"}  # label: executor
_COLUMNS = (
    "node",
    "imus",
    "hz",
    "s",
    "cpu_percent",
    "cpu_ratio",
    "sent",
    "lost",
    "refused",
    "p50_ms",
    "p99_ms",
    "end_to_end_p50_ms",
    "end_to_end_p99_ms",
)
_HARDWARE_COLUMNS = ("hardware", "imus_sent", "hz", "cpu_percent", "late_p99_ms", "late_most_ms")


@dataclass(frozen=True)
class Case:
    """A node on a simulated rig: on all of its sensors, or on some."""

    estimator: str
    rig: str
    sensors: tuple[str, ...] = ()

    def robot(self) -> Robot:
        """With the links and joints between its sensors."""
        rig = SCENARIOS[self.rig]
        return reduced(next(rig.stretches(rig.options())).robot, self.sensors)


PALM_AND_LINK = Case("pcf", "finger", ("palm", "proximal"))
TWO_FINGERS = Case("pcf", "gripper", ("palm", "left_proximal", "left_middle", "left_distal", "right_proximal"))
EXOSHELL = Case("kckf", "exoshell")
CASES = (PALM_AND_LINK, TWO_FINGERS, EXOSHELL)


def reduced(robot: Robot, names: tuple[str, ...]) -> Robot:
    """The robot of the sensors of these names alone; without names the whole one."""
    if not names:
        return robot
    sensors = tuple(robot.sensor(name) for name in names)
    links = tuple(sensor.link for sensor in sensors)
    joints = tuple(joint for joint in robot.joints if joint.parent in links and joint.child in links)
    return dataclasses.replace(robot, links=links, joints=joints, sensors=sensors, world="")


@dataclass(frozen=True)
class Measured:
    """One run: a node on the stream of one simulation. `seen`: what it published, if it does."""

    label: str
    case: Case
    robot: Robot
    rate_hz: float
    sent: Sent
    received: Received
    seen: Seen | None = None

    @property
    def seconds(self) -> float:
        """Length of the stream."""
        return len(self.sent.stamps) / self.rate_hz

    @property
    def messages(self) -> int:
        """How many the hardware sent on the topics of the node."""
        return len(self.sent.stamps) * len(self.received.messages)

    @property
    def lost(self) -> int:
        """How many of them did not arrive."""
        return self.messages - sum(self.received.messages.values())

    def latency_ms(self, percent: float) -> float | None:
        """Percentile of the time from the receipt of the newest input to the end of the publication."""
        return _percentile(self.received.latencies, percent)

    def end_to_end_ms(self, percent: float) -> float | None:
        """Percentile of the time from the publication of the newest input to the receipt of the joint states."""
        if self.seen is None:
            return None
        _, ours, theirs = np.intersect1d(self.sent.stamps, self.seen.stamps, return_indices=True)
        return _percentile(self.seen.times[theirs] - self.sent.times[ours], percent)

    def late_ms(self) -> Any:
        """By how much each frame went out later than the first one, measured by the stamps."""
        return ((self.sent.times - self.sent.times[0]) - (self.sent.stamps - self.sent.stamps[0])) * 1e-6


def _percentile(nanoseconds: Any, percent: float) -> float | None:
    return float(np.percentile(nanoseconds, percent)) * 1e-6 if nanoseconds is not None and len(nanoseconds) else None


def measure(case: Case, rate_hz: float, seconds: float, executor: str = "") -> Measured:
    """One run of the node of a case, or of a plain receiver of the same topics in an executor.

    Raises:
        BenchError: a process fails.
    """
    robot, space = case.robot(), namespace()
    topics = {topic: kind for topic, kind in synthetic.topics(robot).items() if topic != TRUTH_JOINTS}
    parameters = {
        "source": case.rig,
        "rate_hz": rate_hz,
        "duration_s": seconds,
        "wait_for_subscribers": 1,
    }
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        path = Path(folder, "robot.yaml")
        estimators = SCENARIOS[case.rig].estimators
        path.write_text(robot_yaml(robot, {case.estimator: estimators[case.estimator]}, "bench"), encoding="utf-8")
        subject = (
            Process(bench_roles.receiver, namespace=space, topics=topics, executor=executor)
            if executor
            else Process(bench_roles.estimator, namespace=space, name=case.estimator, config=str(path))
        )
        listeners = [subject] if executor else [subject, Process(bench_roles.observer, namespace=space)]
        hardware = Process(bench_roles.hardware, namespace=space, newest=list(topics)[-1], parameters=parameters)
        for process in (*listeners, hardware):
            stack.enter_context(process)
        for process in listeners:
            process.wait_until_ready()
        hardware.tell()
        hardware.wait_until_ready()
        sent = hardware.result(30.0 + 5.0 * seconds)
        for process in listeners:
            process.tell()
        received, *seen = [process.result() for process in listeners]
    label = next((text for text, name in PLAIN.items() if name == executor), f"{case.estimator}_node")
    return Measured(label, case, robot, rate_hz, sent, received, *seen)


def run(options: Options, report: Report) -> PartResult:
    """The part `nodes`."""
    rates, seconds = (QUICK_RATES_HZ, QUICK_SECONDS) if options.quick else (RATES_HZ, SECONDS)
    longest = 5.0 * seconds if options.quick else BUDGET_SECONDS
    plan = [
        (case, rate, executor, longest if (case, rate, executor) == (EXOSHELL, rates[-1], "") else seconds)
        for case in CASES
        for rate in rates
        for executor in ("", *PLAIN.values())
    ]
    total = sum(length for *_, length in plan)
    runs: list[Measured] = []
    for case, rate, executor, length in plan:
        report(round(sum(one.seconds for one in runs)), round(total))
        runs.append(measure(case, rate, length, executor))
    return PartResult(tuple(_tables(runs)), _conditions(seconds, longest))


def _tables(runs: list[Measured]) -> Iterator[ResultTable]:
    plain = {(one.case, one.rate_hz): one.received.cpu for one in runs if PLAIN.get(one.label) == "events"}
    rows = [_row(one, plain.get((one.case, one.rate_hz), math.nan)) for one in runs]
    yield ResultTable("nodes", _COLUMNS, rows)
    ours = [one for one in runs if one.label not in PLAIN]
    yield ResultTable("simulated hardware, beside the nodes", _HARDWARE_COLUMNS, [_hardware_row(one) for one in ours])
    longest = max(ours, key=lambda one: one.seconds)
    p99 = longest.latency_ms(99.0)
    yield ResultTable(
        f"budget: {longest.label}, {len(longest.robot.sensors)} IMUs and Hall at {longest.rate_hz:g} Hz, "
        f"{longest.seconds:g} s",
        ("item", "budget", "measured"),
        [
            ("messages lost", 0, longest.lost),
            ("cpu_percent", BUDGET_CPU, longest.received.cpu),
            ("p99_ms", BUDGET_P99_MS, p99),
        ],
    )


def _row(one: Measured, plain: float) -> tuple[Any, ...]:
    return (
        one.label,
        len(one.robot.sensors),
        round(one.rate_hz),
        one.seconds,
        one.received.cpu,
        one.received.cpu / plain,
        one.messages,
        one.lost,
        one.received.refused,
        *(one.latency_ms(percent) for percent in (50.0, 99.0)),
        *(one.end_to_end_ms(percent) for percent in (50.0, 99.0)),
    )


def _hardware_row(one: Measured) -> tuple[Any, ...]:
    rig = SCENARIOS[one.case.rig]
    late = one.late_ms()
    imus = len(next(rig.stretches(rig.options())).robot.sensors)
    return (one.case.rig, imus, round(one.rate_hz), one.sent.cpu, float(np.percentile(late, 99.0)), float(late.max()))


def _conditions(seconds: float, longest: float) -> tuple[str, ...]:
    return (
        f"a process each: sim_hardware_node, the node, an observer; {seconds:g} s a run, {longest:g} s for the budget",
        "kckf_node: exoshell, 5 IMUs and hall_voltages; pcf_node: palm and one link of the finger, or palm and four "
        "links of the gripper",
        "plain: an rclpy node in place of ours that subscribes to the same topics (deserialised messages, queues of "
        "10) and counts, in an EventsExecutor or a SingleThreadedExecutor",
        "cpu_percent: of a core, all threads of the process; cpu_ratio: to the plain node in an EventsExecutor",
        "p50, p99: from the receipt of the newest input to the end of the publication; end_to_end: from the "
        "publication of the newest input to the receipt of joint_states by the observer",
        "late: how much later than due a frame leaves the hardware, relative to the first one",
    )
