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
    warn,
    write_text,
)
from jointest_ros.cli.tables import consistency_line, error_tables, input_table
from jointest_ros.config import Configuration
from jointest_ros.core.frame import Series
from jointest_ros.evaluation import plots
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
    """

    document: dict[str, Any]
    damage: str
    series: dict[str, Series]
    joints: dict[str, tuple[str, ...]]
    truth: Truth


def run(arguments: argparse.Namespace) -> int:
    """Body of the command. A recording that cannot be evaluated does not keep the others from it."""
    if not math.isfinite(arguments.skip) or arguments.skip < 0.0:
        raise BagError(f"--skip: {arguments.skip} is not allowed; give 0 or more seconds")
    pictures = _pictures(arguments.plot, arguments.bags)
    configuration = config.load(arguments.config)
    load_estimators(configuration, arguments.estimator)
    documents, code = [], 0
    for bag, picture in zip(arguments.bags, pictures, strict=True):
        try:
            done = evaluate(bag, configuration, arguments.estimator, arguments.skip, arguments.namespace)
        except BagError as error:
            complain("evaluate", error)
            code = 2
            continue
        documents.append(done.document)
        if arguments.json != "-":
            out.print(f"{bag}: {done.document['duration_s']:.1f} s, after {arguments.skip:g} s")
            for table in (*error_tables(done.document["estimators"]), input_table(done.document["input"])):
                out.print(table)
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
    bag: Path, configuration: Configuration, chosen: list[str] | None, skip_s: float, namespace: str = ""
) -> Evaluation:
    """Run estimators over one recording and compare with its ground truth.

    Raises:
        BagError: the recording cannot be read, does not fit the configuration or has no ground truth of its joints.
    """
    estimators = load_estimators(configuration, chosen)
    intake = Intake(configuration.robot, configuration.timing)
    sink = offline.SeriesSink(estimators)
    with BagReader(bag) as reader, progress(f"evaluate {bag}") as report:
        if not offline.has_truth(reader, namespace):
            raise BagError(
                f"{bag}: no ground truth (topics {offline.TRUTH_JOINTS}, {offline.TRUTH_ORIENTATION}); "
                "`jointest estimate` does without"
            )
        outcome = offline.run(reader, intake, estimators, sink, namespace=namespace, progress=report, consistency=True)
        duration = reader.duration_s
    series = {name: sink.series(name) for name in estimators}
    tables = {}
    for name, estimator in estimators.items():
        tables[name] = errors(
            series[name], estimator.joints, outcome.truth, skip_s, _continuous(configuration), estimator.torso
        )
        tables[name] |= {"nis": outcome.nis[name], "ns_per_frame": outcome.ns_per_frame[name], "frames": outcome.frames}
    if not any(has_figures(table) for table in tables.values()):
        known = ", ".join([*outcome.truth.position, *outcome.truth.orientation]) or "nothing that can be read"
        raise BagError(f"{bag}: no estimate matches the ground truth (of {known}) after {skip_s:g} s")
    for text in outcome.warnings:
        warn(text)
    document = {
        "schema": SCHEMA,
        "bag": str(bag),
        "duration_s": duration,
        "estimators": tables,
        "input": outcome.inputs,
    }
    joints = {name: estimator.joints for name, estimator in estimators.items()}
    return Evaluation(document, outcome.damage, series, joints, outcome.truth)


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
