"""`jointest evaluate`: estimators against the ground truth of recordings, as a table and as JSON."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

from jointest_ros import config
from jointest_ros.bags import offline
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.cli.common import Parsers, add_config, err, load_estimators, out, progress, warn
from jointest_ros.cli.tables import error_tables, input_table
from jointest_ros.config import Configuration
from jointest_ros.evaluation.metrics import errors, has_figures

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
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of the command."""
    if not math.isfinite(arguments.skip) or arguments.skip < 0.0:
        raise BagError(f"--skip: {arguments.skip} is not allowed; give 0 or more seconds")
    configuration = config.load(arguments.config)
    documents, code = [], 0
    for bag in arguments.bags:
        document, damage = evaluate(bag, configuration, arguments.estimator, arguments.skip, arguments.namespace)
        documents.append(document)
        if arguments.json != "-":
            out.print(f"{bag}: {document['duration_s']:.1f} s, after {arguments.skip:g} s", markup=False)
            for table in (*error_tables(document["estimators"]), input_table(document["input"])):
                out.print(table)
        if damage:
            err.print(f"jointest evaluate: error: {damage}; the figures are of what came before", markup=False)
            code = 2
    if arguments.json:
        _write_json(arguments.json, documents[0] if len(documents) == 1 else documents)
    return code


def evaluate(
    bag: Path, configuration: Configuration, chosen: list[str] | None, skip_s: float, namespace: str = ""
) -> tuple[dict[str, Any], str]:
    """(the JSON of the design for one recording, why it could not be read to its end or "").

    Raises:
        BagError: the recording cannot be read, does not fit the configuration or has no ground truth of its joints.
    """
    estimators = load_estimators(configuration, chosen)
    continuous = {name for joint in configuration.robot.joints if joint.continuous for name in joint.coordinates}
    intake = Intake(configuration.robot, configuration.timing)
    sink = offline.SeriesSink(estimators)
    with BagReader(bag) as reader, progress(f"evaluate {bag}") as report:
        outcome = offline.run(reader, intake, estimators, sink, namespace=namespace, progress=report)
        duration = reader.duration_s
    if not outcome.truth:
        raise BagError(
            f"{bag}: no ground truth (topics {offline.TRUTH_JOINTS}, {offline.TRUTH_ORIENTATION}); "
            "`jointest estimate` does without"
        )
    tables = {}
    for name, estimator in estimators.items():
        tables[name] = errors(sink.series(name), estimator.joints, outcome.truth, skip_s, continuous)
        tables[name] |= {"ns_per_frame": outcome.ns_per_frame[name], "frames": outcome.frames}
    if not any(has_figures(table) for table in tables.values()):
        known = ", ".join([*outcome.truth.position, *outcome.truth.orientation])
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
    return document, outcome.damage


def _write_json(target: str, document: Any) -> None:
    text = json.dumps(document, indent=2, allow_nan=False)
    if target == "-":
        out.print(text, markup=False)
        return
    try:
        Path(target).write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise BagError(f"{target}: cannot be written: {error.strerror}") from None
    out.print(f"{target}: figures", markup=False)
