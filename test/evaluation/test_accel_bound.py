"""The bound of accelerometer arrays: printed figures, a Fisher matrix by brute force, what must hold of any bound."""

from __future__ import annotations

import numpy as np
import pytest
from accel_bounds import FILTER, SMOOTHER

from jointest_ros.core.accel.array import lever
from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation.accel_bound import array_information, bound, rms_deg
from jointest_ros.sim.slider_crank import PERIOD, SCENARIOS, CrankMotion, motion

SETTLED = 100  # samples


def information(truth: CrankMotion, sigma: float) -> FloatArray:
    return array_information(truth.positions_a, truth.positions_b, sigma)


@pytest.mark.parametrize(("scenario", "length"), FILTER)
def test_it_is_the_printed_one(scenario: str, length: float) -> None:
    truth = motion(scenario, length)
    known = information(truth, SCENARIOS[scenario].sigma)
    ours = rms_deg(bound(truth.state, truth.joint_acceleration, known, PERIOD), SETTLED)
    np.testing.assert_allclose(ours, FILTER[scenario, length], rtol=0.005)


@pytest.mark.parametrize("scenario", SMOOTHER)
def test_that_of_smoothers_is_the_printed_one(scenario: str) -> None:
    truth = motion(scenario)
    known = information(truth, SCENARIOS[scenario].sigma)
    ours = rms_deg(bound(truth.state, truth.joint_acceleration, known, PERIOD, smoother=True), SETTLED)
    np.testing.assert_allclose(ours, SMOOTHER[scenario], rtol=0.005)


def channels_of(state: FloatArray, acceleration: FloatArray, force: FloatArray, truth: CrankMotion) -> FloatArray:
    """What the sensors read in one sample, written out by the paper's (1) and (2)."""
    w_a, w_b, angle = state
    turned = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]).T @ force
    of_a = force + lever(truth.positions_a) @ [w_a**2, acceleration[0]]
    of_b = turned + lever(truth.positions_b) @ [w_b**2, acceleration[1]]
    return np.concatenate([of_a.ravel(), of_b.ravel()])


def brute_force(truth: CrankMotion, covariance: FloatArray, bias: FloatArray | None) -> FloatArray:
    """(T, 3) variances of all states by one Fisher matrix of X_0, every al_k and a_O,k, and constant biases."""
    samples = len(truth.time)
    number = 3 + 4 * samples + (0 if bias is None else len(bias))

    def states(unknown: FloatArray) -> list[FloatArray]:
        found = [unknown[:3]]
        for k in range(1, samples):
            before, now = unknown[3 + 4 * k - 4 :][:2], unknown[3 + 4 * k :][:2]
            w = found[-1][:2] + PERIOD / 2.0 * (before + now)
            th = found[-1][2] + PERIOD / 2.0 * (found[-1][0] - found[-1][1] + w[0] - w[1])
            found.append(np.array([*w, th]))
        return found

    def readings(unknown: FloatArray) -> FloatArray:
        offset = 0.0 if bias is None else unknown[-len(bias) :]
        rows = [
            channels_of(state, unknown[3 + 4 * k :][:2], unknown[5 + 4 * k :][:2], truth) + offset
            for k, state in enumerate(states(unknown))
        ]
        return np.concatenate(rows)

    # the states by the trapezoid from the truth's accelerations: near the truth, and consistent
    truths = np.zeros(number)
    truths[:3] = truth.state[0]
    truths[3 : 3 + 4 * samples] = np.hstack([truth.angular_acceleration, truth.joint_acceleration]).ravel()
    step = 1e-4
    columns = [(readings(truths + d) - readings(truths - d)) / (2.0 * step) for d in step * np.eye(number)]
    jacobian = np.stack(columns, axis=1).reshape(samples, -1, number)
    fisher = np.einsum("kcn,cd,kdm->nm", jacobian, np.linalg.inv(covariance), jacobian)
    fisher[:3, :3] += 100.0 * np.eye(3)
    if bias is not None:
        fisher[-len(bias) :, -len(bias) :] += np.linalg.inv(np.diag(bias))
    spread = np.linalg.inv(fisher)
    of_state = np.stack([(np.array(states(d)) - np.array(states(0 * d))) for d in np.eye(number)], axis=-1)
    return np.einsum("kin,nm,kim->ki", of_state, spread, of_state)


def of_trapezoid(truth: CrankMotion) -> FloatArray:
    """(T, 3): the true states as the trapezoid has them."""
    al = truth.angular_acceleration
    steps = PERIOD / 2.0 * (al[1:] + al[:-1])
    rates = truth.state[0, :2] + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
    difference = rates[:, 0] - rates[:, 1]
    angle = truth.state[0, 2] + np.append(0.0, np.cumsum(PERIOD / 2.0 * (difference[1:] + difference[:-1])))
    return np.column_stack([rates, angle])


@pytest.mark.parametrize("correlated", [False, True])
def test_it_is_the_inverse_of_the_whole_fisher_matrix(correlated: bool) -> None:
    places = np.array([[0.05, 0.01], [0.2, -0.02], [0.12, 0.06]]), np.array([[-0.03, 0.02], [0.3, 0.05]])
    truth = motion("G", positions=places, samples=12)
    generator = np.random.default_rng(3)
    root = np.diag(generator.uniform(0.02, 0.05, 10)) + 0.01 * correlated * generator.standard_normal((10, 10))
    covariance = root @ root.T
    known = array_information(*places, covariance)
    state, force = of_trapezoid(truth), truth.joint_acceleration
    smoothed = bound(state, force, known, PERIOD, smoother=True)
    np.testing.assert_allclose(smoothed, brute_force(truth, covariance, None), rtol=1e-5)
    filtered = bound(state, force, known, PERIOD)
    np.testing.assert_allclose(filtered[-1], smoothed[-1], rtol=1e-9)
    shorter = bound(state[:7], force[:7], known, PERIOD, smoother=True)
    np.testing.assert_allclose(filtered[6], shorter[6], rtol=1e-9)


def test_with_constant_biases_it_is_the_inverse_of_the_fisher_matrix_too() -> None:
    places = np.array([[0.05, 0.01], [0.2, -0.02], [0.12, 0.06]]), np.array([[-0.03, 0.02], [0.3, 0.05]])
    truth = motion("G", positions=places, samples=12)
    bias, noise = 0.2, 0.03
    biases = array_information(*places, bias), array_information(*places, 1e-5)  # hardly a random walk
    known = array_information(*places, noise)
    ours = bound(of_trapezoid(truth), truth.joint_acceleration, known, PERIOD, biases=biases, smoother=True)
    expected = brute_force(truth, noise**2 * np.eye(10), np.full(10, bias**2))
    np.testing.assert_allclose(ours, expected, rtol=1e-3)


def test_placements_are_treated_at_once_as_one_by_one() -> None:
    truth = motion("F", samples=60)
    placements = [
        (truth.positions_a * a, truth.positions_b[:, ::-1] + b) for a, b in ((1.0, 0.0), (0.5, 0.1), (2.0, 0.3))
    ]
    known = np.array([array_information(*one, 0.03) for one in placements])
    together = bound(truth.state, truth.joint_acceleration, known, PERIOD)
    for one, alone in zip(together, known, strict=True):
        np.testing.assert_allclose(one, bound(truth.state, truth.joint_acceleration, alone, PERIOD), rtol=1e-9)


def test_it_stays_a_variance_over_a_long_time() -> None:
    truth = motion("F", samples=20001)
    known = information(truth, SCENARIOS["F"].sigma)
    variances = bound(truth.state, truth.joint_acceleration, known, PERIOD)
    np.testing.assert_allclose(rms_deg(variances[-1000:]), rms_deg(variances[1000:2000]), rtol=1e-3)


def test_more_knowledge_never_makes_it_larger() -> None:
    truth = motion("B")
    known, three = (
        array_information(positions, truth.positions_b, 0.03)
        for positions in (truth.positions_a, [*truth.positions_a, (0.1, 0.0)])
    )
    state, force = truth.state, truth.joint_acceleration
    plain = bound(state, force, known, PERIOD)
    assert (bound(state, force, three, PERIOD) < plain).all()
    assert (bound(state, force, known, PERIOD, smoother=True) <= plain * (1.0 + 1e-9)).all()
    biases = (
        array_information(truth.positions_a, truth.positions_b, 0.1),
        array_information(truth.positions_a, truth.positions_b, 1e-3),
    )
    assert (bound(state, force, known, PERIOD, biases=biases) > plain).all()
