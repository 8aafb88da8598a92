"""What `jointest evaluate` prints and writes, one recording after the other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from rich.table import Table

from jointest_ros.cli.common import OutputError, err, out, warn
from jointest_ros.cli.evaluate_bag import Done
from jointest_ros.cli.tables import consistency_line, error_tables, input_table
from jointest_ros.evaluation.report import files, page
from jointest_ros.evaluation.report.changes import Changes
from jointest_ros.evaluation.report.content import Origin


def show(done: Done, skip_s: float, imus: int, *, figures: bool) -> None:
    """Print one recording.

    Args:
        imus: in a frame, where the cost of a sample is to be shown.
        figures: the tables; standard output is free for them.
    """
    for text in done.warnings:
        warn(text)
    if done.document and figures:
        estimators = done.document["estimators"]
        out.print(f"{done.bag}: {done.document['duration_s']:.1f} s, after {skip_s:g} s")
        for table in (*error_tables(estimators, imus), input_table(done.document["input"])):
            out.print(table)
        if done.headings:
            cells = ", ".join(f"{name} {heading}" for name, heading in done.headings.items())
            out.print(f"heading of the peers, the better of two ways each: {cells}")
        if line := consistency_line(estimators):
            out.print(line)
    if done.changes:
        console = out if figures else err
        console.print(_changes_table(done.changes))
        for text in done.changes.notes:
            console.print(text)
    for text in done.written:
        err.print(text)


def write_index(folder: Path, finished: Sequence[Done], origin: Origin, names: Sequence[str]) -> None:
    """The page over several recordings, and their figures.json; `names`: folders of their pages. Raises OutputError."""
    rows = [
        (f"{quote(name)}/index.html", done.damage or "; ".join(done.warnings) or "nothing found", done.document)
        for done, name in zip(finished, names, strict=True)
        if done.document
    ]
    failed = [done.error for done in finished if done.error]
    try:
        files.write_json(folder / "figures.json", [document for *_, document in rows])
        text = page.index(f"{len(rows)} recordings", rows, origin, failed)
        (folder / "index.html").write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror}") from None
    err.print(f"{folder / 'index.html'}: report")


def unique_names(bags: Sequence[Path]) -> list[str]:
    """Names of recordings for files of theirs."""
    names = [bag.resolve().name for bag in bags]
    return [name if names.count(name) == 1 else f"{name}_{number}" for number, name in enumerate(names, 1)]


def _changes_table(changes: Changes) -> Table:
    title = f"rms errors since {changes.source}, deg or deg/s; within {changes.tolerance:g} % is the same"
    table = Table(title=title, title_justify="left")
    for heading in ("estimator", "of", ""):
        table.add_column(heading, overflow="fold")
    for heading in ("old", "new", "difference"):
        table.add_column(heading, justify="right")
    table.add_column("")
    for row in changes.rows:
        numbers = ["-" if value is None else f"{value:.3f}" for value in (row.old, row.new)]
        table.add_row(row.estimator, row.kind, row.part, *numbers, row.difference(), row.verdict)
    return table
