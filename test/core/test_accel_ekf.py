"""`accel_ekf` with the joint model, online: start, biases, gaps, missing and faulty sensors, state, smoothing."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from jointest_ros.core.accel.array import joint_arrays
from jointest_ros.core.accel.ekf import AccelEkf, AccelEkfParams
from jointest_ros.core.accel.joint.filter import JointFilter
from jointest_ros.core.accel.joint.model import JointModel, ModelNoise
from jointest_ros.core.accel.joint.trials import run_joint_model
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import FloatArray, Frame, Recording, Series, Status
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.sim import crank_rig, slider_crank, two_link_arm
from jointest_ros.sim.motion import Signal
from jointest_ros.sim.simulated import SimulatedRobot
from jointest_ros.sim.slider_crank import DATA_SHEET_SIGMA, PERIOD, SCENARIOS, CrankMotion, CrankScenario

WITHOUT_BIAS = AccelEkfParams(bias=False)
MAX_GAP = 0.2


def wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def filter_of(true: CrankMotion, bias: bool) -> JointFilter:
    return JointFilter(joint_arrays(robot_of(true))[0], ModelNoise(bias=bias), MAX_GAP)


def robot_of(true: CrankMotion, accel_range: float = math.inf, **joint: object) -> Robot:
    """The two arrays on links that begin at the joint."""
    sensors = tuple(
        Sensor(f"{link}{k}", link, (x, y, 0.0), gyro=False, accel_range=accel_range)
        for link, places in (("a", true.positions_a), ("b", true.positions_b))
        for k, (x, y) in enumerate(places.tolist(), 1)
    )
    return Robot(("a", "b"), (Joint("j", "a", "b", ((0.0, 0.0, 1.0),), **joint),), sensors)  # type: ignore[arg-type]


def recording_of(true: CrankMotion, channels: FloatArray, first: int = 0) -> Recording:
    robot = robot_of(true)
    vectors = np.pad(channels.reshape(len(channels), -1, 2), ((0, 0), (0, 0), (0, 1)))
    stamps = (np.arange(len(channels), dtype=np.int64) + first) * 10_000_000
    accel = {sensor.name: vectors[:, k] for k, sensor in enumerate(robot.sensors)}
    return Recording(stamps, {}, accel, period=np.full(len(channels), PERIOD))


def angle_error_deg(series: Series, true: CrankMotion) -> FloatArray:
    return np.degrees(wrapped(-series.position[:, 0] - true.state[: len(series), 2]))


def rig_error_deg(series: Series, rig: SimulatedRobot) -> FloatArray:
    return np.degrees(wrapped(series.position - rig.truth_position))[:, 0]


def without_rows(recording: Recording, lost: FloatArray) -> Recording:
    accel = {name: table[~lost] for name, table in recording.accel.items()}
    return Recording(recording.stamps[~lost], {}, accel, period=np.full(int((~lost).sum()), PERIOD))


# ------------------------------------------------------------- start


@pytest.mark.parametrize(("name", "bias"), [(n, False) for n in ("T2", "B", "C", "D", "G")] + [("G", True)])
def test_unknown_start_is_found_within_a_second(name: str, bias: bool) -> None:
    """Section 4, item 5: errors below 10 deg and 10 deg/s over half a second that begins in the first one."""
    true, sigma, runs, found = slider_crank.motion(name, samples=150), SCENARIOS[name].sigma, 30, 0
    variances = np.full(8, sigma**2)
    for channels in true.trials(sigma, range(runs)):
        one, states = filter_of(true, bias), []
        for k, row in enumerate(channels):
            one.step(PERIOD if k else 0.0, row, variances)
            states.append((*one.rates, one.angle))
        error = np.array(states) - true.state
        error[:, 2] = wrapped(error[:, 2])
        good = (np.abs(np.degrees(error)) < 10.0).all(axis=1)
        found += any(good[first : first + 50].all() for first in range(100))
    assert found >= 0.95 * runs


def test_a_start_at_rest_in_a_horizontal_plane_waits_for_motion() -> None:
    still = CrankScenario("at rest for 3 s, then 1 rad", lambda time: _steps(time, ((3.0, 1.0),)))
    true = slider_crank.motion(still, samples=500)
    channels = true.trials(DATA_SHEET_SIGMA, [5])[0]
    series = AccelEkf(robot_of(true), WITHOUT_BIAS).run(recording_of(true, channels))
    assert (series.status[:300, 0] == Status.STARTING | Status.UNOBSERVABLE).all()
    assert series.variance[:300] == pytest.approx(math.pi**2 / 3)
    assert not series.status[350:].any()
    assert np.abs(angle_error_deg(series, true)[350:400]).max() < 4.0


@pytest.mark.parametrize("first", [2.9, 3.4])
def test_the_angle_starts_on_the_branch_of_the_limits(first: float) -> None:
    """th_ab of 120 deg is a position of -120 deg, or 240 deg where the limits say so."""
    still = CrankScenario(
        "held", lambda time: Signal(*(np.full_like(time, v) for v in (first, 0.0, 0.0))), gravity=True
    )
    true = slider_crank.motion(still, samples=30)
    channels = true.trials(DATA_SHEET_SIGMA, [2])[0]
    for limits, low, high in ((None, -math.pi, math.pi), (((0.0, 6.0),), 0.0, math.tau)):
        series = AccelEkf(robot_of(true, limits=limits)).run(recording_of(true, channels))
        position = series.position[-1, 0]
        assert low <= position <= high
        assert math.cos(position + true.state[-1, 2]) > 0.99


# ------------------------------------------------------------- the estimator


@pytest.mark.parametrize(("name", "allowed"), [("T2", 1.2), ("B", 0.55), ("C", 0.25), ("G", 0.12), ("F", 0.05)])
def test_a_recording_by_sensors_without_bias(name: str, allowed: float) -> None:
    """Allowed: the bounds of section 3 with what one trial scatters, deg."""
    rig = crank_rig.simulate(name, seed=21)
    estimator = AccelEkf(rig.robot, WITHOUT_BIAS)
    series = estimator.run(rig.recording)
    error = rig_error_deg(series, rig)[100:]
    assert np.sqrt((error**2).mean()) < allowed
    assert np.degrees(np.sqrt(((series.velocity - rig.truth_velocity)[100:] ** 2).mean())) < 2.0
    assert 0.4 < (np.radians(error) ** 2 / series.variance[100:, 0]).mean() < 2.0
    assert not series.status[100:].any()
    assert np.abs(np.diff(np.unwrap(series.position[100:, 0]) - series.position[100:, 0])).max() < 1e-9
    rates = estimator.link_velocities()
    assert list(rates) == ["crank", "rod"]
    assert rates["rod"] - rates["crank"] == pytest.approx(series.velocity[-1, 0])
    assert estimator.covariance()[0, 0] == pytest.approx(series.variance[-1, 0])
    assert estimator.biases() == {}


def test_biases_are_learned_and_told() -> None:
    true = slider_crank.motion("G")
    bias = np.array([0.2, -0.1, -0.15, 0.1, 0.1, 0.2, -0.2, 0.05])
    channels = true.trials(DATA_SHEET_SIGMA, [3])[0] + bias
    estimator = AccelEkf(robot_of(true))
    series = estimator.run(recording_of(true, channels))
    assert np.sqrt((angle_error_deg(series, true)[200:] ** 2).mean()) < 0.6
    found = estimator.biases()
    assert list(found) == [f"{sensor}.{axis}" for sensor in ("a1", "a2", "b1", "b2") for axis in "xy"]
    # what the sensors of a link have in common is a force at the joint; their difference can be told
    for one, other in ((0, 2), (1, 3), (4, 6), (5, 7)):
        values = list(found.values())
        assert values[one] - values[other] == pytest.approx(bias[one] - bias[other], abs=0.08)


def test_innovations_are_normalised() -> None:
    """Somewhat below 1: the model expects faster movements than this one."""
    rig = crank_rig.simulate("B", seed=6)
    estimator, squares = AccelEkf(rig.robot, WITHOUT_BIAS), []
    for frame in rig.recording.frames():
        estimator.update(frame)
        squares.append(np.square(estimator.innovations()))
    assert np.array(squares).shape == (1001, 8)
    assert 0.5 < np.mean(squares[100:]) < 1.1


def test_run_is_update_in_a_loop_and_a_restored_state_continues_identically() -> None:
    rig = crank_rig.simulate("D", seed=5, duration_s=3.0)
    frames = list(rig.recording.frames())
    del frames[60].accel["b1"]
    one = AccelEkf(rig.robot, WITHOUT_BIAS)
    loop = Series.from_estimates([one.update(frame) for frame in frames], 1)
    other = AccelEkf(rig.robot, WITHOUT_BIAS)
    recording = Recording.from_frames(frames)
    parts = [other.run(recording.part(*rows)) for rows in ((0, 100), (100, 101), (101, 300))]
    assert Series.concatenate(parts).position == pytest.approx(loop.position, abs=1e-9)
    assert Series.concatenate(parts).variance == pytest.approx(loop.variance, abs=1e-9)
    for cut in (1, 5, 40, 61, 250):  # with four hypotheses, with some, with one
        first, second = AccelEkf(rig.robot, WITHOUT_BIAS), AccelEkf(rig.robot, WITHOUT_BIAS)
        for frame in frames[:cut]:
            first.update(frame)
        second.set_state(json.loads(json.dumps(first.get_state())))
        rest = Series.from_estimates([second.update(frame) for frame in frames[cut:]], 1)
        for name in ("position", "velocity", "variance", "status"):
            assert (getattr(rest, name) == getattr(loop, name)[cut:]).all()


def test_online_and_stacked_filters_agree_sample_by_sample() -> None:
    """Once the signs are found, both forget how they started."""
    true, sigma = slider_crank.motion("F"), SCENARIOS["F"].sigma
    channels = true.trials(sigma, [9])
    model = JointModel(true.positions_a, true.positions_b, ModelNoise(bias=False))
    stacked = run_joint_model(model, channels, sigma**2, PERIOD, true.state[0], [0.01] * 3)
    one, variances = filter_of(true, bias=False), np.full(8, sigma**2)
    for k, row in enumerate(channels[0]):
        one.step(PERIOD if k else 0.0, row, variances)
        if k >= 500:
            assert (*one.rates, one.angle) == pytest.approx(stacked.state[0, k].tolist(), abs=1e-6)
            assert one.variance == pytest.approx(stacked.variance[0, k, 2], rel=1e-4)


def test_a_clock_that_jumped_starts_afresh_and_reset_forgets_all() -> None:
    rig = crank_rig.simulate("G", seed=1, duration_s=2.0)
    estimator = AccelEkf(rig.robot)
    first = estimator.run(rig.recording)
    learned = estimator.biases()
    frames = list(rig.recording.frames())
    frames[0].reset = True
    estimator.update(frames[0])
    assert estimator.biases() == pytest.approx(learned, abs=0.05)  # they are the sensors', whatever the clock does
    estimator.reset()
    assert (estimator.run(rig.recording).position == first.position).all()


def test_the_rate_of_the_stream_sets_the_noise() -> None:
    """At four times the rate with the same density the bound of the angle stays about the same."""
    rig = crank_rig.simulate("B", seed=2, rate_hz=400.0)
    series = AccelEkf(rig.robot, WITHOUT_BIAS).run(rig.recording)
    error = rig_error_deg(series, rig)[400:]
    assert np.sqrt((error**2).mean()) < 0.55
    assert 0.4 < (np.radians(error) ** 2 / series.variance[400:, 0]).mean() < 2.0


# ------------------------------------------------------------- rest and gaps


def _steps(time: FloatArray, steps: tuple[tuple[float, float], ...]) -> Signal:
    """From 0 by minimum-jerk movements of a second: when each begins, s, and how far it goes, rad."""
    value, rate, acceleration = (np.zeros_like(time) for _ in range(3))
    for begin, distance in steps:
        u = np.clip(time - begin, 0.0, 1.0)
        value += distance * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        rate += distance * 30.0 * u**2 * (1.0 - u) ** 2
        acceleration += distance * (60.0 * u - 180.0 * u**2 + 120.0 * u**3)
    return Signal(value, rate, acceleration)


@pytest.mark.parametrize("gravity", [True, False])
def test_rests_flip_no_signs(gravity: bool) -> None:
    """Movements between rests of seconds, where w = 0: the velocities of the links come out right every time."""
    scenario = CrankScenario(
        "steps", lambda time: _steps(time, ((0.3, 1.2), (3.0, -1.7), (6.0, 1.0), (9.0, -0.8))), gravity=gravity
    )
    true = slider_crank.motion(scenario, samples=1050)
    for seed in range(3):
        one, variances = filter_of(true, bias=False), np.full(8, DATA_SHEET_SIGMA**2)
        for k, row in enumerate(true.trials(DATA_SHEET_SIGMA, [seed])[0]):
            one.step(PERIOD if k else 0.0, row, variances)
            if k > 100:
                assert np.degrees(np.abs(np.array(one.rates) - true.state[k, :2])).max() < 20.0
                fast = np.abs(true.state[k, :2]) > 0.6
                assert (np.sign(np.array(one.rates))[fast] == np.sign(true.state[k, :2])[fast]).all()


@pytest.mark.parametrize(("name", "lost", "status"), [("G", 10, 0), ("C", 30, Status.GAP), ("F", 60, Status.GAP)])
def test_gap(name: str, lost: int, status: int) -> None:
    rig = crank_rig.simulate(name, seed=11, duration_s=6.0)
    rows = np.arange(len(rig.recording))
    gone = (rows >= 300) & (rows < 300 + lost)
    series = AccelEkf(rig.robot, WITHOUT_BIAS).run(without_rows(rig.recording, gone))
    error = np.degrees(wrapped(series.position - rig.truth_position[~gone]))[:, 0]
    assert series.status[300, 0] & ~Status.UNOBSERVABLE == status
    assert series.variance[300, 0] > 3.0 * series.variance[299, 0]
    assert np.abs(error[330:]).max() < 2.0
    assert not series.status[330:].any()


def test_silence_is_told_and_survived() -> None:
    rig = crank_rig.simulate("G", seed=12, duration_s=5.0)
    frames = list(rig.recording.frames())
    for frame in frames[200:300]:
        frame.accel.clear()
    estimator = AccelEkf(rig.robot)
    series = Series.from_estimates([estimator.update(frame) for frame in frames], 1)
    assert (series.status[200:215, 0] == Status.NO_DATA).all()
    assert series.status[230, 0] & (Status.NO_DATA | Status.GAP) == Status.NO_DATA | Status.GAP
    assert series.status[299, 0] & Status.STALE
    assert np.isfinite(series.position).all() and (series.variance[230:300] > 1.0).all()
    assert np.abs(rig_error_deg(series, rig)[330:]).max() < 2.0


# ------------------------------------------------------------- faulty sensors


def three_a_link(name: str, seed: int) -> tuple[CrankMotion, FloatArray]:
    places = slider_crank.row(0.15, 0.15, 3)
    true = slider_crank.motion(name, positions=(places, places), samples=700)
    return true, true.trials(SCENARIOS[name].sigma, [seed])[0]


@pytest.mark.parametrize("fault", ["silent", "frozen", "offset", "saturated"])
@pytest.mark.parametrize("sensor", [0, 4])
@pytest.mark.parametrize("name", ["B", "G"])
def test_one_sensor_fails_and_the_others_suffice(name: str, sensor: int, fault: str) -> None:
    """Three sensors on a link, one fails for two seconds: its weight goes, the estimate stays, the status tells."""
    true, channels = three_a_link(name, seed=7)
    own = slice(2 * sensor, 2 * sensor + 2)
    if fault == "frozen":
        channels[300:500, own] = channels[300, own]
    else:
        channels[300:500, own] += {"silent": np.nan, "offset": 3.0, "saturated": 1e3}[fault]
    robot = robot_of(true, accel_range=500.0)
    series = AccelEkf(robot, WITHOUT_BIAS).run(recording_of(true, channels))
    error = np.abs(angle_error_deg(series, true))
    limit = 12.0 if fault == "frozen" else 4.0  # until others have moved on, a frozen reading may be true
    assert error[300:350].max() < limit
    assert error[350:].max() < 4.0
    assert not series.status[100:300].any() and not series.status[510:].any()
    told = Status.NO_DATA if fault == "silent" else Status.DISTURBED
    assert ((series.status[350:500, 0] & told) > 0).all()


def test_a_filter_that_went_astray_recovers() -> None:
    """Both sensors of a link read nonsense for a second: afterwards a fresh start beside the filter wins."""
    rig = crank_rig.simulate("B", seed=8, duration_s=8.0)
    frames = list(rig.recording.frames())
    random = np.random.default_rng(1)
    for frame in frames[300:400]:
        for sensor in ("b1", "b2"):
            frame.accel[sensor] = tuple(random.normal(0.0, 3.0, 3).tolist())
    estimator = AccelEkf(rig.robot)
    series = Series.from_estimates([estimator.update(frame) for frame in frames], 1)
    assert (series.status[310:395, 0] & Status.DISTURBED).mean() > 0.5
    assert np.abs(rig_error_deg(series, rig)[600:]).max() < 6.0
    assert not (series.status[600:] & Status.DISTURBED).any()


@pytest.mark.parametrize("bias", [False, True])
def test_whatever_comes_in_numbers_come_out(bias: bool) -> None:
    robot = robot_of(slider_crank.motion("B", samples=2))
    for seed in range(6):
        random, estimator, stamp = np.random.default_rng(seed), AccelEkf(robot, AccelEkfParams(bias=bias)), 0
        for _ in range(300):
            stamp += int(10 ** random.uniform(5.0, 10.0)) if random.random() < 0.1 else 10_000_000
            scale = 10 ** random.uniform(-3.0, 8.0) if random.random() < 0.3 else 10.0
            readings = {
                s.name: tuple(scale * random.standard_normal(3)) for s in robot.sensors if random.random() < 0.9
            }
            frame = Frame(stamp, accel=readings, period=0.01, reset=bool(random.random() < 0.01))
            estimate = estimator.update(frame)
            assert np.isfinite([*estimate.position, *estimate.velocity]).all()
            assert 0.0 <= estimate.variance[0] < 10.0


# ------------------------------------------------------------- smoothing, errors


def test_smoothed_recording() -> None:
    rig = crank_rig.simulate("B", seed=13)
    estimator = AccelEkf(rig.robot, WITHOUT_BIAS)
    filtered, smoothed = estimator.run(rig.recording), estimator.smooth(rig.recording)
    rms = [np.sqrt((rig_error_deg(series, rig)[20:] ** 2).mean()) for series in (filtered, smoothed)]
    assert rms[1] < 0.25 and rms[1] < 0.6 * rms[0]
    assert np.sqrt((np.degrees(smoothed.velocity - rig.truth_velocity)[20:] ** 2).mean()) < 1.0
    assert (smoothed.variance[20:-1] <= filtered.variance[20:-1] * 1.001).all()
    assert smoothed.position[-1] == pytest.approx(filtered.position[-1])


def test_smoothing_across_a_gap_and_a_start() -> None:
    rig = crank_rig.simulate("G", seed=14, duration_s=5.0)
    rows = np.arange(len(rig.recording))
    gone = (rows >= 200) & (rows < 250)
    series = AccelEkf(rig.robot).smooth(without_rows(rig.recording, gone))
    error = np.degrees(wrapped(series.position - rig.truth_position[~gone]))[:, 0]
    assert np.abs(error[1:]).max() < 2.0


def test_the_paper_s_model_has_no_smoother() -> None:
    rig = crank_rig.simulate("B", duration_s=0.1)
    with pytest.raises(ConfigurationError, match=r"^model: 'paper' is not allowed with smoothing"):
        AccelEkf(rig.robot, AccelEkfParams(model="paper")).smooth(rig.recording)


def test_two_joints_in_a_row_share_the_link_between() -> None:
    places = ((0.1, 0.0, 0.0), (0.2, 0.05, 0.0))
    sensors = tuple(Sensor(f"{link}{k}", link, place) for link in ("a", "b", "c") for k, place in enumerate(places))
    axes = ((0.0, 0.0, 1.0),)
    joints = Joint("one", "a", "b", axes, origin=(0.3, 0.0, 0.0)), Joint("two", "b", "c", axes, origin=(0.3, 0.0, 0.0))
    estimator = AccelEkf(Robot(("a", "b", "c"), joints, sensors))
    upright = {sensor.name: (9.81, 0.0, 0.0) for sensor in sensors}
    for k in range(50):
        estimate = estimator.update(Frame(k * 10_000_000, accel=dict(upright), period=0.01))
    assert estimate.position == pytest.approx((0.0, 0.0), abs=1e-3)
    assert estimate.status == (0, 0)
    assert list(estimator.link_velocities()) == ["a", "one.b", "two.b", "c"]
    assert {"a0.x", "one.b0.x", "two.b0.x", "c1.y"} <= set(estimator.biases())
    assert len(estimator.innovations()) == 16


# ------------------------------------------------------------- sensors that are better than their calibration


@pytest.mark.parametrize("scenario", ["slow_periodic", "impulse"])
@pytest.mark.parametrize("calibration", ["exact", "residual"])
def test_low_noise_with_unknown_biases(scenario: str, calibration: str) -> None:
    """The error stays that of biases that a clamped arm cannot tell (0.8 deg), and the estimate knows it."""
    squares, ratios = [], []
    for seed in range(4):
        arm = two_link_arm.simulate(scenario, calibration=calibration, seed=seed, duration_s=20.0)
        series = AccelEkf(arm.robot).run(arm.recording)
        error = rig_error_deg(series, arm)[200:]
        squares.append(np.mean(error**2))
        ratios.append(np.mean(np.radians(error) ** 2 / series.variance[200:, 0]))
    assert math.sqrt(np.mean(squares)) < 1.0
    assert math.sqrt(np.mean(ratios)) < 1.3
