"""Calibrated accelerometers as a picture: what each pose leaves, as configured and as fitted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation.accel_calibration import AccelFit, rms
from jointest_ros.evaluation.plots import PlotError

_COLUMNS = 4
_WIDTH, _HEIGHT = 4.2, 5.0  # inches, of one sensor


@dataclass(frozen=True)
class FittedAccel:
    """What is shown of one sensor: name, the direction of each of its N poses, and its fit."""

    name: str
    poses: tuple[str, ...]
    fit: AccelFit


def draw(path: Path, title: str, sensors: Sequence[FittedAccel], gravity: float) -> None:
    """Write the picture; the suffix of `path` says which format. Raises PlotError when it cannot be written."""
    from matplotlib.figure import Figure  # takes longer to load than many a command to run

    columns = min(_COLUMNS, len(sensors))
    rows = math.ceil(len(sensors) / columns)
    figure = Figure(figsize=(_WIDTH * columns, _HEIGHT * rows), dpi=100, layout="constrained")
    figure.suptitle(title)
    grid = figure.add_gridspec(2 * rows, columns)
    for number, shown in enumerate(sensors):
        row, column = divmod(number, columns)
        for below, (what, residual) in enumerate((("as configured", shown.fit.before), ("fitted", shown.fit.residual))):
            axes = figure.add_subplot(grid[2 * row + below, column])
            _draw(axes, f"{shown.name}, {what}", shown.poses, 1e3 * residual / gravity)
    try:
        figure.savefig(path)
    except OSError as error:
        raise PlotError(f"{path}: cannot be written: {error.strerror}") from None


def _draw(axes: Any, title: str, poses: Sequence[str], residual: FloatArray) -> None:
    """`residual`: (N, 3), mg."""
    places = np.arange(len(poses))
    for axis, colour in enumerate(("C3", "C2", "C0")):
        axes.plot(places, residual[:, axis], "o", color=colour, markersize=4, label="xyz"[axis])
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    axes.set_xticks(places, poses, fontsize="small", rotation=0 if len(poses) <= 12 else 90)
    axes.set(xlabel="pose", ylabel="residual, mg")
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5), handletextpad=0.0, frameon=False)
    axes.set_title(f"{title}: rms {rms(residual):.2f} mg", fontsize="medium")
    axes.grid(color="0.9")
