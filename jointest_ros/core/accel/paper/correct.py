"""Measurement update of the filters on the paper's model, for noise that states and measurement have in common.

Four readings, three or five states: written out, because plain floats are 40 times faster than numpy at this size, and
because the same lines work on arrays over trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from jointest_ros.core.accel.paper.linearise import Linearised, Trig
from jointest_ros.core.accel.paper.model import Real, Values


class Correction(NamedTuple):
    """A corrected state, and its innovations as independent numbers of variance 1 with the root of the determinant."""

    x: list[Real]
    p: list[Real]
    whitened: Values
    root_determinant: Real


def correct(x: Values, p: Values, at: Linearised, r: Values, s: Sequence[Values], trig: Trig) -> Correction:
    """x and P after a measurement: K = (P H^T + S) Pz^-1, P+ = P - K Pz K^T, Pz = H P H^T + H S + S^T H^T + R.

    Args:
        x, p: n = 3 or 5 states and their covariance.
        at: the measurement at this x and P.
        r: upper triangle of R (4, 4) by rows.
        s: S (n, 4), the covariance of the states with the noise of the measurement.
    """
    d_a, d_b, gx, gy = at.slopes
    m0, m1, m2 = at.row
    rows = []
    for (ca, cb, ct), (s0, s1, s2, s3) in zip(columns_of(p), s, strict=True):
        along = m0 * ca + m1 * cb + m2 * ct
        rows.append((d_a * ca + s0, d_b * cb + s1, gx * along + s2, gy * along + s3))
    (a0, a1, a2, a3), (_, b1, b2, b3), (_, _, t2, t3) = rows[:3]  # H (P H^T + S)
    t2, t3 = m0 * a2 + m1 * b2 + m2 * t2, m0 * a3 + m1 * b3 + m2 * t3
    (sa0, sa1, sa2, sa3), (sb0, sb1, sb2, sb3), (st0, st1, st2, st3) = s[:3]  # S^T H^T
    u0, u1 = m0 * sa0 + m1 * sb0 + m2 * st0, m0 * sa1 + m1 * sb1 + m2 * st1
    u2, u3 = m0 * sa2 + m1 * sb2 + m2 * st2, m0 * sa3 + m1 * sb3 + m2 * st3
    pz = (
        *(d_a * (a0 + sa0), d_a * a1 + d_b * sb0, d_a * a2 + gx * u0, d_a * a3 + gy * u0),
        *(d_b * (b1 + sb1), d_b * b2 + gx * u1, d_b * b3 + gy * u1),
        *(gx * (t2 + u2), gx * t3 + gy * u2, gy * (t3 + u3)),
    )
    if at.excess is not None:
        r = [one + more for one, more in zip(r, at.excess, strict=True)]
    root = cholesky([one + more for one, more in zip(pz, r, strict=True)], trig)
    whitened = forward(root, at.innovation)
    v0, v1, v2, v3 = whitened
    gains = [forward(root, row) for row in rows]
    corrected = [one + g0 * v0 + g1 * v1 + g2 * v2 + g3 * v3 for one, (g0, g1, g2, g3) in zip(x, gains, strict=True)]
    after, entry = [], iter(p)
    for i, (g0, g1, g2, g3) in enumerate(gains):
        for h0, h1, h2, h3 in gains[: i + 1]:
            after.append(next(entry) - g0 * h0 - g1 * h1 - g2 * h2 - g3 * h3)
    return Correction(corrected, after, whitened, root[0] * root[2] * root[5] * root[9])


def columns_of(p: Values) -> list[tuple[Real, Real, Real]]:
    """Covariances of each state with w_a, w_b and th."""
    p00, p10, p11, p20, p21, p22 = p[:6]
    columns = [(p00, p10, p20), (p10, p11, p21), (p20, p21, p22)]
    if len(p) > 6:
        p30, p31, p32, _, p40, p41, p42, _, _ = p[6:]
        columns += [(p30, p31, p32), (p40, p41, p42)]
    return columns


def cholesky(a: Values, trig: Trig) -> Values:
    """Cholesky factor of a (4, 4), its upper triangle by rows: lower triangle by rows."""
    sqrt = trig.sqrt
    a00, a01, a02, a03, a11, a12, a13, a22, a23, a33 = a
    l00 = sqrt(a00)
    l10, l20, l30 = a01 / l00, a02 / l00, a03 / l00
    l11 = sqrt(a11 - l10 * l10)
    l21, l31 = (a12 - l20 * l10) / l11, (a13 - l30 * l10) / l11
    l22 = sqrt(a22 - l20 * l20 - l21 * l21)
    l32 = (a23 - l30 * l20 - l31 * l21) / l22
    l33 = sqrt(a33 - l30 * l30 - l31 * l31 - l32 * l32)
    return l00, l10, l11, l20, l21, l22, l30, l31, l32, l33


def forward(root: Values, b: Values) -> Values:
    """L^-1 b."""
    l00, l10, l11, l20, l21, l22, l30, l31, l32, l33 = root
    y0 = b[0] / l00
    y1 = (b[1] - l10 * y0) / l11
    y2 = (b[2] - l20 * y0 - l21 * y1) / l22
    return y0, y1, y2, (b[3] - l30 * y0 - l31 * y1 - l32 * y2) / l33


def backward(root: Values, y: Values) -> Values:
    """L^-T y."""
    l00, l10, l11, l20, l21, l22, l30, l31, l32, l33 = root
    x3 = y[3] / l33
    x2 = (y[2] - l32 * x3) / l22
    x1 = (y[1] - l21 * x2 - l31 * x3) / l11
    return (y[0] - l10 * x1 - l20 * x2 - l30 * x3) / l00, x1, x2, x3
