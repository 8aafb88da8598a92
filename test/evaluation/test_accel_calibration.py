"""Matrix and offset of an accelerometer by still poses: what four, seven and many poses tell, and what they do not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from jointest_ros.core.accel.array import JointArrays, array_matrices, joint_arrays
from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import STANDARD_GRAVITY, Sensor
from jointest_ros.core.rotation import exp
from jointest_ros.evaluation.accel_calibration import AccelFit, fit_directions, fit_norm
from jointest_ros.evaluation.accel_poses import AXES, axes_up, find_poses, in_sensor_frame
from jointest_ros.evaluation.measures import rms_length
from jointest_ros.sim import two_link_arm
from jointest_ros.sim.imu import GRAVITY
from jointest_ros.sim.simulated import SimulatedRobot

SENSOR = Sensor("imu", "link")
MG = 1e-3 * STANDARD_GRAVITY
MATRIX = np.array([[1.01, 0.004, -0.006], [-0.003, 0.992, 0.005], [0.008, -0.002, 0.99]])
OFFSET = np.array([0.19, -0.15, 0.11])  # m/s^2
NOISE = 0.0277374 / math.sqrt(300.0)  # m/s^2: the data sheet's, over 3 s at 100 Hz
SIX = ("+x", "-x", "+y", "-y", "+z", "-z")
SEVEN = ("+y", "+x", "-y", "-x", "-y", "+x", "+y")  # in a plane, as the paper's seven


def directions(names: Sequence[str]) -> FloatArray:
    return np.array([AXES[name] for name in names])


def read(up: FloatArray, sigma: float = 0.0, seed: int = 0, matrix: FloatArray = MATRIX) -> FloatArray:
    """What the sensor reads in such poses."""
    noise = sigma * np.random.default_rng(seed).standard_normal(up.shape)
    return np.linalg.solve(matrix, (STANDARD_GRAVITY * up - OFFSET).T).T + noise


def fit(up: FloatArray, sigma: float = 0.0, seed: int = 0, sensor: Sensor = SENSOR) -> AccelFit:
    return fit_directions(read(up, sigma, seed), np.full(up.shape, sigma), up, sensor)


# ---------------------------------------------------------------- known directions


@pytest.mark.parametrize("names", [SIX, ("+x", "-x", "+y", "+z"), ("+x", "+y", "-z", "-x", "-x")])
def test_four_affinely_independent_poses_tell_everything(names: Sequence[str]) -> None:
    result = fit(directions(names))
    np.testing.assert_allclose(result.matrix, MATRIX, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(result.offset, OFFSET, rtol=0.0, atol=1e-12)
    assert (result.model, result.rank, result.undetermined) == ("full", 12, ())
    assert result.spare == 3 * len(names) - 12
    assert rms_length(result.residual) < 1e-12 < rms_length(result.before)


def test_the_seven_poses_of_the_paper_have_rank_9() -> None:
    result = fit(directions(SEVEN), NOISE)
    assert (result.model, result.rank, result.unknowns) == ("planar", 9, 12)
    assert result.undetermined == ("S_xz", "S_yz", "S_zz")
    # the readings themselves, with noise and a sensor that is not quite flat, look like rank 12
    assert np.linalg.matrix_rank(np.column_stack([read(directions(SEVEN), NOISE), np.ones(7)])) == 4


@pytest.mark.parametrize("seed", range(5))
def test_planar_poses_calibrate_their_plane_to_a_third_of_a_milli_g(seed: int) -> None:
    result = fit(directions(SEVEN), NOISE, seed)
    angles = np.radians(np.arange(0.0, 360.0, 10.0))
    up = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(36)])
    off = read(up) @ result.matrix.T + result.offset - STANDARD_GRAVITY * up
    assert rms_length(off[:, :2]) < 0.3 * MG
    assert rms_length((read(up) - STANDARD_GRAVITY * up)[:, :2]) > 10.0 * MG


def test_across_the_plane_all_stays_as_configured() -> None:
    before = replace(SENSOR, accel_matrix=((1.0, 0.0, 0.01), (0.0, 1.0, 0.02), (0.03, 0.04, 1.05)))
    before = replace(before, accel_offset=(0.1, 0.2, 0.3))
    result = fit(directions(SEVEN), NOISE, sensor=before)
    np.testing.assert_allclose(result.matrix[:, 2], [0.01, 0.02, 1.05], atol=1e-12)
    np.testing.assert_allclose(result.matrix[2], before.accel_matrix[2], atol=1e-12)
    assert result.offset[2] == pytest.approx(0.3)
    kept = np.isnan(result.matrix_std)
    np.testing.assert_array_equal(kept, [[False, False, True], [False, False, True], [True, True, True]])
    np.testing.assert_array_equal(np.isnan(result.offset_std), [False, False, True])


def test_the_plane_may_lie_anywhere_in_the_sensor() -> None:
    mounted = replace(SENSOR, mounting=exp((0.4, -0.8, 0.3)))
    up = in_sensor_frame([AXES[name] for name in SEVEN], mounted)
    result = fit(up)
    assert result.model == "planar"
    normal = in_sensor_frame([AXES["+z"]], mounted)[0]
    off = read(up) @ result.matrix.T + result.offset - STANDARD_GRAVITY * up
    np.testing.assert_allclose(off - np.outer(off @ normal, normal), 0.0, atol=1e-12)
    assert normal @ result.matrix @ normal == pytest.approx(1.0)
    assert normal @ result.offset == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ((), "in no pose an axis of the link points up"),
        (("+x",), "1 pose of rank 3 of 12; hold it still with each of +-x, +-y, +-z up"),
        (("+x", "-x", "+x", "-x"), "4 poses of rank 6 of 12"),
        (("+x", "+y", "+z"), "3 poses of rank 9 of 12"),
        (("+x", "+y", "+x", "+y", "+x"), "5 poses of rank 6 of 12"),
    ],
)
def test_too_few_and_too_similar_poses_are_refused(names: Sequence[str], expected: str) -> None:
    with pytest.raises(CalibrationError, match="^" + expected.replace("+", r"\+")):
        fit(np.array([AXES[name] for name in names]).reshape(-1, 3), NOISE)


def test_poses_in_the_wrong_order_are_refused() -> None:
    up = directions(SIX)
    with pytest.raises(CalibrationError, match=r"the poses do not fit: residual 0\.\d\d g; are the directions right"):
        fit_directions(read(up, NOISE), np.full(up.shape, NOISE), up[[0, 2, 1, 3, 4, 5]], SENSOR)


def test_readings_in_g_get_a_matrix_in_g() -> None:
    up = directions(SIX)
    raw = read(up, NOISE) / STANDARD_GRAVITY
    result = fit_directions(raw, np.full(up.shape, NOISE / STANDARD_GRAVITY), up, SENSOR)
    np.testing.assert_allclose(result.matrix, STANDARD_GRAVITY * MATRIX, atol=5e-3)
    np.testing.assert_allclose(raw @ result.matrix.T + result.offset, STANDARD_GRAVITY * up, atol=4.0 * NOISE)
    assert result.matrix_std.max() < 1e-2


def test_gravity_is_a_scale() -> None:
    up = directions(SIX)
    here = fit_directions(read(up), np.zeros(up.shape), up, SENSOR, 9.78)
    np.testing.assert_allclose(here.matrix, MATRIX * 9.78 / STANDARD_GRAVITY, atol=1e-12)
    np.testing.assert_allclose(here.offset, OFFSET * 9.78 / STANDARD_GRAVITY, atol=1e-12)


def deviations(results: Sequence[AccelFit], matrix: FloatArray = MATRIX) -> FloatArray:
    """(seeds, 12): errors of the unknowns over their reported standard deviations; NaN: not fitted."""
    rows = []
    for one in results:
        errors = np.append(one.matrix - matrix, one.offset - OFFSET)
        rows.append(errors / np.append(one.matrix_std, one.offset_std))
    return np.array(rows)


@pytest.mark.parametrize("names", [SIX, SIX * 3, SEVEN])
def test_the_reported_uncertainty_is_right(names: Sequence[str]) -> None:
    up = directions(names)
    # no tilt out of the plane: what is kept there is right, so that it adds no error to what is fitted
    matrix = MATRIX if names != SEVEN else np.array([[1.01, 0.004, 0.0], [-0.003, 0.992, 0.0], [0.0, 0.0, 1.0]])
    errors = np.full(up.shape, NOISE)
    results = [fit_directions(read(up, NOISE, seed, matrix), errors, up, SENSOR) for seed in range(300)]
    z = deviations(results, matrix)
    fitted = ~np.isnan(z[0])
    assert fitted.sum() == (6 if names == SEVEN else 12)
    assert 0.8 < np.sqrt(np.mean(z[:, fitted] ** 2)) < 1.05  # the larger of two estimates is taken
    assert 0.945 < np.mean(np.abs(z[:, fitted]) < 2.0) < 0.99


def test_a_crooked_fixture_makes_the_uncertainty_larger() -> None:
    up = directions(SIX * 2)
    crooked = up + np.radians(0.5) * np.random.default_rng(3).standard_normal(up.shape)
    result = fit_directions(read(crooked, NOISE), np.full(up.shape, NOISE), up, SENSOR)
    assert result.offset_std.min() > 5.0 * fit(up, NOISE).offset_std.max()


# ---------------------------------------------------------------- unknown directions


def everywhere(number: int, seed: int = 0) -> FloatArray:
    vectors = np.random.default_rng(seed).standard_normal((number, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


SYMMETRIC = 0.5 * (MATRIX + MATRIX.T)


def test_lengths_alone_tell_a_symmetric_matrix() -> None:
    up = everywhere(20)
    result = fit_norm(read(up, matrix=SYMMETRIC), np.zeros(up.shape), SENSOR)
    np.testing.assert_allclose(result.matrix, SYMMETRIC, atol=1e-8)
    np.testing.assert_allclose(result.offset, OFFSET, atol=1e-8)
    assert (result.model, result.rank, result.spare) == ("norm", 9, 11)
    assert rms_length(result.residual) < 1e-8 < rms_length(result.before)


def test_the_reported_uncertainty_of_lengths_is_right() -> None:
    up = everywhere(20)
    errors = np.full(up.shape, NOISE)
    z = deviations([fit_norm(read(up, NOISE, seed, SYMMETRIC), errors, SENSOR) for seed in range(100)], SYMMETRIC)
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.05


def test_in_g_as_well() -> None:
    up = everywhere(20)
    result = fit_norm(read(up, matrix=SYMMETRIC) / STANDARD_GRAVITY, np.zeros(up.shape), SENSOR)
    np.testing.assert_allclose(result.matrix, STANDARD_GRAVITY * SYMMETRIC, atol=1e-7)


@pytest.mark.parametrize(
    ("up", "expected"),
    [
        (everywhere(8), "8 still poses; without known directions 9 are needed"),
        (directions(SIX * 2), "12 poses of rank 6 of 9; without known directions poses between the axes"),
        (everywhere(30) * [1.0, 1.0, 0.0], "30 poses of rank 5 of 9"),
    ],
)
def test_lengths_of_too_few_and_too_similar_poses_are_refused(up: FloatArray, expected: str) -> None:
    up = up / np.linalg.norm(up, axis=1)[:, None]
    with pytest.raises(CalibrationError, match=f"^{expected}"):
        fit_norm(read(up, NOISE), np.full(up.shape, NOISE), SENSOR)


def test_lengths_that_no_ellipsoid_has_are_refused() -> None:
    up = everywhere(20)
    raw = read(up) * np.random.default_rng(0).uniform(0.5, 1.5, (20, 1))
    with pytest.raises(CalibrationError, match=r"^no matrix and offset make all poses equally long"):
        fit_norm(raw, np.full(up.shape, NOISE), SENSOR)


# ---------------------------------------------------------------- what it is good for


def calibrate(poses: SimulatedRobot) -> dict[str, AccelFit]:
    found = find_poses(poses.recording.stamps, poses.recording.accel, 1.0).poses
    fits = {}
    for sensor in poses.robot.sensors:
        up = [direction for direction in axes_up(found, [sensor], math.radians(20.0)) if direction]
        means = np.array([pose.mean[sensor.name] for pose in found])
        errors = np.array([pose.error[sensor.name] for pose in found])
        fits[sensor.name] = fit_directions(means, errors, in_sensor_frame(up, sensor), sensor, GRAVITY)
    return fits


def angle_errors(arrays: JointArrays, simulated: SimulatedRobot, accel: dict[str, FloatArray]) -> FloatArray:
    """(T,) rad, of equation (12)."""
    channels = arrays.channels(np.stack([accel[sensor.name] for sensor in arrays.sensors], axis=1))
    half = 2 * len(arrays.parent.sensors)
    parts = (arrays.parent.positions, channels[:, :half]), (arrays.child.positions, channels[:, half:])
    (ax, ay), (bx, by) = ((array_matrices(positions)[1] @ part.T) for positions, part in parts)
    angle = np.arctan2(ay, ax) - np.arctan2(by, bx)
    return np.angle(np.exp(1j * (angle - simulated.truth_position[:, 0])))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("scenario", "model"), [("poses", "planar"), ("poses_xyz", "full")])
def test_the_joint_angle_is_better_after_calibration(scenario: str, model: str, seed: int) -> None:
    """Up to 20 mg and 1 % a channel; the same sensors in the poses and in the motion that is judged."""
    options = {"seed": seed, "calibration": "residual", "sensor": "bno055"}
    fits = calibrate(two_link_arm.simulate(scenario, duration_s=28.0, **options))
    assert {one.model for one in fits.values()} == {model}
    run = two_link_arm.simulate("slow_periodic", duration_s=20.0, **options)
    (arrays,) = joint_arrays(run.robot)
    ideal = two_link_arm.simulate("slow_periodic", duration_s=20.0, **{**options, "calibration": "exact"})
    calibrated = {name: rows @ fits[name].matrix.T + fits[name].offset for name, rows in run.recording.accel.items()}
    before, after, best = (
        math.degrees(np.sqrt(np.mean(angle_errors(arrays, run, accel) ** 2)))
        for accel in (run.recording.accel, calibrated, ideal.recording.accel)
    )
    assert after < 1.05 * best
    assert before > 1.5 * best
