"""`jointest evaluate`: estimators against the ground truth of recordings, as a table and as JSON."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jointest_ros import config
from jointest_ros.bags import offline
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.cli.common import (
    Parsers,
    add_config,
    complain,
    err,
    load_estimators,
    out,
    progress,
    smoothers,
    warn,
    warn_uncalibrated,
    write_text,
)
from jointest_ros.cli.tables import consistency_line, error_tables, input_table
from jointest_ros.config import Configuration
from jointest_ros.core.frame import Series
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.evaluation import peers, plots
from jointest_ros.evaluation.metrics import errors, has_figures
from jointest_ros.evaluation.truth import Truth

SCHEMA = 1


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "evaluate",
        help="errors of estimators against the ground truth of recordings",
        description="Run estimators over recordings and compare with their ground truth "
        f"(topics {offline.TRUTH_JOINTS}, {offline.TRUTH_ORIENTATION}).",
        epilog="rmse: root mean square of estimate minus truth, over the truth samples after --skip that an estimate "
        "matches within half a truth period; nothing is fitted or removed. bias: mean of that difference; std: its "
        "standard deviation (what counts where the encoder's zero is arbitrary); coverage: matched share of the truth.",
    )
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="rosbag2 directory, or a .mcap or .db3 file")
    add_config(parser)
    parser.add_argument(
        "--skip", type=float, default=0.0, metavar="S", help="leave out the first S seconds (default: 0)"
    )
    parser.add_argument(
        "--moving",
        action="store_true",
        help=f"judge only the truth samples at which the recording says that it moves (topic {offline.TRUTH_MOVEMENT})",
    )
    parser.add_argument(
        "--peers",
        action="store_true",
        help="the orientation filters of vqf, imufusion and ahrs as well (docs/peers.md); they are installed by "
        "pip install 'jointest_ros[peers]'",
    )
    parser.add_argument(
        "--smooth",
        action="store_true",
        help="the smoother as well where an estimator has one (accel_ekf): every estimate from the whole recording",
    )
    parser.add_argument(
        "--json",
        metavar="FILE",
        help="write the figures as JSON, '-': to standard output; a list for several recordings",
    )
    parser.add_argument(
        "--plot",
        type=Path,
        metavar="FILE",
        help="draw estimates, truth and errors: *.png, *.svg or *.pdf; for several recordings FILE_<recording>",
    )
    parser.set_defaults(run=run)


@dataclass(frozen=True)
class Evaluation:
    """What one recording gave.

    Attributes:
        document: the JSON of the design.
        damage: why the recording could not be read to its end, or "".
        series: estimates by estimator.
        joints: columns of the series by estimator.
        truth: what they are compared with.
        headings: peer -> how its heading was taken.
    """

    document: dict[str, Any]
    damage: str
    series: dict[str, Series]
    joints: dict[str, tuple[str, ...]]
    truth: Truth
    headings: dict[str, str]


def run(arguments: argparse.Namespace) -> int:
    """Body of the command. A recording that cannot be evaluated does not keep the others from it."""
    if not math.isfinite(arguments.skip) or arguments.skip < 0.0:
        raise BagError(f"--skip: {arguments.skip} is not allowed; give 0 or more seconds")
    pictures = _pictures(arguments.plot, arguments.bags)
    configuration = config.load(arguments.config)
    warn_uncalibrated(configuration)
    load_estimators(configuration, arguments.estimator)
    if arguments.peers:
        peers.check_installed()
    imus = sum(sensor.gyro and sensor.accel for sensor in configuration.robot.sensors) if arguments.peers else 0
    documents, code = [], 0
    for bag, picture in zip(arguments.bags, pictures, strict=True):
        try:
            done = evaluate(
                bag,
                configuration,
                arguments.estimator,
                arguments.skip,
                arguments.namespace,
                moving=arguments.moving,
                with_peers=arguments.peers,
                smooth=arguments.smooth,
            )
        except BagError as error:
            complain("evaluate", error)
            code = 2
            continue
        documents.append(done.document)
        if arguments.json != "-":
            out.print(f"{bag}: {done.document['duration_s']:.1f} s, after {arguments.skip:g} s")
            for table in (*error_tables(done.document["estimators"], imus), input_table(done.document["input"])):
                out.print(table)
            if done.headings:
                cells = ", ".join(f"{name} {heading}" for name, heading in done.headings.items())
                out.print(f"heading of the peers, the better of two ways each: {cells}")
            if line := consistency_line(done.document["estimators"]):
                out.print(line)
        if done.damage:
            complain("evaluate", f"{done.damage}; the figures are of what came before")
            code = 2
        if picture:
            _plot(picture, bag, done, arguments.skip, _continuous(configuration))
    if arguments.json and documents:
        _write_json(arguments.json, documents if len(arguments.bags) > 1 else documents[0])
    return code


def evaluate(
    bag: Path,
    configuration: Configuration,
    chosen: list[str] | None,
    skip_s: float,
    namespace: str = "",
    *,
    moving: bool = False,
    with_peers: bool = False,
    smooth: bool = False,
) -> Evaluation:
    """Run estimators over one recording and compare with its ground truth.

    Args:
        chosen: names of estimators; None: all of the configuration.
        skip_s: truth samples before this time after the first that is judged are left out, s.
        moving: judge only while the recording says that it moves.
        with_peers: run the filters of others too.
        smooth: smoothers too, as `<estimator>_smoothed`.

    Raises:
        ConfigurationError: no estimator can smooth.
        PeerError: the peers are not installed, or the robot has no IMU for them.
        BagError: the recording cannot be read, does not fit the configuration or has no ground truth of its joints.
    """
    estimators = load_estimators(configuration, chosen)
    intake = Intake(configuration.robot, configuration.timing)
    smoothing = smoothers(estimators) if smooth else {}
    sink, frames = offline.SeriesSink(estimators), offline.RecordingSink()
    with BagReader(bag) as reader, progress(f"evaluate {bag}") as report:
        if not offline.has_truth(reader, namespace):
            raise BagError(
                f"{bag}: no ground truth (topics {offline.TRUTH_JOINTS}, {offline.TRUTH_ORIENTATION}); "
                "`jointest estimate` does without"
            )
        keep = {"frame_sink": frames} if with_peers or smoothing else {}
        outcome = offline.run(
            reader, intake, estimators, sink, namespace=namespace, progress=report, consistency=True, **keep
        )
        duration = reader.duration_s
    for text in outcome.warnings:
        warn(text)
    if moving and not outcome.truth.movement:
        raise BagError(f"{bag}: --moving: no topic {offline.TRUTH_MOVEMENT} that says when it moves")
    truth = outcome.truth.while_moving() if moving else outcome.truth
    series = {name: sink.series(name) for name in estimators}
    judged = dict(estimators)
    for name, estimator in smoothing.items():
        smoothed = f"{name}_smoothed"
        judged[smoothed], series[smoothed] = estimator, estimator.smooth(frames.recording())
    tables = {}
    for name, estimator in judged.items():
        tables[name] = errors(
            series[name],
            estimator.joints,
            truth,
            skip_s,
            _continuous(configuration),
            estimator.torso,
            headings=bool(getattr(estimator.params, "mag_weight", 0.0)),
        )
        costs = {"nis": outcome.nis.get(name), "ns_per_frame": outcome.ns_per_frame.get(name)}
        tables[name] |= {**costs, "frames": outcome.frames}
    if not any(has_figures(table) for table in tables.values()):
        known = ", ".join([*outcome.truth.position, *outcome.truth.orientation]) or "nothing that can be read"
        raise BagError(f"{bag}: no estimate matches the ground truth (of {known}) after {skip_s:g} s")
    joints = {name: estimator.joints for name, estimator in judged.items()}
    headings = {}
    if with_peers:
        params, recording = configuration.estimators.get(Pcf.name), frames.recording()
        for peer in peers.PEERS:
            name = f"{peers.PREFIX}{peer}"
            found = peers.run(peer, configuration.robot, recording, params if isinstance(params, PcfParams) else None)
            tables[name], series[name], headings[name] = peers.judge(found, truth, skip_s, _continuous(configuration))
            joints[name] = found.joints
    document = {
        "schema": SCHEMA,
        "bag": str(bag),
        "duration_s": duration,
        "estimators": tables,
        "input": outcome.inputs,
    }
    return Evaluation(document, outcome.damage, series, joints, truth, headings)


def _continuous(configuration: Configuration) -> set[str]:
    return {name for joint in configuration.robot.joints if joint.continuous for name in joint.coordinates}


def _pictures(target: Path | None, bags: list[Path]) -> list[Path | None]:
    """Where the picture of each recording goes."""
    if target is None:
        return [None] * len(bags)
    plots.check_suffix(target)
    if len(bags) == 1:
        return [target]
    names = [bag.resolve().name for bag in bags]
    unique = [name if names.count(name) == 1 else f"{name}_{number}" for number, name in enumerate(names, 1)]
    return [target.with_name(f"{target.stem}_{name}{target.suffix}") for name in unique]


def _plot(picture: Path, bag: Path, done: Evaluation, skip_s: float, continuous: set[str]) -> None:
    shown = plots.panels(done.series, done.joints, done.truth, skip_s, continuous)
    after = f", without the first {skip_s:g} s" if skip_s else ""
    plots.draw(picture, f"{bag.resolve().name}: {done.document['duration_s']:.1f} s{after}", shown)
    err.print(f"{picture}: picture")


def _write_json(target: str, document: Any) -> None:
    text = json.dumps(document, indent=2, allow_nan=False)
    if target == "-":
        out.print(text)
        return
    write_text(Path(target), text + "\n")
    out.print(f"{target}: figures")
