"""Scales of gyros from motion and gravity, on the simulated finger with accelerometers that are wrong too."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from finger_windows import means_of

from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.pcf.pcf import Pcf, PcfParams
from jointest_ros.core.robot import UNCALIBRATED_SCALE
from jointest_ros.evaluation.gyro_calibration import HingeInformation, Scale, calibrated, combine, hinge_information
from jointest_ros.evaluation.gyro_calibration import why_unknown as why
from jointest_ros.evaluation.joint_pairs import hinge_pairs
from jointest_ros.sim import finger, hand
from jointest_ros.sim.hand import HandRecording
from jointest_ros.sim.imu import ImuNoise

ALONG = 0  # the sensor's axis that is nearest to those of the hinges


def fit(run: HandRecording) -> tuple[list[HingeInformation], list[Scale]]:
    """All hinges of a recording."""
    means = means_of(run.recording)
    hinges = [hinge_information(means, pair) for pair in hinge_pairs(run.robot)[0]]
    return hinges, combine(hinges)


def simulated(scenario: str = "PC", seed: int = 0, **options: float) -> HandRecording:
    return finger.simulate(
        scenario, rate_hz=100.0, duration_s=60.0, zero_pose_s=4.0, mounting="mounted", seed=seed, **options
    )


def true_scale(run: HandRecording, one: Scale) -> float:
    return float(1.0 / run.gyro_scale[one.sensor][one.axis])


def rms_error_deg(run: HandRecording, scales: list[Scale]) -> float:
    sensors = {sensor.name: sensor for sensor in calibrated(run.robot.sensors, scales)}
    gyro = {
        n: w * (sensors[n].gyro_scale if n in sensors else UNCALIBRATED_SCALE) for n, w in run.recording.gyro.items()
    }
    params = PcfParams(zero_at_start=True, lever_arms=True)
    series = Pcf(run.robot, params).run(replace(run.recording, gyro=gyro))
    moving = run.recording.stamps > 8e9
    return float(np.degrees(np.sqrt(np.mean((series.position - run.truth_position)[moving] ** 2))))


def test_scales_are_found_within_their_uncertainty(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = functools.partial(ImuNoise, accel_offset=0.3, accel_scale=0.02)
    monkeypatch.setattr(hand, "ImuNoise", wrong)
    deviations, stds = [], []
    for seed in range(4):
        run = simulated(seed=seed, gyro_scale=0.02)
        known = [one for one in fit(run)[1] if one.known]
        assert [(one.sensor, one.axis) for one in known] == [(sensor.name, ALONG) for sensor in run.robot.sensors]
        deviations += [(one.scale - true_scale(run, one)) / one.std for one in known]
        stds += [one.std for one in known]
    assert max(stds) < 0.005
    assert np.mean(np.abs(deviations) < 1.0) > 0.6
    assert np.mean(np.abs(deviations) < 2.0) > 0.9


def test_the_angles_are_right_again() -> None:
    run = simulated(seed=20, gyro_scale=0.02)
    scales = fit(run)[1]
    assert rms_error_deg(run, scales) < 0.25 * rms_error_deg(run, [])


@pytest.mark.parametrize("scenario", ["PC", "PA"])
def test_gyros_that_are_right_are_left_alone(scenario: str) -> None:
    run = simulated(scenario, seed=30)
    scales = fit(run)[1]
    assert all(abs(one.scale - 1.0) < 2.0 * one.std for one in scales)
    assert rms_error_deg(run, scales) < 1.1 * rms_error_deg(run, [])


def test_a_link_that_does_not_turn_tells_nothing_of_its_gyro() -> None:
    run = simulated("PA", seed=40, gyro_scale=0.02)
    hinges, scales = fit(run)
    palm = [one for one in scales if one.sensor == "palm"]
    assert not any(one.known for one in palm) and all(one.std > 0.025 for one in palm)
    assert "palm" not in {sensor.name for sensor in calibrated(run.robot.sensors, scales)}
    assert "hardly turns" in why("palm", scales, hinges)


def test_a_vertical_axis_tells_nothing() -> None:
    run = finger.simulate("PA", rate_hz=100.0, duration_s=40.0, elevation_deg=88.0, seed=50)
    hinges, scales = fit(run)
    assert not calibrated(run.robot.sensors, scales)
    assert "near gravity" in why("distal", scales, hinges)


def test_a_still_robot_tells_nothing() -> None:
    run = finger.simulate("still", rate_hz=100.0, duration_s=30.0, seed=51)
    hinges, scales = fit(run)
    assert not calibrated(run.robot.sensors, scales)
    assert "hardly turns" in why("middle", scales, hinges)


def test_two_hinges_of_a_sensor_tell_more_than_one() -> None:
    hinges, scales = fit(simulated(seed=60))
    alone = {one.sensor: one.std for one in combine(hinges[:1]) if one.axis == ALONG}
    together = {one.sensor: one.std for one in scales if one.axis == ALONG}
    assert together["proximal"] < alone["proximal"]


def test_axes_that_are_not_found_keep_their_scale() -> None:
    (sensor, *_) = simulated().robot.sensors
    sensor = replace(sensor, gyro_scale=(1.1, 1.2, 1.3))
    scales = [Scale(sensor.name, axis, 0.98, std, 1.0) for axis, std in enumerate((0.03, 0.001, 0.02))]
    (result,) = calibrated([sensor], scales)
    assert result.gyro_scale == (1.1, 0.98, 1.3)
    (result,) = calibrated([sensor], [replace(one, std=0.009, scale=1.008) for one in scales[:1]])
    assert result.gyro_scale == (1.0, 1.2, 1.3)  # less than its standard deviation is no error


def test_too_little_is_refused() -> None:
    run = simulated()
    with pytest.raises(CalibrationError, match=r"'palm' and 'proximal' gave readings together for .* s; at least"):
        hinge_information(means_of(run.recording).between(10.0, 11.0), hinge_pairs(run.robot)[0][0])
