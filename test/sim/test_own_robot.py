"""One's own robot: what its sensors say is what its kinematics say, and a fitting estimator finds the angles again."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jointest_ros import config
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.hall_sensor import HallSensor
from jointest_ros.core.kinematics import link_poses
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.sim import finger
from jointest_ros.sim.hand import HandRecording
from jointest_ros.sim.own_robot import FARTHEST, USUAL_LIMITS, OwnOptions, stretches
from jointest_ros.sim.simulated import SimulationError

PROJECT = Path(__file__).resolve().parents[2]
SHIPPED = ("finger", "exoshell", "softhand_gripper", "two_link_accel")
SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])  # 8th order
NOWHERE = (0.0, 0.0, 0.0)
EARTH = np.array([0.0, 0.0, 9.81])
QUARTER = (0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))  # about z by 90 deg
ASKEW = (0.5, -0.5, 0.1, 0.7)


def biped() -> Robot:
    """Two branches, hips of two axes, mountings turned by 90 deg and askew, one without gyro, one without accel."""
    x, y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    joints, sensors = [], [Sensor("pelvis", "pelvis", (-0.1, 0.0, 0.05), QUARTER)]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        thigh, shank = f"{side}_thigh", f"{side}_shank"
        joints.append(Joint(f"{side}_hip", "pelvis", thigh, (y, x), origin=(0.0, 0.1 * sign, 0.0)))
        limits = ((0.0, math.radians(110.0)),) if sign > 0.0 else None
        joints.append(Joint(f"{side}_knee", thigh, shank, (y,), limits, origin=(0.0, 0.0, -0.4)))
        quat: Any = tuple((np.array(ASKEW) / np.linalg.norm(ASKEW)).tolist())
        sensors += [Sensor(thigh, thigh, (0.05, 0.0, -0.2), quat), Sensor(shank, shank, (0.0, 0.02, -0.1), mag=True)]
    sensors += [Sensor("rate", "left_shank", accel=False), Sensor("force", "right_thigh", (0.0, 0.0, -0.3), gyro=False)]
    links = ("right_shank", "pelvis", "left_thigh", "left_shank", "right_thigh")
    return Robot(links, tuple(joints[::-1]), tuple(sensors))


def robot_of(name: str) -> Robot:
    return biped() if name == "biped" else config.load(PROJECT / "config" / f"{name}.yaml").robot


def whole(robot: Robot, **options: Any) -> HandRecording:
    return next(stretches(robot, OwnOptions(**options), 1e9))


def exact(robot: Robot, **options: Any) -> HandRecording:
    return whole(robot, noise=False, bias=False, **options)


def ideal(robot: Robot) -> Robot:
    """As soon, as linear and with as wide a range as can be."""
    return replace(robot, sensors=tuple(replace(one, delay=0.0, accel_range=math.inf) for one in robot.sensors))


def in_world(made: HandRecording) -> tuple[dict[str, Rotation], dict[str, FloatArray]]:
    """Of every sensor, orientation and position (T, 3) m, by the kinematics of the core; the first root is at 0."""
    robot = made.robot
    rows = [link_poses(robot, dict(zip(made.joint_names, row, strict=True))) for row in made.truth_position.tolist()]
    root = robot.ordered_joints[0].parent
    base = Rotation.identity(len(rows))
    if robot.sensors_on(root):
        sensor = robot.sensors_on(root)[0]
        base = Rotation.from_quat(made.orientation[sensor.name]) * Rotation.from_quat(sensor.mounting).inv()
    turns, places = {}, {}
    for sensor in robot.sensors:
        link = Rotation.from_quat([row[sensor.link].orientation for row in rows])
        origin = np.array([row[sensor.link].position for row in rows])
        turns[sensor.name] = base * link * Rotation.from_quat(sensor.mounting)
        places[sensor.name] = base.apply(origin + link.apply(sensor.position))
    return turns, places


@pytest.mark.parametrize("name", [*SHIPPED, "biped"])
@pytest.mark.parametrize("window", [slice(800, 1600), slice(4000, 4800)], ids=["while it sets in", "in full motion"])
def test_readings_are_those_of_the_differentiated_poses(name: str, window: slice) -> None:
    """At 1 kHz; the windows are between the jumps of the third derivative, which a difference would smear."""
    made = exact(ideal(robot_of(name)), rate_hz=1000.0, duration_s=5.0, zero_pose_s=0.5)
    cut = replace(
        made,
        truth_position=made.truth_position[window],
        orientation={sensor: values[window] for sensor, values in made.orientation.items()},
    )
    turns, places = in_world(cut)
    assert np.ptp(cut.truth_position, axis=0).min() > 0.01
    for sensor in made.robot.sensors:
        turn = turns[sensor.name]
        assert (Rotation.from_quat(cut.orientation[sensor.name]).inv() * turn).magnitude().max() < 1e-9
        if sensor.gyro:
            rate = (turn[:-1].inv() * turn[1:]).as_rotvec() * 1000.0
            np.testing.assert_allclose(made.recording.gyro[sensor.name][window][1:], rate, atol=1e-8)
        if sensor.accel:
            place = places[sensor.name]
            acceleration = sum(w * place[k : len(place) - 8 + k] for k, w in enumerate(SECOND)) * 1e6
            force = turn[4:-4].apply(acceleration + EARTH, inverse=True)
            np.testing.assert_allclose(made.recording.accel[sensor.name][window][4:-4], force, atol=1e-6)
        assert (sensor.name in made.recording.gyro, sensor.name in made.recording.accel) == (sensor.gyro, sensor.accel)
        assert (sensor.name in made.recording.mag) == sensor.mag


@pytest.mark.parametrize("name", ["finger", "exoshell", "biped"])
def test_joints_stay_within_their_limits_and_use_them(name: str) -> None:
    robot = robot_of(name)
    made = exact(robot, duration_s=60.0, zero_pose_s=2.0)
    assert made.joint_names == robot.coordinates
    limits = [pair for joint in robot.joints for pair in joint.limits or (USUAL_LIMITS,) * len(joint.axes)]
    for column, (low, high) in zip(made.truth_position.T, limits, strict=True):
        assert low - 1e-9 <= column.min() < low + 0.02 and high - 0.02 < column.max() <= high + 1e-9
    assert not made.truth_position[:200].any() and not made.truth_velocity[:200].any()
    for values in (*made.recording.gyro.values(), *made.recording.accel.values()):
        assert np.ptp(values[:200], axis=0).max() < 1e-9
    acceleration = np.diff(made.truth_velocity, axis=0) * 100.0
    assert np.abs(np.diff(acceleration, axis=0)).max() < 0.6  # 60 rad/s^3 for 10 ms; no step
    fast = exact(robot, duration_s=60.0, tempo=2.0)
    assert np.abs(fast.truth_velocity).max() == pytest.approx(2.0 * np.abs(made.truth_velocity).max(), rel=0.02)
    assert not exact(robot, duration_s=20.0, tempo=0.0).truth_position.any()


def test_wide_limits_are_not_exhausted() -> None:
    joint = Joint("j", "a", "b", ((1.0, 0.0, 0.0),), ((-10.0, 0.0),), continuous=True)
    made = exact(Robot(("a", "b"), (joint,), (Sensor("a", "a"), Sensor("b", "b"))), duration_s=30.0)
    assert made.truth_position.min() == pytest.approx(-FARTHEST, abs=1e-3) and made.truth_position.max() < 1e-9


# The filters turn by mean rates from stamp to stamp. What they neglect within dt = 1 ms are terms (w dt)^2 / 12 of the
# rate: links that turn at 9 rad/s lose 6e-5 rad/s, of which some 3 s gather before gravity or a Hall sensor corrects
# them: .01 deg. Half a digit of the Hall converter is .4 mV, at 100 deg/V .04 deg a reading, of which hundreds
# count. Lengths are zero where an estimator leaves them out: pcf has no lever_arms in absolute and in rolling.
BAR = math.radians(0.02)


@pytest.mark.parametrize(
    ("name", "estimator", "params"),
    [
        ("finger", "pcf", {"zero_at_start": True, "lever_arms": True}),
        ("softhand_gripper at a point", "pcf", {"zero_at_start": True}),
        ("exoshell", "kckf", {}),
        ("exoshell", "kf", {}),
        ("biped", "pcf", {"zero_at_start": True, "lever_arms": True}),
        ("biped at a point", "pcf", {"zero_at_start": True}),
        ("biped at a point", "pcf", {"zero_at_start": True, "formulation": "absolute"}),
    ],
)
def test_without_noise_the_fitting_estimator_finds_the_angles(name: str, estimator: str, params: Any) -> None:
    robot = robot_of(name.partition(" ")[0])
    if "point" in name:
        robot = at_a_point(robot)
    made = exact(ideal(robot), rate_hz=1000.0, duration_s=15.0, zero_pose_s=2.0)
    assert max(np.abs(rates).max() for rates in made.recording.gyro.values()) < 9.0
    kind = ESTIMATORS[estimator]
    filter_ = kind(made.robot, kind.Params.from_mapping(params))
    position = filter_.run(made.recording).position
    assert set(filter_.joints) == set(robot.coordinates)
    for column, joint in zip(position.T, filter_.joints, strict=True):
        error = column - made.truth_position[:, made.joint_names.index(joint)]
        assert math.sqrt(np.mean(error[2000:] ** 2)) < BAR, joint


def at_a_point(robot: Robot) -> Robot:
    """All lengths zero: every sensor feels gravity alone."""
    return replace(
        robot,
        joints=tuple(replace(joint, origin=NOWHERE, roll_link=joint.roll_link and NOWHERE) for joint in robot.joints),
        sensors=tuple(replace(sensor, position=NOWHERE) for sensor in robot.sensors),
    )


def test_accelerometers_alone() -> None:
    """In a vertical plane, as the arm that is shipped: 0.5 deg is what accel_ekf is good for on its own rig."""
    made = exact(robot_of("two_link_accel"), up="y", root_turns=False, duration_s=30.0, zero_pose_s=3.0)
    kind = ESTIMATORS["accel_ekf"]
    position = kind(made.robot, kind.Params(), None).run(made.recording).position
    assert np.degrees(np.sqrt(np.mean((position - made.truth_position)[500:] ** 2))) < 0.5


def test_it_agrees_with_the_finger_rig_where_both_move_alike() -> None:
    """Palm and proximal link of PC once the motion has set in, bias and noise included."""
    options = {"rate_hz": 100.0, "duration_s": 20.0, "seed": 3, "zero_pose_s": 2.0}
    rig = finger.simulate("PC", mounting="mounted", **options)
    limits = [((0.0, math.radians(amplitude)),) for amplitude in finger.JOINT_AMPLITUDES_DEG]
    joints = [replace(joint, limits=pair) for joint, pair in zip(rig.robot.joints, limits, strict=True)]
    robot = replace(rig.robot, joints=tuple(joints))
    made = whole(robot, tempo=finger.JOINT_FREQUENCIES_HZ[0] / 0.2, **options)
    after = slice(502, None)
    np.testing.assert_allclose(made.truth_position[after, 0], rig.truth_position[after, 0], atol=1e-12)
    for sensor in ("palm", "proximal"):
        for field in ("gyro", "accel"):
            ours, theirs = (getattr(one.recording, field)[sensor][after] for one in (made, rig))
            np.testing.assert_allclose(ours, theirs, atol=1e-10)


def test_a_world_link_stands_still_and_joints_move_from_it() -> None:
    made = exact(robot_of("softhand_gripper"), duration_s=20.0)
    palm = Rotation.from_quat(made.orientation["palm"]).as_euler("ZYX")
    np.testing.assert_allclose(palm, made.truth_position[:, :3], atol=1e-12)


@pytest.mark.parametrize(("up", "axis"), [("x", 0), ("y", 1), ("z", 2), ("-x", 0), ("-y", 1), ("-z", 2)])
def test_up(up: str, axis: int) -> None:
    force = exact(robot_of("finger"), duration_s=1.0, up=up).recording.accel["palm"][0]
    np.testing.assert_allclose(force, np.eye(3)[axis] * (-9.81 if "-" in up else 9.81), atol=1e-12)


def test_the_root_can_stand_still() -> None:
    made = exact(robot_of("finger"), duration_s=20.0, root_turns=False)
    assert np.abs(made.recording.gyro["palm"]).max() < 1e-12


def test_calibration_delay_and_range_are_in_the_readings() -> None:
    robot = robot_of("finger")
    matrix, offset, scale = (
        ((1.02, 0.01, 0.0), (0.0, 0.98, 0.02), (0.0, 0.0, 1.01)),
        (0.1, -0.2, 0.3),
        (1.02, 1.0, 0.97),
    )
    palm, proximal, middle, distal = robot.sensors
    changed = (
        replace(palm, accel_matrix=matrix, accel_offset=offset, gyro_scale=scale),
        replace(proximal, delay=0.02),
        replace(middle, gyro_range=1.0, accel_range=9.0),
        distal,
    )
    options = {"duration_s": 15.0, "zero_pose_s": 2.0}
    true, made = (exact(one, **options).recording for one in (robot, replace(robot, sensors=changed)))
    np.testing.assert_allclose(made.accel["palm"] @ np.array(matrix).T + offset, true.accel["palm"], atol=1e-12)
    np.testing.assert_allclose(made.gyro["palm"] * scale, true.gyro["palm"], atol=1e-12)
    for field in ("gyro", "accel"):
        np.testing.assert_allclose(
            getattr(made, field)["proximal"][2:], getattr(true, field)["proximal"][:-2], atol=1e-9
        )
    assert np.abs(true.gyro["middle"]).max() > 1.0 == np.abs(made.gyro["middle"]).max()
    assert np.abs(made.accel["middle"]).max() == 9.0


def test_noise_is_that_of_the_configuration() -> None:
    robot = robot_of("finger")
    loud = replace(robot.sensors[0], gyro_noise=0.01, accel_noise=0.02)
    made = whole(replace(robot, sensors=(loud, *robot.sensors[1:])), duration_s=30.0, zero_pose_s=30.0, bias=False)
    assert made.recording.gyro["palm"].std(axis=0) == pytest.approx(0.1, rel=0.1)
    assert made.recording.accel["palm"].std(axis=0) == pytest.approx(0.2, rel=0.1)
    assert made.recording.gyro["distal"].std(axis=0) == pytest.approx(10.0 * robot.sensors[3].gyro_noise, rel=0.1)


def test_hall_voltages_are_those_of_the_configured_curves() -> None:
    robot = robot_of("finger")
    sensors = (
        HallSensor("finger_pip", offset=0.05, resolution=0.0, hall_range=(0.0, 3.3)),
        HallSensor("finger_mcp", mirrored=True, hall_range=(0.0, 3.3)),
    )
    narrow = tuple(replace(joint, limits=((-0.3, 0.4),)) for joint in robot.joints)
    made = exact(replace(robot, joints=narrow, hall=sensors), duration_s=20.0)
    volts = made.recording.hall
    assert volts is not None
    np.testing.assert_allclose(sensors[0].angle(volts[:, 0]), made.truth_position[:, 1], atol=1e-4)
    digit = sensors[1].resolution * np.abs(sensors[1].slope(volts[:, 1]))
    assert (np.abs(sensors[1].angle(volts[:, 1]) - made.truth_position[:, 0]) < digit).all()


def test_askew_mountings_are_not_those_of_the_configuration() -> None:
    robot = robot_of("biped")
    made = exact(robot, mounting="askew", duration_s=1.0)
    for given, true in zip(robot.sensors, made.robot.sensors, strict=True):
        between = Rotation.from_quat(given.mounting).inv() * Rotation.from_quat(true.mounting)
        assert 0.0 < between.magnitude() <= math.radians(10.0)


@pytest.mark.parametrize("name", ["exoshell", "biped"])
def test_stretches_are_one_recording(name: str) -> None:
    robot, options = robot_of(name), OwnOptions(duration_s=12.0, zero_pose_s=1.0, seed=2)
    (one,), several = list(stretches(robot, options, 1e9)), list(stretches(robot, options, 2.5))
    assert len(several) == 5
    for sensor in robot.sensors:
        joined = np.vstack([part.recording.gyro[sensor.name] for part in several if sensor.gyro] or [np.empty((0, 3))])
        np.testing.assert_allclose(joined, one.recording.gyro.get(sensor.name, joined), atol=1e-12)
    if robot.hall:
        np.testing.assert_array_equal(np.vstack([part.recording.hall for part in several]), one.recording.hall)


def limited(low: float, high: float) -> Robot:
    joint = Joint("knee", "a", "b", ((0.0, 1.0, 0.0),), ((math.radians(low), math.radians(high)),))
    return Robot(("a", "b"), (joint,), (Sensor("a", "a"), Sensor("b", "b")))


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (lambda: robot_of("broad"), {}, "robot.joints: none; "),
        (lambda: replace(limited(-1.0, 1.0), sensors=()), {}, "sensors: none in use, nor is there hall; "),
        (lambda: limited(10.0, 90.0), {}, "robot.joints.knee.limits_deg: 10 to 90 is not allowed; a simulation starts"),
        (lambda: robot_of("softhand_gripper"), {"up": "y"}, "up: 'y' is not allowed; z of the world link 'world'"),
    ],
)
def test_what_cannot_be_simulated(make: Callable[[], Robot], options: Any, message: str) -> None:
    with pytest.raises(SimulationError) as raised:
        stretches(make(), OwnOptions(**options))
    assert str(raised.value).startswith(message)
    assert "\n" not in str(raised.value)
