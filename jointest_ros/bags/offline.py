"""Runs estimators over a recording, with the decoder, assembler and estimator objects that the nodes use."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from time import perf_counter_ns
from typing import Any

import numpy as np

from jointest_ros.bags.cdr import (
    BOOL,
    JOINT_STATE,
    QUATERNION_STAMPED,
    decode_bool,
    decode_joint_state,
    decode_quaternion_stamped,
)
from jointest_ros.bags.errors import BagError, CdrError
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, Frame, Recording, Series
from jointest_ros.evaluation.truth import Truth

TRUTH_JOINTS = "ground_truth/joint_states"
TRUTH_ORIENTATION = "ground_truth/imu_orientation"
TRUTH_MOVEMENT = "ground_truth/movement"
_CHUNK = 2048  # frames between progress reports

Progress = Callable[[int, int], None]  # messages done, messages in all
Sink = Callable[[str, list[Estimate]], None]  # estimator name, consecutive estimates
FrameSink = Callable[[list[Frame]], None]  # consecutive frames


@dataclass
class Outcome:
    """What a run over a recording gave.

    Attributes:
        inputs: topic -> messages, used, refused by cause.
        frames: number of frames.
        truth: ground truth of the recording, empty where it has none.
        nis: estimator -> mean square of the normalised innovations (1 where the filter's noise is right), if asked for.
        ns_per_frame: estimator -> cost of one update, ns; None where there was no frame.
        warnings: what a user should know, one line each.
        damage: why the recording could not be read to its end; empty when it could.
    """

    inputs: dict[str, dict[str, Any]] = field(default_factory=dict)
    frames: int = 0
    truth: Truth = field(default_factory=Truth)
    nis: dict[str, float | None] = field(default_factory=dict)
    ns_per_frame: dict[str, float | None] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    damage: str = ""


class SeriesSink:
    """Collects estimates as arrays: 8 bytes a number, not an object an estimate."""

    def __init__(self, estimators: dict[str, Estimator]) -> None:
        self._joints = {name: len(estimator.joints) for name, estimator in estimators.items()}
        self._parts: dict[str, list[Series]] = {name: [] for name in estimators}

    def __call__(self, name: str, estimates: list[Estimate]) -> None:
        self._parts[name].append(Series.from_estimates(estimates, self._joints[name]))

    def series(self, name: str) -> Series:
        """All estimates of one estimator."""
        return Series.concatenate(self._parts[name] or [Series.from_estimates([], self._joints[name])])


class RecordingSink:
    """Collects frames as arrays."""

    def __init__(self) -> None:
        self._parts: list[Recording] = []

    def __call__(self, frames: list[Frame]) -> None:
        self._parts.append(Recording.from_frames(frames))

    def recording(self) -> Recording:
        """All frames."""
        return Recording.concatenate(self._parts or [Recording.from_frames([])])


def has_truth(reader: BagReader, namespace: str = "") -> bool:
    """Whether a recording has a topic of ground truth."""
    return any(reader.resolve(topic, namespace) for topic in (TRUTH_JOINTS, TRUTH_ORIENTATION))


def check_topics(reader: BagReader, intake: Intake, namespace: str = "") -> tuple[dict[str, str], list[str]]:
    """(absolute topic -> configured topic, warnings about absent topics).

    Raises:
        BagError: a topic has another type than the configuration needs, or none of them is in the bag.
    """
    found: dict[str, str] = {}
    warnings: list[str] = []
    for name, msgtype in intake.topics.items():
        if reader.resolve(name, namespace) is None:
            warnings.append(
                f"{reader.path}: topic '{name}' of the configuration is not in the bag; its joints go without"
            )
        else:
            found[reader.require(name, msgtype, namespace)] = name
    if not found:
        wanted = ", ".join(intake.topics)
        raise BagError(
            f"{reader.path}: no matching topic; the configuration wants {wanted}; it has: {', '.join(reader.topics)}"
        )
    return found, warnings


def read_frames(
    reader: BagReader,
    intake: Intake,
    frame_sink: FrameSink,
    namespace: str = "",
    progress: Progress = lambda done, total: None,
) -> Outcome:
    """The frames of a whole recording without estimates, as `run` reads them."""
    return run(
        reader, intake, {}, lambda name, estimates: None, namespace=namespace, progress=progress, frame_sink=frame_sink
    )


def run(
    reader: BagReader,
    intake: Intake,
    estimators: dict[str, Estimator],
    sink: Sink,
    *,
    namespace: str = "",
    progress: Progress = lambda done, total: None,
    frame_sink: FrameSink = lambda frames: None,
    consistency: bool = False,
) -> Outcome:
    """Estimate a whole recording frame by frame, in the memory of one chunk.

    Args:
        reader: open.
        sink: takes the estimates of each estimator, chunk after chunk.
        frame_sink: takes the frames themselves.
        namespace: put before the relative topic names.
        consistency: fill `nis`, which costs a microsecond a frame.

    Raises:
        BagError: see `check_topics`. A recording that is damaged further on gives what it can and says so in `damage`.
    """
    found, warnings = check_topics(reader, intake, namespace)
    outcome = Outcome(warnings=warnings)
    truth = _TruthReader(reader, namespace)
    spent = dict.fromkeys(estimators, 0)
    innovations = {name: [0.0, 0] for name in estimators}  # sum of squares, number
    total = sum(reader.counts[topic] for topic in (*found, *truth.handlers))
    handlers = {topic: intake.handlers[name] for topic, name in found.items()}

    def estimate(frames: list[Frame]) -> None:
        outcome.frames += len(frames)
        frame_sink(frames)
        for name, estimator in estimators.items():
            estimates = []
            for frame in frames:
                start = perf_counter_ns()
                estimates.append(estimator.update(frame))
                spent[name] += perf_counter_ns() - start
                if consistency:
                    used = [v * v for v in estimator.innovations() if v == v]
                    innovations[name][0] += sum(used)
                    innovations[name][1] += len(used)
            sink(name, estimates)

    def readable() -> Iterator[tuple[str, int, bytes]]:
        """The messages up to a damage. What the sink raises is no damage, and does not end here."""
        try:
            yield from reader.messages((*handlers, *truth.handlers))
        except BagError as error:
            outcome.damage = str(error)

    frames: list[Frame] = []
    done = 0
    for topic, time, data in readable():
        done += 1
        if topic in handlers:
            frames += handlers[topic](data, time)
            if len(frames) >= _CHUNK:
                estimate(frames)
                frames = []
                progress(done, total)
        else:
            truth.handlers[topic](data, time)
    frames += intake.flush()
    if frames:
        estimate(frames)
    progress(done, total)
    outcome.inputs = {topic: intake.counts(name) for topic, name in found.items()}
    if estimators:
        outcome.warnings += [f"{reader.path}: {text}" for text in intake.warnings()]
    outcome.warnings += [
        f"{reader.path}: {name}: {text}" for name, estimator in estimators.items() for text in estimator.warnings()
    ]
    outcome.truth = truth.truth()
    outcome.nis = {name: squares / number if number else None for name, (squares, number) in innovations.items()}
    outcome.ns_per_frame = {name: ns / outcome.frames if outcome.frames else None for name, ns in spent.items()}
    if truth.refused:
        outcome.warnings.append(
            f"{reader.path}: {truth.refused} ground truth messages refused "
            "(undecodable, an older stamp, or no quaternion of length 1)"
        )
    return outcome


class _TruthReader:
    """Collects the ground truth topics of a recording."""

    def __init__(self, reader: BagReader, namespace: str) -> None:
        self.refused = 0
        self.handlers: dict[str, Callable[[bytes, int], None]] = {}
        self._names: tuple[str, ...] = ()
        self._joints: dict[str, tuple[array[float], array[float]]] = {}
        self._stamps = array("q")
        self._orientation: dict[str, tuple[array[int], array[float]]] = {}
        self._movement: list[tuple[int, bool]] = []
        for name, msgtype, handler in (
            (TRUTH_JOINTS, JOINT_STATE, self._joint_state),
            (TRUTH_ORIENTATION, QUATERNION_STAMPED, self._orientation_of),
            (TRUTH_MOVEMENT, BOOL, self._movement_at),
        ):
            if reader.resolve(name, namespace) is not None:
                self.handlers[reader.require(name, msgtype, namespace)] = handler

    def _joint_state(self, data: bytes, _time: int) -> None:
        try:
            stamp, names, position, velocity = decode_joint_state(data)
        except CdrError:
            self.refused += 1
            return
        if self._stamps and stamp <= self._stamps[-1]:
            self.refused += stamp < self._stamps[-1]
            return
        for name in names:
            if name not in self._joints:
                unknown = [math.nan] * len(self._stamps)
                self._joints[name] = (array("d", unknown), array("d", unknown))
        self._stamps.append(stamp)
        positions, velocities = dict(zip(names, position, strict=False)), dict(zip(names, velocity, strict=False))
        for name, (p, v) in self._joints.items():
            p.append(positions.get(name, math.nan))
            v.append(velocities.get(name, math.nan))

    def _movement_at(self, data: bytes, time: int) -> None:
        """The message has no stamp: its record time stands for it."""
        try:
            self._movement.append((time, decode_bool(data)))
        except CdrError:
            self.refused += 1

    def _orientation_of(self, data: bytes, _time: int) -> None:
        try:
            stamp, sensor, quaternion = decode_quaternion_stamped(data)
        except CdrError:
            self.refused += 1
            return
        stamps, rows = self._orientation.setdefault(sensor, (array("q"), array("d")))
        if not 0.9 < math.hypot(*quaternion) < 1.1:
            self.refused += 1
            return
        if stamps and stamp <= stamps[-1]:
            self.refused += stamp < stamps[-1]
            return
        stamps.append(stamp)
        rows.extend(quaternion)

    def truth(self) -> Truth:
        """All of it as arrays."""
        return Truth(
            np.frombuffer(self._stamps, dtype=np.int64) if self._stamps else np.empty(0, dtype=np.int64),
            {name: np.frombuffer(p) for name, (p, _) in self._joints.items()},
            {name: np.frombuffer(v) for name, (_, v) in self._joints.items()},
            {
                sensor: (np.frombuffer(stamps, dtype=np.int64), np.frombuffer(rows).reshape(-1, 4))
                for sensor, (stamps, rows) in self._orientation.items()
            },
            tuple(self._movement),
        )
