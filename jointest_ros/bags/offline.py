"""Runs estimators over a recording, with the decoder, assembler and estimator objects that the nodes use."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from itertools import islice
from time import perf_counter_ns
from typing import Any

from jointest_ros.bags.array_intake import ArrayIntake, Message, Stretch
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.ground_truth import TRUTH_JOINTS, TRUTH_ORIENTATION, TruthReader
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.series_buffer import SeriesBuffer
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, Frame, Recording, Series
from jointest_ros.core.progress import Progress, no_progress
from jointest_ros.evaluation.truth import Truth

_CHUNK = 2048  # frames that are decoded and assembled together

Sink = Callable[[str, list[Estimate]], None]  # estimator name, consecutive estimates
FrameSink = Callable[[list[Frame]], None]  # consecutive frames
StretchSink = Callable[[Recording], None]  # the same as arrays
InnovationSink = Callable[[str, list[int], list[list[float]]], None]  # estimator name, stamps, innovations of each


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
        self._buffers = {name: SeriesBuffer(joints) for name, joints in self._joints.items()}

    def __call__(self, name: str, estimates: list[Estimate]) -> None:
        self._buffers[name].add(Series.from_estimates(estimates, self._joints[name]))

    def series(self, name: str) -> Series:
        """All estimates of one estimator."""
        return self._buffers[name].series()


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


def run(
    reader: BagReader,
    intake: Intake,
    estimators: dict[str, Estimator],
    sink: Sink,
    *,
    namespace: str = "",
    progress: Progress = no_progress,
    frame_sink: FrameSink = lambda frames: None,
    consistency: bool = False,
    innovation_sink: InnovationSink | None = None,
) -> Outcome:
    """Estimate a whole recording frame by frame, in the memory of one chunk.

    Args:
        reader: open.
        sink: takes the estimates of each estimator, chunk after chunk.
        frame_sink: takes the frames themselves.
        namespace: put before the relative topic names.
        consistency: fill `nis`, which costs a microsecond a frame.
        innovation_sink: takes the innovations that `nis` is made of, chunk after chunk.

    Raises:
        BagError: see `check_topics`. A recording that is damaged further on gives what it can and says so in `damage`.
    """
    found, warnings = check_topics(reader, intake, namespace)
    outcome = Outcome(warnings=warnings)
    truth = TruthReader(reader, namespace)
    spent = dict.fromkeys(estimators, 0)
    innovations = {name: [0.0, 0] for name in estimators}  # sum of squares, number

    def estimate(frames: list[Frame]) -> None:
        frame_sink(frames)
        for name, estimator in estimators.items():
            estimates, normalised = [], []
            for frame in frames:
                start = perf_counter_ns()
                estimates.append(estimator.update(frame))
                spent[name] += perf_counter_ns() - start
                if consistency:
                    normalised.append(estimator.innovations())
                    used = [v * v for v in normalised[-1] if v == v]
                    innovations[name][0] += sum(used)
                    innovations[name][1] += len(used)
            if innovation_sink:
                innovation_sink(name, [frame.stamp for frame in frames], normalised)
            sink(name, estimates)

    for stretch in _stretches(reader, intake, found, truth, outcome, progress):
        estimate(list(stretch.frames()) if isinstance(stretch, Recording) else stretch)
    if estimators:
        outcome.warnings += [f"{reader.path}: {text}" for text in intake.warnings()]
    outcome.warnings += [
        f"{reader.path}: {name}: {text}" for name, estimator in estimators.items() for text in estimator.warnings()
    ]
    outcome.nis = {name: squares / number if number else None for name, (squares, number) in innovations.items()}
    outcome.ns_per_frame = {name: ns / outcome.frames if outcome.frames else None for name, ns in spent.items()}
    _conclude(outcome, reader, intake, found, truth)
    return outcome


def read_frames(
    reader: BagReader,
    intake: Intake,
    frame_sink: FrameSink,
    namespace: str = "",
    progress: Progress = no_progress,
) -> Outcome:
    """The frames of a whole recording without estimates, as `run` reads them."""
    return run(
        reader, intake, {}, lambda name, estimates: None, namespace=namespace, progress=progress, frame_sink=frame_sink
    )


def read_recordings(
    reader: BagReader,
    intake: Intake,
    sink: StretchSink,
    namespace: str = "",
    progress: Progress = no_progress,
) -> Outcome:
    """The frames of a whole recording as consecutive stretches of some thousands; otherwise as `read_frames`."""
    found, warnings = check_topics(reader, intake, namespace)
    outcome = Outcome(warnings=warnings)
    truth = TruthReader(reader, namespace)
    for stretch in _stretches(reader, intake, found, truth, outcome, progress):
        sink(stretch if isinstance(stretch, Recording) else Recording.from_frames(stretch))
    _conclude(outcome, reader, intake, found, truth)
    return outcome


def read_recording(
    reader: BagReader, intake: Intake, namespace: str = "", progress: Progress = no_progress
) -> tuple[Recording, Outcome]:
    """All frames at once."""
    parts: list[Recording] = []
    outcome = read_recordings(reader, intake, parts.append, namespace, progress)
    return Recording.concatenate(parts or [Recording.from_frames([])]), outcome


def _stretches(
    reader: BagReader,
    intake: Intake,
    found: dict[str, str],
    truth: TruthReader,
    outcome: Outcome,
    progress: Progress,
) -> Iterator[Stretch]:
    """All frames in order. `outcome` is told their number, and of a damage."""
    arrays = ArrayIntake(intake, found)
    total = sum(reader.counts[topic] for topic in (*found, *truth.handlers))
    messages = _readable(reader, (*found, *truth.handlers), outcome)
    waiting: list[Message] = []
    done = 0
    while chunk := list(islice(messages, _CHUNK * (len(found) + len(truth.handlers)))):
        stretches, waiting = arrays.add(waiting + [message for message in chunk if message[0] in found])
        for stretch in stretches:
            outcome.frames += len(stretch)
            yield stretch
        for topic, time, data in chunk if truth.handlers else ():
            if topic in truth.handlers:
                truth.handlers[topic](data, time)
        done += len(chunk)
        progress(done, total)
    for stretch in arrays.finish(waiting):
        outcome.frames += len(stretch)
        yield stretch


def _readable(reader: BagReader, topics: Collection[str], outcome: Outcome) -> Iterator[tuple[str, int, bytes]]:
    """The messages up to a damage, which `outcome` is told. What their user raises does not end here."""
    try:
        yield from reader.messages(topics)
    except BagError as error:
        outcome.damage = str(error)


def _conclude(outcome: Outcome, reader: BagReader, intake: Intake, found: dict[str, str], truth: TruthReader) -> None:
    """Fill in what is known at the end: counters and ground truth; `found`: absolute topic -> configured topic."""
    outcome.inputs = {topic: intake.counts(name) for topic, name in found.items()}
    outcome.truth = truth.truth()
    if truth.refused:
        outcome.warnings.append(
            f"{reader.path}: {truth.refused} ground truth messages refused "
            "(undecodable, an older stamp, or no quaternion of length 1)"
        )
