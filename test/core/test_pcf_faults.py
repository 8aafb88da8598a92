"""Lost samples, gaps, silent and dead sensors: the error stays bounded, the flags tell, the estimate recovers."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pcf_swing import X, Y, Z, lose, rest, sway, swing, take

from jointest_ros.core.frame import FloatArray, Frame, Recording, Series, Status
from jointest_ros.core.pcf.params import FORMULATIONS, PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.sim.finger import simulate

FAULTS = Status.NO_DATA | Status.GAP | Status.STALE | Status.STARTING


def swinging(time: FloatArray) -> FloatArray:
    """+-60 deg at .35 Hz: up to 130 deg/s."""
    return np.radians(60.0) * np.sin(2.2 * time)


def errors(series: Series, truth: FloatArray) -> FloatArray:
    return np.degrees(np.abs(series.position - truth)).max(axis=1)


def run(robot: Robot, recording: Recording, formulation: str, **params: object) -> Series:
    return Pcf(robot, PcfParams(formulation=formulation, still_start=0.0, **params)).run(recording)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("share", [0.05, 0.5])
@pytest.mark.parametrize("whole", [False, True])
def test_random_loss(formulation: str, share: float, whole: bool) -> None:
    """Of single samples, or of whole frames."""
    robot, recording, truth = swing(swinging, seconds=30.0, parent=sway, seed=1)
    generator = np.random.default_rng(2)
    kept = generator.random(len(recording)) >= share
    kept[:100] = True
    if whole:
        series, truth = run(robot, take(recording, kept), formulation), truth[kept]
    else:
        damaged = lose(recording, ~kept, ("base",))
        series = run(robot, lose(damaged, generator.random(len(recording)) < share, ("link",)), formulation)
        assert ((series.status[100:, 0] & Status.NO_DATA) > 0).mean() == pytest.approx(
            1.0 - (1.0 - share) ** 2, abs=0.05
        )
    found = errors(series, truth)[len(truth) // 3 :]
    assert np.sqrt(np.mean(found**2)) < (0.5 if share < 0.1 else 2.0)
    assert found.max() < (2.0 if share < 0.1 else 20.0)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("length", [3, 10, 19])
def test_bursts_shorter_than_max_gap_are_bridged(formulation: str, length: int) -> None:
    robot, recording, truth = swing(swinging, seconds=30.0, parent=sway, seed=3)
    lost = (np.arange(len(recording)) % 200 < length) & (np.arange(len(recording)) > 500)
    series = run(robot, take(recording, ~lost), formulation)
    assert not (series.status & Status.GAP).any()
    found = errors(series, truth[~lost])[1500:]
    assert np.sqrt(np.mean(found**2)) < 1.0


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("seconds", [0.3, 1.0, 5.0])
@pytest.mark.parametrize("parent", [rest, sway])
def test_recovery_within_two_seconds_after_a_gap(formulation: str, seconds: float, parent) -> None:
    """Whatever happened in the gap; the standard deviation says how far off it may be."""
    robot, recording, truth = swing(swinging, seconds=40.0, parent=parent, seed=4)
    length = round(100 * seconds)
    kept = np.r_[0:2000, 2000 + length : len(recording)]
    series = run(robot, take(recording, kept), formulation)
    assert series.status[2000, 0] & Status.GAP
    assert not (series.status[2001:] & FAULTS).any()
    found = errors(series, truth[kept])
    std = np.degrees(np.sqrt(series.variance[:, 0]))
    assert found[1900:2000].max() < 1.0
    assert found[2200:].max() < 1.0
    assert np.all(found[2000:2200] < 4.0 * std[2000:2200] + 1.0)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_while_a_sensor_is_silent(formulation: str) -> None:
    """Extrapolated, then held; flags and variance grow; afterwards all is as before."""
    robot, recording, truth = swing(swinging, seconds=30.0, seed=5)
    silent = np.zeros(len(recording), dtype=bool)
    silent[1500:1700] = True
    series = run(robot, lose(recording, silent, ("link",)), formulation)
    flags = series.status[:, 0] & FAULTS
    assert not flags[100:1500].any()
    assert (flags[1500:1519] == Status.NO_DATA).all()
    assert (flags[1520:1549] == Status.NO_DATA | Status.GAP).all()
    assert (flags[1550:1700] == Status.NO_DATA | Status.GAP | Status.STALE).all()
    assert flags[1700] == Status.GAP and not flags[1701:].any()
    # .2 s of constant velocity, then nothing moves
    step = np.diff(series.position[1500:1700, 0])
    np.testing.assert_allclose(step[:18], step[0], atol=1e-9)
    np.testing.assert_allclose(step[21:], 0.0, atol=1e-12)
    assert series.velocity[1510, 0] != 0.0 and not series.velocity[1525:1700].any()
    assert np.all(np.diff(series.variance[1521:1600, 0]) >= 0.0)
    assert series.variance[1690, 0] > 100.0 * series.variance[1490, 0]
    assert errors(series, truth)[1900:].max() < 1.0


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("absent", ["base", "link"])
def test_before_the_first_sample(formulation: str, absent: str) -> None:
    robot, recording, truth = swing(swinging, seconds=10.0, seed=6)
    late = np.arange(len(recording)) < 300
    series = run(robot, lose(recording, late, (absent,)), formulation)
    starting = int(Status.STARTING | Status.NO_DATA | Status.STALE | Status.UNCALIBRATED)
    assert (series.status[:300, 0] == starting).all()
    assert not series.position[:300].any() and not series.velocity[:300].any()
    assert not (series.status[300:] & FAULTS).any()
    assert errors(series, truth)[500:].max() < 1.5


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_an_imu_that_appears_late_leaves_the_other_joints_alone(formulation: str) -> None:
    """The palm's topic begins two seconds after those of the finger, which by then has moved."""
    recorded = simulate("PC", rate_hz=100.0, duration_s=30.0, zero_pose_s=1.0, seed=7, bias=False)
    late = np.arange(len(recorded.recording)) < 300
    damaged = lose(recorded.recording, late, ("palm",))
    series = Pcf(recorded.robot, PcfParams(formulation=formulation, still_start=0.0)).run(damaged)
    found = np.degrees(np.abs(series.position - recorded.truth_position))
    assert not (series.status[1:, 1:] & FAULTS).any()
    assert np.abs(np.diff(series.position[295:305, 1:], axis=0)).max() < math.radians(3.0)
    assert found[600:].max() < 2.0


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_one_silent_sensor_concerns_its_own_joints_only(formulation: str) -> None:
    recorded = simulate("PC", rate_hz=100.0, duration_s=20.0, zero_pose_s=4.0, seed=8)
    silent = np.arange(len(recorded.recording)) >= 1000
    params = PcfParams(formulation=formulation, zero_at_start=True)
    whole = Pcf(recorded.robot, params).run(recorded.recording)
    series = Pcf(recorded.robot, params).run(lose(recorded.recording, silent, ("distal",)))
    np.testing.assert_array_equal(series.position[:, :2], whole.position[:, :2])
    np.testing.assert_array_equal(series.status[:, :2], whole.status[:, :2])
    assert (series.status[1060:, 2] & Status.STALE).all()


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("axes", [(X,), (Z, Y, X), (X, Y)])
def test_dead_accelerometer(formulation: str, axes) -> None:
    """Exact zeros: no direction, but no crash either; the gyros carry on and the flag tells."""
    robot, recording, truth = swing(
        lambda time: np.outer(0.3 * np.sin(time), np.ones(len(axes))), axes, seconds=12.0, seed=9
    )
    recording.accel["link"][600:900] = 0.0
    series = run(robot, recording, formulation)
    assert np.isfinite(series.position).all() and np.isfinite(series.variance).all()
    assert (series.status[800:900] & Status.UNOBSERVABLE).all()
    assert errors(series, truth)[600:].max() < 4.0


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("axes", [(X,), (Z, Y, X)])
def test_accelerometers_that_were_never_alive(formulation: str, axes) -> None:
    robot, recording, _ = swing(lambda time: np.outer(np.sin(time), np.ones(len(axes))), axes, seconds=3.0)
    for name in recording.accel:
        recording.accel[name][:] = 0.0
    series = run(robot, recording, formulation)
    assert np.isfinite(series.position).all() and np.isfinite(series.variance).all()
    assert (series.status & Status.UNOBSERVABLE).all()


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_period_that_is_not_known(formulation: str) -> None:
    """The first frames of a stream, and recordings without periods."""
    robot, recording, truth = swing(swinging, seconds=20.0, parent=sway, seed=10)
    unknown = Recording(recording.stamps, recording.gyro, recording.accel)
    assert errors(run(robot, unknown, formulation), truth)[700:].max() < 1.0
    kept = np.r_[0:1000, 1100:2000]
    series = run(robot, take(unknown, kept), formulation)
    assert series.status[1000, 0] & Status.GAP
    assert errors(series, truth[kept])[1200:].max() < 1.0


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_jitter_of_the_stamps(formulation: str) -> None:
    """+-30 % of a period: the gyro is taken over the interval that the stamps tell."""
    robot, recording, truth = swing(swinging, seconds=20.0, seed=11, noise=0.3)
    generator = np.random.default_rng(12)
    recording.stamps[:] += generator.integers(-3_000_000, 3_000_000, len(recording))
    assert errors(run(robot, recording, formulation), truth)[500:].max() < 2.0


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_frames_with_nothing_in_them(formulation: str) -> None:
    robot, recording, _ = swing(swinging, seconds=2.0)
    estimator = Pcf(robot, PcfParams(formulation=formulation))
    empty = estimator.update(Frame(0))
    assert empty.status[0] & Status.STARTING and empty.position == (0.0,)
    estimator.run(Recording(recording.stamps + 1, recording.gyro, recording.accel, period=recording.period))
    assert estimator.update(Frame(int(recording.stamps[-1]) + 10_000_000)).status[0] & Status.NO_DATA


def test_absolute_goes_on_for_single_imus() -> None:
    """A robot without joints: orientation only, and a sensor that is missing is not in the estimate."""
    robot, recording, _ = swing(swinging, seconds=3.0)
    alone = Robot(robot.links, (), robot.sensors)
    estimator = Pcf(alone, PcfParams(formulation="absolute"))
    series = estimator.run(lose(recording, np.arange(len(recording)) == 200, ("link",)))
    assert series.position.shape == (300, 0)
    assert np.isnan(series.orientation["link"][200]).all()
    assert np.isfinite(series.orientation["base"]).all()
    np.testing.assert_allclose(np.linalg.norm(series.orientation["base"], axis=1), 1.0, atol=1e-12)


def test_sensors_that_no_joint_needs_do_not_matter() -> None:
    robot, recording, _ = swing(swinging, seconds=3.0)
    more = Robot(
        (*robot.links, "loose"),
        (*robot.joints,),
        (*robot.sensors, Sensor("loose", "loose"), Sensor("second", "link"), Sensor("gyro_only", "base", accel=False)),
    )
    np.testing.assert_array_equal(
        Pcf(more, PcfParams()).run(recording).position, Pcf(robot, PcfParams()).run(recording).position
    )
    assert Pcf(more).joints == ("joint",)


def test_joints_in_any_order_of_the_configuration() -> None:
    recorded = simulate("PC", rate_hz=100.0, duration_s=8.0, zero_pose_s=2.0, seed=13)
    robot = recorded.robot
    shuffled = Robot(robot.links, robot.joints[::-1], robot.sensors[::-1])
    for formulation in FORMULATIONS:
        params = PcfParams(formulation=formulation)
        one, other = Pcf(robot, params), Pcf(shuffled, params)
        assert other.joints == one.joints  # parents first
        np.testing.assert_allclose(one.run(recorded.recording).position, other.run(recorded.recording).position)


def test_two_fingers_on_a_palm() -> None:
    """A branching tree: each finger as if it were alone."""
    recorded = simulate("PC", rate_hz=100.0, duration_s=8.0, zero_pose_s=2.0, seed=14)
    robot, recording = recorded.robot, recorded.recording
    links, joints, sensors = list(robot.links), list(robot.joints), list(robot.sensors)
    for link in robot.links[1:]:
        links.append(f"{link}_2")
        sensors.append(replace(robot.sensor(link), name=f"{link}_2", link=f"{link}_2", topic=f"imu/{link}_2"))
        recording.gyro[f"{link}_2"], recording.accel[f"{link}_2"] = recording.gyro[link], recording.accel[link]
    for joint in robot.joints:
        parent = joint.parent if joint.parent == "palm" else f"{joint.parent}_2"
        joints.append(Joint(f"{joint.name}_2", parent, f"{joint.child}_2", joint.axes))
    gripper = Robot(tuple(links), tuple(joints), tuple(sensors))
    for formulation in FORMULATIONS:
        estimator = Pcf(gripper, PcfParams(formulation=formulation))
        series = estimator.run(recording)
        single = Pcf(robot, PcfParams(formulation=formulation)).run(recording)
        for column, name in enumerate(estimator.joints):
            expected = single.position[:, robot.coordinates.index(name.removesuffix("_2"))]
            np.testing.assert_allclose(series.position[:, column], expected, atol=1e-9)
