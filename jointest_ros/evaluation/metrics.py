"""Errors of estimates against ground truth, in degrees: the figures of `jointest evaluate --json`.

Nothing is fitted or removed first. `rmse_deg` is the root mean square of estimate minus truth over the truth samples
that an estimate matches within half a truth period, `bias_deg` the mean of that difference, `std_deg` its standard
deviation, `coverage` the matched share of the truth samples.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Series, Status
from jointest_ros.core.torso import TorsoChain, torsos_of
from jointest_ros.evaluation.measures import rms
from jointest_ros.evaluation.truth import Truth, match

UNUSABLE = int(Status.STARTING | Status.STALE)  # such a position is not published, and not judged


@dataclass(frozen=True)
class MatchedError:
    """The truth samples that an estimate matches.

    Attributes:
        stamps: (K,) of the truth, ns.
        rows: (K,) of the series.
        degrees: (K,) estimate minus truth, deg or deg/s.
        expected: number of truth samples that could have been matched.
    """

    stamps: NDArray[np.int64]
    rows: NDArray[np.intp]
    degrees: FloatArray
    expected: int

    def figures(self) -> dict[str, float | int | None]:
        """As in the JSON."""
        return summarize(self.degrees, self.expected)


def summarize(error_deg: FloatArray, expected: int) -> dict[str, float | int | None]:
    """Figures of (K,) errors in degrees of which there could have been `expected`; None where there is none."""
    figures: dict[str, float | int | None] = dict.fromkeys(("rmse_deg", "bias_deg", "std_deg", "max_abs_deg"))
    if len(error_deg):
        figures["rmse_deg"] = rms(error_deg)
        figures["bias_deg"] = float(np.mean(error_deg))
        figures["std_deg"] = float(np.std(error_deg))
        figures["max_abs_deg"] = float(np.max(np.abs(error_deg)))
    figures["samples"] = len(error_deg)
    figures["coverage"] = len(error_deg) / expected if expected else 0.0
    return figures


def joint_error(
    series: Series,
    column: int,
    truth: Truth,
    joint: str,
    skip_s: float = 0.0,
    *,
    of: Literal["position", "velocity"] = "position",
    wrapped: bool = False,
) -> MatchedError | None:
    """Error of one joint, which is `column` of the series; None where the truth says nothing of it.

    Args:
        skip_s: truth samples before this time after the first are left out, s.
        wrapped: to [-180, 180) deg, for a position of a continuous joint.
    """
    estimates: FloatArray = getattr(series, of)[:, column]
    truths: FloatArray | None = getattr(truth, of).get(joint)
    if truths is None:
        return None
    known = after(truth.stamps, skip_s) & np.isfinite(truths)
    if not known.any():
        return None
    usable = np.flatnonzero(((series.status[:, column] & UNUSABLE) == 0) & np.isfinite(estimates))
    rows, matched = match(series.stamps[usable], truth.stamps[known])
    rows = usable[rows]
    degrees = np.degrees(estimates[rows] - truths[known][matched])
    if wrapped:
        degrees = _wrapped(degrees)
    return MatchedError(truth.stamps[known][matched], rows, degrees, int(known.sum()))


def inclination_error(series: Series, truth: Truth, sensor: str, skip_s: float = 0.0) -> MatchedError | None:
    """Angle between the estimated and the true vertical of one sensor; None where either has no orientation of it."""
    return _orientation_error(series, truth, sensor, skip_s, inclination_deg)


def heading_error(series: Series, truth: Truth, sensor: str, skip_s: float = 0.0) -> MatchedError | None:
    """Turn about the vertical from the true to the estimated orientation of one sensor; None as for the inclination."""
    return _orientation_error(series, truth, sensor, skip_s, heading_deg)


def _orientation_error(
    series: Series, truth: Truth, sensor: str, skip_s: float, degrees_of: Callable[[FloatArray, FloatArray], FloatArray]
) -> MatchedError | None:
    if sensor not in truth.orientation or sensor not in series.orientation:
        return None
    stamps, quaternions = truth.orientation[sensor]
    estimates = series.orientation[sensor]
    kept = after(stamps, skip_s)
    usable = np.flatnonzero(np.isfinite(estimates).all(axis=1))
    rows, matched = match(series.stamps[usable], stamps[kept])
    rows = usable[rows]
    degrees = degrees_of(estimates[rows], quaternions[kept][matched]) if len(rows) else np.empty(0)
    return MatchedError(stamps[kept][matched], rows, degrees, int(kept.sum()))


def inclination_deg(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Angle between the world's vertical as seen by two (K, 4) quaternions (sensor to world), (K,) degrees."""
    up = np.array([0.0, 0.0, 1.0])
    one, two = (Rotation.from_quat(q).inv().apply(up) for q in (estimate, truth))
    sine = np.linalg.norm(np.cross(one, two), axis=1)
    return np.asarray(np.degrees(np.arctan2(sine, (one * two).sum(axis=1))))


def heading_deg(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Turn about the vertical nearest to estimate times inverse truth, (K, 4) quaternions each; (K,) degrees."""
    _, _, z, w = (Rotation.from_quat(estimate) * Rotation.from_quat(truth).inv()).as_quat().T
    return _wrapped(np.degrees(2.0 * np.arctan2(z, w)))


def _wrapped(degrees: FloatArray) -> FloatArray:
    """In [-180, 180)."""
    return np.asarray((degrees + 180.0) % 360.0 - 180.0)


def errors(
    series: Series,
    joints: tuple[str, ...],
    truth: Truth,
    skip_s: float = 0.0,
    continuous: Collection[str] = (),
    chain: TorsoChain | None = None,
    *,
    headings: bool = False,
) -> dict[str, Any]:
    """All error figures of one estimator, keyed as in the JSON of `jointest evaluate`.

    Args:
        series: estimates, columns as `joints`.
        skip_s: truth samples before this time after the first are left out, s.
        continuous: joints whose error is wrapped to [-180, 180) deg.
        chain: whose torso the estimator gives, if it does.
        headings: the estimates have a heading (of a magnetometer); without one it is as arbitrary as its error.
    """
    ratios: list[FloatArray] = []
    positions: dict[str, Any] = {}
    velocities: dict[str, Any] = {}
    for column, joint in enumerate(joints):
        if error := joint_error(series, column, truth, joint, skip_s, wrapped=joint in continuous):
            positions[joint] = error.figures()
            variance = series.variance[error.rows, column]
            ratios.append(np.radians(error.degrees[variance > 0.0]) ** 2 / variance[variance > 0.0])
        if error := joint_error(series, column, truth, joint, skip_s, of="velocity"):
            velocities[joint] = error.figures()
    kinds = {"inclination": inclination_error, **({"heading": heading_error} if headings else {})}
    orientation: dict[str, dict[str, Any]] = {}
    for sensor in truth.orientation:
        for kind, error_of in kinds.items():
            if error := error_of(series, truth, sensor, skip_s):
                orientation.setdefault(sensor, {})[kind] = error.figures()
    return {
        "joints": positions,
        "velocities": velocities,
        "torso": torso_errors(series, chain, truth, skip_s) if chain else {},
        "orientation": orientation,
        "nis": None,
        "nees": float(np.mean(np.concatenate(ratios))) if any(map(len, ratios)) else None,
    }


def torso_errors(series: Series, chain: TorsoChain, truth: Truth, skip_s: float = 0.0) -> dict[str, Any]:
    """`torso` of the JSON: figures of each `torso_error`."""
    return {name: error.figures() for name, error in torso_error(series, chain, truth, skip_s).items()}


def torso_error(series: Series, chain: TorsoChain, truth: Truth, skip_s: float = 0.0) -> dict[str, MatchedError]:
    """Errors of the torso: `x`, `y`, `z` (rotation vector, or sums of angles when additive) and `geodesic`, degrees.

    The true torso is made of the true joint angles by the estimator's own kinematics; samples in which the truth of a
    joint is unknown are left out.
    """
    if series.torso is None or series.torso_orientation is None or not set(chain.joints) <= set(truth.position):
        return {}
    position = np.column_stack([truth.position[joint] for joint in chain.joints])
    known = after(truth.stamps, skip_s) & np.isfinite(position).all(axis=1)
    usable = np.flatnonzero(((series.status & UNUSABLE) == 0).all(axis=1) & np.isfinite(series.torso).all(axis=1))
    rows, matched = match(series.stamps[usable], truth.stamps[known])
    if not len(rows):
        return {}
    rows, expected = usable[rows], int(known.sum())
    vectors, quaternions = torsos_of(chain.axes, position[known][matched], chain.composed)
    difference = np.degrees(series.torso[rows] - vectors)
    turn = Rotation.from_quat(series.torso_orientation[rows]).inv() * Rotation.from_quat(quaternions)
    parts = {**dict(zip("xyz", difference.T, strict=True)), "geodesic": np.degrees(turn.magnitude())}
    stamps = truth.stamps[known][matched]
    return {name: MatchedError(stamps, rows, degrees, expected) for name, degrees in parts.items()}


def has_figures(table: Mapping[str, Any]) -> bool:
    """Whether anything in a table of `errors` was matched with a truth."""
    figures = [*table["joints"].values(), *(sensor["inclination"] for sensor in table["orientation"].values())]
    return any(figure["samples"] for figure in figures)


def after(stamps: NDArray[np.int64], skip_s: float) -> NDArray[np.bool_]:
    """(N,) mask of the stamps that come `skip_s` seconds after the first, or later."""
    if not len(stamps):
        return np.zeros(0, dtype=bool)
    return np.asarray(stamps - stamps[0] >= round(min(skip_s, 1e9) * 1e9))
