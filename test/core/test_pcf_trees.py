"""Any tree: thirty joints that branch, some of two and three axes, the base somewhere in the list of links."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Series, Vec3
from jointest_ros.core.kinematics import link_poses
from jointest_ros.core.pcf.params import FORMULATIONS, PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import unit
from jointest_ros.sim import hand
from jointest_ros.sim.hand import HandOptions, HandRecording, palm_turns
from jointest_ros.sim.motion import LinkMotion, Signal, constant, raised_cosine, smoothstep, tree_motion

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
JOINTS, BASE = 30, "l00"
SEVERAL_AXES: dict[int, tuple[Vec3, ...]] = {7: (X, Y), 12: (Z, Y, X)}  # joint -> axes
OPTIONS = HandOptions(rate_hz=100.0, duration_s=30.0, zero_pose_s=4.0, mounting="mounted", seed=6)


def tree(generator: np.random.Generator) -> Robot:
    """Joint k hangs link k on one of the links before it; links, joints and sensors stand in a random order."""
    joints = []
    for k in range(1, JOINTS + 1):
        parent = int(generator.integers(max(0, k - 8), k))
        x, y, z = generator.standard_normal(3).tolist()
        axes = SEVERAL_AXES.get(k, (unit((x, y, z)),))
        origin = tuple((0.02 * generator.standard_normal(3)).tolist())
        joints.append(Joint(f"j{k:02d}", f"l{parent:02d}", f"l{k:02d}", axes, origin=origin))
    others = [joint.child for joint in joints]
    for names in (joints, others):
        generator.shuffle(names)
    links = (*others[:15], BASE, *others[15:])
    sensors = [Sensor(f"imu_{link}", link, (0.01, 0.0, -0.01)) for link in links[::-1]]
    return Robot(links, tuple(joints), tuple(sensors), name="tree")


def angles_at(robot: Robot, time: FloatArray) -> Mapping[str, Signal]:
    """Every coordinate has a frequency, an amplitude of 15 to 40 deg and a sign of its own."""
    tau = time - OPTIONS.zero_pose_s
    onset = smoothstep(tau, 2.0)
    names = sorted(robot.coordinates)
    return {
        name: onset * raised_cosine(tau, 0.15 + 0.01 * k) * math.radians((-1) ** k * (15.0 + 25.0 * k / len(names)))
        for k, name in enumerate(names)
    }


@pytest.fixture(scope="module")
def recorded() -> HandRecording:
    robot = tree(np.random.default_rng(3))

    def motion(time: FloatArray) -> tuple[Mapping[str, Signal], Mapping[str, LinkMotion]]:
        root = LinkMotion.translating(np.zeros((len(time), 3))).child(X, constant(time, 0.6))
        for axis, angle in zip((Z, Y, X), palm_turns(time - OPTIONS.zero_pose_s), strict=True):
            root = root.child(axis, angle * 0.5)
        angles = angles_at(robot, time)
        return angles, tree_motion(robot, root, angles)

    return next(hand.stretches(OPTIONS, robot, motion, OPTIONS.duration_s))


def errors(recorded: HandRecording, series: Series, names: tuple[str, ...]) -> dict[str, float]:
    """Root mean square after the start, deg, by coordinate."""
    columns = [recorded.joint_names.index(name) for name in names]
    found = np.degrees(series.position - recorded.truth_position[:, columns])[600:]
    return dict(zip(names, np.sqrt(np.mean(found**2, axis=0)).tolist(), strict=True))


def test_the_tree_is_as_asked_for(recorded: HandRecording) -> None:
    robot = recorded.robot
    assert len(robot.joints) == JOINTS and len(robot.coordinates) == JOINTS + 3
    assert robot.links.index(BASE) == 15
    assert robot.ordered_joints != robot.joints
    assert max(sum(joint.parent == link for joint in robot.joints) for link in robot.links) > 1  # it branches
    spans = np.degrees(np.ptp(recorded.truth_position, axis=0))
    assert spans.min() > 14.0  # an angle of another joint would be wrong by degrees
    # the truth is that of forward kinematics, link by link
    row = 2200
    poses = link_poses(robot, dict(zip(recorded.joint_names, recorded.truth_position[row].tolist(), strict=True)))

    def in_world(link: str) -> Rotation:
        (sensor,) = robot.sensors_on(link)
        return Rotation.from_quat(recorded.orientation[sensor.name][row]) * Rotation.from_quat(sensor.mounting).inv()

    for link, pose in poses.items():
        expected = in_world(BASE) * Rotation.from_quat(pose.orientation)
        assert (in_world(link).inv() * expected).magnitude() < 1e-9


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_every_angle_is_right(recorded: HandRecording, formulation: str) -> None:
    estimator = Pcf(recorded.robot, PcfParams(formulation=formulation, zero_at_start=True))
    assert sorted(estimator.joints) == sorted(recorded.robot.coordinates)
    series = estimator.run(recorded.recording)
    found = errors(recorded, series, estimator.joints)
    hinges = [error for name, error in found.items() if "_" not in name]
    others = [error for name, error in found.items() if "_" in name]
    assert len(others) == 5
    assert math.sqrt(np.mean(np.square(hinges))) < (0.10 if formulation == "hinge" else 0.18)
    assert max(hinges) < 0.5
    assert max(others) < 0.2


def test_the_loop_gives_the_same(recorded: HandRecording) -> None:
    part = recorded.recording.part(0, 700)
    loop, arrays = (Pcf(recorded.robot, PcfParams(zero_at_start=True)) for _ in range(2))
    expected = Series.from_estimates([loop.update(frame) for frame in part.frames()], len(loop.joints))
    np.testing.assert_allclose(arrays.run(part).position, expected.position, atol=1e-9)


def test_the_order_of_the_configuration_changes_nothing(recorded: HandRecording) -> None:
    robot = recorded.robot
    other = Robot(robot.links[::-1], robot.joints[::-1], robot.sensors[::-1])
    part = recorded.recording.part(0, 1200)
    for formulation in FORMULATIONS:
        one, two = (Pcf(made, PcfParams(formulation=formulation, zero_at_start=True)) for made in (robot, other))
        first, second = one.run(part).position, two.run(part).position
        order = [two.joints.index(name) for name in one.joints]
        np.testing.assert_allclose(first, second[:, order], atol=1e-9)
