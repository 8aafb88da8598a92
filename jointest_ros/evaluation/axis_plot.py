"""Identified joint axes as a picture: where they are beside the configured ones, and what the rates leave over."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jointest_ros.evaluation.axis_fit import Axis, AxisFit
from jointest_ros.evaluation.picture import save_pairs

_BINS = 300  # of a residual over time; the rms of each is drawn
_HEIGHT = 6.0  # inches, of one joint


def draw(path: Path, title: str, fits: Sequence[AxisFit]) -> None:
    """Write the picture; the suffix of `path` says which format. Raises PlotError when it cannot be written."""
    save_pairs(path, title, [(partial(_draw_axes, fit=one), partial(_draw_residual, fit=one)) for one in fits], _HEIGHT)


def _draw_axes(axes: Any, fit: AxisFit) -> None:
    """Seen along the configured axes: these at the origin, the identified ones with their ellipses of two sigma."""
    for axis, colour in zip(fit.axes, ("C0", "C3"), strict=True):
        if axis.kept:
            continue
        ring = np.degrees(_ring(axis))
        x, y = np.degrees(_place(axis))
        axes.plot(x + ring[:, 0], y + ring[:, 1], color=colour)
        label = f"{axis.sensor}: {math.degrees(axis.change):.2f} ± {math.degrees(axis.std):.3f} deg"
        axes.plot(x, y, "o", color=colour, label=label, markersize=4)
    axes.plot(0.0, 0.0, "k+", markersize=12, label="configured")
    axes.set(title=fit.pair.joint.name, xlabel="deg", ylabel="deg, across the axis")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(fontsize="small")
    axes.grid(color="0.9")


def _place(axis: Axis) -> Any:
    """(2,) rad, of the identified axis as seen from the configured one, along the directions `across`."""
    flat = axis.across @ (axis.axis - axis.configured)
    length = float(np.linalg.norm(flat))
    return flat * (axis.change / length if length > 0.0 else 0.0)


def _ring(axis: Axis) -> Any:
    """(n, 2) rad, two sigma about an axis: a tilt about u moves it along -v, one about v along u."""
    values, vectors = np.linalg.eigh(axis.covariance)
    circle = np.linspace(0.0, 2.0 * math.pi, 60)
    tilts = 2.0 * np.column_stack([np.cos(circle), np.sin(circle)]) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return np.column_stack([tilts[:, 1], -tilts[:, 0]])


def _draw_residual(axes: Any, fit: AxisFit) -> None:
    count = min(_BINS, len(fit.time))
    edges = np.linspace(fit.time[0], fit.time[-1], count + 1)
    place = np.clip(np.searchsorted(edges, fit.time, side="right") - 1, 0, count - 1)
    number = np.bincount(place, minlength=count)
    for values, colour, label in (
        (fit.residual_before_over_time, "0.6", "configured"),
        (fit.residual_over_time, "C0", "identified"),
    ):
        with np.errstate(invalid="ignore", divide="ignore"):
            rms = np.degrees(np.sqrt(np.bincount(place, values**2, minlength=count) / number))
        axes.plot(0.5 * (edges[1:] + edges[:-1]), rms, color=colour, label=label, linewidth=1.0)
    axes.set(xlabel="time, s", ylabel="rates left over, deg/s", yscale="log")
    axes.legend(fontsize="small")
    axes.grid(color="0.9")
