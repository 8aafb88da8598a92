"""The paper's model of a joint between two accelerometer arrays (Woods & Vikas, section II.B), corrected.

State        x = [w_a, w_b, th], th = th_ab = th_a - th_b: angular velocities of the links, joint angle; rad/s and rad.
Reading      of link j: [z, alpha, o_x, o_y] = [G; F] a', what its channels a' say of w^2, the angular acceleration and
             the specific force at the joint O in its axes, (9); its noise is [G; F] e, with covariance [G; F] Qhat
             [G; F]^T: all that the model needs of an array, however many sensors it has.
Input        alpha of both links: d/dt [w_a, w_b, th] = [alpha_a - e_a, alpha_b - e_b, w_a - w_b], (10) with the
             right sign of the noise e.
Measurement  [z_a, z_b, o_a] = h(x) + v, h = [w_a^2, w_b^2, R(th) o_b], R(th) = [[c, s], [-s, c]],
             v = [e_za, e_zb, e_oa - R(th) e_ob]: (11), (18). It has noise in common with the input of the same sample.

Every number may be a float or an array with an axis of trials: the same lines serve a node and a Monte Carlo run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jointest_ros.core.accel.array import array_matrices
from jointest_ros.core.frame import FloatArray

Real = Any  # a float, or an array over trials
Values = Any  # several of these: a sequence, or the rows of an array
LinkNoise = tuple[Real, ...]  # upper triangle by rows of the covariance (4, 4) of [z, alpha, o_x, o_y]
_TRIANGLE = np.triu_indices(4)


def link_reading(positions: ArrayLike) -> FloatArray:
    """[G; F] of one link, (4, 2N): channels to [z, alpha, o_x, o_y] (1/s^2, rad/s^2, m/s^2, m/s^2).

    Args:
        positions: (N, 2), m, from the joint, in the plane of motion.

    Raises:
        ConfigurationError: see `array_matrices`.
    """
    return np.concatenate(array_matrices(positions))


def link_noise(reading: FloatArray, covariance: ArrayLike) -> FloatArray:
    """Covariance of a link's reading, (4, 4), for `link_reading` (4, 2N) and Qhat of its channels.

    Args:
        covariance: (m/s^2)^2: (2N, 2N); (2N), its diagonal; or one variance for all channels.
    """
    q = np.asarray(covariance, dtype=float)
    weighted = reading @ q if q.ndim == 2 else reading * q
    return np.asarray(weighted @ reading.T)


@dataclass(frozen=True, eq=False)
class PaperNoise:
    """Noise of the readings of both links. The entries may be arrays over trials, one geometry or Qhat each."""

    a: LinkNoise
    b: LinkNoise

    @classmethod
    def of(cls, a: FloatArray, b: FloatArray) -> PaperNoise:
        """From covariances (..., 4, 4); leading axes are trials."""
        one, two = ([covariance[..., i, j] for i, j in zip(*_TRIANGLE, strict=True)] for covariance in (a, b))
        if a.ndim == b.ndim == 2:  # arithmetic with numpy's scalars is slow
            return cls(tuple(map(float, one)), tuple(map(float, two)))
        return cls(tuple(one), tuple(two))

    def at(self, c: Real, s: Real) -> tuple[tuple[Real, ...], tuple[Real, ...], tuple[Real, ...]]:
        """R of (18), and E[e v^T] with the noise e of alpha_a and of alpha_b, at cosine and sine of th.

        Returns:
            R: upper triangle of (4, 4) by rows; E[e_a v^T] (4); E[e_b v^T] (4).
        """
        zz_a, az_a, zx_a, zy_a, _, ax_a, ay_a, xx_a, xy_a, yy_a = self.a
        zz_b, az_b, zx_b, zy_b, _, ax_b, ay_b, xx_b, xy_b, yy_b = self.b
        cc, ss, cs = c * c, s * s, c * s
        r = (
            *(zz_a, 0.0, zx_a, zy_a),
            *(zz_b, -c * zx_b - s * zy_b, s * zx_b - c * zy_b),
            *(xx_a + cc * xx_b + 2.0 * cs * xy_b + ss * yy_b, xy_a + cs * (yy_b - xx_b) + (cc - ss) * xy_b),
            yy_a + ss * xx_b - 2.0 * cs * xy_b + cc * yy_b,
        )
        return r, (az_a, 0.0, ax_a, ay_a), (0.0, az_b, -c * ax_b - s * ay_b, s * ax_b - c * ay_b)


@dataclass(frozen=True, eq=False)
class PaperModel:
    """Two arrays with the noise of their channels: from channels to readings.

    Attributes:
        reading: (8, 2 (Na + Nb)): channels to [z_a, alpha_a, o_ax, o_ay, z_b, alpha_b, o_bx, o_by].
        noise: of these.
    """

    reading: FloatArray
    noise: PaperNoise

    @classmethod
    def of(
        cls, positions_a: ArrayLike, positions_b: ArrayLike, covariance_a: ArrayLike, covariance_b: ArrayLike
    ) -> PaperModel:
        """From positions and Qhat of the two links, see `link_reading` and `link_noise`.

        Raises:
            ConfigurationError: see `array_matrices`.
        """
        one, two = link_reading(positions_a), link_reading(positions_b)
        reading = np.zeros((8, one.shape[1] + two.shape[1]))
        reading[:4, : one.shape[1]], reading[4:, one.shape[1] :] = one, two
        return cls(reading, PaperNoise.of(link_noise(one, covariance_a), link_noise(two, covariance_b)))


def relative_vector(o_a: Values, o_b: Values) -> tuple[Real, Real]:
    """(sine, cosine) of (12), both times |o_a| |o_b|: th_ab = atan2 of them. o: (x, y) in the axes of its link."""
    return o_a[0] * o_b[1] - o_a[1] * o_b[0], o_a[0] * o_b[0] + o_a[1] * o_b[1]


def relative_noise(o_a: Values, o_b: Values, noise: PaperNoise) -> Real:
    """Variance of `relative_vector` in any direction, (m/s^2)^4; over |o_a|^2 |o_b|^2 that of the angle, rad^2.

    (|F| sigma / |a_O|)^2 of both links and what their noises make together, which counts where a_O is small.
    """
    a, b = 0.5 * (noise.a[7] + noise.a[9]), 0.5 * (noise.b[7] + noise.b[9])
    return (o_a[0] * o_a[0] + o_a[1] * o_a[1]) * b + (o_b[0] * o_b[0] + o_b[1] * o_b[1]) * a + 2.0 * a * b
