"""Pairs of IMUs that should agree: an IMU that slips is named, with the degrees; motion and faults alarm nobody."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pcf_swing import X, Z, lose, swing, take
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import Recording, Vec3
from jointest_ros.core.pcf.pair_checks import CONTRADICTION, PairCheck, odd_ones, verdict
from jointest_ros.core.pcf.params import FORMULATIONS, PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.robot import Joint, Robot
from jointest_ros.sim import finger, gripper
from jointest_ros.sim.hand import HandRecording

ACROSS: Vec3 = (0.0, 1.0, 0.0)


def slipped(recorded: HandRecording, sensor: str, angle_deg: float, row: int, axis: Vec3 = X) -> Recording:
    """The recording with one IMU turned about an axis of its link from `row` on; no gyro feels that."""
    mounting = Rotation.from_quat(recorded.robot.sensor(sensor).mounting)
    turn = mounting.inv() * Rotation.from_rotvec(np.radians(angle_deg) * np.array(axis)) * mounting
    recording = recorded.recording
    gyro, accel = recording.gyro[sensor].copy(), recording.accel[sensor].copy()
    gyro[row:], accel[row:] = turn.apply(gyro[row:]), turn.apply(accel[row:])
    return replace(recording, gyro={**recording.gyro, sensor: gyro}, accel={**recording.accel, sensor: accel})


def watch(robot: Robot, recording: Recording, **params: object) -> Pcf:
    estimator = Pcf(robot, PcfParams(**{"zero_at_start": True, **params}))
    for frame in recording.frames():
        estimator.update(frame)
    return estimator


@pytest.fixture(scope="module", params=["palm", "closing", "rest"])
def hand(request: pytest.FixtureRequest) -> HandRecording:
    return gripper.simulate(request.param, rate_hz=100.0, duration_s=30.0, zero_pose_s=5.0, seed=2, mounting="mounted")


@pytest.mark.parametrize("sensor", ["palm", "left_proximal", "left_middle", "left_distal", "right_middle"])
def test_an_imu_that_slips_is_named_with_the_degrees(hand: HandRecording, sensor: str) -> None:
    """10 deg about the hinge axis midway, whatever the hand does."""
    estimator = watch(hand.robot, slipped(hand, sensor, 10.0, 2000))
    checks = estimator.pair_checks()
    assert odd_ones(checks) == [sensor]
    for check in checks:
        assert check.agrees == (sensor not in check.sensors)
        if not check.agrees:
            assert math.degrees(abs(check.turned)) == pytest.approx(10.0, abs=1.5)
    assert verdict(checks).startswith(f"IMU {sensor}: turned by ")
    assert estimator.warnings() == [verdict(checks)]


def test_without_a_slip_nothing_is_said(hand: HandRecording) -> None:
    estimator = watch(hand.robot, hand.recording)
    assert len(estimator.pair_checks()) == 6 + 4
    assert estimator.warnings() == []
    assert all(abs(check.residual) < math.radians(1.5) for check in estimator.pair_checks())


def test_the_redundant_pair_around_the_imu_that_slipped_stays_consistent(hand: HandRecording) -> None:
    """IMU 1 to 3 gives q1 + q2 as before: the errors of q1 and q2 cancel."""
    by_joints = {
        check.joints: check for check in watch(hand.robot, slipped(hand, "left_middle", 10.0, 2000)).pair_checks()
    }
    one, two = by_joints["left_pip",], by_joints["left_dip",]
    assert math.degrees(one.turned) == pytest.approx(-math.degrees(two.turned), abs=1.0)
    assert by_joints["left_pip", "left_dip"].turned == 0.0
    assert by_joints["left_mcp", "left_pip"].turned == pytest.approx(one.turned, abs=math.radians(1.5))


def test_a_filter_of_its_own_for_the_redundant_pair_would_repeat_the_sum() -> None:
    """IMU 1 to 3 alone, beside q1 + q2: equal whatever the middle IMU does, so the checks do without it."""
    hand = gripper.simulate("palm", rate_hz=100.0, duration_s=20.0, zero_pose_s=4.0, seed=2, mounting="mounted")
    robot = hand.robot
    direct = Robot(
        ("palm", "left_middle"),
        (Joint("sum", "palm", "left_middle", (X,)),),
        (robot.sensor("palm"), robot.sensor("left_middle")),
    )
    recording = slipped(hand, "left_proximal", 10.0, 1000)
    both = Pcf(robot, PcfParams(zero_at_start=True))
    position = both.run(recording).position
    total = position[:, both.joints.index("left_mcp")] + position[:, both.joints.index("left_pip")]
    found = Pcf(direct, PcfParams(zero_at_start=True)).run(recording).position[:, 0]
    np.testing.assert_allclose(np.degrees(total - found)[400:], 0.0, atol=0.3)
    assert np.ptp(np.degrees(found)) > 90.0


def test_a_mounting_across_the_axis_is_seen_at_rest() -> None:
    """10 deg about an axis perpendicular to gravity and to the joint's, from the first sample on."""
    hand = gripper.simulate("rest", rate_hz=100.0, duration_s=25.0)
    estimator = watch(hand.robot, slipped(hand, "right_middle", 10.0, 0, ACROSS))
    assert verdict(estimator.pair_checks()).startswith("IMU right_middle: the joint's axis is ")
    tilts = {check.joints: math.degrees(check.tilt) for check in estimator.pair_checks()}
    assert abs(tilts["right_pip",]) == pytest.approx(10.0, abs=0.5)
    assert tilts["right_pip",] == pytest.approx(-tilts["right_dip",], abs=0.5)
    assert tilts["right_pip", "right_dip"] == pytest.approx(0.0, abs=0.5)


def test_a_zero_pose_and_a_reset_settle_it(hand: HandRecording) -> None:
    recording = slipped(hand, "palm", -12.0, 2000)
    estimator = watch(hand.robot, recording)
    assert verdict(estimator.pair_checks()).startswith("IMU palm")
    estimator.reset()
    assert estimator.warnings() == []
    resting = gripper.simulate("rest", rate_hz=100.0, duration_s=25.0, seed=2)
    estimator = watch(resting.robot, slipped(resting, "palm", -12.0, 1500))
    assert estimator.warnings()
    estimator.calibrate_zero()
    assert estimator.warnings() == []


@pytest.mark.parametrize("scenario", ["PC", "PD", "PE"])
@pytest.mark.parametrize("still_start", [0.0, 1.0])
def test_motion_shaking_and_unknown_biases_alarm_nobody(scenario: str, still_start: float) -> None:
    recorded = finger.simulate(
        scenario, rate_hz=100.0, duration_s=40.0, zero_pose_s=2.0 * still_start, seed=3, mounting="mounted"
    )
    estimator = watch(recorded.robot, recorded.recording, still_start=still_start, zero_at_start=still_start > 0.0)
    assert estimator.warnings() == []


@pytest.mark.parametrize("factor", [math.degrees(1.0), -1.0], ids=["deg/s", "reversed"])
def test_a_gyro_that_contradicts_its_accelerometer_is_not_put_down_to_a_slip(factor: float) -> None:
    recorded = finger.simulate("PC", rate_hz=100.0, duration_s=30.0, zero_pose_s=2.0, seed=4)
    gyro = {**recorded.recording.gyro, "middle": factor * recorded.recording.gyro["middle"]}
    (text,) = watch(recorded.robot, replace(recorded.recording, gyro=gyro)).warnings()
    assert text.startswith("IMU ") and text.endswith(f": {CONTRADICTION}")
    assert "middle" in text


def test_losses_gaps_and_resets_alarm_nobody() -> None:
    recorded = gripper.simulate("palm", rate_hz=100.0, duration_s=40.0, zero_pose_s=3.0, seed=4)
    recording, generator = recorded.recording, np.random.default_rng(5)
    for sensor in ("palm", "left_middle", "right_distal"):
        recording = lose(recording, generator.random(4000) < 0.2, (sensor,))
    recording = lose(recording, np.r_[900:1000], ("left_proximal",))
    recording.reset = np.arange(4000) == 2500
    recording.stamps[2500:] -= 10_000_000_000
    estimator = watch(recorded.robot, take(recording, np.r_[0:1500, 1600:4000]))
    assert estimator.warnings() == []


def test_two_imus_alone_cannot_tell_which_slipped() -> None:
    robot, recording, _ = swing(lambda time: np.maximum(time - 3.0, 0.0) * 0.0, seconds=25.0)
    mounting = Rotation.from_quat(robot.sensor("link").mounting)
    turn = mounting.inv() * Rotation.from_rotvec(np.radians(8.0) * np.array(X)) * mounting
    recording.accel["link"][1200:] = turn.apply(recording.accel["link"][1200:])
    estimator = watch(robot, recording)
    assert odd_ones(estimator.pair_checks()) == ["base", "link"]
    assert verdict(estimator.pair_checks()).startswith("IMU base or link: turned by ")


def test_only_hinges_between_imus_are_watched() -> None:
    """Not the palm on the world, not joints of more axes, not the free rotations of the paper's filters."""
    hand = gripper.simulate("rest", rate_hz=100.0, duration_s=1.0)
    for formulation in FORMULATIONS[1:]:
        assert watch(hand.robot, hand.recording, formulation=formulation).pair_checks() == []
    robot, recording, _ = swing(lambda time: np.outer(np.sin(time), [0.3, 0.3]), (X, Z), seconds=1.0)
    assert watch(robot, recording).pair_checks() == []


def pair(one: str, two: str, turned: float = 0.0, tilt: float = 0.0) -> PairCheck:
    return PairCheck((one, two), ("j",), 0.0, tilt, turned)


@pytest.mark.parametrize(
    ("checks", "expected"),
    [
        ([], []),
        ([pair("a", "b"), pair("b", "c")], []),
        ([pair("a", "b", 0.2)], ["a", "b"]),
        ([pair("a", "b", 0.2), pair("b", "c")], ["a"]),
        ([pair("a", "b", 0.2), pair("b", "c", -0.2), pair("a", "c")], ["b"]),
        ([pair("a", "b"), pair("b", "c", -0.2), pair("a", "c", -0.2)], ["c"]),
        ([pair("a", "b", 0.2), pair("c", "d", 0.2)], []),
        ([pair("a", "b", tilt=-0.2), pair("b", "c", tilt=0.2), pair("a", "c", tilt=0.01)], ["b"]),
    ],
)
def test_the_odd_one_is_in_all_that_disagree_and_in_none_that_agree(
    checks: list[PairCheck], expected: list[str]
) -> None:
    assert odd_ones(checks) == expected
    assert bool(verdict(checks)) == (not all(check.agrees for check in checks))
