"""Identifies the axis of a hinge in the two inertial sensors beside it, from motion alone (equations: hinge_equations).

Robust least squares of all equations together, from the best of the starts on a grid of the half sphere: the mountings
need not be known at all. The scatter of gyros and accelerometers is found on the way. The common sign of both axes
cannot be seen in any motion: it is that of the configured axis.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial.distance import cdist

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation import hinge_equations as equations
from jointest_ros.evaluation.axis_fit import Axis, AxisFit, spread
from jointest_ros.evaluation.axis_problem import Problem, Solution
from jointest_ros.evaluation.axis_uncertainty import covariance, followed
from jointest_ros.evaluation.hinge_equations import Hinge, Scatter, enough_data, frame_of
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.joint_pairs import Pair

_FEWEST = 100  # windows for a fit
_TRIAL = 600  # windows by which the starts are compared
_TRIAL_EVALUATIONS = 8
_GRID = 200  # directions on the half sphere, about 10 deg apart
_STARTS = 3  # of the grid that are tried, besides the configured axes
_APART = math.radians(30.0)  # between those
_COARSE = Scatter(math.radians(1.0), 0.5)  # rad/s and m/s^2: what is left over by coarse axes
_ROUNDS = 4  # of fit and scatter in turn
_SETTLED = 0.05  # change of the logarithm of the scatter
_EVIDENT = 2.0  # ratio of the squares with an axis reversed: hundreds where the motion shows it, 1.0 to 1.1 otherwise
_RECOGNISED = 0.5  # cosine between identified and configured axis


def fit_axes(means: WindowMeans, pair: Pair, kept: frozenset[str] = frozenset()) -> AxisFit:
    """Identify one hinge.

    Args:
        means: of the recording; both sensors of the pair are among its `given`.
        kept: sensors whose mounting is known: the axis in them is taken as configured.

    Raises:
        CalibrationError: the sensors gave too little together. Whether the motion was enough, the `AxisFit` tells.
    """
    problem = Problem(enough_data(means, pair, _FEWEST), means, pair, kept)
    solution = _start(problem)
    for _ in range(_ROUNDS):
        solution, before = problem.solve(solution.frames, solution.parameters, problem.scatter(solution)), solution
        moved = solution.scatter.gyro / before.scatter.gyro, solution.scatter.accel / before.scatter.accel
        if max(abs(math.log(ratio)) for ratio in moved) < _SETTLED:
            break
    return _result(problem, *_signed(problem, solution))


def _start(problem: Problem) -> Solution:
    """The best of some coarse solutions: from the configured axes, and from directions all over the half sphere."""
    data, kept = problem.data.part(_TRIAL), problem.prior_std[[0, equations.TILT_2.start]] == 0.0
    configured = problem.pair.configured()
    starts = [configured]
    grids = [axis[None] if keep else _half_sphere(_GRID) for axis, keep in zip(configured, kept, strict=True)]
    rates = [w - problem.prior[b] for w, b in zip(data.gyro, (equations.BIAS_1, equations.BIAS_2), strict=True)]
    lengths = [np.linalg.norm(np.cross(w[None], grid[:, None]), axis=2) for w, grid in zip(rates, grids, strict=True)]
    differences = cdist(*lengths, "cityblock")
    for _ in range(_STARTS):
        best = np.unravel_index(np.argmin(differences), differences.shape)
        if not np.isfinite(differences[best]):
            break
        starts.append((grids[0][best[0]], grids[1][best[1]]))
        near = [abs(grid @ grid[k]) > math.cos(_APART) for grid, k in zip(grids, best, strict=True)]
        differences[np.ix_(*near)] = np.inf
    solutions = []
    for one, two in starts:
        for sign in (1.0, -1.0):
            frames = frame_of(one), frame_of(sign * two)
            solutions.append(problem.solve(frames, problem.prior, _COARSE, data, _TRIAL_EVALUATIONS))
    return min(solutions, key=lambda solution: solution.cost)


def _half_sphere(count: int) -> FloatArray:
    """(count, 3) unit vectors, evenly on the half sphere (a spiral of the golden angle)."""
    z = (np.arange(count) + 0.5) / count
    turn = math.pi * (3.0 - math.sqrt(5.0)) * np.arange(count)
    flat = np.sqrt(1.0 - z * z)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])


def _reversed(frame: FloatArray) -> FloatArray:
    """The frame (rows u, v, j) with the axis the other way round."""
    return frame * np.array([[1.0], [-1.0], [-1.0]])


def _signed(problem: Problem, solution: Solution) -> tuple[Solution, bool]:
    """The solution with the signs of its axes: that of one relative to the other from the motion, where that tells it.

    Motion in one plane does not; there, and for the sign of both, the configured axes are followed. False: they are too
    far off for that.
    """
    one, two = solution.frames
    along = [float(frame[2] @ axis) for frame, axis in zip((one, two), problem.pair.configured(), strict=True)]
    trial = problem.data.part(_TRIAL)
    this, other = (
        problem.solve(frames, solution.parameters, solution.scatter, trial)
        for frames in ((one, two), (one, _reversed(two)))
    )
    same = math.prod(float(a[2] @ b[2]) for a, b in zip(this.frames, other.frames, strict=True)) > 0.0
    shown = same or other.cost > _EVIDENT * this.cost
    if not shown and along[0] * along[1] < 0.0:
        solution = problem.solve((one, _reversed(two)), solution.parameters, solution.scatter)
        one, two = solution.frames
        along[1] = -along[1]
    signed = shown or min(map(abs, along)) > _RECOGNISED
    if sum(along) >= 0.0 or not problem.prior_std[[0, equations.TILT_2.start]].all():
        return solution, signed
    signs = np.ones(solution.jacobian.shape[1])
    signs[[1, 3]] = -1.0
    return replace(solution, frames=(_reversed(one), _reversed(two)), jacobian=solution.jacobian * signs), signed


def _result(problem: Problem, solution: Solution, signed: bool) -> AxisFit:
    """The solution with its uncertainty, and what the motion was like."""
    data, pair, p, scatter = problem.data, problem.pair, solution.parameters, solution.scatter
    r = Hinge(data, solution.frames, p, scatter)
    rates = data.gyro[0] - p[equations.BIAS_1], data.gyro[1] - p[equations.BIAS_2]
    misfit = followed(r, data)
    known = covariance(problem, solution, 1.0 + misfit)
    axes = []
    for k, (sensor, configured) in enumerate(zip(pair.sensors, pair.configured(), strict=True)):
        frame, tilt = solution.frames[k], slice(2 * k, 2 * k + 2)
        kept = problem.prior_std[2 * k] == 0.0
        axes.append(Axis(sensor.name, frame[2], known[tilt, tilt], frame[:2], configured, bool(kept)))
    one, two = pair.configured()
    before = Hinge(data, (frame_of(one), frame_of(two)), p, scatter)
    across = (rates[0] @ solution.frames[0][:2].T).std(axis=0)
    return AxisFit(
        pair=pair,
        parent=axes[0],
        child=axes[1],
        signed=signed,
        windows=len(data),
        residual=scatter.gyro * _rms(r.across),
        residual_before=scatter.gyro * _rms(before.across),
        noise=problem.noise.gyro,
        misfit=scatter.gyro * math.sqrt(misfit / (2.0 * len(data))),
        joint_rate=float((rates[1] @ solution.frames[1][2] - rates[0] @ solution.frames[0][2]).std()),
        link_rates=(spread(rates[0]), spread(rates[1])),
        across_rate=float(np.hypot(*across)),
        time=data.time,
        residual_over_time=scatter.gyro * abs(r.across) / math.sqrt(2.0),
        residual_before_over_time=scatter.gyro * abs(before.across) / math.sqrt(2.0),
    )


def _rms(values: FloatArray) -> float:
    """Of a component of (n,) complex numbers."""
    return math.sqrt(float(np.mean(abs(values) ** 2)) / 2.0)
