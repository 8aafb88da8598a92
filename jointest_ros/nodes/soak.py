"""`jointest bench soak`: simulated hours through the nodes, as fast as they take it: memory, drift, counters."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jointest_ros.bags import synthetic
from jointest_ros.bags.ground_truth import TRUTH_JOINTS
from jointest_ros.benchmark.part import Options, PartResult, Report, ResultTable
from jointest_ros.config.text import robot_yaml
from jointest_ros.evaluation.measures import rms
from jointest_ros.nodes import soak_roles
from jointest_ros.nodes.bench_processes import Process, namespace, spawn
from jointest_ros.nodes.soak_roles import FAULT_EVERY, Sent, Taken
from jointest_ros.sim.scenarios import SCENARIOS

RATE_HZ = 100.0
GROWTH_PERCENT = 5.0  # of memory after the first minute
SLOPE_DEG_H = 0.15  # of the mean error
SETTLED = 1  # minutes at the start that do not count
_LOOK = 0.2  # s
_STALLED = 60.0  # s without a message
_MEMORY = ("process", "first_MB", "last_MB", "most_MB", "growth_percent", "limit_percent")
_ERRORS = (
    "node",
    "of",
    "first_tenth_deg",
    "last_tenth_deg",
    "largest_deg",
    "slope_deg_per_h",
    "rms_limit_deg",
    "largest_limit_deg",
)
_COUNTS = ("node", "topic", "sent", "received", "used", "refused", "estimates", "joint_states")


@dataclass(frozen=True)
class Case:
    """A node on a simulated rig.

    Attributes:
        scenario: of the rig.
        settings: of the estimator.
        rms_deg: limit of the rms error of each joint in the last tenth.
        torso_deg: limit of the sum of all joint errors at any time; None: it has no meaning.
    """

    estimator: str
    rig: str
    scenario: str
    settings: Mapping[str, Any]
    rms_deg: float
    torso_deg: float | None = None

    @property
    def label(self) -> str:
        """For tables."""
        return f"{self.estimator}_node"


# limits: spec of the filters, kckf 5.8 (an hour at 100 Hz) and pcf 4 (hinge, PA)
CASES = (
    Case("kckf", "exoshell", "drift", {"kinematics": "additive"}, math.inf, 1.3),
    Case("pcf", "finger", "PC", {"zero_at_start": True, "lever_arms": True}, 0.10),
)


@dataclass
class Outcome:
    """What one case gave."""

    case: Case
    sent: Sent
    taken: Taken
    failures: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.failures += [f"{self.case.label}: {text}" for text in (*self._losses(), *self._drift(), *self._growth())]

    def _losses(self) -> Iterator[str]:
        refused: dict[str, int] = {}
        for topic, counts in self.taken.counts.items():
            sent, received = self.sent.messages[topic], counts["messages"]
            if received != sent:
                yield f"{topic}: {sent} messages sent, {received} received"
            known = counts["used"] + sum(counts["refused"].values())
            if known != received:
                yield f"{topic}: {received} messages received, {known} used or refused"
            for cause, number in counts["refused"].items():
                refused[cause] = refused.get(cause, 0) + number
        if refused != self.sent.faults:
            yield f"messages refused: {refused}, to be refused: {self.sent.faults}"
        if self.sent.states > self.taken.estimates:
            yield f"{self.taken.estimates} estimates, {self.sent.states} joint states"

    def _drift(self) -> Iterator[str]:
        for name, _, last, largest, slope, rms_limit, largest_limit in self.errors():
            if rms_limit is not None and not last <= rms_limit:
                yield f"{name}: rms error in the last tenth {last:.3f} deg, at most {rms_limit:g} is allowed"
            if largest_limit is not None and not largest <= largest_limit:
                yield f"{name}: error of {largest:.2f} deg, at most {largest_limit:g} is allowed"
            if slope is not None and not abs(slope) < SLOPE_DEG_H:
                yield f"{name}: drifts by {slope:.3f} deg/h, less than {SLOPE_DEG_H:g} is allowed"

    def _growth(self) -> Iterator[str]:
        for process, _, _, _, growth, limit in self.memory():
            if not growth < limit:
                yield f"memory of {process}: grew by {growth:.1f} %, less than {limit:g} % is allowed"

    def errors(self) -> Iterator[tuple[Any, ...]]:
        """Name, rms in the first and the last tenth, largest error (deg), slope (deg/h), limits (deg) or None."""
        sent = self.sent
        mean, each, largest = (np.degrees(rows[SETTLED:]) for rows in (sent.mean, sent.rms, sent.largest))
        length = len(mean)
        tenth = max(1, length // 10)
        for column, name in enumerate(sent.names):
            torso = name == sent.names[-1]
            if not length or (torso and self.case.torso_deg is None):
                continue
            yield (
                name,
                rms(each[:tenth, column]),
                rms(each[-tenth:, column]),
                float(largest[:, column].max()),
                60.0 * float(np.polyfit(np.arange(length), mean[:, column], 1)[0]) if length >= 59 else None,
                None if torso or math.isinf(self.case.rms_deg) else self.case.rms_deg,
                self.case.torso_deg if torso else None,
            )

    def memory(self) -> Iterator[tuple[Any, ...]]:
        """Process, memory after the first minute, at the end and most (MB), growth and limit (%)."""
        for process, used in ((self.case.label, self.taken.memory), ("sim_hardware_node", self.sent.memory)):
            if len(used):
                growth = 100.0 * (float(used.max()) / float(used[0]) - 1.0)
                yield process, float(used[0]), float(used[-1]), float(used.max()), growth, GROWTH_PERCENT

    def counts(self) -> Iterator[tuple[Any, ...]]:
        """Topic, messages sent, received, used, refused by cause, estimates and joint states."""
        for topic, one in self.taken.counts.items():
            refused = ", ".join(f"{n} {cause}" for cause, n in sorted(one["refused"].items())) or "none"
            sent = self.sent.messages[topic]
            yield topic, sent, one["messages"], one["used"], refused, self.taken.estimates, self.sent.states


class _Soak:
    """Context manager around the processes of one case."""

    def __init__(self, case: Case, duration_s: float) -> None:
        rig = SCENARIOS[case.rig]
        chosen: dict[str, Any] = {"rate_hz": RATE_HZ, "duration_s": duration_s, "scenario": case.scenario}
        robot = next(rig.stretches(rig.options(**chosen))).robot
        topics = [topic for topic in synthetic.topics(robot) if topic != TRUTH_JOINTS]
        self.case = case
        self.total = round(RATE_HZ * duration_s) * len(topics)
        self.taken = spawn.Value("q", 0, lock=False)
        self._text = robot_yaml(robot, {case.estimator: case.settings}, "soak")
        self._per_minute = round(60.0 * RATE_HZ) * len(topics)
        parameters = {"source": case.rig, "speed": 1000.0, **chosen}
        self._space = namespace()
        self.hardware = Process(soak_roles.hardware, namespace=self._space, taken=self.taken, parameters=parameters)

    def __enter__(self) -> _Soak:
        with ExitStack() as stack:
            path = Path(stack.enter_context(tempfile.TemporaryDirectory()), "robot.yaml")
            path.write_text(self._text, encoding="utf-8")
            self.node = Process(
                soak_roles.estimator,
                namespace=self._space,
                name=self.case.estimator,
                config=str(path),
                taken=self.taken,
                per_minute=self._per_minute,
            )
            stack.enter_context(self.node)
            stack.enter_context(self.hardware)
            self.node.wait_until_ready()
            self.hardware.wait_until_ready()
            self._stack = stack.pop_all()
        return self

    def outcome(self) -> Outcome:
        """At the end."""
        sent = self.hardware.result()
        self.node.tell()
        return Outcome(self.case, sent, self.node.result())

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def soak(cases: tuple[Case, ...], duration_s: float, report: Report) -> list[Outcome]:
    """All cases at the same time, `duration_s` of simulated time each.

    Raises:
        BenchError: a process fails.
    """
    with ExitStack() as stack:
        running = [stack.enter_context(_Soak(case, duration_s)) for case in cases]
        total = sum(one.total for one in running)
        newest, since = -1, time.monotonic()
        while not all(one.hardware.done() for one in running):
            done = sum(int(one.taken.value) for one in running)
            report(done, total)
            if done != newest:
                newest, since = done, time.monotonic()
            elif time.monotonic() - since > _STALLED:
                break  # who has no result is then told of
            time.sleep(_LOOK)
        return [one.outcome() for one in running]


def run(options: Options, report: Report) -> PartResult:
    """The part `soak`."""
    start = time.monotonic()
    outcomes = soak(CASES, 3600.0 * options.hours, report)
    took = time.monotonic() - start
    tables = (
        ResultTable("memory", ("node", *_MEMORY), [(o.case.label, *row) for o in outcomes for row in o.memory()]),
        ResultTable("errors", _ERRORS, [(o.case.label, *row) for o in outcomes for row in o.errors()], ".3f"),
        ResultTable("messages", _COUNTS, [(o.case.label, *row) for o in outcomes for row in o.counts()]),
    )
    conditions = (
        f"{options.hours:g} simulated hours at {RATE_HZ:g} Hz in {took / 60.0:.1f} min; for each node a process of its "
        "own and one for the simulated hardware, all at the same time",
        "the hardware sends as fast as the node takes: what is lost is not for want of a queue",
        f"after every {FAULT_EVERY} messages of an IMU one is sent twice, and one that cannot be decoded: both must be "
        "refused and counted",
        "kckf_node: scenario drift of the exoshell, joints held, their sum is the torso; pcf_node: PC of the finger",
        "errors: of joint_states, after the first minute; memory: resident, from the end of the first minute on",
    )
    return PartResult(tables, conditions, tuple(text for one in outcomes for text in one.failures))
