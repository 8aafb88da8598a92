"""The fixed-interval smoother (Rauch, Tung, Striebel) of the joint model: every estimate uses the whole recording.

The process is linear, so the smoother is the usual one on what the filter had after each correction; the measurement
does not enter again. Offline only: it needs the future.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointest_ros.core.accel.joint.model import JointModel
from jointest_ros.core.frame import FloatArray


def smooth(
    model: JointModel, states: Sequence[FloatArray], covariances: Sequence[FloatArray], dts: Sequence[float]
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Smoothed states and covariances.

    Args:
        states, covariances: (T) of the filter after each correction, each (..., n) and (..., n, n).
        dts: (T) s from the state before to each; the first is not used.
    """
    xs, ps = list(states), list(covariances)
    for k in range(len(xs) - 2, -1, -1):
        phi, q = model.transition(dts[k + 1])
        x, p = xs[k], ps[k]
        p_phi = p @ phi.T
        predicted = phi @ p_phi + q
        # states differ by orders of magnitude: solved in units of their standard deviations
        scale = np.sqrt(np.diagonal(predicted, axis1=-2, axis2=-1))
        unit = predicted / (scale[..., :, None] * scale[..., None, :])
        gain = np.linalg.solve(unit, np.swapaxes(p_phi / scale[..., None, :], -1, -2))
        gain = np.swapaxes(gain / scale[..., :, None], -1, -2)
        xs[k] = x + (gain @ (xs[k + 1] - x @ phi.T)[..., None])[..., 0]
        ps[k] = p + gain @ (ps[k + 1] - predicted) @ np.swapaxes(gain, -1, -2)
    return xs, ps


@dataclass(frozen=True)
class Snapshot:
    """The hypotheses of a filter after one step.

    Attributes:
        dt: s since the step before.
        x, p: (h, n), (h, n, n).
        parents: (h) index of each in the step before; -1: it started in this step.
    """

    dt: float
    x: FloatArray
    p: FloatArray
    parents: tuple[int, ...]


def smooth_steps(model: JointModel, steps: Sequence[Snapshot | None]) -> FloatArray:
    """(T, 4): w_a, w_b, th and the variance of th, smoothed along the hypotheses that won; NaN where there is none.

    Args:
        steps: None where the filter had no estimate.
    """
    result = np.full((len(steps), 4), np.nan)
    end = len(steps) - 1
    while end >= 0:
        if steps[end] is None:
            end -= 1
            continue
        first, chain = end, []
        one = 0  # the most likely at the end
        while first >= 0 and (step := steps[first]) is not None and one >= 0:
            chain.append((step.x[one], step.p[one], step.dt))
            one = step.parents[one]
            first -= 1
        chain.reverse()
        x, p, dts = zip(*chain, strict=True)
        xs, ps = smooth(model, x, p, dts)
        rows = slice(first + 1, end + 1)
        result[rows, :3] = np.array(xs)[:, :3]
        result[rows, 3] = np.array(ps)[:, 2, 2]
        end = first
    return result
