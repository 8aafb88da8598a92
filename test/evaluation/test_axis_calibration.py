"""Identification of hinge axes from motion: how near, how honest, and when it must refuse."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from finger_windows import error_deg, means_of, tilt, true_axis, unmounted
from scipy.spatial.transform import Rotation

from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.frame import Recording
from jointest_ros.core.robot import Robot
from jointest_ros.evaluation.axis_advice import advice, refusal
from jointest_ros.evaluation.axis_calibration import fit_axes
from jointest_ros.evaluation.axis_fit import AxisFit
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.joint_pairs import hinge_pairs
from jointest_ros.sim.finger import simulate
from jointest_ros.sim.hand import HandRecording

SEEDS = range(20, 24)


def recorded(scenario: str, seed: int, **options: object) -> HandRecording:
    return simulate(scenario, **{"seed": seed, "mounting": "mounted", "rate_hz": 200.0, "duration_s": 40.0, **options})


def fits_of(means: WindowMeans, robot: Robot, kept: frozenset[str] = frozenset()) -> list[AxisFit]:
    return [fit_axes(means, pair, kept) for pair in hinge_pairs(robot)[0]]


@pytest.fixture(scope="module")
def runs() -> list[tuple[Robot, list[AxisFit]]]:
    """The true robot and what is identified without its mountings, for several draws of them."""
    found = []
    for seed in SEEDS:
        one = recorded("PC", seed)
        found.append((one.robot, fits_of(means_of(one.recording), unmounted(one.robot))))
    return found


def test_axes_are_found_without_knowing_the_mountings(runs: list[tuple[Robot, list[AxisFit]]]) -> None:
    errors = [
        error_deg(axis, true_axis(robot, axis.sensor, number))
        for robot, fits in runs
        for number, fit in enumerate(fits)
        for axis in fit.axes
    ]
    print(f"axes: rms {np.sqrt(np.mean(np.square(errors))):.4f}, largest {max(errors):.4f} deg")
    assert max(errors) < 0.09
    for _, fits in runs:
        for fit in fits:
            assert not refusal(fit)
            assert not list(advice(fit))
            assert fit.residual == pytest.approx(fit.noise, rel=0.1) and fit.residual < fit.residual_before


def test_the_stated_uncertainty_is_that_of_the_errors(runs: list[tuple[Robot, list[AxisFit]]]) -> None:
    """The squares of the errors over their covariances: 2 on average, as there are two directions."""
    squares = []
    for robot, fits in runs:
        for number, fit in enumerate(fits):
            for axis in fit.axes:
                off = tilt(axis, true_axis(robot, axis.sensor, number))
                squares.append(off @ np.linalg.solve(axis.covariance, off))
    assert 1.0 < np.mean(squares) < 4.0
    assert np.mean(np.array(squares) < 2.0 * math.log(1.0 / (1.0 - 0.95))) > 0.75


@pytest.mark.parametrize("seed", [30, 31])
def test_imus_turned_any_way_are_found_with_the_signs_of_the_configuration(seed: int) -> None:
    one = recorded("PC", seed)
    plain, means = one.recording, {}
    turns = dict(zip(plain.gyro, Rotation.random(4, random_state=seed), strict=True))
    means = means_of(
        Recording(
            plain.stamps,
            {name: turns[name].apply(gyro) for name, gyro in plain.gyro.items()},
            {name: turns[name].apply(accel) for name, accel in plain.accel.items()},
        )
    )
    for number, fit in enumerate(fits_of(means, unmounted(one.robot))):
        true = [turns[axis.sensor].apply(true_axis(one.robot, axis.sensor, number)) for axis in fit.axes]
        configured = one.robot.joints[number].axes[0]
        sign = np.sign(sum(axis.axis @ configured for axis in fit.axes))
        assert sign > 0.0  # both at once, as the configuration has them
        shown = np.sign(fit.parent.axis @ true[0])
        assert [error_deg(axis, shown * t) < 0.09 for axis, t in zip(fit.axes, true, strict=True)] == [True, True]


def test_a_palm_that_keeps_still_leaves_its_own_axis_unknown() -> None:
    one = recorded("PA", 40)
    first, *others = fits_of(means_of(one.recording), unmounted(one.robot))
    assert (first.parent.determined, first.child.determined) == (False, True)
    assert first.parent.std > math.radians(20.0)
    text = refusal(first)
    assert text.startswith("its axis in 'palm' is undetermined: 'palm' hardly turned across it")
    assert "turn it about several directions while the joint moves" in text and "--keep palm" in text
    for number, fit in enumerate(others, 1):
        assert not refusal(fit)
        assert all(error_deg(axis, true_axis(one.robot, axis.sensor, number)) < 0.09 for axis in fit.axes)
    assert error_deg(first.child, true_axis(one.robot, "proximal", 0)) < 0.09


def test_a_sensor_whose_mounting_is_known_can_be_kept() -> None:
    one = recorded("PA", 41)
    robot = unmounted(one.robot)
    robot = replace(robot, sensors=(one.robot.sensors[0], *robot.sensors[1:]))
    fit = fit_axes(means_of(one.recording), hinge_pairs(robot)[0][0], frozenset({"palm"}))
    assert fit.determined and fit.parent.kept and fit.parent.std == 0.0
    assert fit.parent.axis == pytest.approx(true_axis(one.robot, "palm", 0))
    assert error_deg(fit.child, true_axis(one.robot, "proximal", 0)) < 0.09


def test_a_joint_that_does_not_move_is_unknown() -> None:
    """Two IMUs on one body that turns about all axes: the axis could be any."""
    one = recorded("PC", 42)
    plain, generator = one.recording, np.random.default_rng(42)
    gyro, accel = plain.gyro["palm"], plain.accel["palm"]
    also = {
        "gyro": gyro + np.std(np.diff(gyro[:100], axis=0)) * generator.standard_normal(gyro.shape),
        "accel": accel + np.std(np.diff(accel[:100], axis=0)) * generator.standard_normal(accel.shape),
    }
    means = means_of(
        Recording(plain.stamps, {"palm": gyro, "proximal": also["gyro"]}, {"palm": accel, "proximal": also["accel"]})
    )
    fit = fit_axes(means, hinge_pairs(unmounted(one.robot), ["finger_mcp"])[0][0])
    assert not fit.parent.determined and not fit.child.determined
    assert "the joint hardly moved" in refusal(fit) and "bend it" in refusal(fit)


def test_nothing_that_moves_is_unknown() -> None:
    one = recorded("still", 43)
    for fit in fits_of(means_of(one.recording), unmounted(one.robot)):
        assert "the joint hardly moved" in refusal(fit)


def test_sensors_that_are_not_beside_the_joint_are_no_hinge() -> None:
    """Palm and middle link, two joints apart, with a proximal link that turns about another axis."""
    one = recorded("PC", 44)
    plain = one.recording
    across = Rotation.from_rotvec([0.0, 0.0, 1.0])
    wrong = {**plain.gyro, "proximal": across.apply(plain.gyro["distal"])[::-1].copy()}
    fit = fit_axes(means_of(Recording(plain.stamps, wrong, plain.accel)), hinge_pairs(one.robot)[0][0])
    assert "the motion is not about one axis" in refusal(fit)


def test_errors_of_the_gyros_widen_the_uncertainty_and_are_told() -> None:
    """Scale and cross-axis errors of 1 % shift the axes by about a degree, whatever the length of the recording."""
    squares, errors = [], []
    for seed in SEEDS:
        one = recorded("PC", seed)
        plain, generator = one.recording, np.random.default_rng(seed)
        gyro = {n: w @ (np.eye(3) + 0.01 * generator.standard_normal((3, 3))) for n, w in plain.gyro.items()}
        for number, fit in enumerate(
            fits_of(means_of(Recording(plain.stamps, gyro, plain.accel)), unmounted(one.robot))
        ):
            assert not refusal(fit)
            assert any("follows the motion" in text for text in advice(fit)) or fit.misfit < math.radians(0.6)
            for axis in fit.axes:
                true = true_axis(one.robot, axis.sensor, number)
                squares.append(tilt(axis, true) @ np.linalg.solve(axis.covariance, tilt(axis, true)))
                errors.append(error_deg(axis, true))
    assert np.sqrt(np.mean(np.square(errors))) > 0.3
    assert 0.5 < np.mean(squares) < 4.0


def test_biases_need_no_still_phase_and_gaps_do_no_harm() -> None:
    one = recorded("PC", 45, zero_pose_s=0.0)
    plain = one.recording
    present = np.ones(len(plain), dtype=bool)
    present[2000:2600] = False
    gyro = {name: w.copy() for name, w in plain.gyro.items()}
    gyro["middle"][4000:4400] = np.nan
    cut = Recording(
        plain.stamps[present],
        {name: w[present] for name, w in gyro.items()},
        {name: a[present] for name, a in plain.accel.items()},
    )
    means = means_of(cut)
    assert not means.still
    for number, fit in enumerate(fits_of(means, unmounted(one.robot))):
        assert fit.determined
        assert all(error_deg(axis, true_axis(one.robot, axis.sensor, number)) < 0.09 for axis in fit.axes)


def test_drift_of_a_gyro_that_keeps_still_is_no_motion() -> None:
    """Half a degree per second over the recording, as it warms up: still nothing is known of the palm's axis."""
    one = recorded("PA", 46, duration_s=120.0)
    plain = one.recording
    drift = np.radians(0.5) * np.linspace(0.0, 1.0, len(plain))[:, None] * np.array([0.0, 0.6, 0.8])
    gyro = {**plain.gyro, "palm": plain.gyro["palm"] + drift}
    fit = fits_of(means_of(Recording(plain.stamps, gyro, plain.accel)), unmounted(one.robot))[0]
    assert not fit.parent.determined


def test_too_little_is_refused() -> None:
    one = recorded("PC", 47, duration_s=1.0)
    with pytest.raises(CalibrationError, match=r"'palm' and 'proximal' gave readings together for 1.0 s; at least 2 s"):
        fit_axes(means_of(one.recording), hinge_pairs(one.robot)[0][0])
