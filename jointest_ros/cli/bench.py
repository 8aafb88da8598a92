"""`jointest bench`: what the estimators, the nodes and the evaluation of recordings cost on this machine."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jointest_ros.benchmark.part import BenchError, Options, PartResult, Run, document
from jointest_ros.cli.common import Parsers, add_params, complain, given_params, needs_ros, out, progress, write_text
from jointest_ros.cli.tables import result_table
from jointest_ros.reproduction.result import Report

FAILED = 1


@dataclass(frozen=True)
class Part:
    """One part; soak takes long and is run by its name only."""

    description: str
    run: Run
    by_default: bool = True


# Each imports what it needs when it is run: nodes need ROS 2, and every command reads this file.


def _steps(options: Options, report: Report) -> PartResult:
    from jointest_ros.benchmark.steps import run

    return run(options, report)


def _nodes(options: Options, report: Report) -> PartResult:
    with needs_ros():
        from jointest_ros.nodes.bench import run
    return run(options, report)


def _offline(options: Options, report: Report) -> PartResult:
    from jointest_ros.benchmark.recordings import run

    return run(options, report)


def _joints(options: Options, report: Report) -> PartResult:
    from jointest_ros.benchmark.joints import run

    return run(options, report)


def _soak(options: Options, report: Report) -> PartResult:
    with needs_ros():
        from jointest_ros.nodes.soak import run
    return run(options, report)


PARTS = {
    "steps": Part("a step of every estimator, by update and by arrays, beside the peers", _steps),
    "nodes": Part("the nodes: CPU, lost messages, latency at 100 to 1000 Hz, beside a node that only receives", _nodes),
    "offline": Part("evaluation of recordings from mcap and sqlite3: multiples of real time, memory", _offline),
    "joints": Part("how the cost of a step grows from 2 to 32 joints", _joints),
    "soak": Part("hours of simulated messages through the nodes: memory, drift, counters", _soak, by_default=False),
}

_DESCRIPTION = """Measure what the estimators, the nodes and the evaluation of recordings cost on this machine, beside
the peers that are installed (extra `peers`) and beside the budget that the project gives itself.

parts (all but soak, unless some are named):
""" + "\n".join(f"  {name:9}{part.description}" for name, part in PARTS.items())

_EPILOG = """Costs are CPU times, medians of repetitions that alternate, so that a busy machine slows all of them alike.
Between machines, compare the ratios and not the microseconds.

  jointest bench                        some minutes
  jointest bench steps --quick          a first look
  jointest bench --json figures.json    figures for a program as well
  jointest bench soak --hours 24        a day of simulated messages, as fast as the nodes take them

Exit code 1: something was found that must not be (soak)."""


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "bench",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help="which of the parts above")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file as well")
    add_params(parser, Options)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of the command."""
    options = Options(**given_params(arguments, Options))
    chosen = _chosen(arguments.parts)
    if options.hours != Options.hours and "soak" not in chosen:
        raise BenchError("--hours: of no use without the part soak")
    if arguments.json:
        write_text(arguments.json, "")  # found out before the work is done
    results: dict[str, PartResult] = {}
    for name in chosen:
        with progress(f"bench {name}") as report:
            results[name] = PARTS[name].run(options, report)
        _show(name, results[name])
        if arguments.json:  # what was measured is kept when a later part fails
            write_text(arguments.json, json.dumps(document(results, options), indent=2, allow_nan=False) + "\n")
    if arguments.json:
        out.print(f"{arguments.json}: figures")
    return FAILED if any(result.failures for result in results.values()) else 0


def _chosen(names: list[str]) -> list[str]:
    for name in names:
        if name not in PARTS:
            raise BenchError(f"'{name}' is no part; give some of {', '.join(PARTS)}, or none for all but soak")
    return list(dict.fromkeys(names)) or [name for name, part in PARTS.items() if part.by_default]


def _show(name: str, result: PartResult) -> None:
    out.rule(f"{name}: {PARTS[name].description}", align="left")
    for table in result.tables:
        out.print(result_table(table))
    for line in result.conditions:
        out.print(f"- {line}")
    for line in result.failures:
        complain(f"bench {name}", line)
    out.print()
