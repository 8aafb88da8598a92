"""Time update of the filters as the paper has them: Euler on the input of the sample before (13), for `reproduce`.

With (20) right, the noise that input and measurement of a sample have in common is taken out:

    L = S R^-1, S = E[w v^T] = -dT E[e v^T], x- = g(x) + L (z - h(x)), P- = (F - L H) P (F - L H)^T + Q - L R L^T.

The paper's signs in (10) and (20) are both wrong and cancel; Jacobian and process noise it does not state.
Conventions as in paper/linearise.py.
"""

from __future__ import annotations

from jointest_ros.core.accel.paper.correct import Correction, backward, cholesky, columns_of, correct, forward
from jointest_ros.core.accel.paper.linearise import Linearise, Trig
from jointest_ros.core.accel.paper.model import PaperNoise, Real, Values


def predict_euler(
    x: Values, p: Values, dt: float, before: Values, noise: PaperNoise, linearise: Linearise | None, trig: Trig
) -> tuple[list[Real], list[Real]]:
    """Three states and their covariance `dt` s later (13), (17).

    Args:
        before: the reading at x.
        linearise: of (20); None: without it, as the paper's results are.
    """
    w_a, w_b, th = x
    p00, p10, p11, p20, p21, p22 = p
    x = [w_a + dt * before[1], w_b + dt * before[5], th + dt * (w_a - w_b)]
    q_a, q_b = dt * dt * noise.a[4], dt * dt * noise.b[4]
    if linearise is None:
        d0, d1, d2 = dt * (p00 - p10) + p20, dt * (p10 - p11) + p21, dt * (p20 - p21) + p22
        return x, [p00 + q_a, p10, p11 + q_b, d0, d1, dt * (d0 - d1) + d2]
    at = linearise([w_a, w_b, th], p, before, trig)
    r, s_a, s_b = noise.at(at.cos, at.sin)
    root = cholesky(r, trig)
    white_a, white_b = forward(root, s_a), forward(root, s_b)
    gain_a = [-dt * one for one in backward(root, white_a)]  # L
    gain_b = [-dt * one for one in backward(root, white_b)]
    x[0] = x[0] + _dot(gain_a, at.innovation)
    x[1] = x[1] + _dot(gain_b, at.innovation)
    d_a, d_b, gx, gy = at.slopes
    m0, m1, m2 = at.row
    turn_a, turn_b = gain_a[2] * gx + gain_a[3] * gy, gain_b[2] * gx + gain_b[3] * gy
    f = (  # F - L H
        (1.0 - gain_a[0] * d_a - turn_a * m0, -gain_a[1] * d_b - turn_a * m1, -turn_a * m2),
        (-gain_b[0] * d_a - turn_b * m0, 1.0 - gain_b[1] * d_b - turn_b * m1, -turn_b * m2),
        (dt, -dt, 1.0),
    )
    columns = columns_of(p)
    rows = [[u0 * v0 + u1 * v1 + u2 * v2 for v0, v1, v2 in columns] for u0, u1, u2 in f]
    after = [u0 * v0 + u1 * v1 + u2 * v2 for i, (u0, u1, u2) in enumerate(rows) for v0, v1, v2 in f[: i + 1]]
    dt2 = dt * dt
    after[0] = after[0] + q_a - dt2 * _dot(white_a, white_a)
    after[1] = after[1] - dt2 * _dot(white_a, white_b)
    after[2] = after[2] + q_b - dt2 * _dot(white_b, white_b)
    if at.excess is not None:
        after[0] = after[0] + _quadratic(gain_a, at.excess, gain_a)
        after[1] = after[1] + _quadratic(gain_a, at.excess, gain_b)
        after[2] = after[2] + _quadratic(gain_b, at.excess, gain_b)
    return x, after


def correct_euler(
    x: Values, p: Values, reading: Values, noise: PaperNoise, linearise: Linearise, trig: Trig
) -> Correction:
    """`correct` after `predict_euler`: nothing in common with the noise of the states."""
    at = linearise(x, p, reading, trig)
    return correct(x, p, at, noise.at(at.cos, at.sin)[0], ((0.0,) * 4,) * 3, trig)


def _dot(a: Values, b: Values) -> Real:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


def _quadratic(a: Values, m: Values, b: Values) -> Real:
    """a^T M b, M (4, 4) by its upper triangle."""
    m00, m01, m02, m03, m11, m12, m13, m22, m23, m33 = m
    rows = (m00, m01, m02, m03), (m01, m11, m12, m13), (m02, m12, m22, m23), (m03, m13, m23, m33)
    return _dot(a, [_dot(row, b) for row in rows])
