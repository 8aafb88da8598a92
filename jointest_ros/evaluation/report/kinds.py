"""The kinds of errors in the figures of one estimator, and what tables call them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

KINDS = {  # title of its table
    "joints": "joint angle errors, deg",
    "velocities": "joint velocity errors, deg/s",
    "torso": "torso errors, deg",
    "inclination": "inclination errors, deg",
    "heading": "heading errors, deg",
}
FIGURES = {"rmse_deg": "rmse", "bias_deg": "bias", "std_deg": "std", "max_abs_deg": "max"}  # heading of its column


def rows_of(figures: Mapping[str, Any], kind: str) -> dict[str, Any]:
    """Error figures of one of `KINDS` by joint, component or sensor."""
    if kind in ("inclination", "heading"):
        return {sensor: one[kind] for sensor, one in figures["orientation"].items() if kind in one}
    return dict(figures[kind])
