"""The paper's own formulation, and the production filter against it (figures 1 and 2 of the specification)."""

from __future__ import annotations

import numpy as np
import pytest
from kckf_printed import PaperFilter, input_matrix, process_noise

from jointest_ros.core.frame import FloatArray, Recording
from jointest_ros.core.hall_sensor import HallSensor, SplineCurve
from jointest_ros.core.kckf.gyro import Gyro, GyroParams
from jointest_ros.core.kckf.kckf import PAPER, Kckf
from jointest_ros.core.kckf.kf import Kf
from jointest_ros.core.kckf.paper_reference import measurement, observability_rank, pair_rows, transition
from jointest_ros.core.robot import Joint, Robot, Sensor

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
DT = 0.01
LINEAR = SplineCurve((0.0, 3.3), (-165.0, 165.0))


@pytest.mark.parametrize("n", range(2, 9))
def test_observability(n: int) -> None:
    """Figure 1: rank N with the constraint, N - 6 without, 2 n + 6 when a Hall sensor tells one angle of a hinge."""
    states = 6 * n + 6
    a = transition(n, 1.0)
    assert observability_rank(a, measurement(n, pair_rows(n))) == states
    assert observability_rank(a, measurement(n, pair_rows(n), constrained=False)) == states - 6
    hinges = [3 * joint + joint % 2 for joint in range(n)]
    assert observability_rank(a, measurement(n, hinges)) == 2 * n + 6


def test_input_matrix_as_printed_contradicts_the_process_model() -> None:
    gyro = np.array([1.0, 2.0, 4.0])  # (10): phi turns at w_3 - w_1
    assert (input_matrix(2, DT, 1) @ gyro)[2] == pytest.approx(3.0 * DT)
    assert (input_matrix(2, DT, 1, printed=True) @ gyro)[2] == pytest.approx(-5.0 * DT)


def least_eigenvalue(cross_sign: float) -> float:
    """Least real part of the eigenvalues of (I - K C) A of the constrained filter after 1000 steps."""
    paper = PaperFilter(2, [0, 0, 1, 1], axes=1, cross_sign=cross_sign)
    for _ in range(1000):
        paper.predict(DT, np.zeros((3, 1)))
        crossed = paper.covariance @ paper.c.T
        paper.correct(np.zeros(4))
    gain = np.linalg.solve(paper.innovation_covariance, crossed.T).T
    return float(np.linalg.eigvals((np.eye(6) - gain @ paper.c) @ transition(2, DT, 1)).real.min())


def test_the_printed_noise_is_stable_and_its_other_sign_is_not() -> None:
    """With the sign that belongs to (11), an eigenvalue of the closed loop tends to -1."""
    assert least_eigenvalue(1.0) > -0.5
    assert least_eigenvalue(-1.0) == pytest.approx(-1.0, abs=2e-3)


def draws(steps: int, axes: int) -> tuple[FloatArray, FloatArray]:
    """Gyros (steps, 5, axes), deg/s, with biases, and Hall angles (steps, 4, 2, axes), deg, of four moving joints."""
    rng = np.random.default_rng(7)
    time = DT * np.arange(-1, steps)
    angle = 20.0 * np.sin(2.0 * np.pi * 0.8 * time[:, None, None] + rng.uniform(0.0, 6.0, (4, axes)))
    rates = np.concatenate([np.zeros((steps, 1, axes)), np.cumsum(np.diff(angle, axis=0) / DT, axis=1)], axis=1)
    gyro = rates + rng.uniform(-1.0, 1.0, (5, axes)) + 0.038 * rng.standard_normal(rates.shape)
    return gyro, angle[1:, :, None] + 3.2 * rng.standard_normal((steps, 4, 2, axes))


def run_paper(gyro: FloatArray, hall: FloatArray, constrained: bool = True) -> tuple[FloatArray, FloatArray]:
    """Joints (steps, 4, axes) and torso (steps, axes) of the paper's filter, deg."""
    axes = gyro.shape[2]
    paper = PaperFilter(4, pair_rows(4, axes), axes, constrained)
    joints, torso = [], []
    for k, (rates, angles) in enumerate(zip(gyro, hall, strict=True)):
        if k:
            paper.predict(DT, rates)
        paper.correct(angles.ravel())
        joints.append(paper.angles)
        torso.append(paper.torso)
    return np.array(joints), np.array(torso)


def recorded(gyro: FloatArray, hall: FloatArray) -> tuple[Robot, Recording]:
    """The same for the production filter: joints of one or three axes, linear Hall sensors."""
    axes = (X, Y, Z)[: gyro.shape[2]]
    links = tuple(f"link_{k}" for k in range(5))
    joints = tuple(Joint(f"joint_{k}", links[k], links[k + 1], axes) for k in range(4))
    sensors = tuple(Sensor(link, link, accel=False) for link in links)
    names = [name for joint in joints for name in joint.coordinates]
    halls = tuple(HallSensor(name, LINEAR, hall_range=(0.0, 3.3)) for name in names for _ in range(2))
    rates = np.zeros((len(gyro), 5, 3))
    rates[:, :, : len(axes)] = np.radians(gyro)
    recording = Recording(
        (np.arange(len(gyro)) * round(DT * 1e9)).astype(np.int64),
        {link: rates[:, k] for k, link in enumerate(links)},
        {},
        hall=1.65 + np.moveaxis(hall, 3, 2).reshape(len(hall), -1) / 100.0,
    )
    return Robot(links, joints, sensors, hall=halls), recording


def test_the_paper_s_filter_is_three_small_ones() -> None:
    """Figure 2: each block of 3 is the same filter of 2 n + 2 states."""
    gyro, hall = draws(800, 3)
    joints, torso = run_paper(gyro, hall)
    for axis in range(3):
        one, phi = run_paper(gyro[:, :, axis : axis + 1], hall[..., axis : axis + 1])
        assert np.abs(joints[:, :, axis] - one[:, :, 0]).max() < 1e-5 * np.abs(one).max()
        assert np.abs(torso[:, axis] - phi[:, 0]).max() < 1e-5 * np.abs(phi).max()


@pytest.mark.parametrize("axes", [1, 3])
def test_the_reduced_filter_equals_the_constrained_one(axes: int) -> None:
    """Figure 2: without phi and its bias, with the equivalent noise, joints and torso are those of (19), (20)."""
    gyro, hall = draws(3000 if axes == 1 else 600, axes)
    joints, torso = run_paper(gyro, hall)
    robot, recording = recorded(gyro, hall)
    series = Kckf(robot, PAPER).run(recording)
    assert np.degrees(series.position).reshape(joints.shape) == pytest.approx(joints, abs=1e-5)
    assert series.torso is not None
    assert np.degrees(series.torso)[:, :axes] == pytest.approx(torso, abs=1e-5)


def test_the_unconstrained_filter_equals_the_paper_s_and_its_torso_is_integration() -> None:
    """Figure 2: the torso of the standard Kalman filter is gyro integration to 1e-9 deg."""
    gyro, hall = draws(3000, 1)
    joints, torso = run_paper(gyro, hall, constrained=False)
    robot, recording = recorded(gyro, hall)
    kf = Kf(robot, Kf.Params(noise="paper", hall_noise="constant", kinematics="additive")).run(recording)
    integrated = Gyro(robot, GyroParams(kinematics="additive")).run(recording)
    assert np.degrees(kf.position) == pytest.approx(joints[:, :, 0], abs=1e-5)
    assert kf.torso is not None and integrated.torso is not None
    assert np.degrees(kf.torso)[:, 0] == pytest.approx(torso[:, 0], abs=1e-9)
    assert np.degrees(integrated.torso)[:, 0] == pytest.approx(torso[:, 0], abs=1e-9)


def test_process_noise_is_that_of_equation_13() -> None:
    q = process_noise(1, 0.1, axes=1)
    assert q == pytest.approx(
        np.array([[2.5e-5, 0.0, 5e-4, 0.0], [0.0, 2.5e-5, 0.0, 5e-4], [5e-4, 0.0, 1e-2, 0.0], [0.0, 5e-4, 0.0, 1e-2]])
    )
