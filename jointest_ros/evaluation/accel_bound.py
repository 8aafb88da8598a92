"""Cramér-Rao bound of joint angle and link rates from accelerometer arrays (Woods & Vikas), along a true trajectory.

Unknown at every sample k are the state X_k = [w_a, w_b, th_ab], the angular accelerations al_k = [al_a, al_b] and the
specific force at the joint a_O,k; about al and a_O nothing is known beforehand, at any sample. They are tied by the
trapezoid

    w_k = w_k-1 + dT/2 (al_k-1 + al_k),    th_k = th_k-1 + dT/2 (w_a - w_b)_k-1 + dT/2 (w_a - w_b)_k

and measured by all channels of `core.accel.array`, with white noise of covariance Qhat:

    a_i = a_O + D(r_i) [w_a^2, al_a],    b_i = R(th)^T a_O + D(r_i) [w_b^2, al_b]

The model is linearised at the truth. Sensors are known exactly and have no biases, so that a real estimator stays
above. The recursion is that of information matrices: "nothing is known" is a zero in them, and of a placement of
sensors only an 8 x 8 matrix matters, so that many placements of any number of sensors are treated at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from jointest_ros.core.accel.array import lever
from jointest_ros.core.frame import FloatArray

INITIAL_VARIANCE = 0.01  # of each state before the first sample, rad and s


def array_information(positions_a: ArrayLike, positions_b: ArrayLike, noise: ArrayLike) -> FloatArray:
    """(8, 8) information of one sample on [a_O, w_a^2, al_a] in axes of a and [a_O, w_b^2, al_b] in axes of b, SI.

    Args:
        positions_a, positions_b: (Na, 2), (Nb, 2), m, of the accelerometers from the joint.
        noise: one standard deviation of all channels, m/s^2, or Qhat, their covariance (2 (Na + Nb), 2 (Na + Nb)).
    """
    of_a, of_b = (_channels(np.asarray(positions, dtype=float)) for positions in (positions_a, positions_b))
    channels = np.zeros((len(of_a) + len(of_b), 8))
    channels[: len(of_a), :4] = of_a
    channels[len(of_a) :, 4:] = of_b
    covariance = np.asarray(noise, dtype=float)
    if covariance.ndim == 0:
        return np.asarray(channels.T @ channels / covariance**2)
    return np.asarray(channels.T @ np.linalg.solve(covariance, channels))


def bound(
    state: FloatArray,
    joint_acceleration: FloatArray,
    information: FloatArray,
    period: float,
    *,
    initial: ArrayLike = INITIAL_VARIANCE,
    smoother: bool = False,
    biases: tuple[FloatArray, FloatArray] | None = None,
) -> FloatArray:
    """(..., T, 3) variances of [w_a, w_b, th_ab] that no unbiased estimator beats, (rad/s)^2 and rad^2.

    Args:
        state: (T, 3) the true w_a, w_b (rad/s) and th_ab (rad).
        joint_acceleration: (T, 2) the true specific force at the joint in the axes of a, m/s^2.
        information: (..., 8, 8) of `array_information`, one for each placement.
        period: of the samples, s.
        initial: variance of each state before sample 0, or their covariance (3, 3), rad and s.
        smoother: of estimates that know all samples; otherwise those up to their own.
        biases: the channels have unknown biases too: (..., 8, 8) each, `array_information` with their standard
            deviation in place of the noise, and with that of their random walk in one period (more than 0). Exact where
            noise and biases of all channels are alike.
    """
    samples, jacobians = len(state), _jacobians(state, joint_acceleration)
    if biases is not None:  # what they do to the 8 quantities of `information`: eight more variables
        jacobians = np.concatenate([jacobians[..., :5], np.tile(np.eye(8), (samples, 1, 1)), jacobians[..., 5:]], -1)
    measured = [_without_last(2, j.T @ information @ j) for j in jacobians]  # all but a_O
    back, ahead = _transitions(-period, biases is not None), _transitions(period, biases is not None)
    old = 2 + (0 if biases is None else 8)  # variables of the neighbouring sample: al, biases
    walk = np.zeros((old + len(ahead), old + len(ahead)))
    known = np.empty((samples, *measured[0].shape))  # on [X_k, al_k, biases_k], from the samples up to k
    known[0] = measured[0]
    prior = np.asarray(initial, dtype=float)
    known[0, ..., :3, :3] += np.linalg.inv(prior * np.eye(3) if prior.ndim == 0 else prior)
    if biases is not None:
        known[0, ..., 5:, 5:] += biases[0]
        step = np.hstack([np.zeros((8, 5)), np.eye(8), np.zeros((8, 2)), -np.eye(8)])
        walk = step.T @ biases[1] @ step
    for k in range(1, samples):
        known[k] = _without_last(old, back.T @ known[k - 1] @ back + walk) + measured[k]
    if smoother:
        later = np.zeros(known.shape[1:])  # the same from the samples after k
        for k in range(samples - 2, -1, -1):
            later = _without_last(old, ahead.T @ (later + measured[k + 1]) @ ahead + walk)
            known[k] += later
    variances = np.diagonal(np.linalg.inv(known), axis1=-2, axis2=-1)[..., :3]
    return np.moveaxis(variances, 0, -2)


def rms_deg(variances: FloatArray, first: int = 0) -> FloatArray:
    """(..., 3) root mean square over the samples from `first` on of variances (..., T, 3), in deg/s, deg/s and deg."""
    return np.asarray(np.degrees(np.sqrt(variances[..., first:, :].mean(axis=-2))))


def _channels(positions: FloatArray) -> FloatArray:
    """(2N, 4): what the channels of one link are made of, [a_O, w^2, al]."""
    return np.hstack([np.tile(np.eye(2), (len(positions), 1)), lever(positions).reshape(-1, 2)])


def _jacobians(state: FloatArray, joint_acceleration: FloatArray) -> FloatArray:
    """(T, 8, 7): of [a_O, w_a^2, al_a, R(th)^T a_O, w_b^2, al_b] by [w_a, w_b, th, al_a, al_b, a_O]."""
    w_a, w_b, angle = state.T
    c, s = np.cos(angle), np.sin(angle)
    a_x, a_y = joint_acceleration.T
    jacobian = np.zeros((len(state), 8, 7))
    jacobian[:, 0, 5] = jacobian[:, 1, 6] = 1.0
    jacobian[:, 2, 0], jacobian[:, 6, 1] = 2.0 * w_a, 2.0 * w_b
    jacobian[:, 3, 3] = jacobian[:, 7, 4] = 1.0
    jacobian[:, 4, 5], jacobian[:, 4, 6], jacobian[:, 5, 5], jacobian[:, 5, 6] = c, -s, s, c  # R(th)^T
    jacobian[:, 4, 2], jacobian[:, 5, 2] = -s * a_x - c * a_y, c * a_x - s * a_y
    return jacobian


def _transitions(period: float, with_biases: bool) -> FloatArray:
    """[X, al, biases] a period later (earlier: negative) by these [X, al, biases] and that [al, biases]."""
    number = 8 if with_biases else 0
    here = 5 + number
    matrix = np.zeros((here, here + 2 + number))
    w_a, w_b, angle = np.eye(3, here + 2 + number)
    for w, rate in enumerate((w_a, w_b)):
        rate[[3 + w, here + w]] = period / 2.0
    matrix[0], matrix[1] = w_a, w_b
    matrix[2] = angle + period / 2.0 * (w_a - w_b)
    matrix[2, :2] += period / 2.0 * np.array([1.0, -1.0])
    matrix[3:, here:] = np.eye(2 + number)
    return matrix


def _without_last(number: int, information: FloatArray) -> FloatArray:
    """On all but the last variables, whatever these are: the Schur complement."""
    cross = information[..., -number:, :-number]
    rest = information[..., :-number, :-number]
    rest = rest - np.swapaxes(cross, -1, -2) @ np.linalg.solve(information[..., -number:, -number:], cross)
    return np.asarray(0.5 * (rest + np.swapaxes(rest, -1, -2)))  # what is not symmetric would grow from step to step
