"""The measurement h(x) of the paper's model as an affine function: what makes a Kalman filter an EKF or a UKF.

The EKF takes the derivative at x and neglects the rest. The UKF takes the moments over the sigma points (21), (22): by
statistical linearisation an affine function with an error of its own, which gives the paper's P_xz and P_zz exactly
(with h_k where P_xz has z_k in print). Angular velocities enter h as squares, for which these moments have closed
forms; the angle enters by cosine and sine of three offsets. No point is ever drawn.

States are sequences [w_a, w_b, th, ...] (rad/s, rad), covariances P their lower triangles by rows, readings those of
`PaperModel`; all numbers are floats or arrays over trials, and `Trig` the functions that fit them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jointest_ros.core.accel.paper.model import Real, Values


class Trig(NamedTuple):
    """The functions for one kind of number."""

    cos: Callable[[Any], Any]
    sin: Callable[[Any], Any]
    sqrt: Callable[[Any], Any]


FLOATS = Trig(math.cos, math.sin, math.sqrt)
ARRAYS = Trig(np.cos, np.sin, np.sqrt)


class Linearised(NamedTuple):
    """h about x with covariance P: `innovation` = H (x_true - x) + what is not linear + noise.

    Attributes:
        innovation: (4) z - mean of h.
        slopes: (2 w_a, 2 w_b, g_x, g_y): H = [[2 w_a, 0, 0], [0, 2 w_b, 0], [g_x m], [g_y m]] (15).
        row: m (3); of the EKF [0, 0, 1].
        excess: upper triangle by rows of the covariance (4, 4) of what is not linear; None where it is neglected.
        cos, sin: of th.
    """

    innovation: Values
    slopes: Values
    row: Values
    excess: Values | None
    cos: Real
    sin: Real


Linearise = Callable[[Values, Values, Values, Trig], Linearised]


def linearise_ekf(x: Values, p: Values, reading: Values, trig: Trig) -> Linearised:
    """First order at x."""
    w_a, w_b, th = x[:3]
    z_a, _, ox_a, oy_a, z_b, _, ox_b, oy_b = reading
    c, s = trig.cos(th), trig.sin(th)
    hx, hy = c * ox_b + s * oy_b, c * oy_b - s * ox_b
    y = z_a - w_a * w_a, z_b - w_b * w_b, ox_a - hx, oy_a - hy
    return Linearised(y, (2.0 * w_a, 2.0 * w_b, hy, -hx), (0.0, 0.0, 1.0), None, c, s)


def ukf(alpha: float = 1.0, kappa: float = 0.0, beta: float = 2.0) -> Linearise:
    """Linearisation over the seven sigma points with the weights of (22)."""
    spread2 = alpha * alpha * (3.0 + kappa)  # n + lambda
    spread = math.sqrt(spread2)
    centre_mean = 1.0 - 3.0 / spread2
    centre, point = centre_mean + 1.0 - alpha * alpha + beta, 1.0 / spread2  # `point`: of a pair

    def linearise_ukf(x: Values, p: Values, reading: Values, trig: Trig) -> Linearised:
        w_a, w_b, th = x[:3]
        p00, p10, p11, p20, p21, p22 = p[:6]
        z_a, _, ox_a, oy_a, z_b, _, ox_b, oy_b = reading
        cos, sin, sqrt = trig
        # square root of P, lower triangle
        l00 = sqrt(p00)
        l10, l20 = p10 / l00, p20 / l00
        l11 = sqrt(p11 - l10 * l10)
        l21 = (p21 - l20 * l10) / l11
        l22 = sqrt(p22 - l20 * l20 - l21 * l21)
        # the points are th + d and th - d, d = spread (l20, l21, l22): R(th +- d) = cos d R(th) +- sin d R'(th)
        d0, d1, d2 = spread * l20, spread * l21, spread * l22
        c0, c1, c2 = cos(d0), cos(d1), cos(d2)
        mean = centre_mean + point * (c0 + c1 + c2)
        m2 = sin(d2) / d2
        m1 = (sin(d1) / spread - m2 * l21) / l11
        m0 = (sin(d0) / spread - m2 * l20 - m1 * l10) / l00
        c, s = cos(th), sin(th)
        hx, hy = c * ox_b + s * oy_b, c * oy_b - s * ox_b
        y = z_a - w_a * w_a - p00, z_b - w_b * w_b - p11, ox_a - mean * hx, oy_a - mean * hy
        # even parts of [w_a^2, w_b^2, cos d] at the points, and at the centre, less their means
        q0, q1 = spread2 * l10 * l10, spread2 * l11 * l11
        f0, f1, f2, f = c0 - mean, c1 - mean, c2 - mean, 1.0 - mean
        a0, b0, b1 = spread2 * p00 - p00, q0 - p11, q1 - p11
        za = centre * p00 * p00 + point * (a0 * a0 + 2.0 * p00 * p00)
        zb = centre * p11 * p11 + point * (b0 * b0 + b1 * b1 + p11 * p11)
        ab = centre * p00 * p11 + point * (a0 * b0 - p00 * b1 + p00 * p11)
        ah = point * (a0 * f0 - p00 * (f1 + f2)) - centre * p00 * f
        bh = point * (b0 * f0 + b1 * f1 - p11 * f2) - centre * p11 * f
        hh = centre * f * f + point * (f0 * f0 + f1 * f1 + f2 * f2)
        excess = za, ab, ah * hx, ah * hy, zb, bh * hx, bh * hy, hh * hx * hx, hh * hx * hy, hh * hy * hy
        return Linearised(y, (2.0 * w_a, 2.0 * w_b, hy, -hx), (m0, m1, m2), excess, c, s)

    return linearise_ukf
