"""Calibrated accelerometers as a picture: what each pose leaves, as configured and as fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation.accel_calibration import AccelFit
from jointest_ros.evaluation.measures import rms_length
from jointest_ros.evaluation.picture import Draw, save_pairs

_HEIGHT = 5.0  # inches, of one sensor


@dataclass(frozen=True)
class FittedAccel:
    """What is shown of one sensor: name, the direction of each of its N poses, and its fit."""

    name: str
    poses: tuple[str, ...]
    fit: AccelFit


def draw(path: Path, title: str, sensors: Sequence[FittedAccel], gravity: float) -> None:
    """Write the picture; the suffix of `path` says which format. Raises PlotError when it cannot be written."""

    def plot(shown: FittedAccel, what: str, residual: FloatArray) -> Draw:
        return partial(_draw, title=f"{shown.name}, {what}", poses=shown.poses, residual=1e3 * residual / gravity)

    pairs = [(plot(one, "as configured", one.fit.before), plot(one, "fitted", one.fit.residual)) for one in sensors]
    save_pairs(path, title, pairs, _HEIGHT, ratios=(1, 1))


def _draw(axes: Any, title: str, poses: Sequence[str], residual: FloatArray) -> None:
    """`residual`: (N, 3), mg."""
    places = np.arange(len(poses))
    for axis, colour in enumerate(("C3", "C2", "C0")):
        axes.plot(places, residual[:, axis], "o", color=colour, markersize=4, label="xyz"[axis])
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    axes.set_xticks(places, poses, fontsize="small", rotation=0 if len(poses) <= 12 else 90)
    axes.set(xlabel="pose", ylabel="residual, mg")
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5), handletextpad=0.0, frameon=False)
    axes.set_title(f"{title}: rms {rms_length(residual):.2f} mg", fontsize="medium")
    axes.grid(color="0.9")
