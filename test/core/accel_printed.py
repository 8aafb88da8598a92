"""The filters of Woods & Vikas as they stand in the paper, in matrices, many trials at a time: to hold ours against.

Channels are used as they are, with the matrices A, B, Z, V, F, G, H, Q, R of the paper, in its notation. The state is
[w_a, w_b, th_ab]. Nothing here is shared with `jointest_ros.core.accel` but G and F of a link.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointest_ros.core.accel.array import array_matrices
from jointest_ros.core.frame import FloatArray


def rotation(angle: FloatArray) -> FloatArray:
    """R(th) of (12), (..., 2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -2)


def transposed(m: FloatArray) -> FloatArray:
    return np.swapaxes(m, -1, -2)


def times(m: FloatArray, v: FloatArray) -> FloatArray:
    return np.einsum("...ij,...j->...i", m, v)


@dataclass
class Printed:
    """(10) to (20) for one geometry. `sign` of L: 1 as printed (both errors) or both mended, -1 one of them mended."""

    positions_a: FloatArray
    positions_b: FloatArray
    q: FloatArray  # Qhat (C, C)
    dt: float = 0.01
    decorrelated: bool = False
    sign: float = 1.0

    def __post_init__(self) -> None:
        (ga, fa), (gb, fb) = array_matrices(self.positions_a), array_matrices(self.positions_b)
        na, nb = ga.shape[1], gb.shape[1]
        zero_a, zero_b = np.zeros(na), np.zeros(nb)
        self.a = np.array([[0.0, 0, 0], [0, 0, 0], [1, -1, 0]])
        self.b = np.stack([np.r_[ga[1], zero_b], np.r_[zero_a, gb[1]], np.r_[zero_a, zero_b]])
        self.z = np.vstack([np.r_[ga[0], zero_b], np.r_[zero_a, gb[0]], np.c_[fa, np.zeros((2, nb))]])
        self.fb = np.c_[np.zeros((2, na)), fb]
        self.f = np.eye(3) + self.dt * self.a

    def h(self, x: FloatArray, channels: FloatArray) -> FloatArray:
        turned = times(rotation(x[..., 2]), channels @ self.fb.T)
        return np.concatenate([x[..., :2] ** 2, turned], -1)

    def jacobian(self, x: FloatArray, channels: FloatArray) -> FloatArray:
        """H of (15)."""
        h = np.zeros((*x.shape[:-1], 4, 3))
        h[..., 0, 0], h[..., 1, 1] = 2 * x[..., 0], 2 * x[..., 1]
        h[..., 2:, 2] = times(rotation(x[..., 2] + np.pi / 2), channels @ self.fb.T)
        return h

    def v(self, x: FloatArray) -> FloatArray:
        v = np.broadcast_to(self.z, (*x.shape[:-1], *self.z.shape)).copy()
        v[..., 2:, :] -= rotation(x[..., 2]) @ self.fb
        return v

    def gain(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """L of (20), in discrete time, and the process noise that is left."""
        v = self.v(x)
        r = v @ self.q @ transposed(v)
        s = -self.dt * self.b @ self.q @ transposed(v)
        gain = self.sign * transposed(np.linalg.solve(r, transposed(s)))
        return gain, self.dt**2 * self.b @ self.q @ self.b.T - gain @ r @ transposed(gain)

    def ekf(self, channels: FloatArray, x: FloatArray, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """States and variances (trials, T, 3) of channels (trials, T, C) from x (trials, 3) and P0 (3, 3)."""
        p = np.broadcast_to(p, (len(channels), 3, 3))
        states, variances = [], []
        for k in range(channels.shape[1]):
            now = channels[:, k]
            if k:
                before = channels[:, k - 1]
                ahead = times(self.f, x) + self.dt * before @ self.b.T
                f, q = self.f, self.dt**2 * self.b @ self.q @ self.b.T
                if self.decorrelated:
                    gain, q = self.gain(x)
                    ahead = ahead + times(gain, before @ self.z.T - self.h(x, before))
                    f = f - gain @ self.jacobian(x, before)
                x, p = ahead, f @ p @ transposed(f) + q
            h, v = self.jacobian(x, now), self.v(x)
            pz = h @ p @ transposed(h) + v @ self.q @ transposed(v)
            k_gain = transposed(np.linalg.solve(pz, h @ p))
            x = x + times(k_gain, now @ self.z.T - self.h(x, now))
            p = p - k_gain @ pz @ transposed(k_gain)
            states.append(x)
            variances.append(np.diagonal(p, axis1=-2, axis2=-1))
        return np.stack(states, 1), np.stack(variances, 1)

    def ukf(
        self, channels: FloatArray, x: FloatArray, p: FloatArray, alpha: float, kappa: float
    ) -> tuple[FloatArray, FloatArray]:
        """The same by the sigma points (21), (22), drawn anew for each update; h_k where P_xz has z_k in print."""
        p = np.broadcast_to(p, (len(channels), 3, 3))
        states, variances = [], []
        for k in range(channels.shape[1]):
            now = channels[:, k]
            if k:
                before = channels[:, k - 1]
                q = self.dt**2 * self.b @ self.q @ self.b.T
                points, mean, covariance = sigma_points(x, p, alpha, kappa)
                ahead = times(self.f, points) + (self.dt * before @ self.b.T)[:, None]
                if self.decorrelated:
                    gain, q = self.gain(x)
                    z = before @ self.z.T
                    ahead = ahead + times(gain[:, None], z[:, None] - self.h(points, before[:, None]))
                x = np.einsum("i,tij->tj", mean, ahead)
                p = covariance_of(ahead - x[:, None], ahead - x[:, None], covariance) + q
            points, mean, covariance = sigma_points(x, p, alpha, kappa)
            seen = self.h(points, now[:, None])
            h_k = np.einsum("i,tij->tj", mean, seen)
            v = self.v(x)
            pz = covariance_of(seen - h_k[:, None], seen - h_k[:, None], covariance) + v @ self.q @ transposed(v)
            pxz = covariance_of(points - x[:, None], seen - h_k[:, None], covariance)
            k_gain = transposed(np.linalg.solve(pz, transposed(pxz)))
            x = x + times(k_gain, now @ self.z.T - h_k)
            p = p - k_gain @ pz @ transposed(k_gain)
            states.append(x)
            variances.append(np.diagonal(p, axis1=-2, axis2=-1))
        return np.stack(states, 1), np.stack(variances, 1)


def sigma_points(
    x: FloatArray, p: FloatArray, alpha: float, kappa: float, beta: float = 2.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (..., 7, 3) of (21) and the weights (7) of (22)."""
    n = 3
    spread = alpha**2 * (n + kappa)
    columns = transposed(np.linalg.cholesky(spread * p))
    points = np.concatenate([x[..., None, :], x[..., None, :] + columns, x[..., None, :] - columns], -2)
    mean = np.full(7, 1 / (2 * spread))
    mean[0] = (spread - n) / spread
    covariance = mean.copy()
    covariance[0] += 1 - alpha**2 + beta
    return points, mean, covariance


def covariance_of(a: FloatArray, b: FloatArray, weights: FloatArray) -> FloatArray:
    return np.einsum("i,...ij,...ik->...jk", weights, a, b)
