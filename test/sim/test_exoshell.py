"""The simulated exoshell: motions, gyros, voltages and truths of every scenario."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.kckf.kckf import PAPER, Kckf
from jointest_ros.sim import exoshell
from jointest_ros.sim.exoshell import SCENARIOS, ExoshellOptions, ExoshellRecording, simulate, stretches
from jointest_ros.sim.simulated import SimulationError

AXES = (0, 1, 0, 1)  # components of the hinge axes


@pytest.fixture(scope="module")
def recordings() -> dict[str, ExoshellRecording]:
    return {name: simulate(name, duration_s=30.0, seed=1) for name in SCENARIOS}


def voltages(made: ExoshellRecording) -> FloatArray:
    assert made.recording.hall is not None
    return made.recording.hall


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_same_seed_gives_the_same_recording(name: str, recordings: dict[str, ExoshellRecording]) -> None:
    again, other = simulate(name, duration_s=30.0, seed=1), simulate(name, duration_s=30.0, seed=2)
    first = recordings[name]
    assert (voltages(again) == voltages(first)).all() and (voltages(other) != voltages(first)).any()
    for sensor in exoshell.GYROS:
        assert (again.recording.gyro[sensor] == first.recording.gyro[sensor]).all()
        assert (other.recording.gyro[sensor] != first.recording.gyro[sensor]).any()
    assert (again.truth_position == other.truth_position).all()


@pytest.mark.parametrize("name", ["bench", "composed-free", "drift", "human"])
def test_stretches_join_to_the_whole(name: str) -> None:
    options = {"duration_s": 3.0, "seed": 4, "hysteresis_deg": 1.0}
    whole = simulate(name, **options)
    parts: Iterator[ExoshellRecording] = stretches(ExoshellOptions(scenario=name, **options), 0.7)  # type: ignore[arg-type]
    rows = list(parts)
    assert len(rows) == 5
    assert np.concatenate([part.recording.stamps for part in rows]).tolist() == whole.recording.stamps.tolist()
    assert np.concatenate([voltages(part) for part in rows]) == pytest.approx(voltages(whole), abs=1e-9)
    for sensor in exoshell.GYROS:
        joined = np.concatenate([part.recording.gyro[sensor] for part in rows])
        assert joined == pytest.approx(whole.recording.gyro[sensor], abs=1e-9)
    assert np.concatenate([part.truth_torso for part in rows]) == pytest.approx(whole.truth_torso, abs=1e-9)


@pytest.mark.parametrize("name", SCENARIOS)
def test_gyros_without_their_biases_carry_the_joints(name: str, recordings: dict[str, ExoshellRecording]) -> None:
    """Row k is the mean rate over the interval that ends at stamp k, of every hinge along its axis."""
    made = recordings[name]
    for k, axis in enumerate(SCENARIOS[name].axes):
        inner, outer = (
            made.recording.gyro[f"imu_{number}"] - made.gyro_bias[f"imu_{number}"] for number in (k + 1, k + 2)
        )
        rate = (outer - inner) @ np.array(axis)
        angle = made.truth_position[0, k] + 0.01 * np.cumsum(np.append(0.0, rate[1:]))
        walk = 5.0 * exoshell.GYRO_NOISE * math.sqrt(2.0 * 30.0)  # integrated white noise
        assert np.abs(angle - made.truth_position[:, k]).max() < walk


@pytest.mark.parametrize("name", SCENARIOS)
def test_truths_belong_together(name: str, recordings: dict[str, ExoshellRecording]) -> None:
    made = recordings[name]
    numeric = np.gradient(made.truth_position, 0.01, axis=0)
    assert made.truth_velocity[1:-1] == pytest.approx(numeric[1:-1], abs=0.05)
    torso = Rotation.from_quat(made.truth_torso_orientation)
    if SCENARIOS[name].base is None:
        sums = made.truth_position @ np.array(SCENARIOS[name].axes)
        assert made.truth_torso == pytest.approx(sums)
    else:
        whole = Rotation.identity(len(sums := made.truth_position))
        for k, axis in enumerate(SCENARIOS[name].axes):
            whole = whole * Rotation.from_rotvec(sums[:, k, None] * np.array(axis))
        assert (torso.inv() * whole).magnitude().max() < 1e-9
    assert torso.as_rotvec() == pytest.approx(made.truth_torso, abs=1e-9)


def test_bench_is_the_bench_of_the_specification(shared_data: Path) -> None:
    """Motion B against the fixed draw of it: the same truth, the same statistics of the sensors."""
    made = simulate("bench", duration_s=120.01)
    with np.load(shared_data / "exoshell" / "bench.npz") as data:
        assert np.degrees(made.truth_position) == pytest.approx(data["theta"], abs=1e-9)
        assert np.degrees(made.truth_torso[:, :2]) == pytest.approx(data["phi"], abs=1e-9)
        theirs = data["hall_V"].reshape(-1, 8)
        step = np.diff(data["gyro"][:, 0] - data["gyro_bias"][0], axis=0)
    expected = np.column_stack(
        [sensor.voltage(made.truth_position[:, k // 2]) for k, sensor in enumerate(made.robot.hall)]
    )
    assert (voltages(made) - expected).std() == pytest.approx((theirs - expected).std(), rel=0.02)
    ours = made.recording.gyro["imu_1"]
    assert np.degrees(np.diff(ours, axis=0)).std() == pytest.approx(step.std(), rel=0.03)
    assert np.abs(np.degrees([bias[0] for bias in made.gyro_bias.values()])).max() <= 1.0


def test_table_1_is_that_of_the_specification(shared_data: Path) -> None:
    made = simulate("table1", duration_s=100.01)
    with np.load(shared_data / "exoshell" / "table1_like.npz") as data:
        # the specification gives the parameters in hundredths of a degree
        assert np.degrees(made.truth_position) == pytest.approx(data["theta"], abs=0.02)
        theirs = data["hall_V"].reshape(-1, 8)
        biases = data["gyro_bias"]
    rail = theirs.max()
    assert (voltages(made) == rail).mean() == pytest.approx((theirs == rail).mean(), abs=0.01)
    # the voltages of both draws differ by their noise alone
    sigma = np.repeat([0.0049, 0.0076, 0.0030, 0.0178], 2)
    assert (np.abs(voltages(made) - theirs).mean(axis=0) < 1.2 * sigma).all()
    mean = np.degrees([made.gyro_bias[name].mean(axis=0) for name in exoshell.GYROS])
    assert mean == pytest.approx(biases, abs=0.06)


def test_voltages_are_rounded_and_end_at_the_rails(recordings: dict[str, ExoshellRecording]) -> None:
    digits = voltages(recordings["clipped"]) / (3.3 / 4096)
    assert digits == pytest.approx(np.round(digits), abs=1e-6)
    assert voltages(recordings["clipped"]).max() == pytest.approx(1.79985, abs=1e-5)
    assert voltages(recordings["bench"]).max() > 1.9
    free = np.degrees(recordings["bench"].robot.hall[0].angle(voltages(recordings["bench"])[:, 0]))
    assert np.abs(free - np.degrees(recordings["bench"].truth_position[:, 0])).mean() < 5.0


def test_offsets_of_a_scenario_are_hidden_from_the_robot(recordings: dict[str, ExoshellRecording]) -> None:
    made = recordings["offset"]
    assert all(sensor.offset == 0.0 for sensor in made.robot.hall)
    still = voltages(made)[:5].mean(axis=0) - [float(s.voltage(np.array(0.0))) for s in made.robot.hall]
    assert still.reshape(4, 2).mean(axis=0) == pytest.approx([-0.040, 0.020], abs=0.01)


def test_linear_sensors_have_the_paper_s_noise(recordings: dict[str, ExoshellRecording]) -> None:
    made = recordings["monte-carlo"]
    angle = np.column_stack([s.angle(voltages(made)[:, k]) for k, s in enumerate(made.robot.hall)])
    error = np.degrees(angle - np.repeat(made.truth_position, 2, axis=1))
    assert error.std() == pytest.approx(3.2, rel=0.02) and abs(error.mean()) < 0.1


def test_errors_of_the_sensors_can_be_added() -> None:
    plain, *changed = (
        simulate("bench", duration_s=20.0, seed=3, **options)
        for options in ({}, {"hall_offset_mv": 40.0}, {"hall_gain_percent": 5.0}, {"hysteresis_deg": 2.0})
    )
    assert voltages(changed[0]) - voltages(plain) == pytest.approx(np.tile([-0.04, 0.04], (2000, 4)), abs=1e-3)
    first = [np.degrees(made.robot.hall[0].angle(voltages(made)[:, 0])) for made in (plain, *changed)]
    truth = np.degrees(plain.truth_position[:, 0])
    assert np.polyfit(truth, first[2] - first[0], 1)[0] == pytest.approx(0.05, abs=0.005)
    loop = (first[3] - first[0])[500:]
    rising = plain.truth_velocity[500:, 0] > 1.0
    falling = plain.truth_velocity[500:, 0] < -1.0
    assert np.median(loop[rising]) == pytest.approx(-1.0, abs=0.1)
    assert np.median(loop[falling]) == pytest.approx(1.0, abs=0.1)


def test_the_drift_posture_is_held_with_the_biases_of_the_specification(
    recordings: dict[str, ExoshellRecording],
) -> None:
    made = recordings["drift"]
    assert np.degrees(made.truth_position[-1]) == pytest.approx([20.0, -12.0, 8.0, 15.0])
    rates = [np.degrees(made.recording.gyro[name][1000:, 0].mean()) for name in exoshell.GYROS]
    assert rates == pytest.approx([0.10, -0.06, 0.12, -0.02, 0.2528], abs=0.01)
    wrong = recordings["drift-hall-error"]
    assert wrong.truth_position.tolist() == made.truth_position.tolist()
    shift = 100.0 * (voltages(wrong) - voltages(made)).mean(axis=0)
    assert shift[::2] == pytest.approx([4.0, -2.0, 3.0, 2.0], abs=1e-6)
    assert shift[1::2] == pytest.approx([-4.0, 2.0, -3.0, -2.0], abs=1e-6)


def test_the_wearer_walks_and_turns(recordings: dict[str, ExoshellRecording]) -> None:
    """The base moves in `composed-free` alone, and changes neither the joints nor what the Hall sensors see."""
    fixed, free = recordings["composed"], recordings["composed-free"]
    assert np.abs(np.degrees(fixed.recording.gyro["imu_1"])).max() < 2.0
    assert np.degrees(free.recording.gyro["imu_1"][:, 2]).std() == pytest.approx(
        8.0 * 2 * math.pi * 0.8 / math.sqrt(2), rel=0.1
    )
    assert (voltages(fixed) == voltages(free)).all()


def test_a_bending_user_shifts_the_sensors_at_both_ends() -> None:
    made = simulate("human", duration_s=60.0)
    flexion = np.degrees(made.truth_torso[:, 0])
    assert flexion.max() == pytest.approx(30.0, abs=0.5) and flexion[500:].min() > -1.0
    # sensor 2 covers the bent side: what it shows too much, by flexion
    excess = np.degrees(made.robot.hall[1].angle(voltages(made)[:, 1]) - made.truth_position[:, 0])
    assert excess[flexion > 29.0].mean() > 4.0
    assert excess[(flexion < 1.0) & (np.arange(len(flexion)) > 500)].mean() < -4.0
    assert abs(excess[(flexion > 12.0) & (flexion < 18.0)].mean()) < 1.0
    series = Kckf(made.robot, PAPER).run(made.recording)
    assert series.torso is not None
    error = np.degrees(series.torso - made.truth_torso)[:, 0]
    assert np.sqrt((error**2).mean()) == pytest.approx(4.85, rel=0.05)


def test_what_there_is_not_is_refused() -> None:
    with pytest.raises(SimulationError, match=r"scenario: 'jump' is not allowed.*bench"):
        simulate("jump")
    with pytest.raises(SimulationError, match="hysteresis"):
        simulate("bench", hysteresis=1.0)
