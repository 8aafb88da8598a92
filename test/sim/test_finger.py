"""The finger rig against the specification of its scenarios and against independent kinematics."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray
from jointest_ros.sim import finger
from jointest_ros.sim.hand import HandRecording
from jointest_ros.sim.simulated import SimulationError

simulate, chunks = (partial(make, mounting="mounted") for make in (finger.simulate, finger.chunks))

FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])  # 8th order
X = np.array([1.0, 0.0, 0.0])
PAIRS = list(zip(finger.LINKS[:-1], finger.LINKS[1:], strict=True))
CLEAN = {"noise": False, "bias": False}


def difference(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted sums over nine neighbouring rows; four rows are lost at either end."""
    return sum(w * values[i : len(values) - 8 + i] for i, w in enumerate(weights))


def attitude(recorded: HandRecording, sensor: str) -> Rotation:
    return Rotation.from_quat(recorded.orientation[sensor])


def mounting(recorded: HandRecording, sensor: str) -> Rotation:
    return Rotation.from_quat(recorded.robot.sensor(sensor).mounting)


def tau_of(recorded: HandRecording, zero_pose_s: float = 10.0) -> FloatArray:
    return recorded.recording.stamps * 1e-9 - zero_pose_s


def sensor_positions(recorded: HandRecording) -> dict[str, FloatArray]:
    """World positions (T, 3) from the true attitudes and the specified lengths; the palm's reference point is at 0."""
    turns = {name: attitude(recorded, name) * mounting(recorded, name).inv() for name in finger.LINKS}
    positions, joint = {"palm": np.zeros((len(recorded.recording), 3))}, turns["palm"].apply([0.0, 0.050, 0.0])
    for name, length in (("proximal", 0.040), ("middle", 0.025), ("distal", 0.020)):
        positions[name] = joint + turns[name].apply([0.0, length / 2, 0.0])
        joint = joint + turns[name].apply([0.0, length, 0.0])
    return positions


def shaking(tau: FloatArray) -> FloatArray:
    u = np.clip(tau / 3.0, 0.0, 1.0)
    s = u * u * (3.0 - 2.0 * u)
    return np.column_stack([s * 0.3 * 9.81 * np.sin(2 * np.pi * f * tau) for f in (1.5, 1.9, 2.3)])


@pytest.mark.parametrize(("scenario", "tempo"), [("PA", 1.0), ("PC", 1.0), ("PD", 1.0), ("PE", 3.0), ("still", 0.0)])
def test_joint_motion_of_the_specification(scenario: str, tempo: float) -> None:
    recorded = simulate(scenario, rate_hz=100.0)
    tau = tau_of(recorded)
    u = np.clip(tau / 2.0, 0.0, 1.0)
    s = u * u * (3.0 - 2.0 * u)
    for i, (amplitude, frequency) in enumerate([(70.0, 0.35), (60.0, 0.35), (40.0, 0.5)]):
        expected = s * amplitude * (1.0 - np.cos(2 * np.pi * tempo * frequency * tau)) / 2.0
        np.testing.assert_allclose(np.degrees(recorded.truth_position[:, i]), expected, atol=1e-10)
    assert recorded.joint_names == recorded.robot.coordinates == finger.JOINTS


@pytest.mark.parametrize("scenario", ["PA", "PC", "PD"])
def test_palm_motion_of_the_specification(scenario: str) -> None:
    recorded = simulate(scenario, rate_hz=100.0, mounting="ideal")
    tau = tau_of(recorded)
    u = np.clip(tau / 3.0, 0.0, 1.0)
    s = u * u * (3.0 - 2.0 * u) * (scenario != "PA")
    angles = [s * a * np.sin(2 * np.pi * f * tau) for a, f in ((60.0, 0.10), (30.0, 0.17), (30.0, 0.13))]
    expected = Rotation.from_euler("ZYX", np.column_stack(angles), degrees=True)
    assert (expected.inv() * attitude(recorded, "palm")).magnitude().max() < 1e-12


@pytest.mark.parametrize("scenario", ["PA", "PC", "PD", "PE"])
def test_clean_gyro_integrates_to_the_true_attitude_and_angle(scenario: str) -> None:
    recorded = simulate(scenario, rate_hz=100.0, duration_s=25.0, **CLEAN)
    interval = np.diff(recorded.recording.stamps)[0] * 1e-9
    for name in finger.LINKS:
        truth = attitude(recorded, name)
        turned = truth[0]
        steps = Rotation.from_rotvec(recorded.recording.gyro[name] * interval)
        for k in range(1, len(recorded.recording)):
            turned = turned * steps[k]
        assert (turned.inv() * truth[-1]).magnitude() < 1e-11
    for i, (parent, child) in enumerate(PAIRS):
        relative = attitude(recorded, parent).inv() * attitude(recorded, child)
        zero = mounting(recorded, parent).inv() * mounting(recorded, child)
        axis = mounting(recorded, child).apply(X, inverse=True)
        twist = (zero.inv() * relative).as_rotvec()
        np.testing.assert_allclose(twist, recorded.truth_position[:, [i]] * axis, atol=1e-12)


@pytest.mark.parametrize("options", [{}, {"mounting": "ideal"}, {"elevation_deg": 50.0}])
def test_zero_pose_is_still_and_its_relative_attitude_is_that_of_the_mountings(options: dict[str, object]) -> None:
    recorded = simulate("PD", rate_hz=200.0, duration_s=6.0, zero_pose_s=4.0, **CLEAN, **options)
    resting = tau_of(recorded, 4.0) <= 0.0
    assert resting.sum() == 801
    assert not recorded.truth_position[resting].any()
    assert not recorded.truth_velocity[resting].any()
    for name in finger.LINKS:
        np.testing.assert_allclose(recorded.recording.gyro[name][resting], 0.0, atol=1e-13)
        accel = recorded.recording.accel[name][resting]
        np.testing.assert_allclose(accel, np.tile(accel[0], (801, 1)), atol=1e-13)
        upward = attitude(recorded, name)[0].apply([0.0, 0.0, 9.81], inverse=True)
        np.testing.assert_allclose(accel[0], upward, atol=1e-12)
        assert np.abs(recorded.recording.gyro[name][~resting]).max() > 0.1
    for parent, child in PAIRS:
        zero = mounting(recorded, parent).inv() * mounting(recorded, child)
        relative = attitude(recorded, parent)[0].inv() * attitude(recorded, child)[0]
        assert (zero.inv() * relative).magnitude() < 1e-12
        # the hinge axis has fixed components in both sensors: j_i = M_i^T x
        j1, j2 = (mounting(recorded, name).apply(X, inverse=True) for name in (parent, child))
        every = attitude(recorded, parent).inv() * attitude(recorded, child)
        np.testing.assert_allclose(every.apply(j2), np.tile(j1, (len(every), 1)), atol=1e-12)


@pytest.mark.parametrize("scenario", ["PA", "PC", "PD", "PE"])
def test_velocities_and_accelerometers_agree_with_differentiated_positions(scenario: str) -> None:
    recorded = simulate(scenario, duration_s=8.0, zero_pose_s=1.0, elevation_deg=20.0, **CLEAN)
    tau = tau_of(recorded, 1.0)[4:-4]
    smooth = np.all([np.abs(tau - jump) > 0.01 for jump in (0.0, 2.0, 3.0)], axis=0)  # ends of the smoothsteps
    velocity = difference(recorded.truth_position, FIRST) / 1e-3
    np.testing.assert_allclose(recorded.truth_velocity[4:-4][smooth], velocity[smooth], atol=1e-9)
    for name, position in sensor_positions(recorded).items():
        expected = difference(position, SECOND) / 1e-6 + np.array([0.0, 0.0, 9.81])
        if scenario == "PD":
            expected += shaking(tau)
        measured = attitude(recorded, name).apply(recorded.recording.accel[name])[4:-4]
        np.testing.assert_allclose(measured[smooth], expected[smooth], atol=1e-7)


def test_shaking_is_the_same_for_every_imu_and_cancels_between_them() -> None:
    quiet, shaken = (simulate(s, rate_hz=200.0, duration_s=20.0, **CLEAN) for s in ("PC", "PD"))
    tau = tau_of(shaken)
    in_world = {}
    for name in finger.LINKS:
        assert np.array_equal(shaken.recording.gyro[name], quiet.recording.gyro[name])
        difference = shaken.recording.accel[name] - quiet.recording.accel[name]
        in_world[name] = attitude(shaken, name).apply(difference)
        np.testing.assert_allclose(in_world[name], shaking(tau), atol=1e-11)
    for parent, child in PAIRS:
        np.testing.assert_allclose(in_world[parent], in_world[child], atol=1e-11)


def test_without_lever_arm_all_accelerometers_feel_the_same_force() -> None:
    recorded = simulate("PD", rate_hz=200.0, duration_s=20.0, lever_arm=False, **CLEAN)
    forces = [attitude(recorded, name).apply(recorded.recording.accel[name]) for name in finger.LINKS]
    for force in forces:
        np.testing.assert_allclose(force, forces[0], atol=1e-11)
    assert all(sensor.position == (0.0, 0.0, 0.0) for sensor in recorded.robot.sensors)


@pytest.mark.parametrize("elevation", [0.0, 37.0, 90.0])
def test_elevation_is_that_of_the_hinge_axis(elevation: float) -> None:
    recorded = simulate("PA", rate_hz=100.0, duration_s=15.0, elevation_deg=elevation)
    for name in finger.LINKS:
        axis = (attitude(recorded, name) * mounting(recorded, name).inv()).apply(X)
        np.testing.assert_allclose(axis[:, 2], np.sin(np.radians(elevation)), atol=1e-12)


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_noise_figures_of_the_specification(rate_hz: float, seed: int) -> None:
    recorded = simulate("still", rate_hz=rate_hz, duration_s=40.0, seed=seed)
    gyro = np.array([recorded.recording.gyro[n] - recorded.gyro_bias[n] for n in finger.LINKS])
    gravity = [attitude(recorded, n).apply([0.0, 0.0, 9.81], inverse=True) for n in finger.LINKS]
    accel = np.array([recorded.recording.accel[n] for n in finger.LINKS]) - gravity
    bound = 5.0 / np.sqrt(2 * gyro.size)
    assert abs(np.degrees(gyro.std()) / (0.005 * np.sqrt(rate_hz)) - 1.0) < bound
    assert abs(accel.std() / (400e-6 * 9.81 * np.sqrt(rate_hz)) - 1.0) < bound
    steps = np.degrees(np.diff([recorded.gyro_bias[n] for n in finger.LINKS], axis=1))
    assert abs(steps.std() / (0.001 / np.sqrt(rate_hz)) - 1.0) < bound
    angles = np.degrees([mounting(recorded, n).magnitude() for n in finger.LINKS])
    assert len(set(angles.tolist())) == 4 and angles.max() <= 10.0


def test_gyro_biases_fill_three_degrees_per_second_either_way() -> None:
    short = [simulate("still", rate_hz=100.0, duration_s=0.1, seed=seed) for seed in range(20)]
    start = np.degrees([recorded.gyro_bias[name][0] for recorded in short for name in finger.LINKS])
    assert -3.0 <= start.min() < -2.7 and 2.7 < start.max() <= 3.0


def test_accelerometer_bias_has_the_given_norm_and_is_in_the_samples() -> None:
    plain, biased = (simulate("PC", rate_hz=100.0, duration_s=12.0, accel_bias_mg=mg) for mg in (0.0, 30.0))
    for name in finger.LINKS:
        difference = biased.recording.accel[name] - plain.recording.accel[name]
        np.testing.assert_allclose(difference, np.tile(biased.accel_bias[name], (1200, 1)), atol=1e-12)
        assert np.linalg.norm(biased.accel_bias[name]) == pytest.approx(0.030 * 9.81)
        assert not plain.accel_bias[name].any()
    assert not np.allclose(biased.accel_bias["palm"], biased.accel_bias["distal"])


def flat(recorded: HandRecording) -> FloatArray:
    tables = (recorded.recording.gyro, recorded.recording.accel, recorded.recording.mag, recorded.orientation)
    truth = (recorded.truth_position, recorded.truth_velocity)
    return np.hstack([table[name] for table in tables for name in table] + list(truth))


def test_same_seed_same_recording() -> None:
    options = {"rate_hz": 100.0, "duration_s": 12.0, "mag": True}
    assert np.array_equal(flat(simulate("PC", seed=7, **options)), flat(simulate("PC", seed=7, **options)))
    assert not np.allclose(flat(simulate("PC", seed=7, **options)), flat(simulate("PC", seed=8, **options)))


def test_switching_one_error_off_leaves_the_others() -> None:
    def take(**switches: object) -> HandRecording:
        return simulate("PC", rate_hz=100.0, duration_s=12.0, seed=3, **switches)

    everything, noiseless, unbiased, clean = take(), take(noise=False), take(bias=False), take(**CLEAN)
    for name in finger.LINKS:
        full, no_noise, no_bias, bare = (r.recording.gyro[name] for r in (everything, noiseless, unbiased, clean))
        np.testing.assert_allclose(full - no_noise, no_bias - bare, atol=1e-14)
        np.testing.assert_allclose(no_noise - bare, everything.gyro_bias[name], atol=1e-14)
        assert np.array_equal(everything.gyro_bias[name], noiseless.gyro_bias[name])
        assert np.array_equal(everything.recording.accel[name], unbiased.recording.accel[name])
    aligned, without_arm = take(mounting="ideal"), take(lever_arm=False)
    for name in finger.LINKS:
        assert mounting(aligned, name).magnitude() == 0.0
        assert np.array_equal(aligned.gyro_bias[name], everything.gyro_bias[name])
        assert np.array_equal(without_arm.recording.gyro[name], everything.recording.gyro[name])


@pytest.mark.parametrize("rate_hz", [100.0, 333.0])
def test_stretches_join_to_the_whole(rate_hz: float) -> None:
    options = {"rate_hz": rate_hz, "duration_s": 14.0, "seed": 2}
    whole, pieces = simulate("PD", **options), list(chunks("PD", chunk_s=3.3, **options))
    assert len(pieces) == 5
    assert np.array_equal(np.concatenate([p.recording.stamps for p in pieces]), whole.recording.stamps)
    np.testing.assert_allclose(np.vstack([flat(p) for p in pieces]), flat(whole), atol=1e-11)
    for name in finger.LINKS:
        assert np.array_equal(np.vstack([p.gyro_bias[name] for p in pieces]), whole.gyro_bias[name])


def test_a_longer_recording_begins_like_a_shorter_one() -> None:
    short, long = (simulate("PC", rate_hz=100.0, duration_s=d) for d in (13.0, 20.0))
    np.testing.assert_allclose(flat(long)[:1300], flat(short), atol=1e-11)


@pytest.mark.parametrize("rate_hz", [100.0, 333.0, 1000.0])
def test_recording_is_what_an_estimator_takes(rate_hz: float) -> None:
    recording = simulate(rate_hz=rate_hz, duration_s=2.0).recording
    assert len(recording) == 2 * rate_hz
    assert recording.stamps.dtype == np.int64
    assert recording.stamps[0] == 0
    np.testing.assert_allclose(np.diff(recording.stamps), 1e9 / rate_hz, atol=1.0)
    first = next(recording.frames())
    assert list(first.gyro) == list(first.accel) == list(finger.LINKS)
    assert first.period == pytest.approx(1.0 / rate_hz)
    assert first.hall is None and not first.mag


def test_sensors_carry_the_specified_figures() -> None:
    robot = simulate(rate_hz=100.0, duration_s=1.0, noise=False).robot
    assert [sensor.position[1] for sensor in robot.sensors] == pytest.approx([0.0, 0.020, 0.0125, 0.010])
    for sensor in robot.sensors:  # a data sheet does not change when a simulation leaves its noise out
        assert np.degrees(sensor.gyro_noise) == pytest.approx(0.005)
        assert np.degrees(sensor.gyro_bias_walk) == pytest.approx(0.001)
        assert sensor.accel_noise == pytest.approx(400e-6 * 9.81)
        assert not sensor.mag


def test_magnetometers_on_request() -> None:
    recorded = simulate("PC", rate_hz=100.0, duration_s=12.0, mag=True)
    plain = simulate("PC", rate_hz=100.0, duration_s=12.0)
    for name in finger.LINKS:
        field = attitude(recorded, name).apply(recorded.recording.mag[name])
        assert np.ptp(field, axis=0).max() < 10e-6 and field[:, 0].mean() > 15e-6
        assert np.array_equal(recorded.recording.accel[name], plain.recording.accel[name])
    assert all(sensor.mag for sensor in recorded.robot.sensors)


@pytest.mark.parametrize(
    ("options", "named", "allowed"),
    [
        ({"scenario": "PB"}, "'PB'", "PA, PC, PD, PE, still"),
        ({"rate_hz": 99.0}, "rate_hz: 99", "100 to 1000 Hz"),
        ({"rate_hz": 2000}, "rate_hz: 2000", "100 to 1000 Hz"),
        ({"duration_s": 0.0}, "duration_s: 0.0", "s"),
        ({"duration_s": -5}, "duration_s: -5", "s"),
        ({"duration_s": float("nan")}, "duration_s: nan", "s"),
        ({"seed": 1.5}, "seed: 1.5", "0 or more"),
        ({"mounting": "glued"}, "'glued'", "ideal, mounted"),
        ({"elevation_deg": 91.0}, "elevation_deg: 91", "0 to 90 deg"),
        ({"rate": 100.0}, "rate: unknown", "rate_hz"),
    ],
)
@pytest.mark.parametrize("take", [simulate, chunks])
def test_bad_input_is_one_line_that_says_what_is_allowed(take, options, named, allowed) -> None:
    with pytest.raises(SimulationError) as caught:
        take(**options)
    message = str(caught.value)
    assert named in message and allowed in message and "\n" not in message
