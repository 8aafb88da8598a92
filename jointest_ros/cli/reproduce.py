"""`jointest reproduce`: the papers' tables and figures beside ours, computed at that moment."""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.table import Table

from jointest_ros.cli.common import Parsers, out, progress
from jointest_ros.cli.parallel import add_workers, given_workers
from jointest_ros.cli.tables import result_table
from jointest_ros.core.params import allowed_text
from jointest_ros.reproduction.result import Options, Reproduction, ReproductionError, Result

Catalogue = Mapping[str, Reproduction]
SCHEMA = 1
ALL = "all"
DPI = 120


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "reproduce",
        description="Compute tables and figures of the papers anew and show them beside the printed ones. Each writes "
        "NAME.png and NAME.json into the output directory. Without a name: the list.",
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which, or '{ALL}'")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("reproduction"), metavar="DIR", help="default: ./%(default)s"
    )
    for spec in dataclasses.fields(Options):
        text = spec.metadata["description"]
        if spec.type != "str":
            text += f" ({allowed_text(spec)}; default: {spec.default})"
        parser.add_argument(
            _flag(spec.name), dest=spec.name, type=type(spec.default), default=spec.default, metavar="X", help=text
        )
    add_workers(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of the command."""
    from jointest_ros.reproduction.catalogue import REPRODUCTIONS

    if not arguments.names:
        out.print(_list(REPRODUCTIONS))
        out.print("jointest reproduce NAME..., or all", markup=False)
        return 0
    chosen = _chosen(arguments.names, REPRODUCTIONS)
    options = Options(**{spec.name: getattr(arguments, spec.name) for spec in dataclasses.fields(Options)})
    _check_use(chosen, options, REPRODUCTIONS)
    workers = given_workers(arguments)
    _make(arguments.output)
    for entry in chosen:
        with progress(entry.name) as report:
            result = entry.run(report, options, workers)
            written = _write(arguments.output, entry, options, result)
        out.rule(f"{entry.name}: {entry.description}", align="left")
        _show(result)
        out.print(f"written: {', '.join(map(str, written))}", markup=False)
        out.print()
    return 0


def _flag(name: str) -> str:
    return "--" + name.removesuffix("_s")


def _list(known: Catalogue) -> Table:
    table = Table(title="what can be reproduced", title_justify="left")
    for column in ("name", "paper", "options"):
        table.add_column(column)
    for entry in known.values():
        table.add_row(entry.name, entry.description, " ".join(map(_flag, entry.uses)))
    return table


def _chosen(names: list[str], known: Catalogue) -> list[Reproduction]:
    for name in names:
        if name != ALL and name not in known:
            raise ReproductionError(f"'{name}' cannot be reproduced; give {ALL} or some of {', '.join(known)}")
    return list(known.values()) if ALL in names else [known[name] for name in dict.fromkeys(names)]


def _check_use(chosen: list[Reproduction], options: Options, known: Catalogue) -> None:
    """An option that would have no effect is refused."""
    for spec in dataclasses.fields(options):
        if getattr(options, spec.name) != spec.default and not any(spec.name in entry.uses for entry in chosen):
            users = [entry.name for entry in known.values() if spec.name in entry.uses]
            raise ReproductionError(
                f"{_flag(spec.name)}: of no use for {', '.join(entry.name for entry in chosen)}; "
                f"only for {', '.join(users)}"
            )


def _make(directory: Path) -> None:
    """Find out before the work is done whether its results can be written."""
    probe = directory / ".jointest-reproduce"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ReproductionError(f"--output {directory}: cannot be written: {error.strerror}") from None


def _write(directory: Path, entry: Reproduction, options: Options, result: Result) -> tuple[Path, Path]:
    from matplotlib.figure import Figure

    picture, figures = directory / f"{entry.name}.png", directory / f"{entry.name}.json"
    figure = Figure(figsize=result.size, layout="constrained")
    result.draw(figure)
    used = {name: getattr(options, name) for name in entry.uses}
    document = {"schema": SCHEMA, "name": entry.name, "options": used, **result.document()}
    try:
        figure.savefig(picture, dpi=DPI)
        figures.write_text(json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise ReproductionError(f"--output {directory}: cannot be written: {error.strerror}") from None
    return picture, figures


def _show(result: Result) -> None:
    for table in result.tables:
        out.print(result_table(table))
    for heading, lines in (("Conditions", result.conditions), ("Remarks", result.remarks)):
        if lines:
            out.print(f"{heading}:", style="bold")
        for line in lines:
            out.print(f"- {line}", markup=False)
