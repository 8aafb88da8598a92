"""How well a hinge's axis is known from a motion.

Covariance   the inverse curvature of the squares, less what noise and drift alone would add to it: noise in the rates
             looks like motion, and a direction of which nothing more is known counts as unknown.
Misfit       the part of the residual that follows the rates (scale and cross-axis errors of the gyros, play, a joint
             that is no hinge) does not average out: all of it together counts as one observation that went wrong.
"""

from __future__ import annotations

import math

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation import hinge_equations as equations
from jointest_ros.evaluation.axis_problem import PRIOR_TILT, UNKNOWN_BIAS, Problem, Solution
from jointest_ros.evaluation.hinge_equations import Hinge, HingeData

_CLEAR = 4.0  # times what noise adds to the curvature: less of it is taken for noise
_FAR_OUT = 5.0  # sigma from which a residual is no noise
_SLOW = 30.0  # s, over which a bias may drift


def followed(r: Hinge, data: HingeData) -> float:
    """Sum of the squares of `r.across` that errors of the gyros' matrices explain beyond chance."""
    rates = data.beside
    limit = np.minimum(1.0, _FAR_OUT / np.maximum(abs(r.across), _FAR_OUT))
    across = r.across * limit
    regressors = np.column_stack([rates[0], r.turn[:, None] * rates[1]]) * limit[:, None]
    explained = regressors @ np.linalg.lstsq(regressors, across, rcond=None)[0]
    variance = float(np.mean(abs(across - explained) ** 2))
    number = regressors.shape[1]
    by_chance = variance * (number + 3.0 * math.sqrt(number))
    return max(0.0, float(np.sum(abs(explained) ** 2)) - by_chance)


def covariance(problem: Problem, solution: Solution, inflation: float) -> FloatArray:
    """(4, 4) rad^2, of the tilts of both axes; zeros for an axis that was kept."""
    curvature = solution.jacobian.T @ solution.jacobian
    tilts = np.flatnonzero(problem.free < equations.TILT_2.stop)
    others = np.flatnonzero(problem.free >= equations.TILT_2.stop)
    cross = curvature[np.ix_(tilts, others)]
    own = curvature[np.ix_(tilts, tilts)] - cross @ np.linalg.solve(curvature[np.ix_(others, others)], cross.T)
    own -= np.eye(len(tilts)) / PRIOR_TILT**2
    scatter, count = solution.scatter, len(problem.data)
    noise = []
    for (white, accel), gyro, frame in zip(problem.white, problem.data.gyro, solution.frames, strict=True):
        false = math.hypot(white, _drift(problem.data.time, gyro @ frame[2]))
        noise.append(count * ((false / scatter.gyro) ** 2 + (accel / scatter.accel) ** 2))
    scale = np.sqrt(np.maximum(np.repeat(noise, 2)[problem.free[tilts]], 1.0))
    ratios, directions = np.linalg.eigh(own / np.outer(scale, scale))
    real = np.where(ratios > _CLEAR, ratios - 1.0, 0.0) / inflation
    weighted = scale[:, None] * directions
    result = np.zeros((4, 4))
    chosen = problem.free[tilts]
    result[np.ix_(chosen, chosen)] = np.linalg.inv(weighted * real @ weighted.T + np.eye(len(tilts)) / PRIOR_TILT**2)
    return result


def _drift(time: FloatArray, rate: FloatArray) -> float:
    """What may be drift of a gyro's bias in (n,) rates at (n,) s, not motion: standard deviation of the slow part."""
    bins, count = np.unique(time // _SLOW, return_inverse=True, return_counts=True)[1:]
    means = (np.bincount(bins, rate) / count)[bins]
    return min(float(means.std()), UNKNOWN_BIAS)
