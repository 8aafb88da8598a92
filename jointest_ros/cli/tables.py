"""Figures as tables for a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.table import Table

_COLUMNS = (("rmse_deg", "rmse"), ("bias_deg", "bias"), ("std_deg", "std"), ("max_abs_deg", "max"))


def error_tables(estimators: dict[str, dict[str, Any]], imus: int = 0) -> Iterator[Table]:
    """Joint, velocity and orientation errors of all estimators, where there are any.

    With the number of `imus` of a frame also what a sample of one costs.
    """
    for title, rows in (
        ("joint angle errors, deg", lambda figures: figures["joints"]),
        ("joint velocity errors, deg/s", lambda figures: figures["velocities"]),
        ("torso errors, deg", lambda figures: figures["torso"]),
        ("inclination errors, deg", lambda figures: {s: f["inclination"] for s, f in figures["orientation"].items()}),
        ("heading errors, deg", lambda figures: _headings(figures["orientation"])),
    ):
        if any(rows(figures) for figures in estimators.values()):
            yield _table(title, estimators, rows, imus)


def _headings(orientation: dict[str, dict[str, Any]]) -> dict[str, Any]:
    return {sensor: figures["heading"] for sensor, figures in orientation.items() if "heading" in figures}


def consistency_line(estimators: dict[str, dict[str, Any]]) -> str:
    """NIS and NEES of those estimators that have them: 1 where the reported variances are right. "" without any."""
    cells = []
    for name, figures in estimators.items():
        both = [f"{key.upper()} {figures[key]:.2f}" for key in ("nis", "nees") if figures[key] is not None]
        if both:
            cells.append(f"{name} {' '.join(both)}")
    meaning = "consistency (1: the reported variances are right, more: they are too small)"
    return f"{meaning}: {', '.join(cells)}" if cells else ""


def _table(title: str, estimators: dict[str, dict[str, Any]], rows: Any, imus: int) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in ("estimator", "of"):
        table.add_column(heading, overflow="fold")  # a name is shown whole
    for _, heading in _COLUMNS:
        table.add_column(heading, justify="right")
    table.add_column("coverage", justify="right")
    if imus:
        table.title, table.padding = f"{title}; ns: cost of a sample of one IMU", (0, 1, 0, 0)  # fits into 80 columns
        table.add_column("ns", justify="right")
    for name, figures in estimators.items():
        for what, values in rows(figures).items():
            numbers = ["-" if values[key] is None else f"{values[key]:.3f}" for key, _ in _COLUMNS]
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
