"""Joints of two axes: their geometry holds the rotation about gravity, and the variance says what it does not hold."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pcf_swing import X, Y, Z, sway, swing
from test_pcf_joints import composed, directions

from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.pcf.two_axes import LEAST, TwoAxes
from jointest_ros.core.rotation import IDENTITY, about, dot, multiply, norm, rotate, rotate_inverse

FREE = (0.0, 0.0)  # middles of the ranges
HIP: tuple[Vec3, Vec3] = (Y, X)
angles = st.tuples(st.floats(-1.2, 1.2), st.floats(-1.2, 1.2))


def walk(time: FloatArray) -> FloatArray:
    """Flexion and abduction, from the zero pose."""
    return np.column_stack([0.5 * np.sin(1.9 * time), 0.25 * np.sin(1.3 * time)])


def run(params: PcfParams, seed: int, bias_dps: float, seconds: float = 60.0) -> tuple[FloatArray, FloatArray]:
    """(errors, standard deviations), deg (T, 2), of a hip on a pelvis that sways; still and zero for 2 s."""
    motion = {"parent": lambda time: sway(np.maximum(time - 2.0, 0.0)), "bias": math.radians(bias_dps), "seed": seed}
    robot, recording, truth = swing(lambda time: walk(np.maximum(time - 2.0, 0.0)), HIP, seconds=seconds, **motion)
    estimator = Pcf(robot, params)
    estimator.run(recording.part(0, 150))
    estimator.calibrate_zero()
    series = estimator.run(recording.part(150, len(recording)))
    return np.degrees(series.position - truth[150:]), np.degrees(np.sqrt(series.variance))


@given(directions, directions, angles, directions, st.floats(-0.02, 0.02))
def test_a_small_turn_about_gravity_is_seen_as_far_as_the_axes_show_it(
    first: Vec3, second: Vec3, pose: tuple[float, float], gravity: Vec3, turn: float
) -> None:
    """R12 = T exp(g turn): the correction is -turn s^2 about g, to the first order."""
    assume(abs(dot(first, second)) < 0.9)
    pair = TwoAxes((first, second), IDENTITY, FREE)
    turned = composed((first, second), pose)
    accel = tuple(9.81 * c for c in gravity)
    exact, seen = pair.correction(turned, accel)
    assert norm(exact) < 1e-12
    assert (seen == 0.0) or LEAST <= seen <= 1.0 + 1e-12
    found, seen = pair.correction(multiply(turned, about(gravity, turn)), accel)
    assert found == pytest.approx(tuple(-turn * seen * c for c in gravity), abs=turn**2 + 1e-12)


def test_axes_in_a_plane_with_gravity_show_nothing_of_it() -> None:
    pair = TwoAxes((X, Z), IDENTITY, FREE)
    assert pair.correction(about(Z, 0.1), (3.0, 0.0, 9.0)) == ((0.0, 0.0, 0.0), 0.0)
    assert pair.correction(IDENTITY, (0.0, 0.0, 0.0)) == ((0.0, 0.0, 0.0), 0.0)


@given(directions, directions, angles, directions)
def test_gravity_alone_tells_both_angles(first: Vec3, second: Vec3, pose: tuple[float, float], up: Vec3) -> None:
    """With the middle of the ranges at the pose itself, the right one of the two solutions is found."""
    assume(abs(dot(first, second)) < 0.9)
    turned = composed((first, second), pose)
    child = rotate_inverse(turned, up)
    found = TwoAxes((first, second), IDENTITY, pose).from_gravity(up, child)
    if found is None:
        assert min(1.0 - dot(first, up) ** 2, 1.0 - dot(second, child) ** 2) < 0.03 / (1.0 - dot(first, second) ** 2)
        return
    assert rotate(found, child) == pytest.approx(up, abs=1e-6)
    assert dot(first, rotate(found, second)) == pytest.approx(dot(first, second), abs=1e-9)


def test_the_angles_are_right_from_the_first_sample_in_any_pose() -> None:
    robot, recording, truth = swing(lambda time: np.tile([0.9, -0.4], (len(time), 1)), HIP, noise=0.0, seconds=1.0)
    series = Pcf(robot, PcfParams(still_start=0.0)).run(recording)
    np.testing.assert_allclose(series.position[0], truth[0], atol=1e-6)


def test_gyro_biases_do_not_carry_the_angles_away() -> None:
    """A degree per second that nobody has calibrated: without the axes it turns the thigh about the vertical."""
    held, free = (
        [run(PcfParams(still_start=0.0, axes_weight=weight), seed, 1.0)[0][-2000:] for seed in range(4)]
        for weight in (PcfParams().axes_weight, 0.0)
    )
    assert np.sqrt(np.mean(np.square(held))) < 0.5
    assert np.sqrt(np.mean(np.square(free))) > 5.0


@pytest.mark.parametrize("weight", [0.0, 0.3])
@pytest.mark.parametrize("bias_dps", [0.2, 1.0])
def test_the_standard_deviation_covers_the_drift(weight: float, bias_dps: float) -> None:
    """Over many biases as large as stated, error and deviation are of one size: no silent wrong angle."""
    deviation = math.sqrt(2.0 / 3.0) * bias_dps  # of the difference of two that are uniform, along an axis
    params = PcfParams(still_start=0.0, axes_weight=weight, bias_std_dps=deviation, floor_deg=0.0)
    scores = []
    for seed in range(8):
        errors, deviations = run(params, seed, bias_dps, seconds=20.0)
        scores.append(errors[300:] / deviations[300:])
    assert 0.5 < math.sqrt(np.mean(np.square(scores))) < 1.5


def test_three_axes_say_that_nothing_holds_them_about_gravity() -> None:
    """Also where no axis is near gravity: each coordinate has its share in the drift, and states it."""
    robot, recording, truth = swing(
        lambda time: np.column_stack([walk(time), 0.2 * np.sin(time)]), (X, Y, Z), seconds=60.0, bias=0.01, parent=sway
    )
    series = Pcf(robot, PcfParams(bias_std_dps=0.6, still_start=0.0)).run(recording)
    last = slice(-1000, None)
    errors = np.sqrt(np.mean((series.position - truth)[last] ** 2, axis=0))
    assert errors.max() > math.radians(3.0)
    assert (np.sqrt(series.variance[last].mean(axis=0)) > 0.3 * errors).all()
