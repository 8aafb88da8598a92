"""The least squares behind the identification of a hinge's axis: what is known before, and the solver."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.rotation import rotate_inverse
from jointest_ros.evaluation import hinge_equations as equations
from jointest_ros.evaluation.hinge_equations import Frames, Hinge, HingeData, Scatter, tilted
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.joint_pairs import Pair

PRIOR_TILT = 1.0  # rad
UNKNOWN_BIAS = math.radians(3.0)  # rad/s, of a gyro that was never seen at rest
_KNOWN_BIAS = math.radians(0.003)  # rad/s, at least, of one that was
_PRIOR_ARM = 0.1  # m
_PRIOR_OFFSET = 0.5  # m/s^2: two accelerometers of some 30 mg
_MOST = 4000  # windows in a fit: more take time and tell nothing
_OUTLIER = 3.0  # sigma from which the loss grows with a residual, not with its square
_TOLERANCE = 1e-6  # relative, of squares and parameters
_LEAST = 1e-9  # of a scatter, where a simulation has no noise


@dataclass(frozen=True)
class Solution:
    """Axes as `frames`, parameters (17,) with a tilt of zero, and (rows, free) derivatives there."""

    frames: Frames
    parameters: FloatArray
    scatter: Scatter
    cost: float
    jacobian: FloatArray


class Problem:
    """The least squares of one pair.

    Attributes:
        data: the windows, at most 4000.
        prior, prior_std: (17,) what is known of the parameters before; a standard deviation of 0: exactly that.
        free: the parameters that are to be found.
        noise: scatter by the data sheets.
        white: for parent and child, standard deviation of the white noise in the windows of gyro and accelerometer.
    """

    def __init__(self, data: HingeData, means: WindowMeans, pair: Pair, kept: frozenset[str]) -> None:
        self.data, self.pair = data.part(_MOST), pair
        self.white = [(_white(data, w), _white(data, a)) for w, a in zip(data.gyro, data.accel, strict=True)]
        self.prior, self.prior_std = np.zeros(equations.PARAMETERS), np.ones(equations.PARAMETERS)
        self.prior_std[: equations.TILT_2.stop] = PRIOR_TILT
        self.prior_std[equations.OFFSET] = _PRIOR_OFFSET
        arms = np.array(pair.parent.position) - np.array(pair.joint.origin), np.array(pair.child.position)
        rest = sum(phase.duration for phase in means.still)
        for sensor, arm, tilt, bias, place in (
            (pair.parent, arms[0], equations.TILT_1, equations.BIAS_1, equations.ARM_1),
            (pair.child, arms[1], equations.TILT_2, equations.BIAS_2, equations.ARM_2),
        ):
            if sensor.name in kept:
                self.prior_std[tilt] = 0.0
            self.prior[place], self.prior_std[place] = rotate_inverse(sensor.mounting, tuple(arm.tolist())), _PRIOR_ARM
            self.prior_std[bias] = UNKNOWN_BIAS
            if rest:
                weighted = [phase.duration * np.array(phase.gyro[sensor.name]) for phase in means.still]
                drift = sensor.gyro_bias_walk * math.sqrt(float(data.time[-1] - data.time[0]))
                self.prior[bias] = np.sum(weighted, axis=0) / rest
                self.prior_std[bias] = math.hypot(_KNOWN_BIAS, drift, sensor.gyro_noise / math.sqrt(rest))
        self.free = np.flatnonzero(self.prior_std)
        noise = (math.hypot(*(getattr(s, kind) for s in pair.sensors)) for kind in ("gyro_noise", "accel_noise"))
        self.noise = Scatter(*(max(density / math.sqrt(means.length), _LEAST) for density in noise))

    def solve(
        self,
        frames: Frames,
        parameters: FloatArray,
        scatter: Scatter,
        data: HingeData | None = None,
        evaluations: int = 20,
    ) -> Solution:
        """Robust least squares from there."""
        rows = data or self.data

        def whole(x: FloatArray) -> FloatArray:
            p = parameters.copy()
            p[self.free] = x
            return p

        def squares(x: FloatArray) -> FloatArray:
            hinge = Hinge(rows, frames, whole(x), scatter)
            return np.append(hinge.residuals(), (x - self.prior[self.free]) / self.prior_std[self.free])

        def derivatives(x: FloatArray) -> FloatArray:
            hinge = Hinge(rows, frames, whole(x), scatter)
            return np.vstack([hinge.derivatives()[:, self.free], np.diag(1.0 / self.prior_std[self.free])])

        found = least_squares(
            squares,
            parameters[self.free],
            jac=derivatives,
            x_scale=self.prior_std[self.free],
            loss="soft_l1",
            f_scale=_OUTLIER,
            max_nfev=evaluations,
            ftol=_TOLERANCE,
            xtol=_TOLERANCE,
        )
        p = whole(found.x)
        frames = tilted(frames[0], p[equations.TILT_1]), tilted(frames[1], p[equations.TILT_2])
        p[: equations.TILT_2.stop] = 0.0
        return Solution(frames, p, scatter, float(found.cost), np.asarray(found.jac))

    def scatter(self, solution: Solution) -> Scatter:
        """What the residuals of a solution scatter by; coarse digits can hide it, so not far less than specified."""
        r = Hinge(self.data, solution.frames, solution.parameters, solution.scatter)
        across = float(np.median(abs(np.concatenate([r.across.real, r.across.imag]))))
        return Scatter(
            max(1.4826 * across * solution.scatter.gyro, 0.5 * self.noise.gyro),
            max(1.4826 * float(np.median(abs(r.along))) * solution.scatter.accel, 0.5 * self.noise.accel),
        )


def _white(data: HingeData, readings: FloatArray) -> float:
    """Standard deviation of the white noise in (n, 3) readings: third differences hold hardly anything of a motion."""
    third = np.diff(readings, 3, axis=0)[data.stretch[3:] == data.stretch[:-3]]
    return math.sqrt(float(np.mean(third**2)) / 20.0) if len(third) else 0.0
