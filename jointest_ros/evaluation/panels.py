"""What is shown of estimates beside ground truth: curves over time, and their thinning for a picture or a page."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray, Series
from jointest_ros.core.torso import TorsoChain
from jointest_ros.evaluation.metrics import MatchedError, after, inclination_error, joint_error, torso_error
from jointest_ros.evaluation.truth import Truth

_STRETCHES = 1500  # a longer line is drawn by the lowest and the highest sample of each of so many stretches of time
_GAP = 10  # intervals without a sample that interrupt a line


@dataclass(frozen=True)
class Curve:
    """What one estimator gives at the truth samples that it matches: (K,) each.

    Attributes:
        seconds: after the first truth sample.
        error: estimate minus truth, deg or deg/s.
        estimate: deg or deg/s; None where an error has none to it (inclination).
        spread: two reported standard deviations, deg; None where none is reported.
        stamps: of the truth, ns.
    """

    seconds: FloatArray
    error: FloatArray
    estimate: FloatArray | None = None
    spread: FloatArray | None = None
    stamps: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))


@dataclass(frozen=True)
class Panel:
    """One joint, or the inclination of one sensor: curves by estimator, and the truth as (s, deg) for a joint."""

    name: str
    curves: dict[str, Curve]
    truth: tuple[FloatArray, FloatArray] | None = None


def panels(
    series: Mapping[str, Series],
    joints: Mapping[str, tuple[str, ...]],
    truth: Truth,
    skip_s: float = 0.0,
    continuous: Collection[str] = (),
) -> list[Panel]:
    """Whatever an estimator can be compared with the truth in: angles of joints, then inclinations.

    Args:
        series: estimates by estimator.
        joints: by estimator, the columns of its series.
        skip_s, continuous: as in `metrics.errors`.
    """
    return [
        *joint_panels(series, joints, truth, skip_s, continuous),
        *inclination_panels(series, truth, skip_s),
    ]


def joint_panels(
    series: Mapping[str, Series],
    joints: Mapping[str, tuple[str, ...]],
    truth: Truth,
    skip_s: float = 0.0,
    continuous: Collection[str] = (),
    of: Literal["position", "velocity"] = "position",
) -> list[Panel]:
    """Angles (deg) or velocities (deg/s) of the joints that the truth knows; arguments as for `panels`."""
    found = []
    truths: dict[str, FloatArray] = getattr(truth, of)
    for joint, values in truths.items():
        curves = {}
        for name, columns in joints.items():
            if joint not in columns:
                continue
            column, one = columns.index(joint), series[name]
            error = joint_error(
                one, column, truth, joint, skip_s, of=of, wrapped=of == "position" and joint in continuous
            )
            if error is None or not len(error.rows):
                continue
            estimate = np.degrees(getattr(one, of)[error.rows, column])
            spread = 2.0 * np.degrees(np.sqrt(one.variance[error.rows, column])) if of == "position" else None
            reported = spread if spread is not None and np.isfinite(spread).all() else None  # peers report none
            seconds = _seconds(error.stamps, truth.stamps)
            curves[name] = Curve(seconds, error.degrees, estimate, reported, error.stamps)
        known = after(truth.stamps, skip_s) & np.isfinite(values)
        if curves:
            shown = _seconds(truth.stamps[known], truth.stamps), np.degrees(values[known])
            found.append(Panel(joint, curves, shown))
    return found


def inclination_panels(series: Mapping[str, Series], truth: Truth, skip_s: float = 0.0) -> list[Panel]:
    """Inclination errors of the sensors whose orientation the truth knows."""
    found = []
    for sensor, (stamps, _) in truth.orientation.items():
        errors = {name: inclination_error(one, truth, sensor, skip_s) for name, one in series.items()}
        if curves := _curves(errors, stamps):
            found.append(Panel(f"inclination of {sensor}", curves))
    return found


def torso_panels(
    series: Mapping[str, Series], chains: Mapping[str, TorsoChain], truth: Truth, skip_s: float = 0.0
) -> list[Panel]:
    """Errors of the torso, as in `metrics.torso_errors`; `chains`: by estimator, where it gives a torso."""
    errors = {name: torso_error(series[name], chain, truth, skip_s) for name, chain in chains.items()}
    parts = dict.fromkeys(part for one in errors.values() for part in one)
    found = [
        Panel(f"torso {part}", _curves({name: one.get(part) for name, one in errors.items()}, truth.stamps))
        for part in parts
    ]
    return [panel for panel in found if panel.curves]


def line(seconds: FloatArray, values: FloatArray, stretches: int = _STRETCHES) -> tuple[FloatArray, FloatArray]:
    """(K,) rising times and values as they are drawn: thinned where there are many, NaN where samples are missing.

    Thinned is to the lowest and the highest sample of each stretch of time, where they are: no spike is lost.
    """
    if len(values) > 2 * stretches:
        edges = np.linspace(seconds[0], seconds[-1], stretches, endpoint=False)
        begins = np.unique(np.searchsorted(seconds, edges))
        ends = np.append(begins[1:], len(values))
        kept = np.unique(
            [
                begin + row
                for begin, end in zip(begins.tolist(), ends.tolist(), strict=True)
                for row in (np.argmin(values[begin:end]), np.argmax(values[begin:end]))
            ]
        )
        gaps = _gaps(seconds, stretches // 2)  # those of the samples; a stretch is longer than many a gap
        kept = np.unique(np.concatenate([kept, gaps - 1, gaps]))
        interrupted = np.searchsorted(kept, gaps)
        seconds, values = seconds[kept], values[kept]
    else:
        interrupted = _gaps(seconds, len(seconds))
    return np.insert(seconds, interrupted, np.nan), np.insert(values, interrupted, np.nan)


def _gaps(seconds: FloatArray, most: int) -> NDArray[np.intp]:
    """Rows before which samples are missing; of more than `most` the longest."""
    steps = np.diff(seconds)
    usual = np.median(steps[steps > 0.0]) if (steps > 0.0).any() else np.inf
    found = np.flatnonzero(steps > _GAP * usual)
    longest = found[np.argsort(-steps[found], kind="stable")[:most]]
    return np.sort(longest) + 1


def _curves(errors: Mapping[str, MatchedError | None], stamps: NDArray[np.int64]) -> dict[str, Curve]:
    return {
        name: Curve(_seconds(error.stamps, stamps), error.degrees, stamps=error.stamps)
        for name, error in errors.items()
        if error is not None and len(error.rows)
    }


def _seconds(stamps: NDArray[np.int64], all_stamps: NDArray[np.int64]) -> FloatArray:
    return (stamps - all_stamps[0]) * 1e-9
