"""Errors of the torso, the last link of a chain in the first; its truth is made of the true joint angles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import Series, Vec3
from jointest_ros.core.torso import torsos_of
from jointest_ros.evaluation.metrics import after, summarize
from jointest_ros.evaluation.truth import Truth, match


def torso_errors(
    series: Series, joints: Sequence[str], axes: Sequence[Vec3], composed: bool, truth: Truth, skip_s: float = 0.0
) -> dict[str, Any]:
    """`torso` of the JSON: `x`, `y`, `z` (rotation vector, or sums of angles when additive) and `geodesic`, degrees.

    Args:
        series: estimates with a torso.
        joints, axes: of the chain, in order; samples in which the truth of one is unknown are left out.
        composed: rotations in succession, or sums of the angles about the same axis.
    """
    if series.torso is None or series.torso_orientation is None or not set(joints) <= set(truth.position):
        return {}
    position = np.column_stack([truth.position[joint] for joint in joints])
    known = after(truth.stamps, skip_s) & np.isfinite(position).all(axis=1)
    if not known.any():
        return {}
    vectors, quaternions = torsos_of(axes, position[known], composed)
    usable = np.isfinite(series.torso).all(axis=1)
    rows, matched = match(series.stamps[usable], truth.stamps[known])
    difference = np.degrees(series.torso[usable][rows] - vectors[matched])
    expected = int(known.sum())
    table = {name: summarize(difference[:, column], expected) for column, name in enumerate("xyz")}
    turns = Rotation.from_quat(series.torso_orientation[usable][rows]).inv() * Rotation.from_quat(quaternions[matched])
    return {**table, "geodesic": summarize(np.degrees(turns.magnitude()), expected)} if len(rows) else table
