"""The joint model: its equations against finite differences and against the same filter with a_O as a state."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from jointest_ros.core.accel.array import lever
from jointest_ros.core.accel.joint.model import (
    ANGLE,
    MOTION,
    JointModel,
    ModelNoise,
    channel_innovations,
)
from jointest_ros.core.accel.joint.trials import run_joint_model
from jointest_ros.core.frame import FloatArray
from jointest_ros.sim import slider_crank

PLACES_A = np.array([[0.1, 0.02], [0.2, -0.01], [0.15, 0.05]])
PLACES_B = np.array([[0.05, 0.0], [0.3, 0.04]])
FORCE = np.array([2.0, 9.0])


def channels_at(x: FloatArray, force: FloatArray) -> FloatArray:
    """The measurement as the specification has it, (10)."""
    c, s = np.cos(x[ANGLE]), np.sin(x[ANGLE])
    of_a = [force + lever(place) @ [x[0] ** 2, x[3]] for place in PLACES_A]
    of_b = [np.array([[c, -s], [s, c]]) @ force + lever(place) @ [x[1] ** 2, x[4]] for place in PLACES_B]
    return np.concatenate([*of_a, *of_b]) + (x[MOTION:] if len(x) > MOTION else 0.0)


def explicit_update(
    x: FloatArray, p: FloatArray, z: FloatArray, variances: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Gauss-Newton on state and a_O with a flat prior, by weighted least squares; derivatives by differences."""
    before, information = x, np.linalg.inv(p)
    weight = np.diag(1.0 / np.repeat(variances, 2))
    full = np.concatenate([x, _mean_force(x, z, variances)])
    size = len(x)
    for _ in range(2):
        steps = 1e-6 * np.eye(size + 2)
        h = np.array(
            [
                (channels_at(*np.split(full + step, [size])) - channels_at(*np.split(full - step, [size]))) / 2e-6
                for step in steps
            ]
        ).T
        normal = h.T @ weight @ h
        normal[:size, :size] += information
        right = h.T @ weight @ (z - channels_at(*np.split(full, [size])))
        right[:size] += information @ (before - full[:size])
        full = full + np.linalg.solve(normal, right)
        full[size:] = _mean_force(full[:size], z, variances)
    return full[:size], np.linalg.inv(normal)[:size, :size]


def _mean_force(x: FloatArray, z: FloatArray, variances: FloatArray) -> FloatArray:
    c, s = np.cos(x[ANGLE]), np.sin(x[ANGLE])
    rest = (z - channels_at(x, np.zeros(2))).reshape(-1, 2)
    rest[len(PLACES_A) :] = rest[len(PLACES_A) :] @ np.array([[c, s], [-s, c]]).T
    return np.average(rest, axis=0, weights=1.0 / variances)


def example(bias: bool, seed: int = 0) -> tuple[JointModel, FloatArray, FloatArray, FloatArray, FloatArray]:
    """(model, prediction, its covariance, channels, variances of the sensors)."""
    random = np.random.default_rng(seed)
    model = JointModel(PLACES_A, PLACES_B, ModelNoise(bias=bias))
    x, p = model.prior(np.array([1.0, -2.0, 0.7]), np.full(3, 0.01))
    x[3:MOTION] = 3.0, -4.0, 20.0, 5.0
    variances = np.array([1.0, 2.0, 0.5, 1.0, 3.0]) * 1e-3
    off = 0.1 * random.standard_normal(model.size) * [1, 1, 1, *([0.3] * (model.size - 3))]
    z = channels_at(x + off, FORCE) + 0.03 * random.standard_normal(10)
    return model, x, p, z, variances


@pytest.mark.parametrize("bias", [False, True])
def test_update_equals_that_with_the_force_at_the_joint_as_a_state(bias: bool) -> None:
    model, x, p, z, variances = example(bias)
    expected, covariance = explicit_update(x, p, z, variances)
    found, spread, _ = model.correct(x, p, z.view(complex), model.weighting(variances))
    sd = np.sqrt(np.diag(covariance))
    assert np.abs((found - expected) / sd).max() < 1e-4
    assert np.abs((spread - covariance) / np.outer(sd, sd)).max() < 1e-4


def test_a_missing_sensor_counts_as_none() -> None:
    model, x, p, z, variances = example(False)
    missing = np.array([False, True, False, False, False])
    fewer = JointModel(PLACES_A[~missing[:3]], PLACES_B, ModelNoise(bias=False))
    readings = z.view(complex)
    expected = fewer.correct(x, p, readings[~missing], fewer.weighting(variances[~missing]))
    found = model.correct(x, p, np.where(missing, 0.0, readings), model.weighting(variances, missing))
    assert found[0] == pytest.approx(expected[0], rel=1e-9)
    assert found[1] == pytest.approx(expected[1], rel=1e-7, abs=1e-9)
    assert found[2].log_likelihood() == pytest.approx(expected[2].log_likelihood())
    seen = channel_innovations(found[2], model.weighting(variances, missing)).reshape(-1, 2)
    assert np.isnan(seen[1]).all() and np.isfinite(seen[~missing]).all()


@pytest.mark.parametrize("present", [0, 1])
def test_a_single_reading_says_nothing(present: int) -> None:
    model, x, p, z, variances = example(True)
    missing = np.arange(5) >= present
    found = model.correct(x, p, np.where(missing, 0.0, z.view(complex)), model.weighting(variances, missing))
    assert found[0] == pytest.approx(x, abs=1e-12)
    assert found[1] == pytest.approx(p, rel=1e-9, abs=1e-9)


def test_stacked_states_give_what_single_ones_give() -> None:
    model, x, p, z, variances = example(True)
    random = np.random.default_rng(2)
    xs = x + 0.05 * random.standard_normal((3, model.size))
    zs = (z + 0.03 * random.standard_normal((3, 10))).view(complex)
    missing = random.random((3, 5)) < 0.2
    zs[missing] = 0.0
    ahead = model.predict(xs, np.stack([p] * 3), 0.01)
    stacked = model.correct(*ahead, zs, model.weighting(variances, missing))
    for k in range(3):
        single = model.predict(xs[k], p, 0.01)
        alone = model.correct(*single, zs[k], model.weighting(variances, missing[k]))
        assert stacked[0][k] == pytest.approx(alone[0], rel=1e-9, abs=1e-12)
        assert stacked[1][k] == pytest.approx(alone[1], rel=1e-7, abs=1e-12)
        assert stacked[2].log_likelihood()[k] == pytest.approx(alone[2].log_likelihood())


def test_discretisation_is_exact() -> None:
    """Van Loan's block exponential of the same chains."""
    model, dt, snap = JointModel(PLACES_A, PLACES_B, ModelNoise(snap=7.0, bias=False)), 0.3, 7.0
    a, spread = np.zeros((MOTION, MOTION)), np.zeros((MOTION, MOTION))
    a[2, 0], a[2, 1] = 1.0, -1.0
    a[[0, 1, 3, 4], [3, 4, 5, 6]] = 1.0
    spread[[5, 6], [5, 6]] = snap
    block = expm(np.block([[-a, spread], [np.zeros_like(a), a.T]]) * dt)
    phi = block[MOTION:, MOTION:].T
    found_phi, found_q = model.transition(dt)
    assert found_phi == pytest.approx(phi, abs=1e-12)
    assert found_q == pytest.approx(phi @ block[:MOTION, MOTION:], abs=1e-9)


def test_covariance_stays_symmetric_and_positive_over_a_long_time() -> None:
    motion = slider_crank.motion("G")
    model = JointModel(motion.positions_a, motion.positions_b)
    weighting = model.weighting(np.full(4, slider_crank.DATA_SHEET_SIGMA**2))
    x, p = model.prior(motion.state[0], np.full(3, 0.01))
    random = np.random.default_rng(1)
    for k in range(5000):
        x, p = model.predict(x, p, 0.01)
        z = motion.channels[(k + 1) % 400] + slider_crank.DATA_SHEET_SIGMA * random.standard_normal(8)
        x, p, _ = model.correct(x, p, z.view(complex), weighting)
    sd = np.sqrt(np.diag(p))
    scaled = p / np.outer(sd, sd)
    assert np.abs(scaled - scaled.T).max() < 1e-9
    assert np.linalg.eigvalsh(scaled).min() > 0.0
    assert np.abs(x[MOTION:]).max() < 0.5


def test_readings_without_noise_give_the_truth() -> None:
    motion = slider_crank.motion("G")
    model = JointModel(motion.positions_a, motion.positions_b, ModelNoise(bias=False))
    trials = run_joint_model(model, motion.channels[None], 1e-8, 0.01, motion.state[0], [1e-6] * 3)
    assert np.abs(trials.state[0] - motion.state)[100:].max() < 2e-4


def test_without_a_force_at_the_joint_noise_does_not_tell_the_angle() -> None:
    """At rest in a horizontal plane the variance of the angle grows, and covers what the estimate drifts.

    With the derivative at the noise that is found for a_O, the mean square over the variance is 11.
    """
    model = JointModel(PLACES_A[:2], PLACES_B, ModelNoise(bias=False))
    readings = 0.03 * np.random.default_rng(8).standard_normal((40, 300, 8))
    trials = run_joint_model(model, readings, 0.03**2, 0.01, np.zeros(3), [0.01] * 3)
    nees = np.mean(trials.state[:, 50::50, ANGLE] ** 2 / trials.variance[:, 50::50, ANGLE])
    assert nees < 3.0
    assert trials.variance[:, -1, ANGLE].mean() > 1.3 * trials.variance[:, 100, ANGLE].mean()
