"""Fitted Hall sensors as a picture: readings and curve, and below them the residuals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.hall_sensor import HallSensor
from jointest_ros.evaluation.hall_calibration import HallFit
from jointest_ros.evaluation.picture import save_pairs

_POINTS = 3000  # of a panel; more readings are thinned
_HEIGHT = 5.0  # inches, of one sensor


@dataclass(frozen=True)
class FittedSensor:
    """What is drawn of one sensor: readings (N,) V over reference (N,) rad, its fit, and what was configured."""

    name: str
    volts: FloatArray
    reference: FloatArray
    fit: HallFit
    configured: HallSensor


def draw(path: Path, title: str, sensors: Sequence[FittedSensor]) -> None:
    """Write the picture; the suffix of `path` says which format. Raises PlotError when it cannot be written."""
    save_pairs(
        path, title, [(partial(_draw_curve, shown=one), partial(_draw_residual, shown=one)) for one in sensors], _HEIGHT
    )


def _draw_curve(axes: Any, shown: FittedSensor) -> None:
    fit, angles = shown.fit, np.degrees(shown.reference)
    for chosen, colour, label in ((~fit.used, "0.75", "not used"), (fit.used, "C0", "used")):
        rows = np.flatnonzero(chosen)[:: math.ceil(len(chosen) / _POINTS)]
        axes.plot(shown.volts[rows], angles[rows], ".", color=colour, markersize=2, label=label)
    limits = {"xlim": axes.get_xlim(), "ylim": axes.get_ylim()}
    everywhere = np.linspace(*fit.sensor.hall_range, 400)
    axes.plot(everywhere, np.degrees(shown.configured.angle(everywhere)), "--", color="0.4", label="configured")
    axes.plot(everywhere, np.degrees(fit.sensor.angle(everywhere)), "C3", label="fitted")
    curve = np.degrees(fit.sensor.angle(fit.volts))
    axes.fill_between(fit.volts, curve - 2.0 * fit.std_deg, curve + 2.0 * fit.std_deg, color="C3", alpha=0.3)
    axes.set(title=shown.name, xlabel="voltage, V", ylabel="joint angle, deg", **limits)
    axes.legend(fontsize="small", markerscale=4.0)
    axes.grid(color="0.9")


def _draw_residual(axes: Any, shown: FittedSensor) -> None:
    fit = shown.fit
    rows = np.flatnonzero(fit.used)[:: math.ceil(fit.used.sum() / _POINTS)]
    axes.plot(np.degrees(shown.reference[rows]), 1e3 * fit.residual[rows], ".", color="C0", markersize=2)
    axes.axhline(0.0, color="C3")
    axes.set(xlabel="joint angle, deg", ylabel="residual, mV")
    axes.set_title(f"rms {1e3 * fit.rms_volts:.1f} mV, {fit.rms_deg:.2f} deg", fontsize="medium")
    axes.grid(color="0.9")
