"""`jointest evaluate`: estimators against the ground truth of recordings, as tables, JSON, pictures and reports."""

from __future__ import annotations

import argparse
import math
from contextlib import suppress
from pathlib import Path
from typing import Any

from jointest_ros import config
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.ground_truth import TRUTH_JOINTS, TRUTH_MOVEMENT, TRUTH_ORIENTATION
from jointest_ros.cli import evaluate_output as output
from jointest_ros.cli.common import Parsers, add_config, complain, load_estimators, tell_calibration, warn, write_json
from jointest_ros.cli.evaluate_bag import Options, Task
from jointest_ros.cli.evaluate_jobs import evaluated
from jointest_ros.cli.parallel import add_workers, given_workers
from jointest_ros.cli.provenance import digest, origin
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.evaluation import peers, plots
from jointest_ros.evaluation.report import changes, files
from jointest_ros.evaluation.report.library import plotly_js

WORSE = 1  # exit code of --fail-worse


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "evaluate",
        description="Run estimators over recordings and compare with their ground truth "
        f"(topics {TRUTH_JOINTS}, {TRUTH_ORIENTATION}).",
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
        help=f"judge only the truth samples at which the recording says that it moves (topic {TRUTH_MOVEMENT})",
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
    parser.add_argument(
        "--report",
        type=Path,
        metavar="DIR",
        help="write DIR/index.html, one page with plots that zoom, to be read without network, and beside it PNG and "
        "CSV; needs plotly: pip install 'jointest_ros[report]'",
    )
    parser.add_argument(
        "--against",
        type=Path,
        metavar="OLD",
        help="show what changed since an earlier evaluation, of which OLD is the JSON (--json, or figures.json of a "
        f"report); a difference of {changes.TOLERANCE:g} %% or {changes.SMALLEST_DEG:g} deg counts as none",
    )
    parser.add_argument(
        "--fail-worse",
        type=float,
        metavar="PERCENT",
        help=f"with --against: end with code {WORSE} when an rms error is worse by more than so much, or is gone, "
        "with 2 when OLD has none to compare with",
    )
    add_workers(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of the command. A recording that cannot be evaluated does not keep the others from it."""
    try:
        return _evaluate(arguments)
    finally:
        if arguments.report is not None:
            with suppress(OSError):
                arguments.report.rmdir()  # only where nothing came into it


def _evaluate(arguments: argparse.Namespace) -> int:
    workers = given_workers(arguments)
    tasks, imus = _tasks(arguments)
    quiet, several = arguments.json == "-", len(tasks) > 1
    finished, code = [], 0
    for done in evaluated(tasks, workers):
        finished.append(done)
        output.show(done, arguments.skip, imus, figures=not quiet)
        for text in (f"{done.damage}; the figures are of what came before" if done.damage else "", done.error):
            if text:
                complain("evaluate", text)
                code = 2
    documents = [done.document for done in finished if done.document]
    if arguments.json and documents:
        write_json(arguments.json, documents if several else documents[0])
    if arguments.report and several:
        output.write_index(arguments.report, finished, tasks[0].options.origin, output.unique_names(arguments.bags))
    if (
        arguments.fail_worse is not None
        and not code
        and not any(done.changes and done.changes.known for done in finished)
    ):
        complain("evaluate", f"--fail-worse: {arguments.against} has no rms error of these recordings and estimators")
        code = 2
    worse = [row for done in finished if done.changes for row in done.changes.worse]
    if arguments.fail_worse is not None and worse and not code:
        complain("evaluate", f"--fail-worse: {len(worse)} rms errors are worse than in {arguments.against}")
        code = WORSE
    return code


def _tasks(arguments: argparse.Namespace) -> tuple[list[Task], int]:
    """What there is to do, after all is checked that can be before the work; and the number of IMUs of the peers."""
    if not math.isfinite(arguments.skip) or arguments.skip < 0.0:
        raise BagError(f"--skip: {arguments.skip} is not allowed; give 0 or more seconds")
    bags: list[Path] = arguments.bags
    if arguments.plot is not None:
        plots.check_suffix(arguments.plot)
    earlier = _earlier(arguments)
    configuration = config.load(arguments.config)
    tell_calibration(configuration)
    load_estimators(configuration, arguments.estimator)
    imus = 0
    if arguments.peers:
        peers.check_installed()
        imus = sum(sensor.gyro and sensor.accel for sensor in configuration.robot.sensors)
    if arguments.report is not None:
        plotly_js()
        files.make_folder(arguments.report)
    tolerance = changes.TOLERANCE if arguments.fail_worse is None else arguments.fail_worse
    options = Options(
        configuration,
        arguments.estimator,
        arguments.skip,
        arguments.namespace,
        arguments.moving,
        arguments.peers,
        arguments.smooth,
        digest(configuration),
        origin(configuration),
        against=(str(arguments.against), tolerance) if arguments.against else None,
    )
    names = output.unique_names(bags)
    several = len(bags) > 1
    tasks = []
    for bag, name in zip(bags, names, strict=True):
        picture, report = arguments.plot, arguments.report
        if several and picture is not None:
            picture = picture.with_name(f"{picture.stem}_{name}{picture.suffix}")
        if several and report is not None:
            report = report / name
        then = changes.earlier(earlier, str(bag), only=not several)
        if arguments.against is not None and then is None:
            warn(f"{bag}: not in {arguments.against}")
        tasks.append(Task(bag, options, picture, report, then))
    return tasks, imus


def _earlier(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """The earlier evaluation that --against names."""
    allowed = arguments.fail_worse
    if arguments.against is None:
        if allowed is not None:
            raise ConfigurationError("--fail-worse: give an earlier evaluation by --against")
        return []
    if allowed is not None and not 0.0 <= allowed < math.inf:
        raise ConfigurationError(f"--fail-worse: {allowed} is not allowed; give 0 or more percent")
    return changes.read(arguments.against)
