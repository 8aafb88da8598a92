"""Figures as tables for a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rich.table import Table

from jointest_ros.evaluation.report.kinds import FIGURES, KINDS, rows_of
from jointest_ros.reproduction.result import ResultTable


def columns(title: str, first: Sequence[str], numbers: Sequence[str]) -> Table:
    """An empty table with columns of names and columns of numbers."""
    table = Table(title=title, title_justify="left")
    for heading in first:
        table.add_column(heading, no_wrap=True)
    for heading in numbers:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def error_tables(estimators: dict[str, dict[str, Any]], imus: int = 0) -> Iterator[Table]:
    """Joint, velocity and orientation errors of all estimators, where there are any.

    With the number of `imus` of a frame also what a sample of one costs.
    """
    for kind, title in KINDS.items():
        if any(rows_of(figures, kind) for figures in estimators.values()):
            yield _table(title, estimators, kind, imus)


def consistency_line(estimators: dict[str, dict[str, Any]]) -> str:
    """NIS and NEES of those estimators that have them: 1 where the reported variances are right. "" without any."""
    cells = []
    for name, figures in estimators.items():
        both = [f"{key.upper()} {figures[key]:.2f}" for key in ("nis", "nees") if figures[key] is not None]
        if both:
            cells.append(f"{name} {' '.join(both)}")
    meaning = "consistency (1: the reported variances are right, more: they are too small)"
    return f"{meaning}: {', '.join(cells)}" if cells else ""


def _table(title: str, estimators: dict[str, dict[str, Any]], kind: str, imus: int) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in ("estimator", "of"):
        table.add_column(heading, overflow="fold")  # a name is shown whole
    for heading in (*FIGURES.values(), "coverage"):
        table.add_column(heading, justify="right")
    if imus:
        table.title, table.padding = f"{title}; ns: cost of a sample of one IMU", (0, 1, 0, 0)  # fits into 80 columns
        table.add_column("ns", justify="right")
    for name, figures in estimators.items():
        for what, values in rows_of(figures, kind).items():
            numbers = ["-" if values[key] is None else f"{values[key]:.3f}" for key in FIGURES]
            cost = [f"{figures['ns_per_frame'] / imus:.0f}"] if imus else []
            table.add_row(name, what, *numbers, f"{100.0 * values['coverage']:.1f} %", *cost)
    return table


def input_table(inputs: dict[str, dict[str, Any]]) -> Table:
    """Messages received, used and refused by topic."""
    table = Table(title="input messages", title_justify="left")
    table.add_column("topic")
    for heading in ("received", "used"):
        table.add_column(heading, justify="right")
    table.add_column("refused")
    for topic, counts in inputs.items():
        refused = ", ".join(f"{n} {cause}" for cause, n in sorted(counts["refused"].items()))
        table.add_row(topic, str(counts["messages"]), str(counts["used"]), refused or "none")
    return table


def result_table(figures: ResultTable) -> Table:
    """Words to the left, figures to the right."""
    table = Table(title=figures.title, title_justify="left")
    for number, column in enumerate(figures.columns):
        words = all(isinstance(row[number], str | None) for row in figures.rows)
        table.add_column(column, justify="left" if words else "right")
    for row in figures.rows:
        table.add_row(*map(figures.text, row))
    return table
