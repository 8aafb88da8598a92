"""Identification of the axes of joints of two, from motion: how near, how honest, and when it must refuse."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from finger_windows import error_deg, means_of
from scipy.spatial.transform import Rotation

from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.evaluation.axis_advice import refusal
from jointest_ros.evaluation.axis_fit import AxisFit
from jointest_ros.evaluation.joint_pairs import Pair, hinge_pairs
from jointest_ros.evaluation.two_axis_calibration import fit_two_axes
from jointest_ros.sim.own_robot import OwnOptions, stretches

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
OBLIQUE = (0.6, 0.0, 0.8)
SEEDS = range(60, 63)


def robot_of(axes: Any = (Y, X)) -> Robot:
    sensors = (Sensor("pelvis", "pelvis", (-0.1, 0.0, 0.05)), Sensor("thigh", "thigh", (0.05, 0.0, -0.2)))
    return Robot(("pelvis", "thigh"), (Joint("hip", "pelvis", "thigh", axes, origin=(0.0, 0.1, 0.0)),), sensors)


def identified(
    robot: Robot, seed: int, askew_deg: float = 8.0, kept: tuple[str, ...] = (), **options: Any
) -> tuple[AxisFit, list[float]]:
    """(fit without knowing how the sensors are turned against their mountings, errors of its axes, deg)."""
    generator = np.random.default_rng(seed)
    sensors = []
    for sensor in robot.sensors:
        turn = generator.standard_normal(3)
        turn *= math.radians(0.0 if sensor.name in kept else askew_deg) / np.linalg.norm(turn)
        x, y, z, w = (Rotation.from_quat(sensor.mounting) * Rotation.from_rotvec(turn)).as_quat().tolist()
        sensors.append(replace(sensor, mounting=(x, y, z, w)))
    true = replace(robot, sensors=tuple(sensors))
    options = {"duration_s": 40.0, "zero_pose_s": 3.0, "seed": seed, **options}
    made = next(stretches(true, OwnOptions(**options), 1e9))
    fit = fit_two_axes(means_of(made.recording), hinge_pairs(robot, most_axes=2)[0][0], frozenset(kept))
    right = Pair(true.joints[0], *true.sensors).configured()
    return fit, [error_deg(axis, truth) for axis, truth in zip(fit.axes, right, strict=True)]


@pytest.mark.parametrize("axes", [(Y, X), (Y, OBLIQUE)])
@pytest.mark.parametrize("up", ["z", "x"])
def test_axes_are_found_and_known_as_well_as_stated(axes: Any, up: str) -> None:
    found = [identified(robot_of(axes), seed, up=up) for seed in SEEDS]
    scores = []
    for fit, errors in found:
        assert not refusal(fit)
        assert max(errors) < 0.09
        assert fit.residual == pytest.approx(fit.noise, rel=0.25) and fit.residual < 0.1 * fit.residual_before
        scores += [error / math.degrees(axis.std) for error, axis in zip(errors, fit.axes, strict=True)]
    assert math.sqrt(np.mean(np.square(scores))) < 4.0


def test_mountings_that_are_far_off() -> None:
    _, errors = identified(robot_of(), 60, askew_deg=45.0)
    assert max(errors) < 0.09


def test_gyro_scale_and_accelerometer_bias_cost_little_and_are_stated() -> None:
    scores = []
    for seed in SEEDS:
        fit, errors = identified(robot_of(), seed, duration_s=60.0, gyro_scale=0.01, accel_bias_mg=30.0)
        assert max(errors) < 1.0
        scores += [error / math.degrees(axis.std) for error, axis in zip(errors, fit.axes, strict=True)]
    assert math.sqrt(np.mean(np.square(scores))) < 3.0


def test_a_parent_that_does_not_turn_hides_its_axis() -> None:
    """Nothing tells there how it is turned about the vertical, unless its mounting is known."""
    fit, _ = identified(robot_of(), 61, root_turns=False)
    assert not fit.parent.determined
    assert "its axis in 'pelvis' is undetermined: 'pelvis' hardly turned" in refusal(fit)
    assert refusal(fit).endswith("--keep pelvis")
    fit, errors = identified(robot_of(), 61, kept=("pelvis",), root_turns=False)
    assert fit.parent.kept and not refusal(fit)
    assert errors == [pytest.approx(0.0, abs=1e-6), pytest.approx(0.0, abs=0.09)]


def test_a_joint_of_three_axes_is_not_one_of_two() -> None:
    ball = robot_of((Y, X, Z))
    made = next(stretches(ball, OwnOptions(duration_s=40.0, zero_pose_s=3.0), 1e9))
    fit = fit_two_axes(means_of(made.recording), hinge_pairs(robot_of(), most_axes=2)[0][0])
    assert "the motion is not about two axes" in refusal(fit)


def test_without_rest_or_time_it_refuses() -> None:
    with pytest.raises(CalibrationError, match=r"'pelvis' and 'thigh' are never at rest, .*; hold the robot still"):
        identified(robot_of(), 60, zero_pose_s=0.0)
    with pytest.raises(CalibrationError, match=r"gave readings together for 6\.. s; at least 20 s are needed"):
        identified(robot_of(), 60, duration_s=6.5)
