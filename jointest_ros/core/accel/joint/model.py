"""The joint model: a Kalman filter on the readings themselves, with the motion of both links as its state.

State        X = [w_a, w_b, th, al_a, al_b, j_a, j_b, b]: rates, angle th_ab, angular accelerations and jerks of the
             links, and optionally a bias b of every channel.
Process      on each link th' = w, w' = al, al' = j, j' = white snap of density q, discretised exactly; the angle has
             the noise of a minus that of b. Biases are random walks.
Measurement  every channel: a_i = a_O + D(r_i) [w_a^2, al_a] + b_i,   b_i = R(th)^T a_O + D(r_i) [w_b^2, al_b] + b_i,
             white noise R of the sensors, correlated with nothing: (2), (7) without their reduction.

The specific force a_O at the joint has no memory, its prior is flat at every sample. It enters linearly, so it is
eliminated rather than estimated: with the readings of b turned into the axes of a, and all weighted by their noise, the
N - 1 combinations that are orthogonal to a_O hold all that the sample says of X, and their noise is white again.

A planar vector is a complex number here (x + iy): D(r) [w^2, al] = (-w^2 + i al) r and R(th) v = exp(-i th) v.
All functions take one state (n), (n, n) or a stack of them (..., n), (..., n, n).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray

ComplexArray = NDArray[np.complex128]

MOTION = 7  # states that are not biases
W_A, W_B, ANGLE, AL_A, AL_B, J_A, J_B = range(MOTION)
START_ACCELERATION = 1e2  # rad/s^2, standard deviation of the angular accelerations at the start
START_JERK = 1e3  # rad/s^3
_ITERATIONS = 2  # of Gauss-Newton
_SIGNIFICANT = 3.0  # standard deviations of its noise, below which a_O tells nothing of the angle
_CHAINS = ((ANGLE, W_A, AL_A, J_A), 1.0), ((ANGLE, W_B, AL_B, J_B), -1.0)


@dataclass(frozen=True)
class ModelNoise:
    """What the model assumes besides the noise of the sensors.

    Attributes:
        snap: density q of the white snap, rad^2/s^7.
        bias: channels have biases.
        bias_std: of a bias at the start, m/s^2.
        bias_walk: m/s^2/sqrt(s).
    """

    snap: float = 1e5
    bias: bool = True
    bias_std: float = 0.2
    bias_walk: float = 0.015


@dataclass(slots=True)
class Correction:
    """What one correction found, at the linearisation of the prediction.

    Attributes:
        innovation: (..., m) of the m = 2 (N - 1) combinations, noise of variance 1.
        covariance: (..., m, m) of the innovation.
        turn: (..., N) complex, turns the readings into the axes of a.
    """

    innovation: FloatArray
    covariance: FloatArray
    turn: ComplexArray

    def log_likelihood(self) -> FloatArray:
        """(...) of the sample, without the constant."""
        _, log_determinant = np.linalg.slogdet(self.covariance)
        weighted = np.linalg.solve(self.covariance, self.innovation[..., None])[..., 0]
        return -0.5 * (np.sum(self.innovation * weighted, axis=-1) + log_determinant)


@dataclass(slots=True)
class Weighting:
    """How much each sensor counts, and what follows from it for `JointModel.correct`.

    Attributes:
        mixing: (..., N, N) from readings, turned into the axes of a, to N - 1 white combinations without a_O and, in
            the last column, their weighted mean.
        design: (..., n, N - 1) what of H^T does not depend on the state: row by row times a factor.
        force_floor: (...) |a_O|^2 below which it cannot be told from noise, (m/s^2)^2.
    """

    mixing: ComplexArray
    design: ComplexArray
    force_floor: FloatArray


class JointModel:
    """The model of one joint.

    Args:
        parent, child: (Na, 2), (Nb, 2) positions of the accelerometers from the joint, m.

    Attributes:
        size: n, of the state.
        sensors: N = Na + Nb.
    """

    def __init__(self, parent: FloatArray, child: FloatArray, noise: ModelNoise | None = None) -> None:
        self.noise = noise = noise or ModelNoise()
        places = np.concatenate([parent, child])
        self.sensors, self._number_a = len(places), len(parent)
        self._places = places[:, 0] + 1j * places[:, 1]
        self.size = MOTION + (2 * self.sensors if noise.bias else 0)
        self._identity = np.eye(self.size)
        self._white = np.eye(2 * (self.sensors - 1))
        self._powers = np.arange(8)
        of_b = np.arange(self.sensors) >= self._number_a
        channels_of_b = np.repeat(of_b, 2) if noise.bias else np.empty(0)
        turned = [0, 1, 0, 0, 1, 0, 0, *channels_of_b, *of_b]
        self._turned = -1j * np.array(turned, dtype=float)  # states whose column of H is turned, then sensors
        # h(x) without a_O is linear in the state with squared rates
        self._readings_of = np.zeros((self.size, self.sensors), dtype=complex)
        self._readings_of[[W_A, W_B]] = -self._places * [~of_b, of_b]
        self._readings_of[[AL_A, AL_B]] = 1j * self._places * [~of_b, of_b]
        if noise.bias:
            self._readings_of[MOTION::2], self._readings_of[MOTION + 1 :: 2] = (
                np.eye(self.sensors),
                1j * np.eye(self.sensors),
            )
        self._flow, self._spread = _flow_terms(self.size), _spread_terms(self.size, noise)

    def prior(self, rates_and_angle: FloatArray, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(state, covariance) of a start: w_a, w_b, th (..., 3) and their variances; the rest unknown."""
        x = np.zeros((*rates_and_angle.shape[:-1], self.size))
        x[..., :3] = rates_and_angle
        p = np.zeros((*x.shape, self.size))
        diagonal = np.arange(self.size)
        p[..., diagonal, diagonal] = self.noise.bias_std**2
        p[..., [AL_A, AL_B], [AL_A, AL_B]] = START_ACCELERATION**2
        p[..., [J_A, J_B], [J_A, J_B]] = START_JERK**2
        p[..., [0, 1, 2], [0, 1, 2]] = variances
        return x, p

    def transition(self, dt: float) -> tuple[FloatArray, FloatArray]:
        """(Phi, Q), (n, n), of a step of `dt` s."""
        powers = dt**self._powers
        shape = self.size, self.size
        return (powers[:4] @ self._flow).reshape(shape), (powers @ self._spread).reshape(shape)

    def predict(self, x: FloatArray, p: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
        """State and covariance `dt` s later."""
        phi, q = self.transition(dt)
        return x @ phi.T, phi @ p @ phi.T + q

    def weighting(self, variances: FloatArray, missing: NDArray[np.bool_] | None = None) -> Weighting:
        """Of sensors that are independent and whose noise is the same in x and y; what is missing weighs nothing.

        Args:
            variances: (N) noise, (m/s^2)^2 in each component.
            missing: (..., N).
        """
        weights = 1.0 / variances
        if missing is not None:
            weights = np.where(missing, 0.0, weights)
        total = np.sum(weights, axis=-1, keepdims=True)
        root = np.sqrt(weights)
        # Householder's reflection that turns the direction of a_O into the last axis
        mirror = root / np.sqrt(np.where(total > 0.0, total, 1.0))
        mirror[..., -1] += 1.0
        square = np.sum(mirror**2, axis=-1)[..., None, None]
        rows = np.eye(self.sensors) - 2.0 / square * mirror[..., :, None] * mirror[..., None, :]
        rows = rows * root[..., None, :]
        rows[..., -1, :] = weights / np.where(total > 0.0, total, 1.0)
        columns = np.swapaxes(rows, -1, -2)[..., :-1]

        number, places = self._number_a, self._places
        of_a = (columns[..., :number, :] * places[:number, None]).sum(axis=-2)
        of_b = (columns[..., number:, :] * places[number:, None]).sum(axis=-2)
        design = np.zeros((*weights.shape[:-1], self.size, self.sensors - 1), dtype=complex)
        design[..., W_A, :], design[..., AL_A, :] = -2.0 * of_a, 1j * of_a
        design[..., W_B, :], design[..., AL_B, :] = -2.0 * of_b, 1j * of_b
        design[..., ANGLE, :] = 1j * columns[..., number:, :].sum(axis=-2)
        if self.noise.bias:
            design[..., MOTION::2, :], design[..., MOTION + 1 :: 2, :] = columns, 1j * columns
        floor = _SIGNIFICANT**2 * 2.0 / np.where(total > 0.0, total, 1.0)[..., 0]
        return Weighting(np.swapaxes(rows, -1, -2).astype(complex), design, floor)

    def correct(
        self, x: FloatArray, p: FloatArray, readings: ComplexArray, weighting: Weighting
    ) -> tuple[FloatArray, FloatArray, Correction]:
        """Two Gauss-Newton iterations, the covariance in Joseph's form.

        Args:
            x, p: prediction.
            readings: (..., N) m/s^2 in the axes of their links; finite, 0 where missing.
        """
        design, mixing, floor = weighting.design, weighting.mixing, weighting.force_floor
        before, first = x, None
        for _ in range(_ITERATIONS):
            # z - h(x), turned into the axes of a, where a_O is the weighted mean
            linear = x.copy()
            linear[..., :ANGLE] *= x[..., :ANGLE]
            turns = np.exp(x[..., ANGLE : ANGLE + 1] * self._turned)
            turn = turns[..., self.size :]
            mixed = (((readings - linear @ self._readings_of) * turn)[..., None, :] @ mixing)[..., 0, :]
            innovation = mixed[..., :-1].view(float)
            # H^T. Noise that is taken for a_O would seem to tell the angle.
            force = mixed[..., -1]
            squared = force.real**2 + force.imag**2
            factor = turns[..., : self.size]
            factor[..., :ANGLE] *= x[..., :ANGLE]
            factor[..., ANGLE] = force * (squared > floor)
            h = (factor[..., None] * design).view(float)
            h_transposed = h.swapaxes(-1, -2)

            ph = p @ h
            s = h_transposed @ ph + self._white
            gain = np.linalg.solve(s, ph.swapaxes(-1, -2)).swapaxes(-1, -2)
            if first is None:
                first = Correction(innovation, s, turn)
            else:
                innovation = innovation + ((x - before)[..., None, :] @ h)[..., 0, :]
            x = before + (gain @ innovation[..., None])[..., 0]
        kept = self._identity - gain @ h_transposed
        p = kept @ p @ kept.swapaxes(-1, -2) + gain @ gain.swapaxes(-1, -2)
        assert first is not None
        return x, p, first


def channel_innovations(found: Correction, weighting: Weighting) -> FloatArray:
    """(2N) innovations of the channels over their standard deviations, of one correction; NaN where missing.

    What a_O explains is taken out of them: they are the innovations of the combinations, spread over the channels.
    """
    channels = found.turn.conj() * weighting.mixing[:, :-1].T  # (N - 1, N); their scale cancels below
    spread = np.stack([channels, 1j * channels], axis=1).reshape(-1, channels.shape[1]).view(float)  # (m, 2 N)
    variances = np.sum((found.covariance @ spread) * spread, axis=0)
    present = variances > 0.0
    return np.where(present, found.innovation @ spread, np.nan) / np.sqrt(np.where(present, variances, 1.0))


def _flow_terms(size: int) -> FloatArray:
    """(4, n n): Phi = sum dt^k terms[k]."""
    terms = np.zeros((4, size, size))
    terms[0] = np.eye(size)
    for chain, sign in _CHAINS:
        for row, to in enumerate(chain):
            for column in range(row + 1, 4):
                k = column - row
                terms[k, to, chain[column]] = (sign if to == ANGLE else 1.0) / (1.0, 1.0, 2.0, 6.0)[k]
    return terms.reshape(4, -1)


def _spread_terms(size: int, noise: ModelNoise) -> FloatArray:
    """(8, n n): Q = sum dt^k terms[k]; of the chains int_0^dt g g^T, g = [t^3/6, t^2/2, t, 1]."""
    terms = np.zeros((8, size, size))
    factorial = (6.0, 2.0, 1.0, 1.0)
    for chain, sign in _CHAINS:
        for row, one in enumerate(chain):
            for column, other in enumerate(chain):
                k = 7 - row - column
                signs = (sign if one == ANGLE else 1.0) * (sign if other == ANGLE else 1.0)
                terms[k, one, other] += signs * noise.snap / (k * factorial[row] * factorial[column])
    biases = np.arange(MOTION, size)
    terms[1, biases, biases] = noise.bias_walk**2
    return terms.reshape(8, -1)
