"""Time update of the production filters on the paper's model: nothing lags, no common noise is overlooked.

Euler (13) lags by alpha dT / 2. Here the inputs of both ends enter: the trapezoid, with the end correction, for equal
steps -dT/12 (alpha_k - 2 alpha_k-1 + alpha_k-2). The noise of an input then is in the predictions before and after its
sample and in the measurement of that sample. So the filter carries the angular accelerations as well, without memory:
X = [w_a, w_b, th, alpha_a, alpha_b], each alpha from its reading alone, improved by the measurement that shares its
noise. The noise of the end correction does not add up from step to step and is left out.

Conventions as in paper/linearise.py.
"""

from __future__ import annotations

from jointest_ros.core.accel.paper.correct import Correction, correct
from jointest_ros.core.accel.paper.linearise import Linearise, Trig
from jointest_ros.core.accel.paper.model import PaperNoise, Real, Values


def predict_trapezoid(
    x: Values, p: Values, dt: float, reading: Values, noise: PaperNoise, bend: tuple[Real, Real], spread2: float
) -> tuple[list[Real], list[Real]]:
    """Five states and their covariance `dt` s later, with the input at that time but before its measurement.

    Args:
        reading: at the new time.
        bend: `divided_difference` of alpha of both links, rad/s^4: the end correction; 0: none.
        spread2: variance of what both have missed of an angular velocity, (rad/s)^2.
    """
    w_a, w_b, th, al_a, al_b = x
    p00, p10, p11, p20, p21, p22, p30, p31, p32, p33, p40, p41, p42, p43, p44 = p
    new_a, new_b = reading[1], reading[5]
    var_a, var_b = noise.a[4], noise.b[4]
    h, q, q_new = dt / 2.0, dt * dt / 3.0, dt * dt / 6.0  # integrals of a straight line between the two alphas
    cubic = dt * dt * dt / 6.0
    w_a, w_b, th = (
        w_a + h * (al_a + new_a) - cubic * bend[0],
        w_b + h * (al_b + new_b) - cubic * bend[1],
        th + dt * (w_a - w_b) + q * (al_a - al_b) + q_new * (new_a - new_b) - 0.5 * dt * cubic * (bend[0] - bend[1]),
    )
    a0, a1, a2, a3, a4 = p00 + h * p30, p10 + h * p31, p20 + h * p32, p30 + h * p33, p40 + h * p43
    b0, b1, b2, b3, b4 = p10 + h * p40, p11 + h * p41, p21 + h * p42, p31 + h * p43, p41 + h * p44
    t0, t1, t2 = dt * (p00 - p10) + p20, dt * (p10 - p11) + p21, dt * (p20 - p21) + p22
    t0, t1, t2 = t0 + q * (p30 - p40), t1 + q * (p31 - p41), t2 + q * (p32 - p42)
    t3, t4 = dt * (p30 - p31) + p32 + q * (p33 - p43), dt * (p40 - p41) + p42 + q * (p43 - p44)
    h_a, h_b, q_a, q_b = h * var_a, h * var_b, q_new * var_a, q_new * var_b
    covariance = [
        a0 + h * a3 + h * h_a + spread2,
        a1 + h * a4,
        b1 + h * b4 + h * h_b + spread2,
        dt * (a0 - a1) + a2 + q * (a3 - a4) + h * q_a + h * spread2,
        dt * (b0 - b1) + b2 + q * (b3 - b4) - h * q_b - h * spread2,
        dt * (t0 - t1) + t2 + q * (t3 - t4) + q_new * (q_a + q_b) + 2.0 * h * h * spread2,
        *(h_a, 0.0, q_a, var_a),
        *(0.0, h_b, -q_b, 0.0, var_b),
    ]
    return [w_a, w_b, th, new_a, new_b], covariance


def divided_difference(before: Real, last: Real, new: Real, h_before: float, h: float) -> Real:
    """Second divided difference of values `h_before` and `h` apart: half the second derivative."""
    return ((new - last) / h - (last - before) / h_before) / (h + h_before)


def correct_trapezoid(
    x: Values, p: Values, dt: float, reading: Values, noise: PaperNoise, linearise: Linearise, trig: Trig
) -> Correction:
    """`correct` after `predict_trapezoid` over `dt`; 0: after the start."""
    at = linearise(x, p, reading, trig)
    r, s_a, s_b = noise.at(at.cos, at.sin)
    h, q = -dt / 2.0, -dt * dt / 6.0
    s = (
        [h * one for one in s_a],
        [h * one for one in s_b],
        [q * (one - two) for one, two in zip(s_a, s_b, strict=True)],
        [-one for one in s_a],
        [-one for one in s_b],
    )
    return correct(x, p, at, r, s, trig)


def start_trapezoid(x: Values, p: Values, reading: Values, noise: PaperNoise) -> tuple[list[Real], list[Real]]:
    """Five states from three at the first sample, before its measurement."""
    nothing = (0.0, 0.0, 0.0)
    return [*x, reading[1], reading[5]], [*p, *nothing, noise.a[4], *nothing, 0.0, noise.b[4]]
