"""The joint model over many trials at a time, for `reproduce` and tests: the lines of the online filter, stacked."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from jointest_ros.core.accel.joint.model import ANGLE, JointModel
from jointest_ros.core.accel.joint.smoother import smooth
from jointest_ros.core.accel.paper.trials import Trials
from jointest_ros.core.frame import FloatArray

BLOCK = 64  # trials at a time: their numbers fit into the cache, and the smoother keeps all of them


def run_joint_model(
    model: JointModel,
    channels: FloatArray,
    variances: ArrayLike,
    period: float,
    start: ArrayLike,
    start_variances: ArrayLike,
    *,
    smoothed: bool = False,
) -> Trials:
    """Run the filter from a known start, without hypotheses; sample 0 corrects it.

    Args:
        channels: (trials, T, C) m/s^2, in the order of `JointArrays.channels`; NaN: missing.
        variances: of a sample of each channel, (m/s^2)^2, or (C).
        period: s.
        start: w_a, w_b, th: (3) or (trials, 3), rad/s and rad.
        start_variances: (3).
        smoothed: by the smoother, from the whole trial.
    """
    per_sensor = np.broadcast_to(np.asarray(variances, dtype=float), channels.shape[2])[::2]
    starts = np.broadcast_to(np.asarray(start, dtype=float), (len(channels), 3))
    parts = []
    for first in range(0, len(channels), BLOCK):
        rows = slice(first, first + BLOCK)
        x, p = model.prior(starts[rows], np.asarray(start_variances, dtype=float))
        parts.append(_run(model, np.ascontiguousarray(channels[rows]), per_sensor, period, x, p, smoothed))
    states, spreads = zip(*parts, strict=True)
    return Trials(np.concatenate(states), np.concatenate(spreads))


def _run(
    model: JointModel,
    channels: FloatArray,
    variances: FloatArray,
    period: float,
    x: FloatArray,
    p: FloatArray,
    smoothed: bool,
) -> tuple[FloatArray, FloatArray]:
    readings = channels.view(complex)
    missing = np.isnan(readings)
    readings = np.where(missing, 0.0, readings)
    whole = model.weighting(variances)
    xs, ps = [], []
    for k in range(readings.shape[1]):
        if k:
            x, p = model.predict(x, p, period)
        weighting = model.weighting(variances, missing[:, k]) if missing[:, k].any() else whole
        x, p, _ = model.correct(x, p, readings[:, k], weighting)
        xs.append(x if smoothed else x[:, : ANGLE + 1])
        ps.append(p if smoothed else p[:, : ANGLE + 1, : ANGLE + 1])
    if smoothed:
        xs, ps = smooth(model, xs, ps, [period] * len(xs))
    states = np.stack(xs, axis=1)[..., : ANGLE + 1]
    spreads = np.diagonal(np.stack(ps, axis=1), axis1=-2, axis2=-1)[..., : ANGLE + 1]
    return states, spreads
