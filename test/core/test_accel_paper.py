"""The filters on the paper's model against the paper's own matrices, and online against batched, sample by sample."""

from __future__ import annotations

import math

import numpy as np
import pytest
from accel_printed import Printed, covariance_of, rotation, sigma_points, times, transposed

from jointest_ros.core.accel.array import array_matrices
from jointest_ros.core.accel.paper.linearise import ARRAYS, FLOATS, Linearise, linearise_ekf, ukf
from jointest_ros.core.accel.paper.model import PaperModel, PaperNoise, link_noise, link_reading
from jointest_ros.core.accel.paper.trapezoid import (
    correct_trapezoid,
    divided_difference,
    predict_trapezoid,
    start_trapezoid,
)
from jointest_ros.core.accel.paper.trials import DECORRELATED, PRINTED, TRAPEZOID, run_filter
from jointest_ros.core.frame import FloatArray
from jointest_ros.sim import slider_crank

DT = slider_crank.PERIOD
P0 = 0.01 * np.eye(3)
TRIALS, SAMPLES = 6, 250
# any number of sensors, anywhere in the plane
UNEVEN = np.array([[0.05, 0.02], [0.2, -0.04], [0.3, 0.03]]), np.array([[0.1, 0.05], [0.4, 0.0]])


def covariance(channels: int) -> FloatArray:
    """Qhat of one link: no two channels alike, all in common."""
    root = np.random.default_rng(channels).standard_normal((channels, channels))
    return np.asarray(3e-5 * root @ root.T + 2e-4 * np.eye(channels))


class Case:
    """Trials of scenario B with sensors at `places`."""

    def __init__(self, places: tuple[FloatArray, FloatArray], q: tuple[FloatArray, FloatArray]) -> None:
        self.motion = slider_crank.motion("B", positions=places, samples=SAMPLES)
        self.q = np.block([[q[0], np.zeros((len(q[0]), len(q[1])))], [np.zeros((len(q[1]), len(q[0]))), q[1]]])
        noise = np.random.default_rng(11).standard_normal((TRIALS, *self.motion.channels.shape))
        self.channels = self.motion.channels + noise @ np.linalg.cholesky(self.q).T
        self.model = PaperModel.of(*places, *q)
        self.readings = self.channels @ self.model.reading.T
        self.start = self.motion.state[0] + 0.1 * np.random.default_rng(7).standard_normal(3)
        self.starts = np.tile(self.start, (TRIALS, 1))


@pytest.fixture(scope="module", params=["two", "uneven"])
def case(request: pytest.FixtureRequest) -> Case:
    if request.param == "uneven":
        return Case(UNEVEN, (covariance(6), covariance(4)))
    pair = slider_crank.row(0.15, 0.15)
    return Case((pair, pair), (2e-4 * np.eye(4),) * 2)


@pytest.mark.parametrize(("form", "decorrelated"), [(PRINTED, False), (DECORRELATED, True)])
def test_ekf_is_that_of_the_paper(case: Case, form: str, decorrelated: bool) -> None:
    printed = Printed(case.motion.positions_a, case.motion.positions_b, case.q, decorrelated=decorrelated)
    state, variance = printed.ekf(case.channels, case.starts, P0)
    ours = run_filter(case.readings, case.model.noise, DT, case.start, P0, form)
    assert np.abs(ours.state - state).max() < 1e-9
    assert ours.variance == pytest.approx(variance, rel=1e-9)


@pytest.mark.parametrize(("form", "decorrelated"), [(PRINTED, False), (DECORRELATED, True)])
@pytest.mark.parametrize(("alpha", "kappa"), [(1.0, 0.0), (0.5, 0.0), (0.1, 2.0)])
def test_ukf_is_that_of_the_paper(case: Case, form: str, decorrelated: bool, alpha: float, kappa: float) -> None:
    printed = Printed(case.motion.positions_a, case.motion.positions_b, case.q, decorrelated=decorrelated)
    state, variance = printed.ukf(case.channels, case.starts, P0, alpha, kappa)
    ours = run_filter(case.readings, case.model.noise, DT, case.start, P0, form, ukf(alpha, kappa))
    assert np.abs(ours.state - state).max() < 1e-9
    assert ours.variance == pytest.approx(variance, rel=1e-9)


def dense_trapezoid(case: Case, unscented: bool) -> tuple[FloatArray, FloatArray]:
    """The production filter in matrices: X = [w_a, w_b, th, alpha_a, alpha_b], trapezoid and end correction."""
    places = case.motion.positions_a, case.motion.positions_b
    printed = Printed(*places, case.q)
    g_alpha = np.stack([printed.b[0], printed.b[1]])
    phi = np.eye(5)
    phi[0, 3] = phi[1, 4] = DT / 2
    phi[2] = [DT, -DT, 1, DT**2 / 3, -(DT**2) / 3]
    phi[3, 3] = phi[4, 4] = 0.0
    ahead = np.vstack([DT / 2 * np.eye(2), DT**2 / 6 * np.array([[1, -1]]), np.eye(2)])  # of the new alphas
    alphas = case.channels @ g_alpha.T
    x = np.c_[case.starts, alphas[:, 0]]
    p = np.zeros((TRIALS, 5, 5))
    p[:, :3, :3] = P0
    p[:, 3:, 3:] = g_alpha @ case.q @ g_alpha.T
    entering = np.vstack([np.zeros((3, 2)), np.eye(2)])
    states, variances = [], []
    for k in range(SAMPLES):
        now = case.channels[:, k]
        if k:
            entering = ahead
            x = times(phi, x) + times(ahead, alphas[:, k])
            p = phi @ p @ phi.T + ahead @ g_alpha @ case.q @ g_alpha.T @ ahead.T
            if k > 1:
                bend = DT / 12 * (alphas[:, k] - 2 * alphas[:, k - 1] + alphas[:, k - 2])
                x[:, :2] -= bend
                x[:, 2] -= DT / 2 * (bend[:, 0] - bend[:, 1])
        v = printed.v(x[:, :3])
        s = -entering @ g_alpha @ case.q @ transposed(v)
        r = v @ case.q @ transposed(v)
        if unscented:
            points, mean, weights = sigma_points(x[:, :3], p[:, :3, :3], 1.0, 0.0)
            seen = printed.h(points, now[:, None])
            expected = np.einsum("i,tij->tj", mean, seen)
            crossed = covariance_of(points - x[:, None, :3], seen - expected[:, None], weights)
            h = transposed(np.linalg.solve(p[:, :3, :3], crossed))
            r = r + covariance_of(seen - expected[:, None], seen - expected[:, None], weights)
            r = r - h @ p[:, :3, :3] @ transposed(h)
        else:
            h, expected = printed.jacobian(x[:, :3], now), printed.h(x[:, :3], now)
        h = np.concatenate([h, np.zeros((TRIALS, 4, 2))], -1)
        pz = h @ p @ transposed(h) + h @ s + transposed(h @ s) + r
        gain = transposed(np.linalg.solve(pz, transposed(p @ transposed(h) + s)))
        x = x + times(gain, now @ printed.z.T - expected)
        p = p - gain @ pz @ transposed(gain)
        states.append(x[:, :3])
        variances.append(np.diagonal(p, axis1=-2, axis2=-1)[:, :3])
    return np.stack(states, 1), np.stack(variances, 1)


@pytest.mark.parametrize(("linearise", "unscented"), [(linearise_ekf, False), (ukf(), True)])
def test_trapezoid_is_that_of_its_matrices(case: Case, linearise: Linearise, unscented: bool) -> None:
    state, variance = dense_trapezoid(case, unscented)
    ours = run_filter(case.readings, case.model.noise, DT, case.start, P0, TRAPEZOID, linearise)
    assert np.abs(ours.state - state).max() < 1e-9
    assert ours.variance == pytest.approx(variance, rel=1e-9)


@pytest.mark.parametrize("linearise", [linearise_ekf, ukf()])
def test_online_is_batched(case: Case, linearise: Linearise) -> None:
    batch = run_filter(case.readings[:1], case.model.noise, DT, case.start, P0, TRAPEZOID, linearise)
    rows = case.readings[0].tolist()
    p0 = P0[np.tril_indices(3)].tolist()
    x, p = start_trapezoid(case.start.tolist(), p0, rows[0], case.model.noise)
    for k, reading in enumerate(rows):
        if k:
            bend = (0.0, 0.0)
            if k > 1:
                one, two = rows[k - 2], rows[k - 1]
                bend = tuple(divided_difference(one[i], two[i], reading[i], DT, DT) for i in (1, 5))
            x, p = predict_trapezoid(x, p, DT, reading, case.model.noise, bend, 0.0)
        x, p, _, _ = correct_trapezoid(x, p, DT if k else 0.0, reading, case.model.noise, linearise, FLOATS)
        assert x[:3] == pytest.approx(batch.state[0, k], rel=1e-9, abs=1e-9)
        assert [p[0], p[2], p[5]] == pytest.approx(batch.variance[0, k], rel=1e-9)
        assert all(isinstance(number, float) for number in (*x, *p))


def test_trials_of_different_arrays_run_together() -> None:
    pair = slider_crank.row(0.15, 0.15)
    cases = [Case((pair, pair), (2e-4 * np.eye(4),) * 2), Case(UNEVEN, (covariance(6), covariance(4)))]
    links = []
    for name in ("positions_a", "positions_b"):
        places = [getattr(one.motion, name) for one in cases]
        q = [(2e-4 * np.eye(4)), covariance(6 if name == "positions_a" else 4)]
        each = [link_noise(link_reading(place), one) for place, one in zip(places, q, strict=True)]
        links.append(np.repeat(each, TRIALS, axis=0))
    readings = np.concatenate([one.readings for one in cases])
    starts = np.concatenate([one.starts for one in cases])
    together = run_filter(readings, PaperNoise.of(*links), DT, starts, P0)
    for k, one in enumerate(cases):
        alone = run_filter(one.readings, one.model.noise, DT, one.start, P0)
        assert together.state[k * TRIALS : (k + 1) * TRIALS] == pytest.approx(alone.state, abs=1e-12)


def test_many_trials_are_the_same_in_blocks(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = run_filter(case.readings[:, :50], case.model.noise, DT, case.starts, P0)
    monkeypatch.setattr("jointest_ros.core.accel.paper.trials.BLOCK", 4)
    parts = run_filter(case.readings[:, :50], case.model.noise, DT, case.starts, P0)
    assert (parts.state == whole.state).all()


def test_jacobian_is_the_derivative() -> None:
    reading = [4.0, 10.0, 2.0, -3.0, 1.0, 5.0, -1.0, 4.0]
    x, p = [1.8, -0.9, 0.4], [0.01, 0.0, 0.01, 0.0, 0.0, 0.01]
    at = linearise_ekf(x, p, reading, FLOATS)
    d_a, d_b, gx, gy = at.slopes
    h = np.array([[d_a, 0, 0], [0, d_b, 0], [0, 0, gx], [0, 0, gy]])
    for state in range(3):
        step = np.eye(3)[state] * 1e-6
        plus = linearise_ekf((x + step).tolist(), p, reading, FLOATS).innovation
        minus = linearise_ekf((x - step).tolist(), p, reading, FLOATS).innovation
        assert (np.array(minus) - plus) / 2e-6 == pytest.approx(h[:, state], abs=1e-7)


@pytest.mark.parametrize("seed", range(20))
def test_ukf_linearisation_has_the_moments_of_the_sigma_points(seed: int) -> None:
    random = np.random.default_rng(seed)
    root = random.uniform(-1, 1, (3, 3)) * [[0.5], [0.5], [1.0]]
    x, p = random.uniform(-3, 3, 3), root @ root.T + 0.01 * np.eye(3)
    reading, alpha, kappa = random.uniform(-5, 5, 8), float(random.uniform(0.05, 1.0)), float(random.uniform(0, 3))
    at = ukf(alpha, kappa)(x.tolist(), p[np.tril_indices(3)].tolist(), reading.tolist(), FLOATS)
    points, mean, weights = sigma_points(x, p, alpha, kappa)
    seen = np.concatenate([points[:, :2] ** 2, times(rotation(points[:, 2]), reading[6:8])], -1)
    expected = mean @ seen
    assert np.array(at.innovation) == pytest.approx(reading[[0, 4, 2, 3]] - expected, rel=1e-9, abs=1e-9)
    d_a, d_b, gx, gy = at.slopes
    h = np.array([[d_a, 0, 0], [0, d_b, 0], gx * np.array(at.row), gy * np.array(at.row)])
    assert h @ p == pytest.approx(covariance_of(seen - expected, points - x, weights), rel=1e-8, abs=1e-9)
    excess = np.zeros((4, 4))
    excess[np.triu_indices(4)] = at.excess
    excess = excess + excess.T - np.diag(np.diag(excess))
    whole = covariance_of(seen - expected, seen - expected, weights)
    assert h @ p @ h.T + excess == pytest.approx(whole, rel=1e-8, abs=1e-8)


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.5])
def test_noise_of_the_measurement_is_v_q_vt(angle: float) -> None:
    q_a, q_b = covariance(6), covariance(4)
    model = PaperModel.of(*UNEVEN, q_a, q_b)
    (g_a, f_a), (g_b, f_b) = (array_matrices(places) for places in UNEVEN)
    turned = rotation(np.array(angle)) @ f_b
    v = np.block(
        [[g_a[:1], np.zeros((1, 4))], [np.zeros((1, 6)), g_b[:1]], [f_a, -turned]],
    )
    q = np.block([[q_a, np.zeros((6, 4))], [np.zeros((4, 6)), q_b]])
    r, s_a, s_b = model.noise.at(math.cos(angle), math.sin(angle))
    assert np.array(r) == pytest.approx((v @ q @ v.T)[np.triu_indices(4)], abs=1e-12)
    assert np.array(s_a) == pytest.approx(np.r_[g_a[1], np.zeros(4)] @ q @ v.T, abs=1e-12)
    assert np.array(s_b) == pytest.approx(np.r_[np.zeros(6), g_b[1]] @ q @ v.T, abs=1e-12)


def test_qhat_may_be_a_number_a_diagonal_or_a_matrix() -> None:
    reading = link_reading(UNEVEN[1])
    assert link_noise(reading, 0.3) == pytest.approx(link_noise(reading, np.full(4, 0.3)))
    assert link_noise(reading, 0.3) == pytest.approx(link_noise(reading, 0.3 * np.eye(4)))


def test_functions_of_arrays_are_those_of_floats() -> None:
    for one, two in zip(ARRAYS, FLOATS, strict=True):
        assert one(np.array([0.3])) == pytest.approx(two(0.3))
