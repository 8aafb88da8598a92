"""The pictures beside a page: distribution of the errors, comparison of estimators, consistency."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jointest_ros.evaluation.panels import Panel
from jointest_ros.evaluation.picture import save
from jointest_ros.evaluation.report.consistency import Course
from jointest_ros.evaluation.report.summary import ranking

_COLUMNS = 4
_SIZE = (4.2, 3.0)  # inches, of one plot


def distributions(path: Path, panels: Sequence[Panel]) -> None:
    """Share of the samples within an error, a plot for each panel. Raises PlotError when it cannot be written."""
    columns = min(_COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure = _figure(columns, rows)
    colours = _colours(name for panel in panels for name in panel.curves)
    percent = np.linspace(0.0, 100.0, 201)
    for number, panel in enumerate(panels):
        axes = figure.add_subplot(rows, columns, number + 1)
        for name, curve in panel.curves.items():
            size = np.maximum(np.quantile(np.abs(curve.error), percent / 100.0), 1e-6)
            axes.semilogx(size, percent, color=colours[name], label=name)
        axes.set(title=panel.name, xlabel="size of the error, deg", ylabel="samples within it, %")
        _finish(axes)
    save(figure, path)


def comparison(path: Path, estimators: Mapping[str, Any]) -> None:
    """Root mean square of the error by estimator. Raises PlotError when it cannot be written."""
    ranked = ranking(estimators)
    figure = _figure(1.5, max(1.0, 0.15 * len(ranked)))
    axes = figure.add_subplot()
    names = [name for name, _ in reversed(ranked)]
    bars = axes.barh(names, [whole.rmse_deg for _, whole in reversed(ranked)], color="C0")
    axes.bar_label(bars, fmt="%.3g", padding=3)
    axes.margins(x=0.12)
    axes.set_xlabel("rms error, deg")
    axes.grid(axis="x", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    save(figure, path)


def consistency(path: Path, nees: Mapping[str, Course], nis: Mapping[str, Course]) -> None:
    """NEES and NIS over time with their bounds. Raises PlotError when it cannot be written."""
    colours = _colours((*nees, *nis))
    figure = _figure(2, 2)
    for row, (title, shown) in enumerate((("NEES", nees), ("NIS", nis))):
        axes = figure.add_subplot(2, 1, row + 1)
        for name, course in shown.items():
            axes.semilogy(course.seconds, course.ratio, color=colours[name], linewidth=1.0, label=name)
            for bound in (course.low, course.high):
                axes.semilogy(course.seconds, bound, color=colours[name], linewidth=0.8, linestyle="--")
        axes.axhline(1.0, color="0.5", linewidth=0.8)
        axes.set(ylabel=f"{title} (1 is right)", xlabel="time, s")
        _finish(axes)
    save(figure, path)


def _figure(columns: float, rows: float) -> Any:
    from matplotlib.figure import Figure  # takes longer to load than many a command to run

    return Figure(figsize=(_SIZE[0] * columns, _SIZE[1] * rows), dpi=110, layout="constrained")


def _colours(names: Iterable[str]) -> dict[str, str]:
    return {name: f"C{number}" for number, name in enumerate(dict.fromkeys(names))}


def _finish(axes: Any) -> None:
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize="small", frameon=False)
