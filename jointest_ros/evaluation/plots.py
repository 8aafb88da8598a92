"""Estimates over ground truth as a picture: for each joint the angles, and below them the error with its band."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation.measures import rms
from jointest_ros.evaluation.panels import Curve, Panel, line
from jointest_ros.evaluation.picture import PlotError, save

SUFFIXES = (".png", ".svg", ".pdf")
_ROWS, _COLUMNS = 4, 3  # panels in one column, and columns; more panels make columns longer
_WIDTH, _HEIGHT = 10.0, 3.2  # inches, of one panel


def check_suffix(path: Path) -> None:
    """Raise a `PlotError` unless the suffix of `path` is that of a picture."""
    if path.suffix.lower() not in SUFFIXES:
        raise PlotError(f"{path}: the suffix '{path.suffix}' is not allowed; give one of {', '.join(SUFFIXES)}")


def draw(path: Path, title: str, shown: list[Panel]) -> None:
    """Write the picture of some panels; its suffix says which format. Touches no global state of matplotlib.

    Raises:
        PlotError: there is nothing to draw, the suffix is unknown, the file cannot be written.
    """
    check_suffix(path)
    if not shown:
        raise PlotError(f"{path}: nothing to draw: no estimate matches a ground truth")
    from matplotlib.figure import Figure  # takes longer to load than many a command to run

    columns = min(-(-len(shown) // _ROWS), _COLUMNS)
    rows = -(-len(shown) // columns)
    names = list(dict.fromkeys(name for panel in shown for name in panel.curves))
    colours = {name: f"C{number}" for number, name in enumerate(names)}
    figure = Figure(figsize=(_WIDTH * columns, _HEIGHT * rows + 0.6), dpi=120, layout="constrained")
    figure.suptitle(f"{title}\n{_overall(names, shown)}", fontsize="medium")
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=(3, 2) * rows)
    for number, panel in enumerate(shown):
        column, row = divmod(number, rows)
        first, second = grid[2 * row, column], grid[2 * row + 1, column]
        upper = None
        if panel.truth is None:
            second = grid[2 * row : 2 * row + 2, column]
        else:
            upper = figure.add_subplot(first)
            _draw_angles(upper, panel, panel.truth, colours)
        lower = figure.add_subplot(second, sharex=upper)
        _draw_errors(lower, panel, colours)
        (upper or lower).set_title(panel.name, loc="left", fontsize="medium")
        if row == rows - 1 or panel is shown[-1]:
            lower.set_xlabel("time, s")
    figure.align_ylabels()
    save(figure, path)


def _overall(names: list[str], shown: list[Panel]) -> str:
    errors = {name: [panel.curves[name].error for panel in shown if name in panel.curves] for name in names}
    return "rms: " + ", ".join(f"{name} {rms(np.concatenate(parts)):.3f} deg" for name, parts in errors.items())


def _draw_angles(axes: Any, panel: Panel, truth: tuple[FloatArray, FloatArray], colours: Mapping[str, str]) -> None:
    axes.plot(*line(*truth), color="0.6", linewidth=2.5, label="truth")
    for name, curve in panel.curves.items():
        if curve.estimate is not None:
            axes.plot(*line(curve.seconds, curve.estimate), color=colours[name], linewidth=1.0, label=name)
    axes.set_ylabel("angle, deg")
    axes.tick_params(labelbottom=False)
    _finish(axes)


def _draw_errors(axes: Any, panel: Panel, colours: Mapping[str, str]) -> None:
    axes.axhline(0.0, color="0.6", linewidth=0.8)
    for name, curve in panel.curves.items():
        label = f"{name}: rms {rms(curve.error):.3f}, std {np.std(curve.error):.3f}"
        axes.plot(*line(curve.seconds, curve.error), color=colours[name], linewidth=0.8, alpha=0.6, label=label)
    for name, curve in panel.curves.items():
        if curve.spread is not None:
            seconds, spread = line(curve.seconds, curve.spread)
            band = "±2 reported std" if name == next(iter(panel.curves)) else None
            axes.fill_between(seconds, -spread, spread, color=colours[name], alpha=0.15, linewidth=0.0, label=band)
            for edge in (-spread, spread):  # seen also where the error is wider than the band
                axes.plot(seconds, edge, color=colours[name], linewidth=1.0, linestyle="--")
    axes.set_ylim(*_limits(panel.curves.values()))
    axes.set_ylabel("error, deg")
    _finish(axes)


def _finish(axes: Any) -> None:
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.margins(x=0.0)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.05), fontsize="small", frameon=False)


def _limits(curves: Collection[Curve]) -> tuple[float, float]:
    """Of the error: all errors, and the narrowest band as it usually is (it may be as wide as a turn at the start)."""
    usual = min((float(np.median(curve.spread)) for curve in curves if curve.spread is not None), default=0.0)
    low = min(-usual, 0.0, *(float(curve.error.min()) for curve in curves))
    high = max(usual, 0.0, *(float(curve.error.max()) for curve in curves))
    margin = 0.08 * (high - low) or 1.0
    return low - margin, high + margin
