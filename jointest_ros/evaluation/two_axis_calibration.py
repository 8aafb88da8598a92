"""Identifies the axes of a joint of two: the first one in the parent's sensor, the second one in the child's.

In a stretch of a few seconds the gyros carry the attitude of either sensor from its start, R1(t) and R2(t). With A the
rotation child to parent there, R12(t) = R1^T A R2, and whatever the joint does

    j1 . R12(t) j2 = cosine of the angle between both axes, as configured

(Laidig, Lehmann, Begin, Seel 2017). A is free in every stretch but for gravity: the mean specific force at the joint,
in the frame of the start, is the same for both. No motion is needed that the joint does not make; the common sign of
axis and angle cannot be seen, so the configured axes must be right to some 45 deg.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.rotation import between, rotate_inverse
from jointest_ros.evaluation.axis_fit import Axis, AxisFit, spread
from jointest_ros.evaluation.hinge_equations import Frames, HingeData, frame_of, hinge_data, tilted
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.joint_pairs import Pair
from jointest_ros.evaluation.measures import rms, rms_length

_FEWEST = 4  # stretches
_MOST = 60  # stretches: more take time and tell nothing
_TILT = 0.03  # rad, of A: accelerometer biases of 30 mg
_HEADINGS = 24  # that are tried for A about gravity
_ROUNDS = 4  # of fit and scatter in turn
_LEAST = 1e-5  # of the scatter, where a simulation has no noise
_OUTLIER = 3.0  # sigma from which the loss grows with a residual, not with its square


@dataclass(frozen=True)
class _Stretches:
    """n windows in K stretches.

    Attributes:
        data: the windows.
        rates: (n, 3), (n, 3) rad/s, without bias.
        turns: (n, 3, 3), (n, 3, 3) attitudes of parent and child since the start of the stretch.
        start: (K, 3, 3) A by gravity, and anyhow about it.
        basis: (K, 3, 3) rows: two directions across the mean force in the parent, and its own.
    """

    data: HingeData
    rates: tuple[FloatArray, FloatArray]
    turns: tuple[FloatArray, FloatArray]
    start: FloatArray
    basis: FloatArray

    def left_over(self, axes: FloatArray, attitudes: FloatArray, cosine: float) -> FloatArray:
        """(n,) rad: what the module text says is zero; `axes` (2, 3), `attitudes` (K, 3, 3)."""
        one, two = self.turns[0] @ axes[0], self.turns[1] @ axes[1]
        return np.asarray(np.einsum("ni,nij,nj->n", one, attitudes[self.data.stretch], two) - cosine)

    def headed(self, axes: FloatArray, attitudes: FloatArray, cosine: float) -> FloatArray:
        """(K, 3, 3) the attitudes, or where others fit these axes better: `start`, turned about the mean force."""
        best = np.bincount(self.data.stretch, self.left_over(axes, attitudes, cosine) ** 2)
        attitudes = attitudes.copy()
        for heading in np.arange(_HEADINGS) * 2.0 * math.pi / _HEADINGS:
            trial = Rotation.from_rotvec(heading * self.basis[:, 2]).as_matrix() @ self.start
            squares = np.bincount(self.data.stretch, self.left_over(axes, trial, cosine) ** 2)
            better = squares < best
            best[better], attitudes[better] = squares[better], trial[better]
        return attitudes


def fit_two_axes(means: WindowMeans, pair: Pair, kept: frozenset[str] = frozenset()) -> AxisFit:
    """Identify the axes of a joint of two.

    Args:
        means: of the recording; both sensors of the pair are among its `given`.
        kept: sensors whose mounting is known: the axis in them is taken as configured.

    Raises:
        CalibrationError: the sensors gave too little together, or were never at rest. Whether the motion was enough,
            the `AxisFit` tells.
    """
    stretches = _stretches(means, pair)
    one, two = pair.configured()
    frames = frame_of(one), frame_of(two)
    first, second = (np.array(axis) for axis in pair.joint.axes)
    cosine = float(first @ second)
    prior = np.array([0.0 if s.name in kept else 1.0 for s in pair.sensors for _ in range(2)])
    attitudes, scatter = stretches.start, 0.1
    for _ in range(_ROUNDS):
        attitudes = stretches.headed(np.array([frames[0][2], frames[1][2]]), attitudes, cosine)
        frames, attitudes, known, left = _solve(stretches, frames, attitudes, cosine, prior, scatter)
        scatter, before = max(_LEAST, 1.4826 * float(np.median(abs(left)))), scatter
        if abs(math.log(scatter / before)) < 0.05:
            break
    return _result(stretches, pair, frames, attitudes, known)


def _stretches(means: WindowMeans, pair: Pair) -> _Stretches:
    names = [sensor.name for sensor in pair.sensors]
    if not means.still:
        raise CalibrationError(
            f"'{names[0]}' and '{names[1]}' are never at rest, which tells their gyro biases; "
            "hold the robot still for a few seconds, then move the joint"
        )
    data = _with_most_motion(hinge_data(means, *names))
    number = int(data.stretch[-1]) + 1 if len(data) else 0
    if number < _FEWEST:
        lasted = len(data) * means.length
        raise CalibrationError(
            f"'{names[0]}' and '{names[1]}' gave readings together for {lasted:.1f} s; at least 20 s are needed"
        )
    rest = sum(phase.duration for phase in means.still)
    rates, turns, forces = [], [], []
    places = np.array(pair.parent.position) - np.array(pair.joint.origin), np.array(pair.child.position)
    for k, sensor in enumerate(pair.sensors):
        bias = sum(phase.duration * np.array(phase.gyro[sensor.name]) for phase in means.still) / rest
        rates.append(data.gyro[k] - bias)
        turns.append(_attitudes(rates[k], data, means.length))
        arm = np.array(rotate_inverse(sensor.mounting, tuple(places[k].tolist())))
        force = np.einsum("nij,nj->ni", turns[k], data.accel[k] - data.arms[k] @ arm)
        begin = np.flatnonzero(np.append(True, np.diff(data.stretch) > 0))
        forces.append(np.add.reduceat(force, begin) / np.bincount(data.stretch)[:, None])
    vectors = [[tuple(row) for row in force.tolist()] for force in forces]
    start = Rotation.from_quat([between(b, a) for a, b in zip(*vectors, strict=True)]).as_matrix()
    basis = np.array([frame_of(force / np.linalg.norm(force)) for force in forces[0]])
    return _Stretches(data, (rates[0], rates[1]), (turns[0], turns[1]), start, basis)


def _with_most_motion(data: HingeData) -> HingeData:
    """At most so many stretches: those whose links turn most against each other."""
    if not len(data) or data.stretch[-1] < _MOST:
        return data
    moved = sum(np.bincount(data.stretch, np.sum(rate**2, axis=1)) for rate in data.gyro)
    chosen = np.isin(data.stretch, np.argsort(moved)[-_MOST:])
    return data.rows(chosen)


def _attitudes(rate: FloatArray, data: HingeData, length: float) -> FloatArray:
    """(n, 3, 3) of the middle of each window since that of the first one of its stretch; coning is taken along."""
    steps = 0.5 * (rate[1:] + rate[:-1]) * length + np.cross(rate[:-1], rate[1:]) * length**2 / 12.0
    turns = np.concatenate([np.eye(3)[None], Rotation.from_rotvec(steps).as_matrix()])
    place = np.rint(data.elapsed / length).astype(int)
    turns[place == 0] = np.eye(3)
    for k in range(1, int(place.max()) + 1):
        rows = np.flatnonzero(place == k)
        turns[rows] = turns[rows - 1] @ turns[rows]
    return np.asarray(turns)


def _solve(
    stretches: _Stretches, frames: Frames, attitudes: FloatArray, cosine: float, prior: FloatArray, scatter: float
) -> tuple[Frames, FloatArray, FloatArray, FloatArray]:
    """Robust least squares from there: (frames, attitudes, (4, 4) covariance of the tilts, (n,) what is left over)."""
    number, stretch = len(attitudes), stretches.data.stretch
    free = np.flatnonzero(prior)
    std = np.concatenate([prior[free], np.tile([_TILT, _TILT, 1.0], number)])
    known = attitudes @ stretches.start.transpose(0, 2, 1)  # what was turned already, beside what gravity says
    turned = np.einsum("kij,kj->ki", stretches.basis, Rotation.from_matrix(known).as_rotvec())

    def unpacked(x: FloatArray) -> tuple[Frames, FloatArray]:
        tilts = np.zeros(4)
        tilts[free] = x[: len(free)]
        vectors = np.einsum("kji,kj->ki", stretches.basis, x[len(free) :].reshape(-1, 3))
        made = Rotation.from_rotvec(vectors).as_matrix() @ stretches.start
        return (tilted(frames[0], tilts[:2]), tilted(frames[1], tilts[2:])), made

    def squares(x: FloatArray) -> FloatArray:
        (one, two), made = unpacked(x)
        return np.append(stretches.left_over(np.array([one[2], two[2]]), made, cosine) / scatter, x / std)

    rows = np.arange(len(stretch))
    own = len(free) + 3 * stretch
    columns = np.column_stack([np.tile(np.arange(len(free)), (len(rows), 1)), own, own + 1, own + 2])
    pattern = csr_matrix(
        (np.ones(columns.size), (np.repeat(rows, columns.shape[1]), columns.ravel())), (len(rows), len(std))
    )
    whole = csr_matrix(np.vstack([pattern.toarray(), np.eye(len(std))]))
    begin = np.concatenate([np.zeros(len(free)), turned.ravel()])
    found = least_squares(
        squares, begin, jac_sparsity=whole, x_scale=std, loss="soft_l1", f_scale=_OUTLIER, max_nfev=30
    )
    (one, two), made = unpacked(found.x)
    jacobian = found.jac.toarray()
    # Errors within a stretch belong together (gyro scale, accelerometer bias): the scatter is that between stretches.
    weighted = found.fun * (1.0 + (found.fun / _OUTLIER) ** 2) ** -0.25
    label = np.concatenate([stretch, np.full(len(free), number), np.repeat(np.arange(number), 3)])
    pulls = np.array([jacobian[label == k].T @ weighted[label == k] for k in range(number)])
    bread = np.linalg.inv(jacobian.T @ jacobian)[: len(free)]
    covariance = np.zeros((4, 4))
    covariance[np.ix_(free, free)] = bread @ (pulls.T @ pulls) @ bread.T * number / max(1, number - 1)
    return (one, two), made, covariance, found.fun[: len(stretch)] * scatter


def _result(stretches: _Stretches, pair: Pair, frames: Frames, attitudes: FloatArray, known: FloatArray) -> AxisFit:
    data, rates = stretches.data, stretches.rates
    turned = np.einsum("nji,njk,nkl->nil", stretches.turns[0], attitudes[data.stretch], stretches.turns[1])
    moved = np.einsum("nij,nj->ni", turned, rates[1]) - rates[0]
    axes = [
        Axis(sensor.name, frame[2], known[tilt, tilt], frame[:2], configured, not known[tilt, tilt].any())
        for sensor, frame, configured, tilt in zip(
            pair.sensors, frames, pair.configured(), (slice(0, 2), slice(2, 4)), strict=True
        )
    ]

    def over(one: FloatArray, two: FloatArray) -> FloatArray:
        """(n,) rad/s about neither axis."""
        normal = np.cross(one, turned @ two)
        return np.asarray(np.sum(moved * normal, axis=1) / np.linalg.norm(normal, axis=1))

    left, before = over(axes[0].axis, axes[1].axis), over(*pair.configured())
    noise = math.hypot(*(sensor.gyro_noise for sensor in pair.sensors)) / math.sqrt(_length(data))
    return AxisFit(
        pair=pair,
        parent=axes[0],
        child=axes[1],
        signed=True,
        windows=len(data),
        residual=rms(left),
        residual_before=rms(before),
        noise=noise,
        misfit=math.sqrt(max(0.0, rms(left) ** 2 - noise**2)),
        joint_rate=rms_length(moved),
        link_rates=(spread(rates[0]), spread(rates[1])),
        across_rate=spread(rates[0] @ frames[0][:2].T),
        time=data.time,
        residual_over_time=abs(left),
        residual_before_over_time=abs(before),
    )


def _length(data: HingeData) -> float:
    """Of a window, s."""
    return float(np.median(np.diff(data.time)))
