"""Properties of the `hinge` formulation: any axis, any range, its bias, its variance, its limits."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pcf_swing import X, Y, Z, rest, sway, swing
from scipy.spatial.transform import Rotation

from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.frame import FloatArray, Frame, Recording, Series, Status, Vec3
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import between, norm, unit
from jointest_ros.core.timing import Timing

component = st.floats(-1.0, 1.0)
directions = st.tuples(component, component, component).filter(lambda v: norm(v) > 0.1).map(unit)


def slow_swing(time: FloatArray) -> FloatArray:
    """0 to 70 deg, .35 Hz."""
    return np.radians(35.0) * (1.0 - np.cos(2.2 * time))


def error_deg(series: Series, truth: FloatArray, after: float = 0.0) -> FloatArray:
    late = (series.stamps - series.stamps[0]) * 1e-9 >= after
    return np.degrees(series.position - truth)[late]


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@settings(max_examples=15)
@given(axis=directions, seed=st.integers(0, 1000))
def test_axis_of_any_direction(axis: Vec3, seed: int) -> None:
    """The base lies so that the axis is 30 deg above horizontal."""
    tilted = Rotation.from_quat(between(axis, (math.cos(math.pi / 6), 0.0, 0.5)))
    robot, recording, truth = swing(
        slow_swing, (axis,), seconds=8.0, seed=seed, parent=lambda time: Rotation.concatenate([tilted] * len(time))
    )
    series = Pcf(robot, PcfParams(still_start=0.0)).run(recording)
    assert rms(error_deg(series, truth, after=3.0)) < 0.25


@pytest.mark.parametrize("parent", [rest, sway])
@pytest.mark.parametrize("reach", [170.0, 330.0, 1000.0])
def test_range_beyond_180_deg(parent, reach: float) -> None:
    """Once started the angle is followed over any number of turns."""
    robot, recording, truth = swing(
        lambda time: np.radians(reach) * np.sin(0.5 * time), seconds=20.0, parent=parent, noise=0.5
    )
    series = Pcf(robot, PcfParams(still_start=0.0)).run(recording)
    assert np.abs(error_deg(series, truth, after=5.0)).max() < 1.0


@pytest.mark.parametrize(
    ("limits", "start", "expected"),
    [
        (None, 170.0, 170.0),
        (None, 190.0, -170.0),
        ((0.0, 270.0), 190.0, 190.0),
        ((0.0, 270.0), 268.0, 268.0),
        ((-270.0, 0.0), -200.0, -200.0),
        ((90.0, 400.0), 399.0, 399.0),
    ],
)
@pytest.mark.parametrize("formulation", ["hinge", "relative", "absolute"])
def test_first_angle_is_on_the_branch_of_the_limits(
    formulation: str, limits: tuple[float, float] | None, start: float, expected: float
) -> None:
    ranges = None if limits is None else (tuple(np.radians(limits)),)
    robot, recording, _ = swing(lambda time: np.full_like(time, np.radians(start)), seconds=2.0, limits=ranges)
    series = Pcf(robot, PcfParams(formulation=formulation)).run(recording)
    assert np.degrees(series.position[-1, 0]) == pytest.approx(expected, abs=0.5)


@pytest.mark.parametrize("formulation", ["hinge", "relative", "absolute"])
def test_limits_bring_the_angle_back_after_a_gap(formulation: str) -> None:
    """From 260 to 10 deg while nobody looked: the short way round would be to 370."""
    robot, recording, _ = swing(
        lambda time: np.radians(np.where(time < 5.0, 260.0, 10.0)), seconds=10.0, limits=((0.0, math.radians(270.0)),)
    )
    for name in ("base", "link"):  # the jump itself was not measured
        recording.gyro[name][500] = recording.gyro[name][499]
    recording.stamps[500:] += 3_000_000_000
    series = Pcf(robot, PcfParams(formulation=formulation)).run(recording)
    found = np.degrees(series.position[:, 0])
    assert found[499] == pytest.approx(260.0, abs=1.0)
    assert found[-1] == pytest.approx(10.0, abs=1.0)


def test_innovation_is_wrapped() -> None:
    """The measured angle jumps by a turn at 180 deg, the estimate does not."""
    robot, recording, _ = swing(lambda time: np.radians(180.0) + 0.05 * np.sin(3.0 * time), seconds=10.0)
    estimator = Pcf(robot, PcfParams(still_start=0.0))
    hinge = estimator._hinges[0]
    innovations = []
    for frame in recording.frames():
        estimator.update(frame)
        innovations.append(hinge.innovation)
    assert np.nanmax(np.abs(innovations[1:])) < 0.2


def test_bias_is_found_without_calibration() -> None:
    robot, recording, truth = swing(slow_swing, seconds=120.0, bias=math.radians(3.0), seed=3, parent=sway)
    estimator = Pcf(robot, PcfParams(still_start=0.0))
    series = estimator.run(recording)
    assert (series.status & Status.UNCALIBRATED).all()
    assert rms(error_deg(series, truth, after=30.0)) < 0.15
    calibrated = Pcf(robot, PcfParams())
    still = swing(lambda time: 0.0 * time, seconds=4.0, bias=math.radians(3.0), seed=3)[1]
    calibrated.run(still)
    assert estimator.biases()["joint.gyro"] == pytest.approx(calibrated.biases()["joint.gyro"], abs=math.radians(0.02))


def test_reported_std_covers_the_error() -> None:
    """Without floor and without anything that is not modelled: normalised errors are of unit size."""
    normalised = []
    for seed in range(40):
        robot, recording, truth = swing(slow_swing, seconds=30.0, bias=math.radians(2.0), seed=seed, parent=sway)
        series = Pcf(robot, PcfParams(still_start=0.0, floor_deg=0.0)).run(recording)
        normalised.append((series.position - truth)[500::500, 0] / np.sqrt(series.variance[500::500, 0]))
    assert 0.8 < rms(np.array(normalised)) < 1.2


def test_innovations_are_white_and_of_the_stated_size() -> None:
    robot, recording, _ = swing(slow_swing, seconds=60.0, parent=sway, seed=4)
    estimator = Pcf(robot, PcfParams(still_start=0.0))
    hinge = estimator._hinges[0]
    squares = []
    for frame in recording.frames():
        estimator.update(frame)
        squares.append(hinge.innovation**2 / hinge.innovation_variance)
    assert np.mean(squares[500:]) == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize("formulation", ["hinge", "relative", "absolute"])
def test_axis_along_gravity_is_flagged_and_its_std_grows(formulation: str) -> None:
    robot, recording, truth = swing(lambda time: slow_swing(np.maximum(time - 4.0, 0.0)), (Z,), seconds=30.0, seed=5)
    series = Pcf(robot, PcfParams(formulation=formulation, zero_at_start=True, floor_deg=0.0)).run(recording)
    assert (series.status & Status.UNOBSERVABLE).all()
    assert np.abs(error_deg(series, truth, after=4.0)).max() < 1.0
    std = np.degrees(np.sqrt(series.variance[:, 0]))
    assert std[0] > 90.0
    assert np.all(np.diff(std[400::100]) > 0.0)
    assert std[-1] < 1.0


@pytest.mark.parametrize("formulation", ["hinge", "relative", "absolute"])
def test_magnetometers_make_a_vertical_axis_observable(formulation: str) -> None:
    """Gyro biases that nobody calibrated carry the angle away, unless the field holds it."""
    robot, recording, truth = swing(slow_swing, (Z,), seconds=60.0, bias=math.radians(0.5), mag=True, seed=6, rate=50.0)
    found = {}
    for weight in (0.0, 1.0):
        params = PcfParams(formulation=formulation, still_start=0.0, mag_weight=weight)
        series = Pcf(robot, params).run(recording)
        flagged = (series.status[500:] & Status.UNOBSERVABLE).any()
        found[weight] = rms(error_deg(series, truth, after=30.0)), bool(flagged)
    assert found[0.0][0] > 5.0 and found[0.0][1]
    assert found[1.0][0] < 3.0 and not found[1.0][1]


def test_magnetometers_slower_than_the_imus_hold_the_angle_as_well() -> None:
    robot, recording, truth = swing(slow_swing, (Z,), seconds=60.0, bias=math.radians(0.5), mag=True, seed=6)
    for name in recording.mag:
        recording.mag[name][np.arange(len(recording)) % 10 > 0] = np.nan
    for formulation in ("hinge", "relative", "absolute"):
        series = Pcf(robot, PcfParams(formulation=formulation, still_start=0.0, mag_weight=1.0)).run(recording)
        assert rms(error_deg(series, truth, after=30.0)) < 3.0
        assert not (series.status[500:] & Status.UNOBSERVABLE).any()


def test_accelerometer_weight_zero_leaves_the_field_alone() -> None:
    robot, recording, truth = swing(slow_swing, (Z,), seconds=20.0, mag=True, seed=7)
    disturbed = {name: accel + np.array([3.0, 2.0, 0.0]) for name, accel in recording.accel.items()}
    recording = Recording(recording.stamps, recording.gyro, disturbed, recording.mag, period=recording.period)
    params = PcfParams(still_start=0.0, accel_weight=0.0, mag_weight=1.0)
    assert rms(error_deg(Pcf(robot, params).run(recording), truth, after=5.0)) < 0.5


@pytest.mark.parametrize("formulation", ["hinge", "relative", "absolute"])
def test_velocity(formulation: str) -> None:
    robot, recording, truth = swing(slow_swing, seconds=20.0, bias=math.radians(2.0), parent=sway, seed=8)
    rest_first = swing(lambda time: 0.0 * time, seconds=4.0, bias=math.radians(2.0), seed=8)[1]
    estimator = Pcf(robot, PcfParams(formulation=formulation))
    estimator.run(rest_first)
    recording.stamps += 4_000_000_000
    series = estimator.run(recording)
    rate = np.diff(truth[:, 0]) * 100.0
    late = slice(500, None)
    assert np.degrees(rms(series.velocity[1:, 0][late] - rate[late])) < 0.15


# -------------------------------------------------------------------- calibration


def test_still_start_calibrates_and_the_flag_goes() -> None:
    robot, recording, _ = swing(lambda time: 0.0 * time, seconds=3.0, bias=math.radians(3.0), seed=9)
    estimator = Pcf(robot, PcfParams())
    series = estimator.run(recording)
    uncalibrated = (series.status[:, 0] & Status.UNCALIBRATED) > 0
    assert uncalibrated[:100].all() and not uncalibrated[105:].any()
    assert estimator.calibrated
    assert Pcf(robot, PcfParams(still_start=0.0)).run(recording).status[-1, 0] & Status.UNCALIBRATED


@pytest.mark.parametrize("formulation", ["hinge", "relative", "absolute"])
def test_zero_pose_is_taken_where_the_robot_stands(formulation: str) -> None:
    """The zero pose may be any pose; afterwards angles count from there."""
    robot, recording, _ = swing(
        lambda time: np.full_like(time, 0.7), seconds=4.0, seed=10, parent=lambda time: sway(np.ones_like(time))
    )
    estimator = Pcf(robot, PcfParams(formulation=formulation, still_start=0.0))
    assert estimator.run(recording).position[-1, 0] == pytest.approx(0.7, abs=0.01)
    estimator.calibrate_zero()
    later = Recording(recording.stamps + 4_000_000_000, recording.gyro, recording.accel, period=recording.period)
    assert estimator.run(later).position[-1, 0] == pytest.approx(0.0, abs=0.01)
    estimator.reset()
    assert estimator.run(recording).position[-1, 0] == pytest.approx(0.0, abs=0.01)


def test_calibrations_are_refused_while_the_robot_moves() -> None:
    robot, recording, _ = swing(slow_swing, seconds=5.0)
    estimator = Pcf(robot, PcfParams())
    for action in (estimator.calibrate_zero, estimator.calibrate_gyro_bias):
        with pytest.raises(CalibrationError, match="still"):
            action()
    estimator.run(recording)
    for action in (estimator.calibrate_zero, estimator.calibrate_gyro_bias):
        with pytest.raises(CalibrationError, match="still"):
            action()
    assert not estimator.calibrated


def test_frame_with_reset_keeps_the_bias_and_the_zero_pose() -> None:
    robot, recording, _ = swing(lambda time: np.full_like(time, 0.4), seconds=4.0, bias=math.radians(3.0), seed=11)
    estimator = Pcf(robot, PcfParams(zero_at_start=True))
    estimator.run(recording)
    before = estimator.biases()
    again = next(recording.frames())
    again.reset = True
    estimate = estimator.update(again)
    assert estimator.biases() == before and estimator.calibrated
    assert estimate.position[0] == pytest.approx(0.0, abs=0.05)  # the accelerometers of a single sample
    assert not estimate.status[0] & (Status.GAP | Status.STARTING | Status.UNCALIBRATED)
    assert estimate.variance[0] > 0.2  # as at the start


def test_reset_forgets_the_bias() -> None:
    robot, recording, _ = swing(lambda time: 0.0 * time, seconds=4.0, bias=math.radians(3.0), seed=12)
    for formulation in ("hinge", "relative", "absolute"):
        estimator = Pcf(robot, PcfParams(formulation=formulation))
        estimator.run(recording)
        assert estimator.calibrated and max(map(abs, estimator.biases().values())) > 1e-2
        estimator.reset()
        assert not estimator.calibrated and set(estimator.biases().values()) == {0.0}
        assert np.diag(estimator.covariance()).min() > 1.0


# -------------------------------------------------------------------- what is refused


def test_robot_without_imus_on_both_sides_is_refused() -> None:
    robot = Robot(("a", "b"), (Joint("j", "a", "b", (X,)),), (Sensor("s", "a"), Sensor("t", "b", accel=False)))
    with pytest.raises(ConfigurationError, match="joint 'j': link 'b' carries no sensor with gyro and accelerometer"):
        Pcf(robot)
    with pytest.raises(ConfigurationError, match="no joints"):
        Pcf(Robot(("a",), (), (Sensor("s", "a"),)))
    assert Pcf(Robot(("a",), (), (Sensor("s", "a"),)), PcfParams(formulation="absolute")).joints == ()


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"formulation": "hings"}, "formulation: 'hings' is not allowed; give one of hinge, relative, absolute"),
        ({"kp": -1.0}, "kp: -1.0 is not allowed; give 0 to 100 1/s"),
        ({"gravity_cone_deg": 90.0}, "gravity_cone_deg: 90.0 is not allowed; give 0.1 to 45 deg"),
        ({"Kp": 1.0}, "Kp: unknown key; did you mean 'kp'?"),
    ],
)
def test_parameters(values: dict[str, object], named: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        PcfParams.from_mapping(values)
    assert str(caught.value) == named


def test_sensors_that_are_said_to_have_no_noise() -> None:
    robot, recording, truth = swing(slow_swing, (Y,), seconds=5.0, noise=0.0)
    robot = replace(robot, sensors=tuple(replace(one, gyro_noise=0.0, accel_noise=0.0) for one in robot.sensors))
    for formulation in ("hinge", "relative", "absolute"):
        series = Pcf(robot, PcfParams(formulation=formulation, still_start=0.0)).run(recording)
        assert np.abs(error_deg(series, truth)).max() < 1e-3
        assert np.isfinite(series.variance).all()


def test_timing_of_the_estimator_is_the_users() -> None:
    robot, recording, _ = swing(slow_swing, seconds=1.0)
    estimator = Pcf(robot, PcfParams(), Timing(max_gap=0.05, stale_after=0.1))
    estimator.run(recording)
    last = int(recording.stamps[-1])
    flags = [estimator.update(Frame(last + ms * 1_000_000)).status[0] for ms in (40, 60, 120)]
    relevant = Status.GAP | Status.STALE
    assert [flag & relevant for flag in flags] == [0, Status.GAP, Status.GAP | Status.STALE]
