"""`lever_arms` and `accel_time`: what the motion of the links does to their accelerometers, and how it is taken out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.pcf.average import AccelAverage
from jointest_ros.core.pcf.pair_checks import TILT_LIMIT
from jointest_ros.core.pcf.params import FORMULATIONS, PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.sim.finger import simulate
from jointest_ros.sim.hand import HandRecording
from jointest_ros.sim.imu import GRAVITY
from jointest_ros.sim.own_robot import OwnOptions, stretches

FAST, SHAKEN = "PE", "PD"


def recorded(scenario: str, **options: object) -> HandRecording:
    return simulate(scenario, rate_hz=200.0, duration_s=30.0, zero_pose_s=5.0, mounting="mounted", seed=8, **options)


def rms_deg(hand: HandRecording, **params: object) -> FloatArray:
    """By joint, after 10 s."""
    series = Pcf(hand.robot, PcfParams(zero_at_start=True, **params)).run(hand.recording)
    late = series.stamps > 10_000_000_000
    return np.sqrt(np.mean(np.degrees(series.position - hand.truth_position)[late] ** 2, axis=0))


@pytest.mark.parametrize("formulation", ["hinge", "relative"])
@pytest.mark.parametrize("scenario", [FAST, SHAKEN])
def test_with_lever_arms_the_motion_does_no_harm(scenario: str, formulation: str) -> None:
    """The error is that of the same motion with all sensors in one place, up to a few hundredths of a degree."""
    hand, without_arms = recorded(scenario), recorded(scenario, lever_arm=False)
    found = rms_deg(hand, lever_arms=True, formulation=formulation)
    assert (found < rms_deg(without_arms, formulation=formulation) + 0.02).all()
    assert np.linalg.norm(found) < 0.6 * np.linalg.norm(rms_deg(hand, formulation=formulation))


def test_lever_arms_need_the_right_places() -> None:
    hand = recorded(FAST)
    sensors = tuple(replace(sensor, position=(0.0, 0.0, 0.0)) for sensor in hand.robot.sensors)
    wrong = replace(hand, robot=replace(hand.robot, sensors=sensors))
    assert np.linalg.norm(rms_deg(wrong, lever_arms=True)) > 3.0 * np.linalg.norm(rms_deg(hand, lever_arms=True))


def test_with_lever_arms_fast_links_are_no_slipped_imus() -> None:
    """The checks of neighbouring IMUs look at what the filters look at: accelerations in step with the motion have a
    mean."""
    axes, number = np.eye(3), 12
    sensors = tuple(Sensor(f"imu_{n}", f"link_{n}", (0.0, 0.2, 0.0)) for n in range(number))
    joints = [
        Joint(f"joint_{n}", f"link_{n - 1}", f"link_{n}", (tuple(axes[n % 3].tolist()),), origin=(0.0, 0.3, 0.0))
        for n in range(1, number)
    ]
    robot = Robot(tuple(sensor.link for sensor in sensors), tuple(joints), sensors)
    made = next(stretches(robot, OwnOptions(duration_s=20.0, zero_pose_s=3.0), 1e9))
    tilts = []
    for lever_arms in (True, False):
        estimator = Pcf(robot, PcfParams(zero_at_start=True, lever_arms=lever_arms))
        for frame in made.recording.frames():
            estimator.update(frame)
        tilts.append(max(abs(pair.tilt) for pair in estimator.pair_checks()))
    assert 10.0 * tilts[0] < TILT_LIMIT < tilts[1]


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_averaged_accelerometers_lose_what_is_in_step_with_the_motion(formulation: str) -> None:
    hand = recorded(FAST)
    averaged = np.linalg.norm(rms_deg(hand, formulation=formulation, accel_time=1.0))
    assert averaged < 0.35 * np.linalg.norm(rms_deg(hand, formulation=formulation))


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_without_a_calibration_nothing_is_averaged(formulation: str) -> None:
    """A bias of 3 deg/s would carry an average over 2 s away by 6 deg."""
    hand = recorded("PC")
    plain, averaged = (
        Pcf(hand.robot, PcfParams(formulation=formulation, still_start=0.0, accel_time=time)).run(hand.recording)
        for time in (0.0, 2.0)
    )
    np.testing.assert_allclose(averaged.position, plain.position, atol=1e-9)


def test_a_calibration_while_averaging_moves_nothing() -> None:
    hand = recorded("still")
    estimator = Pcf(hand.robot, PcfParams(accel_time=2.0))
    before = estimator.run(hand.recording.part(0, 4000)).position[-1]
    assert estimator.calibrated
    estimator.calibrate_gyro_bias()
    after = estimator.run(hand.recording.part(4000, 6000)).position
    assert np.degrees(np.abs(after - before)).max() < 0.1


# ------------------------------------------------------------- the average by itself


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), time=st.floats(0.05, 5.0))
def test_gravity_passes_the_average_unchanged(seed: int, time: float) -> None:
    """However the sensor turns, also by a radian a sample."""
    generator = np.random.default_rng(seed)
    average = AccelAverage(time)
    orientation = Rotation.from_rotvec(generator.uniform(-2.0, 2.0, 3))
    elapsed = float("nan")
    rate = np.zeros(3)
    for _ in range(200):
        if elapsed == elapsed:
            orientation = orientation * Rotation.from_rotvec(rate * elapsed)
        up = orientation.inv().apply([0.0, 0.0, GRAVITY])
        found = average.add(tuple(rate), tuple(up), elapsed)
        np.testing.assert_allclose(found, up, atol=1e-9)
        elapsed = float(generator.uniform(1e-3, 0.05))
        rate = generator.uniform(-20.0, 20.0, 3)


def test_it_is_the_mean_at_first_and_forgets_later() -> None:
    average = AccelAverage(0.5)
    rows = np.random.default_rng(1).normal(size=(2000, 3))
    still, found = (0.0, 0.0, 0.0), []
    for number, row in enumerate(rows):
        found.append(average.add(still, tuple(row), 0.01 if number else float("nan")))
    np.testing.assert_allclose(found[50], rows[:51].mean(axis=0))
    assert average.age == pytest.approx(0.5)
    weights = (0.01 / 0.51) * (0.5 / 0.51) ** np.arange(1900)[::-1]
    np.testing.assert_allclose(found[-1], weights @ rows[-1900:], atol=1e-6)
