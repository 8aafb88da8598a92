"""Errors of estimates against ground truth, in degrees: the figures of `jointest evaluate --json`.

Nothing is fitted or removed first. `rmse_deg` is the root mean square of estimate minus truth over the truth samples
that an estimate matches within half a truth period, `bias_deg` the mean of that difference, `std_deg` its standard
deviation, `coverage` the matched share of the truth samples.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Series, Status
from jointest_ros.evaluation.truth import Truth, match

UNUSABLE = int(Status.STARTING | Status.STALE)  # such a position is not published, and not judged


def summarize(error_deg: FloatArray, expected: int) -> dict[str, float | int | None]:
    """Figures of (K,) errors in degrees of which there could have been `expected`; None where there is none."""
    figures: dict[str, float | int | None] = dict.fromkeys(("rmse_deg", "bias_deg", "std_deg", "max_abs_deg"))
    if len(error_deg):
        figures["rmse_deg"] = float(np.sqrt(np.mean(error_deg**2)))
        figures["bias_deg"] = float(np.mean(error_deg))
        figures["std_deg"] = float(np.std(error_deg))
        figures["max_abs_deg"] = float(np.max(np.abs(error_deg)))
    figures["samples"] = len(error_deg)
    figures["coverage"] = len(error_deg) / expected if expected else 0.0
    return figures


def joint_errors(
    series: Series, joints: tuple[str, ...], truth: Truth, skip_s: float = 0.0, continuous: Collection[str] = ()
) -> dict[str, dict[str, Any]]:
    """`joints` and `velocities` of the JSON for every joint that has a truth.

    Args:
        series: estimates, columns as `joints`.
        skip_s: truth samples before this time after the first are left out, s.
        continuous: joints whose error is wrapped to [-180, 180) deg.
    """
    kept = _after(truth.stamps, skip_s)
    positions: dict[str, Any] = {}
    velocities: dict[str, Any] = {}
    for column, joint in enumerate(joints):
        usable = (series.status[:, column] & UNUSABLE) == 0
        for table, estimates, truths in (
            (positions, series.position, truth.position),
            (velocities, series.velocity, truth.velocity),
        ):
            if joint not in truths or not np.isfinite(truths[joint][kept]).any():
                continue
            known = kept & np.isfinite(truths[joint])
            rows, matched = match(series.stamps[usable], truth.stamps[known])
            error = np.degrees(estimates[usable, column][rows] - truths[joint][known][matched])
            if table is positions and joint in continuous:
                error = (error + 180.0) % 360.0 - 180.0
            table[joint] = summarize(error, int(known.sum()))
    return {"joints": positions, "velocities": velocities}


def inclination_errors(series: Series, truth: Truth, skip_s: float = 0.0) -> dict[str, dict[str, Any]]:
    """`orientation` of the JSON: angle between estimated and true vertical of every sensor, degrees."""
    table: dict[str, Any] = {}
    for sensor, (stamps, quaternions) in truth.orientation.items():
        if sensor not in series.orientation:
            continue
        estimates = series.orientation[sensor]
        usable = np.isfinite(estimates).all(axis=1)
        kept = _after(stamps, skip_s)
        rows, matched = match(series.stamps[usable], stamps[kept])
        error = np.empty(0)
        if len(rows):
            error = inclination_deg(estimates[usable][rows], quaternions[kept][matched])
        table[sensor] = {"inclination": summarize(error, int(kept.sum()))}
    return table


def inclination_deg(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Angle between the world's vertical as seen by two (K, 4) quaternions (sensor to world), (K,) degrees."""
    up = np.array([0.0, 0.0, 1.0])
    one, two = (Rotation.from_quat(q).inv().apply(up) for q in (estimate, truth))
    sine = np.linalg.norm(np.cross(one, two), axis=1)
    return np.asarray(np.degrees(np.arctan2(sine, (one * two).sum(axis=1))))


def errors(
    series: Series, joints: tuple[str, ...], truth: Truth, skip_s: float, continuous: Collection[str]
) -> dict[str, Any]:
    """All error figures of one estimator, keyed as in the JSON of the design."""
    table: dict[str, Any] = joint_errors(series, joints, truth, skip_s, continuous)
    return {**table, "torso": {}, "orientation": inclination_errors(series, truth, skip_s), "nis": None, "nees": None}


def has_figures(table: Mapping[str, Any]) -> bool:
    """Whether anything in a table of `errors` was matched with a truth."""
    figures = [*table["joints"].values(), *(sensor["inclination"] for sensor in table["orientation"].values())]
    return any(figure["samples"] for figure in figures)


def _after(stamps: NDArray[np.int64], skip_s: float) -> NDArray[np.bool_]:
    if not len(stamps):
        return np.zeros(0, dtype=bool)
    return np.asarray(stamps - stamps[0] >= round(skip_s * 1e9))
