"""`accel_analytical`: item 8 of section 4 of the specification, the window, the batch twin, faults."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from jointest_ros.core.accel.analytical import AccelAnalytical, AccelAnalyticalParams
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import FloatArray, Recording, Series, Status
from jointest_ros.core.robot import Joint, Robot
from jointest_ros.core.timing import Timing
from jointest_ros.sim import crank_rig
from jointest_ros.sim.simulated import SimulatedRobot

RAW = AccelAnalyticalParams(window=1)
COLUMNS = ("position", "velocity", "variance", "status")


def wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def error_deg(series: Series, rig: SimulatedRobot) -> FloatArray:
    return np.degrees(wrapped(series.position - rig.truth_position))[:, 0]


def loop(estimator: AccelAnalytical, recording: Recording) -> Series:
    return Series.from_estimates([estimator.update(frame) for frame in recording.frames()], len(estimator.joints))


def same(one: Series, other: Series) -> None:
    for name in COLUMNS:
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-9, abs=1e-9)


# ------------------------------------------------------------- angle, window, variance


@pytest.mark.parametrize(
    ("name", "length", "expected"),
    [("T2", 0.3, 9.05), ("T2", 0.2, 13.7), ("T2", 0.1, 29.7), ("B", 0.3, 2.74), ("G", 0.3, 0.367)],
)
def test_each_sample_by_itself(name: str, length: float, expected: float) -> None:
    rigs = [crank_rig.simulate(name, length=length, seed=seed) for seed in range(30)]
    errors = [error_deg(AccelAnalytical(rig.robot, RAW).run(rig.recording), rig)[100:] for rig in rigs]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("name", ["B", "C", "D", "G", "F"])
def test_exact_without_noise(name: str) -> None:
    rig = crank_rig.simulate(name, noise=0.0)
    series = AccelAnalytical(rig.robot, RAW).run(rig.recording)
    assert np.abs(error_deg(series, rig)[1:]).max() < 1e-8


def test_variance_is_that_of_the_error() -> None:
    for name in ("B", "C", "G", "F"):
        rig = crank_rig.simulate(name, seed=1)
        series = AccelAnalytical(rig.robot, RAW).run(rig.recording)
        squares = np.radians(error_deg(series, rig)) ** 2 / series.variance[:, 0]
        assert squares[100:].mean() == pytest.approx(1.0, abs=0.15)


def test_window_smooths_and_lags_by_half_of_it() -> None:
    rig = crank_rig.simulate("T2", seed=2)
    series = AccelAnalytical(rig.robot).run(rig.recording)
    assert AccelAnalytical(rig.robot).params.window == 25
    late = np.degrees(wrapped(series.position[12:] - rig.truth_position[:-12]))[:, 0]
    raw = error_deg(AccelAnalytical(rig.robot, RAW).run(rig.recording), rig)
    assert np.sqrt((late[100:] ** 2).mean()) < 0.3 * np.sqrt((raw[100:] ** 2).mean())
    squares = np.radians(error_deg(series, rig)) ** 2 / series.variance[:, 0]
    assert 0.5 < squares[100:].mean() < 5.0  # the lag is in the variance


def test_window_knows_no_jump_at_180_deg() -> None:
    """Full turns: the angles' mean would be wrong where they jump, that of the vectors only lags."""
    rig = crank_rig.simulate("C", seed=3)
    series = AccelAnalytical(rig.robot, AccelAnalyticalParams(window=5)).run(rig.recording)
    lag = np.abs(rig.truth_velocity).max() * 0.02
    assert np.abs(error_deg(series, rig)[100:]).max() < np.degrees(lag) + 4.0


def test_velocity_is_the_slope_in_the_window() -> None:
    rig = crank_rig.simulate("G", seed=4)
    series = AccelAnalytical(rig.robot).run(rig.recording)
    late = series.velocity[12:] - rig.truth_velocity[:-12]
    assert np.degrees(np.sqrt((late[100:] ** 2).mean())) < 5.0
    assert all(math.isnan(rate) for rate in AccelAnalytical(rig.robot).link_velocities().values())
    assert set(AccelAnalytical(rig.robot).link_velocities()) == {"crank", "rod"}


def test_no_force_at_the_joint_is_unobservable() -> None:
    rig = crank_rig.simulate("B", seed=5, duration_s=2.0)
    noise = np.random.default_rng(5)
    still = {name: 0.0277 * noise.standard_normal(table.shape) for name, table in rig.recording.accel.items()}
    series = AccelAnalytical(rig.robot).run(replace_accel(rig.recording, still))
    assert (series.status == Status.UNOBSERVABLE).mean() > 0.95
    assert (series.variance > 0.25)[series.status == Status.UNOBSERVABLE].all()
    assert (series.variance <= math.pi**2 / 3).all()


def replace_accel(recording: Recording, accel: dict[str, FloatArray]) -> Recording:
    return Recording(recording.stamps, {}, accel, period=recording.period)


@pytest.mark.parametrize(
    ("joint", "lowest", "highest"),
    [
        ({}, -math.pi, math.pi),
        ({"limits": ((-5.0, -1.0),)}, -3.0 - math.pi, -3.0 + math.pi),
        ({"limits": ((-20.0, 20.0),)}, -32.0, 0.0),  # more than a turn: followed
        ({"continuous": True}, -32.0, 0.0),
    ],
)
def test_branch(joint: dict[str, object], lowest: float, highest: float) -> None:
    rig = crank_rig.simulate("C", seed=6)
    plain = Joint("crank_pin", "crank", "rod", ((0.0, 0.0, 1.0),), origin=rig.robot.joints[0].origin)
    robot = replace(rig.robot, joints=(replace(plain, **joint),))  # type: ignore[arg-type]
    series = AccelAnalytical(robot, RAW).run(rig.recording)
    assert lowest <= series.position.min() and series.position.max() <= highest + 0.1
    if highest < 1.0 and lowest < -20.0:
        assert series.position == pytest.approx(rig.truth_position, abs=0.2)
    same(series, loop(AccelAnalytical(robot, RAW), rig.recording))


# ------------------------------------------------------------- by arrays


def faulty(kind: str, rig: SimulatedRobot) -> tuple[Robot, Recording]:
    """The rig's recording with a fault in the middle."""
    accel = {name: table.copy() for name, table in rig.recording.accel.items()}
    robot, recording = rig.robot, replace_accel(rig.recording, accel)
    if kind == "nan":
        accel["a1"][300:310] = np.nan
    elif kind == "gap":
        recording = Recording.concatenate([recording.part(0, 300), recording.part(360, len(recording))])
    elif kind == "frozen":
        accel["b2"][300:450] = accel["b2"][300]
    elif kind == "saturated":
        sensors = tuple(replace(sensor, accel_range=15.0) for sensor in robot.sensors)
        robot = replace(robot, sensors=sensors)
        accel["a2"][300:305, 0] = 15.0
    elif kind == "reset":
        recording.reset = np.arange(len(recording)) == 300
    elif kind == "period":
        assert recording.period is not None
        recording.period = np.where(np.arange(len(recording)) < 200, np.nan, recording.period)
    elif kind == "silent":
        del accel["b1"]
    return robot, recording


@pytest.mark.parametrize("window", [1, 2, 3, 25])
@pytest.mark.parametrize("kind", ["sound", "nan", "gap", "frozen", "saturated", "reset", "period", "silent"])
def test_run_is_update_in_a_loop(kind: str, window: int) -> None:
    rig = crank_rig.simulate("B", seed=7, duration_s=7.0)
    robot, recording = faulty(kind, rig)
    params = AccelAnalyticalParams(window=window)
    one, other = AccelAnalytical(robot, params), AccelAnalytical(robot, params)
    expected = loop(one, recording)
    parts = [recording.part(0, 123), recording.part(123, 124), recording.part(124, len(recording))]
    same(Series.concatenate([other.run(part) for part in parts]), expected)
    assert other.get_state()["silent"] == one.get_state()["silent"]
    after = [expected.status[-1, 0], *other.covariance().ravel()]
    assert after[1:] == pytest.approx(one.covariance().ravel())


def test_sound_stretches_run_by_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = crank_rig.simulate("B", seed=7)
    monkeypatch.setattr(AccelAnalytical, "update", None)
    assert not AccelAnalytical(rig.robot).run(rig.recording).status.any()


def test_a_restored_state_continues_identically() -> None:
    rig = crank_rig.simulate("B", seed=8, duration_s=3.0)
    frames = list(rig.recording.frames())
    one, two = AccelAnalytical(rig.robot), AccelAnalytical(rig.robot)
    for frame in frames[:100]:
        one.update(frame)
    two.set_state(json.loads(json.dumps(one.get_state())))
    assert [one.update(frame) for frame in frames[100:]] == [two.update(frame) for frame in frames[100:]]
    assert one.innovations() == [] and one.biases() == {}


# ------------------------------------------------------------- missing samples


def test_nothing_stale_is_reused() -> None:
    """A missing sample: the newest angle stands, with a variance that grows; after `max_gap` the window begins anew."""
    rig = crank_rig.simulate("G", seed=9)
    accel = {name: table.copy() for name, table in rig.recording.accel.items()}
    accel["b1"][300:340] = np.nan
    estimator = AccelAnalytical(rig.robot, timing=Timing(max_gap=0.2))
    series = loop(estimator, replace_accel(rig.recording, accel))
    gap = slice(300, 340)
    assert (series.position[gap] == series.position[299]).all() and not series.velocity[gap].any()
    assert (series.status[gap] & Status.NO_DATA).all() and (series.status[330:340] & Status.GAP).all()
    growth = series.variance[gap, 0]
    assert (np.diff(growth[:15]) > 0.0).all() and growth[-1] == pytest.approx(math.pi**2 / 3)
    fresh = loop(AccelAnalytical(rig.robot), rig.recording.part(340, 400))
    assert series.position[340:400] == pytest.approx(fresh.position)


def test_start() -> None:
    rig = crank_rig.simulate("G", seed=10, duration_s=1.0)
    accel = {name: table.copy() for name, table in rig.recording.accel.items()}
    accel["a2"][:3] = np.nan
    series = loop(AccelAnalytical(rig.robot), replace_accel(rig.recording, accel))
    assert (series.status[:3] & Status.STARTING).all() and not series.position[:3].any()
    assert not series.status[4:].any() and series.velocity[3] == 0.0


@pytest.mark.parametrize("window", [0, 1001, 2.5])
def test_windows_that_are_not_allowed(window: float) -> None:
    with pytest.raises(ConfigurationError, match="window"):
        AccelAnalyticalParams(window=window)  # type: ignore[arg-type]
