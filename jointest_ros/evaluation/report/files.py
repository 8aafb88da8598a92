"""The files of a report: page, pictures, tables of numbers, and the JSON by which later evaluations compare.

index.html               the page
figures.json             as of `evaluate --json`
plots/*.png              angles and errors, distribution, consistency, comparison
series/<joint>.csv       truth, estimates, errors and standard deviations of the truth samples
series/errors.csv        the error figures; series/consistency.csv: NIS and NEES over time
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation import plots
from jointest_ros.evaluation.panels import Panel
from jointest_ros.evaluation.report import pictures
from jointest_ros.evaluation.report.changes import Changes
from jointest_ros.evaluation.report.content import Evaluation, Origin
from jointest_ros.evaluation.report.kinds import KINDS, rows_of
from jointest_ros.evaluation.report.library import ReportError
from jointest_ros.evaluation.report.page import Page


def write(folder: Path, evaluation: Evaluation, origin: Origin, library: str, changes: Changes | None = None) -> None:
    """The report of one recording. Files of these names are replaced.

    Args:
        library: source of plotly.js.

    Raises:
        ReportError: something cannot be written.
        PlotError: a picture cannot be written.
    """
    page = Page(evaluation, origin, changes)
    try:
        for name in ("plots", "series"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        write_json(folder / "figures.json", evaluation.document)
        _write_series(folder / "series", page)
        _write_plots(folder / "plots", page)
        (folder / "index.html").write_text(page.html(library), encoding="utf-8")
    except OSError as error:
        raise ReportError(f"{error.filename or folder}: cannot be written: {error.strerror}") from None


def write_json(path: Path, document: Any) -> None:
    """As `evaluate --json`."""
    path.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def make_folder(folder: Path) -> None:
    """Make a folder where there is none. Raises ReportError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ReportError(f"{folder}: cannot be made: {error.strerror}") from None


def _write_series(folder: Path, page: Page) -> None:
    zero = page.evaluation.zero
    for panel in (*page.joints, *page.torso, *page.inclinations):
        _write_panel(folder / f"{_file_name(panel.name)}.csv", panel, "deg", zero)
    for panel in page.velocities:
        _write_panel(folder / f"{_file_name(panel.name)}_velocity.csv", panel, "dps", zero)
    figures = (
        [name, kind, part, *("" if value is None else value for value in one.values())]
        for name, table in page.estimators.items()
        for kind in KINDS
        for part, one in rows_of(table, kind).items()
    )
    headings = ["estimator", "kind", "of", "rmse_deg", "bias_deg", "std_deg", "max_abs_deg", "samples", "coverage"]
    _write_rows(folder / "errors.csv", headings, figures)
    courses = (
        [name, kind, *(f"{value:.6g}" for value in row)]
        for kind, found in (("nees", page.nees), ("nis", page.nis))
        for name, course in found.items()
        for row in zip(course.seconds, course.ratio, course.low, course.high, strict=True)
    )
    _write_rows(folder / "consistency.csv", ["estimator", "kind", "time_s", "ratio", "low", "high"], courses)


def _write_panel(path: Path, panel: Panel, unit: str, zero: int) -> None:
    """One row a truth sample that any estimator matches; empty where one does not. `zero`: stamp of time 0, ns."""
    every = np.unique(np.concatenate([curve.stamps for curve in panel.curves.values()]))
    seconds = (every - zero) * 1e-9
    columns: dict[str, FloatArray] = {}
    if panel.truth is not None:
        columns[f"truth_{unit}"] = panel.truth[1][np.searchsorted(panel.truth[0], seconds)]
    for name, curve in panel.curves.items():
        rows = np.searchsorted(every, curve.stamps)
        std = None if curve.spread is None else 0.5 * curve.spread
        for what, values in (("estimate", curve.estimate), ("error", curve.error), ("std", std)):
            if values is not None:
                columns[f"{name}_{what}_{unit}"] = column = np.full(len(every), np.nan)
                column[rows] = values
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(",".join(["stamp_ns", "time_s", *columns]) + "\n")
        table = (column.tolist() for column in columns.values())
        for stamp, second, *row in zip(every.tolist(), seconds.tolist(), *table, strict=True):
            numbers = ",".join(["" if value != value else f"{value:.6g}" for value in row])
            stream.write(f"{stamp},{second:.6f},{numbers}\n")


def _write_rows(path: Path, headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(headings)
        writer.writerows(rows)


def _write_plots(folder: Path, page: Page) -> None:
    shown = [*page.joints, *page.inclinations]
    if shown:
        one = page.evaluation
        title = f"{one.document['bag']}: {one.document['duration_s']:.1f} s"
        plots.draw(folder / "angles_and_errors.png", title, shown)
        pictures.distributions(folder / "distribution.png", shown)
    pictures.comparison(folder / "comparison.png", page.estimators)
    pictures.consistency(folder / "consistency.png", page.nees, page.nis)


def _file_name(text: str) -> str:
    """Of a joint or sensor, safe in every file system."""
    return re.sub(r"[^\w.-]+", "_", text)
