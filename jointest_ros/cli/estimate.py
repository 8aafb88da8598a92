"""`jointest estimate`: joint angles of a recording without ground truth, to rosbag2 or CSV."""

from __future__ import annotations

import argparse
import csv
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jointest_ros import config
from jointest_ros.bags import offline
from jointest_ros.bags.cdr import JOINT_STATE
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.output import JointStateOutput
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter
from jointest_ros.cli.common import (
    OutputError,
    Parsers,
    add_config,
    complain,
    load_estimators,
    out,
    progress,
    smoothers,
    tell_calibration,
    warn,
)
from jointest_ros.core.errors import ConfigurationError, counted
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, Series, Status

_STARTING = int(Status.STARTING)


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "estimate",
        description="Estimate the joint angles of a recording. No ground truth is needed.",
        epilog="CSV columns: stamp_ns, then for each joint position (rad), velocity (rad/s), standard deviation (rad) "
        "and status (0: all is well; see the documentation of Status). With several estimators their names are put "
        "before the joints. A recording gets /joint_states, with several estimators /<estimator>/joint_states.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2 directory, or a .mcap or .db3 file")
    add_config(parser)
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        type=Path,
        metavar="OUT",
        help="a file *.csv, or the directory of a new recording",
    )
    parser.add_argument(
        "--smooth",
        action="store_true",
        help="estimate each angle from the whole recording, also from what comes after (accel_ekf)",
    )
    parser.add_argument("--storage", choices=("mcap", "sqlite3"), default="mcap", help="default: %(default)s")
    parser.add_argument("--overwrite", action="store_true", help="replace what is there under that name")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of the command."""
    configuration = config.load(arguments.config)
    tell_calibration(configuration)
    estimators = load_estimators(configuration, arguments.estimator)
    if not any(estimator.joints for estimator in estimators.values()):
        raise ConfigurationError(f"{configuration.path}: robot.joints: none; there is no joint angle to estimate")
    smoothing = smoothers(estimators) if arguments.smooth else {}
    estimators = smoothing or estimators
    source = arguments.bag.resolve()
    if arguments.output.resolve() in (source, *source.parents):
        raise OutputError(f"{arguments.output}: is the recording itself; choose another name")
    if arguments.output.suffix.lower() != ".csv" and not _names_a_bag(arguments.output):
        advice = "give a name that ends in .csv, or the name of a new bag (no extension)"
        raise OutputError(f"{arguments.output}: is not allowed as output; {advice}")
    intake = Intake(configuration.robot, configuration.timing)
    with BagReader(arguments.bag) as reader, progress(f"estimate {arguments.bag}") as report:
        offline.check_topics(reader, intake, arguments.namespace)
        make_sink = _csv_sink if arguments.output.suffix.lower() == ".csv" else _bag_sink
        with make_sink(arguments, estimators) as write:
            lacking = {name: list(estimator.joints) for name, estimator in estimators.items()}

            def sink(name: str, estimates: list[Estimate]) -> None:
                for estimate in estimates if lacking[name] else ():
                    flags = dict(zip(estimators[name].joints, estimate.status, strict=True))
                    lacking[name] = [joint for joint in lacking[name] if flags[joint] & _STARTING]
                write(name, estimates)

            how: dict[str, Any] = {"namespace": arguments.namespace, "progress": report}
            if smoothing:
                recording, outcome = offline.read_recording(reader, intake, **how)
                for name, estimator in smoothing.items():
                    sink(name, _estimates(estimator.smooth(recording)))
            else:
                outcome = offline.run(reader, intake, estimators, sink, **how)
    joints = {name: estimator.joints for name, estimator in estimators.items()}
    return _conclude(arguments, outcome, joints, lacking)


def _conclude(
    arguments: argparse.Namespace,
    outcome: offline.Outcome,
    joints: dict[str, tuple[str, ...]],
    lacking: dict[str, list[str]],
) -> int:
    """Tell what came out; the exit code. `joints`: of each estimator; `lacking`: those of them without an estimate."""
    for text in outcome.warnings:
        warn(text)
    out.print(f"{arguments.output}: {counted(outcome.frames, 'frame')}, {', '.join(joints)}")
    for name, absent in lacking.items():
        if absent:
            warn(f"{name}: no estimate of {', '.join(absent)} in the whole recording")
    if all(len(lacking[name]) == len(columns) for name, columns in joints.items()):
        complain("estimate", f"{arguments.bag}: no joint could be estimated; the warnings above and status say why")
        return 2
    if outcome.damage:
        complain("estimate", f"{outcome.damage}; what came before is in {arguments.output}")
        return 2
    return 0


@contextmanager
def _csv_sink(arguments: argparse.Namespace, estimators: dict[str, Estimator]) -> Iterator[offline.Sink]:
    """Rows of all estimators side by side: each gets the same frames."""
    if arguments.output.exists() and not arguments.overwrite:
        raise OutputError(f"{arguments.output}: exists already; remove it, choose another name or give --overwrite")
    header = ["stamp_ns"]
    for name, estimator in estimators.items():
        prefix = f"{name}/" if len(estimators) > 1 else ""
        for joint in estimator.joints:
            header += [f"{prefix}{joint}_{what}" for what in ("rad", "rad_s", "std_rad", "status")]
    waiting: list[list[Estimate]] = []
    try:
        with arguments.output.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(header)

            def sink(_name: str, estimates: list[Estimate]) -> None:
                waiting.append(estimates)
                if len(waiting) == len(estimators):
                    writer.writerows(
                        [row[0].stamp, *(v for e in row for v in _values(e))] for row in zip(*waiting, strict=True)
                    )
                    waiting.clear()

            yield sink
    except OSError as error:
        raise OutputError(f"{arguments.output}: cannot be written: {error.strerror}") from None


def _names_a_bag(path: Path) -> bool:
    """Whether it is meant as the directory of a recording; a date or a version in its name is no extension."""
    return path.name != "-" and re.fullmatch(r"\.[A-Za-z][A-Za-z0-9]{0,4}", path.suffix) is None


def _estimates(series: Series) -> list[Estimate]:
    tables = series.position, series.velocity, series.variance, series.status
    rows = zip(series.stamps.tolist(), *(map(tuple, table.tolist()) for table in tables), strict=True)
    return [Estimate(stamp, q, v, variance, status) for stamp, q, v, variance, status in rows]


def _values(estimate: Estimate) -> Iterator[float]:
    for q, v, variance, status in zip(
        estimate.position, estimate.velocity, estimate.variance, estimate.status, strict=True
    ):
        yield from (q, v, variance**0.5, int(status))  # Python 3.10 would write the names of the flags


@contextmanager
def _bag_sink(arguments: argparse.Namespace, estimators: dict[str, Estimator]) -> Iterator[offline.Sink]:
    outputs = {name: JointStateOutput(estimator.joints) for name, estimator in estimators.items()}
    topics = {name: f"/{name}/joint_states" if len(estimators) > 1 else "/joint_states" for name in estimators}
    with BagWriter(arguments.output, arguments.storage, overwrite=arguments.overwrite) as writer:
        for topic in topics.values():
            writer.add_topic(topic, JOINT_STATE)

        def sink(name: str, estimates: list[Estimate]) -> None:
            for estimate in estimates:
                message = outputs[name].encode(estimate)
                if message is not None:
                    writer.write(topics[name], estimate.stamp, message)

        yield sink
