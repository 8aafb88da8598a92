"""One recording of `jointest evaluate`: plain options in, plain figures out, so that any process can do it."""

from __future__ import annotations

import platform
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from jointest_ros import __version__
from jointest_ros.bags import ground_truth, offline
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.cli.common import load_estimators, smoothers
from jointest_ros.config import Configuration
from jointest_ros.core.errors import JointestError
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Series
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.progress import Progress, no_progress
from jointest_ros.evaluation import peers, plots
from jointest_ros.evaluation.metrics import errors, has_figures
from jointest_ros.evaluation.panels import panels
from jointest_ros.evaluation.report import changes, files
from jointest_ros.evaluation.report.changes import Changes
from jointest_ros.evaluation.report.consistency import Innovations
from jointest_ros.evaluation.report.content import SCHEMA, Evaluation, Origin
from jointest_ros.evaluation.report.library import plotly_js
from jointest_ros.evaluation.truth import Truth


@dataclass(frozen=True)
class Options:
    """What is the same for all recordings of a call.

    Attributes:
        chosen: names of estimators; None: all of the configuration.
        skip_s: truth samples before this time after the first that is judged are left out, s.
        namespace: of the sensors' topics.
        moving: judge only while the recording says that it moves.
        with_peers: run the filters of others too.
        smooth: smoothers too, as `<estimator>_smoothed`.
        digest: of the robot's configuration and calibration, for the JSON.
        origin: what reports say of the call.
        against: the file of an earlier evaluation, and the tolerance in percent; None: no comparison.
    """

    configuration: Configuration
    chosen: list[str] | None = None
    skip_s: float = 0.0
    namespace: str = ""
    moving: bool = False
    with_peers: bool = False
    smooth: bool = False
    digest: str = ""
    origin: Origin = field(default_factory=lambda: Origin("", "", ()))
    against: tuple[str, float] | None = None

    @cached_property
    def continuous(self) -> frozenset[str]:
        """Joints whose error is wrapped."""
        joints = self.configuration.robot.joints
        return frozenset(name for joint in joints if joint.continuous for name in joint.coordinates)


@dataclass(frozen=True)
class Task:
    """One recording to evaluate.

    Attributes:
        picture: where its picture goes; None: nowhere.
        report: folder of its report; None: no report.
        earlier: the JSON of its earlier evaluation, where there is one.
    """

    bag: Path
    options: Options
    picture: Path | None = None
    report: Path | None = None
    earlier: dict[str, Any] | None = None


@dataclass(frozen=True)
class Done:
    """What one task gave.

    Attributes:
        document: what --json writes; None: it could not be evaluated.
        error: why not, or why a picture or report of it is missing; "".
        damage: why the recording could not be read to its end, or "".
        warnings: what a user should know, one line each.
        headings: peer -> how its heading was taken.
        changes: since the earlier evaluation.
        written: pictures and pages.
    """

    bag: Path
    document: dict[str, Any] | None = None
    error: str = ""
    damage: str = ""
    warnings: list[str] = field(default_factory=list)
    headings: dict[str, str] = field(default_factory=dict)
    changes: Changes | None = None
    written: list[str] = field(default_factory=list)


def evaluate_task(task: Task, progress: Progress = no_progress) -> Done:
    """One recording from its file to its figures, picture and report. What it needs and gives can be pickled.

    Raises:
        ConfigurationError, PeerError: see `evaluate`; they would be the same for every recording.
    """
    options, warnings = task.options, list[str]()
    try:
        one = evaluate(task.bag, options, warnings, detailed=task.report is not None, progress=progress)
    except BagError as error:
        return Done(task.bag, error=str(error), warnings=warnings)
    found = None
    if options.against and task.earlier:
        found = changes.compare(task.earlier, one.document, *options.against)
    done = Done(task.bag, one.document, "", one.damage, warnings, one.headings, found)
    try:
        if task.picture:
            _draw(task.picture, task.bag, one)
            done.written.append(f"{task.picture}: picture")
        if task.report:
            files.write(task.report, one, options.origin, plotly_js(), found)
            done.written.append(f"{task.report / 'index.html'}: report")
    except JointestError as error:
        return replace(done, error=str(error))
    return done


def evaluate(
    bag: Path,
    options: Options,
    warnings: list[str],
    *,
    detailed: bool = False,
    progress: Progress = no_progress,
) -> Evaluation:
    """Run estimators over one recording and compare with its ground truth.

    Args:
        warnings: gets what a user should know, also where the evaluation fails then.
        detailed: keep the frames and the innovations, for a report.

    Raises:
        ConfigurationError: no estimator can smooth.
        PeerError: the peers are not installed, or the robot has no IMU for them.
        BagError: the recording cannot be read, does not fit the configuration or has no ground truth of its joints.
    """
    configuration, skip_s = options.configuration, options.skip_s
    estimators = load_estimators(configuration, options.chosen)
    intake = Intake(configuration.robot, configuration.timing)
    smoothing = smoothers(estimators) if options.smooth else {}
    sink, frames, innovations = offline.SeriesSink(estimators), offline.RecordingSink(), InnovationsSink()
    how: dict[str, Any] = {"progress": progress, "consistency": True}
    if options.with_peers or smoothing or detailed:
        how["frame_sink"] = frames
    if detailed:
        how["innovation_sink"] = innovations
    with BagReader(bag) as reader:
        _check_truth(reader, options.namespace)
        outcome = offline.run(reader, intake, estimators, sink, namespace=options.namespace, **how)
        duration = reader.duration_s
    warnings += outcome.warnings
    if options.moving and not outcome.truth.movement:
        raise BagError(f"{bag}: --moving: no topic {ground_truth.TRUTH_MOVEMENT} that says when it moves")
    truth = outcome.truth.while_moving() if options.moving else outcome.truth
    series = {name: sink.series(name) for name in estimators}
    judged = dict(estimators)
    for name, estimator in smoothing.items():
        smoothed = f"{name}_smoothed"
        judged[smoothed], series[smoothed] = estimator, estimator.smooth(frames.recording())
    tables = {name: _errors(estimator, series[name], truth, options) for name, estimator in judged.items()}
    for name, table in tables.items():
        table |= {"nis": outcome.nis.get(name), "ns_per_frame": outcome.ns_per_frame.get(name)}
        table["frames"] = outcome.frames
    if not any(has_figures(table) for table in tables.values()):
        known = ", ".join([*outcome.truth.position, *outcome.truth.orientation]) or "nothing that can be read"
        raise BagError(f"{bag}: no estimate matches the ground truth (of {known}) after {skip_s:g} s")
    joints = {name: estimator.joints for name, estimator in judged.items()}
    headings = {}
    if options.with_peers:
        params, recording = configuration.estimators.get(Pcf.name), frames.recording()
        for peer in peers.PEERS:
            name = f"{peers.PREFIX}{peer}"
            found = peers.run(peer, configuration.robot, recording, params if isinstance(params, PcfParams) else None)
            tables[name], series[name], headings[name] = peers.judge(found, truth, skip_s, options.continuous)
            joints[name] = found.joints
    document = {
        "schema": SCHEMA,
        "bag": str(bag),
        "duration_s": duration,
        "estimators": tables,
        "input": outcome.inputs,
        "settings": _settings(options, estimators),
        "versions": versions(),
    }
    return Evaluation(
        document,
        outcome.damage,
        warnings,
        series,
        joints,
        {name: chain for name, estimator in judged.items() if (chain := estimator.torso)},
        truth,
        skip_s,
        options.continuous,
        headings,
        innovations.found(),
        frames.recording() if detailed else None,
        {what: n for topic in intake.topics for what, n in intake.saturated(topic).items()},
    )


def _check_truth(reader: BagReader, namespace: str) -> None:
    if offline.has_truth(reader, namespace):
        return
    names = (ground_truth.TRUTH_JOINTS, ground_truth.TRUTH_ORIENTATION)
    others = [
        topic.removesuffix(f"/{name}") or "/" for topic in reader.topics for name in names if topic.endswith(f"/{name}")
    ]
    does = f"it has one with --namespace {others[0]}" if others else "`jointest estimate` does without"
    raise BagError(f"{reader.path}: no ground truth (topics {', '.join(names)}); {does}")


def _errors(estimator: Estimator, series: Series, truth: Truth, options: Options) -> dict[str, Any]:
    """Those of an estimator, as in the JSON."""
    headings = bool(getattr(estimator.params, "mag_weight", 0.0))
    return errors(
        series, estimator.joints, truth, options.skip_s, options.continuous, estimator.torso, headings=headings
    )


def versions() -> dict[str, str]:
    """Of what the figures depend on."""
    return {
        "jointest_ros": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


class InnovationsSink:
    """Collects the innovations of a run, by estimator."""

    def __init__(self) -> None:
        self._parts: dict[str, list[Innovations]] = {}

    def __call__(self, name: str, stamps: list[int], rows: list[list[float]]) -> None:
        self._parts.setdefault(name, []).append(Innovations.from_rows(stamps, rows))

    def found(self) -> dict[str, Innovations]:
        """Of the estimators that have any."""
        joined = {name: Innovations.concatenate(parts) for name, parts in self._parts.items()}
        return {name: one for name, one in joined.items() if len(one.values)}


def _settings(options: Options, estimators: dict[str, Estimator]) -> dict[str, Any]:
    """By what the figures came about, as far as it was chosen."""
    return {
        "skip_s": options.skip_s,
        "moving": options.moving,
        "namespace": options.namespace,
        "robot": options.digest,
        "estimators": {name: dict(vars(estimator.params)) for name, estimator in estimators.items()},
    }


def _draw(picture: Path, bag: Path, one: Evaluation) -> None:
    shown = panels(one.series, one.joints, one.truth, one.skip_s, one.continuous)
    after = f", without the first {one.skip_s:g} s" if one.skip_s else ""
    plots.draw(picture, f"{bag.resolve().name}: {one.document['duration_s']:.1f} s{after}", shown)
