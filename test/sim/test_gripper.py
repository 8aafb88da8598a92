"""The gripper rig against independent kinematics, and its configuration against the rig."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jointest_ros import config
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.kinematics import link_poses
from jointest_ros.sim.gripper import DISKS, SCENARIOS, gripper, simulate
from jointest_ros.sim.hand import HandRecording
from jointest_ros.sim.simulated import SimulationError

PROJECT = Path(__file__).resolve().parents[2]
FINGERS = tuple(f"{side}_{joint}" for side in ("left", "right") for joint in ("mcp", "pip", "dip"))
CLEAN = {"noise": False, "bias": False}
FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])  # 8th order
GRASPS = ("grasp_small", "grasp_medium", "grasp_large")


def difference(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted sums over nine neighbouring rows; four rows are lost at either end."""
    return sum(w * values[i : len(values) - 8 + i] for i, w in enumerate(weights))


def sensor_positions(recorded: HandRecording) -> dict[str, FloatArray]:
    """World positions (T, 3) by forward kinematics of the true angles."""
    rows = [
        link_poses(recorded.robot, dict(zip(recorded.joint_names, row, strict=True)))
        for row in recorded.truth_position.tolist()
    ]
    return {s.name: np.array([poses[s.link].point(s.position) for poses in rows]) for s in recorded.robot.sensors}


@pytest.mark.parametrize("scenario", ["palm", "push"])
def test_samples_agree_with_forward_kinematics(scenario: str) -> None:
    """Rates, and accelerations by differences of positions, rolling joints included."""
    recorded = simulate(scenario, duration_s=5.0, zero_pose_s=0.5, mounting="mounted", **CLEAN)
    tau = recorded.recording.stamps[4:-4] * 1e-9 - 0.5
    jumps = [0.0, 2.0, 3.0] + [k for start in (2.0, 5.0) for k in (start + 0.25, start + 1.0, start + 1.25)]
    smooth = np.all([np.abs(tau - jump) > 0.01 for jump in jumps], axis=0)  # ends of the smoothsteps
    velocity = difference(recorded.truth_position, FIRST) / 1e-3
    np.testing.assert_allclose(recorded.truth_velocity[4:-4][smooth], velocity[smooth], atol=1e-8)
    assert np.abs(velocity).max() > 1.0
    for name, position in sensor_positions(recorded).items():
        attitude = Rotation.from_quat(recorded.orientation[name])
        measured = attitude.apply(recorded.recording.accel[name])[4:-4]
        expected = difference(position, SECOND) / 1e-6 + np.array([0.0, 0.0, 9.81])
        np.testing.assert_allclose(measured[smooth], expected[smooth], atol=1e-6)
        turned = attitude[0]
        for step in Rotation.from_rotvec(recorded.recording.gyro[name][1:] * 1e-3):
            turned = turned * step
        assert (turned.inv() * attitude[-1]).magnitude() < 1e-9


def held(scenario: str) -> FloatArray:
    """The angles of the fingers (T, 6), deg, after the zero pose; those of the palm are zero unless it moves."""
    recorded = simulate(scenario, rate_hz=100.0, duration_s=30.0, zero_pose_s=2.0, **CLEAN)
    assert recorded.joint_names == ("palm_z", "palm_y", "palm_x", *FINGERS) == recorded.robot.coordinates
    assert not recorded.truth_position[:201].any()
    palm = np.degrees(np.abs(recorded.truth_position[:, :3]).max(axis=0))
    assert palm == pytest.approx([60.0, 30.0, 30.0] if scenario == "palm" else [0.0] * 3, abs=1.0)
    low, high = np.degrees(recorded.robot.joints[1].limits[0])
    fingers = np.degrees(recorded.truth_position[:, 3:])
    assert low <= fingers.min() and fingers.max() <= high
    return fingers[201:]


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_what_moves(scenario: str) -> None:
    fingers = held(scenario)
    spans = np.ptp(fingers, axis=0)
    if scenario == "rest":
        assert not spans.any()
    elif scenario == "push":
        assert np.ptp(fingers[300:], axis=0) == pytest.approx([20.0, 12.0, 8.0, 0.0, 0.0, 0.0])
        assert fingers[-1, 3:] == pytest.approx([20.0, 30.0, 20.0])
    elif scenario in GRASPS:
        angles = list(DISKS.values())[GRASPS.index(scenario)]
        for phase in (500, 1400):  # while it is held, again and again
            assert fingers[phase] == pytest.approx([*angles, *angles])
        assert fingers[800] == pytest.approx([0.0] * 6)
    else:
        assert spans == pytest.approx([45.0, 60.0, 40.0] * 2, abs=0.5)


@pytest.mark.parametrize("side", ["left", "right"])
def test_positive_angles_close_the_fingers(side: str) -> None:
    robot = gripper()
    open_hand = dict.fromkeys(robot.coordinates, 0.0)
    bent = open_hand | {f"{side}_{joint}": 0.3 for joint in ("mcp", "pip", "dip")}
    straight, closed = (
        link_poses(robot, angles)[f"{side}_distal"].point((0.0, 0.0, 0.025)) for angles in (open_hand, bent)
    )
    assert straight[2] == pytest.approx(3 * 0.013 + 0.035 + 2 * 0.025)
    assert abs(closed[1]) < abs(straight[1]) - 0.02
    assert closed[0] == straight[0]


def test_without_lever_arm_all_accelerometers_feel_the_same_force() -> None:
    recorded = simulate("palm", rate_hz=200.0, duration_s=14.0, lever_arm=False, **CLEAN)
    for name, accel in recorded.recording.accel.items():
        force = Rotation.from_quat(recorded.orientation[name]).apply(accel)
        np.testing.assert_allclose(force, np.tile([0.0, 0.0, 9.81], (2800, 1)), atol=1e-11)


def test_an_unknown_scenario_is_one_line() -> None:
    with pytest.raises(
        SimulationError, match=r"^scenario: 'PA' is not allowed; give one of rest, closing, push, palm, grasp_"
    ):
        simulate("PA")


# ----------------------------------------------------------------- files


def test_the_configuration_is_the_rig() -> None:
    """Links, joints, places of the sensors; with ideal mountings and the noise of its data sheet."""
    read = config.load(PROJECT / "config" / "softhand_gripper.yaml").robot
    robot = gripper()
    assert (read.links, read.world, read.name) == (robot.links, robot.world, robot.name)
    for found, expected in zip(read.joints, robot.joints, strict=True):
        assert found == expected
    simulated = simulate("rest", rate_hz=100.0, duration_s=0.1).robot
    for found, expected in zip(read.sensors, simulated.sensors, strict=True):
        assert (found.name, found.link, found.topic) == (expected.name, expected.link, expected.topic)
        assert found.position == pytest.approx(expected.position)
        assert found.mounting == pytest.approx(expected.mounting)
        assert (found.gyro_noise, found.gyro_bias_walk) == pytest.approx((expected.gyro_noise, expected.gyro_bias_walk))
        assert found.accel_noise == pytest.approx(expected.accel_noise, rel=1e-3)
