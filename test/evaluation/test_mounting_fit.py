"""Mountings from axes and from a zero pose: what is asked for happens, and nothing else changes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import Quat, Vec3
from jointest_ros.core.kinematics import link_poses
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import IDENTITY, conjugate, exp, log, multiply, norm, rotate, rotate_inverse
from jointest_ros.evaluation.joint_pairs import hinge_pairs
from jointest_ros.evaluation.mounting_fit import SeenAxis, aligned, reading, turned, zeroed

X, Y, Z = np.eye(3)
GRAVITY: Vec3 = (0.0, 0.0, 9.81)


def apart_deg(one: Quat, two: Quat) -> float:
    return math.degrees(norm(log(multiply(conjugate(one), two))))


def test_one_axis_makes_the_smallest_turn() -> None:
    before = exp((0.3, -0.2, 0.5))
    seen = Rotation.from_quat(before).inv().apply(Rotation.from_rotvec([0.0, 0.0, 0.1]).apply(X))
    after, (over,) = aligned(before, [SeenAxis(seen, X, 1e-3)])
    assert over < 1e-7
    assert np.array(rotate(after, tuple(seen))) == pytest.approx(X, abs=1e-7)
    assert apart_deg(before, after) == pytest.approx(math.degrees(0.1), abs=1e-5)
    assert turned(Sensor("imu", "link", mounting=before), after) == pytest.approx(0.1)


def test_two_axes_give_the_mounting_whatever_it_was() -> None:
    true = Rotation.from_rotvec([2.0, -1.0, 0.5])
    axes = [SeenAxis(true.inv().apply(axis), axis, 1e-3) for axis in (X, Z)]
    after, over = aligned(IDENTITY, axes)
    assert apart_deg(after, tuple(true.as_quat())) == pytest.approx(0.0, abs=1e-5)
    assert max(over) < 1e-7


def test_the_better_known_axis_counts_more_and_the_rest_is_left_over() -> None:
    """Two axes that are parallel as configured, seen 1 deg apart."""
    other = Rotation.from_rotvec([0.0, 0.0, math.radians(1.0)]).apply(X)
    _, (one, two) = aligned(IDENTITY, [SeenAxis(X, X, math.radians(0.1)), SeenAxis(other, X, math.radians(0.3))])
    assert math.degrees(one) == pytest.approx(0.1, abs=0.01)
    assert math.degrees(two) == pytest.approx(0.9, abs=0.01)


def arm(axes: list[tuple[float, float, float]], mountings: list[Quat]) -> Robot:
    """Links in a row, a hinge about each of `axes` between them, an IMU on each."""
    links = tuple(f"link_{k}" for k in range(len(mountings)))
    joints = tuple(Joint(f"joint_{k + 1}", links[k], links[k + 1], (axis,)) for k, axis in enumerate(axes))
    sensors = tuple(Sensor(f"imu_{k}", links[k], mounting=m) for k, m in enumerate(mountings))
    return Robot(links, joints, sensors)


def at_rest(true: Robot, positions: dict[str, float], base: Quat = IDENTITY) -> dict[str, Vec3]:
    """What the accelerometers of the true robot read in a pose; `base`: first link to world."""
    poses = link_poses(true, positions)
    return {
        s.name: rotate_inverse(multiply(multiply(base, poses[s.link].orientation), s.mounting), GRAVITY)
        for s in true.sensors
    }


def with_mountings(robot: Robot, mountings: dict[str, Quat]) -> Robot:
    return replace(robot, sensors=tuple(replace(s, mounting=mountings[s.name]) for s in robot.sensors))


def test_zeroing_parallel_axes_turns_the_links_after_the_first() -> None:
    x = (1.0, 0.0, 0.0)
    true = arm([x, x, x], [exp((a, 0.0, 0.0)) for a in (0.1, -0.2, 0.3, 3.0)])
    configured = with_mountings(true, dict.fromkeys((s.name for s in true.sensors), IDENTITY))
    pairs = hinge_pairs(configured)[0]
    accel = at_rest(true, {"joint_1": 0.0, "joint_2": 0.0, "joint_3": 0.0})
    after = zeroed(pairs, accel, {"joint_1", "joint_2", "joint_3"})
    for pair in hinge_pairs(with_mountings(configured, after))[0]:
        assert reading(pair, accel[pair.parent.name], accel[pair.child.name]) == pytest.approx(0.0, abs=1e-6)
        for sensor, axis in zip(pair.sensors, pair.configured(), strict=True):
            assert axis == pytest.approx(X, abs=1e-6), sensor.name  # where they were
    assert apart_deg(after["imu_0"], IDENTITY) < 1e-4


def test_zeroing_one_joint_leaves_the_readings_of_the_others() -> None:
    x = (1.0, 0.0, 0.0)
    robot = arm([x, x, x], [IDENTITY] * 4)
    pose = {"joint_1": 0.1, "joint_2": -0.2, "joint_3": 0.3}
    accel = at_rest(robot, pose)
    after = zeroed(hinge_pairs(robot)[0], accel, {"joint_2"})
    found = {
        pair.joint.name: reading(pair, accel[pair.parent.name], accel[pair.child.name])
        for pair in hinge_pairs(with_mountings(robot, after))[0]
    }
    assert found == pytest.approx({"joint_1": 0.1, "joint_2": 0.0, "joint_3": 0.3}, abs=1e-6)


def test_axes_that_cross_are_kept_and_the_link_with_freedom_turns() -> None:
    """A yaw-pitch arm, tilted so that both show: the middle mounting follows from its axes, the outer ones give way."""
    true = arm([(0.0, 0.0, 1.0), (0.0, 1.0, 0.0)], [exp((0.0, 0.0, 0.2)), IDENTITY, exp((0.0, -0.3, 0.0))])
    configured = with_mountings(true, dict.fromkeys((s.name for s in true.sensors), IDENTITY))
    accel = at_rest(true, {"joint_1": 0.0, "joint_2": 0.0}, exp((0.9, 0.3, 0.0)))
    after = zeroed(hinge_pairs(configured)[0], accel, {"joint_1", "joint_2"})
    for sensor in true.sensors:
        assert apart_deg(after[sensor.name], sensor.mounting) < 0.01, sensor.name


def test_an_upright_axis_has_no_reading() -> None:
    (pair,) = hinge_pairs(arm([(0.0, 0.0, 1.0)], [IDENTITY, IDENTITY]))[0]
    assert reading(pair, GRAVITY, GRAVITY) is None
    tilted = rotate_inverse(exp((math.radians(30.0), 0.0, 0.0)), GRAVITY)
    assert reading(pair, tilted, tilted) == pytest.approx(0.0)
