"""Estimates over ground truth as a picture: for each joint the angles, and below them the error with its band."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray, Series
from jointest_ros.evaluation.metrics import MatchedError, after, inclination_error, joint_error
from jointest_ros.evaluation.picture import PlotError, save
from jointest_ros.evaluation.truth import Truth

SUFFIXES = (".png", ".svg", ".pdf")
_STRETCHES = 1500  # a longer line is drawn by the lowest and highest value of so many stretches of time
_GAP = 10  # intervals without a sample that interrupt a line
_ROWS = 4  # panels in one column
_WIDTH, _HEIGHT = 10.0, 3.2  # inches, of one panel


@dataclass(frozen=True)
class Curve:
    """What one estimator gives at the truth samples that it matches: (K,) each.

    Attributes:
        seconds: after the first truth sample.
        error: estimate minus truth, deg.
        estimate: deg; None where an error has no angle to it (inclination).
        spread: two reported standard deviations, deg; None where none is reported.
    """

    seconds: FloatArray
    error: FloatArray
    estimate: FloatArray | None = None
    spread: FloatArray | None = None


@dataclass(frozen=True)
class Panel:
    """One joint, or the inclination of one sensor: curves by estimator, and the truth as (s, deg) for a joint."""

    name: str
    curves: dict[str, Curve]
    truth: tuple[FloatArray, FloatArray] | None = None


def check_suffix(path: Path) -> None:
    """Raise a `PlotError` unless the suffix of `path` is that of a picture."""
    if path.suffix.lower() not in SUFFIXES:
        raise PlotError(f"{path}: the suffix '{path.suffix}' is not allowed; give one of {', '.join(SUFFIXES)}")


def panels(
    series: Mapping[str, Series],
    joints: Mapping[str, tuple[str, ...]],
    truth: Truth,
    skip_s: float = 0.0,
    continuous: Collection[str] = (),
) -> list[Panel]:
    """Whatever an estimator can be compared with the truth in, joints first.

    Args:
        series: estimates by estimator.
        joints: by estimator, the columns of its series.
        skip_s, continuous: as in `metrics.errors`.
    """
    found = []
    for joint, angles in truth.position.items():
        curves = {}
        for name, columns in joints.items():
            if joint in columns:
                column, one = columns.index(joint), series[name]
                error = joint_error(one, column, truth, joint, skip_s, wrapped=joint in continuous)
                if error is not None and len(error.rows):
                    estimate = np.degrees(one.position[error.rows, column])
                    spread = 2.0 * np.degrees(np.sqrt(one.variance[error.rows, column]))
                    reported = spread if np.isfinite(spread).all() else None  # peers report none
                    curves[name] = Curve(_seconds(error.stamps, truth.stamps), error.degrees, estimate, reported)
        known = after(truth.stamps, skip_s) & np.isfinite(angles)
        if curves:
            found.append(Panel(joint, curves, (_seconds(truth.stamps[known], truth.stamps), np.degrees(angles[known]))))
    for sensor, (stamps, _) in truth.orientation.items():
        errors: dict[str, MatchedError | None] = {
            name: inclination_error(one, truth, sensor, skip_s) for name, one in series.items()
        }
        curves = {
            name: Curve(_seconds(error.stamps, stamps), error.degrees)
            for name, error in errors.items()
            if error is not None and len(error.rows)
        }
        if curves:
            found.append(Panel(f"inclination of {sensor}", curves))
    return found


def draw(path: Path, title: str, shown: list[Panel]) -> None:
    """Write the picture of some panels; its suffix says which format. Touches no global state of matplotlib.

    Raises:
        PlotError: there is nothing to draw, the suffix is unknown, the file cannot be written.
    """
    check_suffix(path)
    if not shown:
        raise PlotError(f"{path}: nothing to draw: no estimate matches a ground truth")
    from matplotlib.figure import Figure  # takes longer to load than many a command to run

    columns = -(-len(shown) // _ROWS)
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
    return "rms: " + ", ".join(f"{name} {_rms(np.concatenate(parts)):.3f} deg" for name, parts in errors.items())


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
        label = f"{name}: rms {_rms(curve.error):.3f}, std {np.std(curve.error):.3f}"
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


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _limits(curves: Collection[Curve]) -> tuple[float, float]:
    """Of the error: all errors, and the narrowest band as it usually is (it may be as wide as a turn at the start)."""
    usual = min((float(np.median(curve.spread)) for curve in curves if curve.spread is not None), default=0.0)
    low = min(-usual, 0.0, *(float(curve.error.min()) for curve in curves))
    high = max(usual, 0.0, *(float(curve.error.max()) for curve in curves))
    margin = 0.08 * (high - low) or 1.0
    return low - margin, high + margin


def line(seconds: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(K,) rising times and values as they are drawn: thinned where there are many, NaN where samples are missing."""
    if len(values) > 2 * _STRETCHES:
        edges = np.linspace(seconds[0], seconds[-1], _STRETCHES, endpoint=False)
        first = np.unique(np.searchsorted(seconds, edges))
        low, high = np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)
        seconds, values = np.repeat(seconds[first], 2), np.column_stack([low, high]).ravel()
    steps = np.diff(seconds)
    usual = np.median(steps[steps > 0.0]) if (steps > 0.0).any() else np.inf
    gaps = np.flatnonzero(steps > _GAP * usual) + 1
    return np.insert(seconds, gaps, np.nan), np.insert(values, gaps, np.nan)


def _seconds(stamps: NDArray[np.int64], all_stamps: NDArray[np.int64]) -> FloatArray:
    return (stamps - all_stamps[0]) * 1e-9
