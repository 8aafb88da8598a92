"""How estimators notice that they were led astray, and frozen sensors: without messages, on frames and arrays."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pcf_swing import rest, swing

from jointest_ros.core.accel.ekf import AccelEkf, AccelEkfParams
from jointest_ros.core.assembler import FrameAssembler
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import FloatArray, Frame, Recording, Series, Status, Vec3
from jointest_ros.core.kckf.gyro import Gyro
from jointest_ros.core.kckf.kckf import Kckf, KckfParams
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.robot import Robot, Sensor
from jointest_ros.sim import exoshell, two_link_arm

MS = 1_000_000
UP: Vec3 = (0.0, 0.0, 9.81)
WAYS: dict[str, Callable[[Robot], Estimator]] = {
    "kckf": Kckf,
    "kckf offset": lambda robot: Kckf(robot, KckfParams(hall_offset=True)),
    "kckf off axis": lambda robot: Kckf(robot, KckfParams(off_axis=True)),
}


# ---------------------------------------------------------------- frozen IMUs


def held(gyro: Vec3, samples: int, accel: Vec3 = UP, change: float = 0.0) -> FrameAssembler:
    """An assembler in which `a` repeats a reading at 100 Hz beside a lively `b`; but `change` of acceleration."""
    assembler = FrameAssembler([Sensor("a", "one"), Sensor("b", "two")])
    for k in range(50 + samples):
        now = gyro if k >= 50 else (0.01 * (k % 7), 0.0, 0.0)
        assembler.add_imu("a", k * 10 * MS, now, (accel[0] + change * k, accel[1], accel[2]))
        assembler.add_imu("b", k * 10 * MS, (0.02 * (k % 5), 0.0, 0.0), UP)
    return assembler


def test_an_imu_that_repeats_a_turn_is_refused_after_a_tenth_of_a_second_and_holds_up_nobody() -> None:
    assembler = held((0.5, 0.0, 0.0), 40)
    assembler.flush()
    source = assembler.sources["a"]
    assert source.refused == {"frozen": 30}  # ten repetitions take 100 ms
    assert (source.received, source.used) == (90, 60)
    assert assembler.frames == 90
    assert assembler.partial == 30


@pytest.mark.parametrize(
    ("gyro", "change"),
    [((0.1, 0.0, 0.0), 0.0), ((0.5, 0.0, 0.0), 1e-9)],
    ids=["a link at rest may repeat its reading for hours", "its accelerometer goes on"],
)
def test_what_is_not_frozen(gyro: Vec3, change: float) -> None:
    assert not held(gyro, 200, change=change).sources["a"].refused


def test_a_driver_that_sends_every_reading_five_times_is_not_frozen() -> None:
    assembler = FrameAssembler([Sensor("a", "one")])
    for k in range(500):
        assembler.add_imu("a", k * 2 * MS, (1.0 + 0.1 * (k // 5 % 9), 0.0, 0.0), UP)
    assert not assembler.sources["a"].refused


# ---------------------------------------------------------------- Hall sensors


@pytest.fixture(scope="module")
def made() -> exoshell.ExoshellRecording:
    return exoshell.simulate("composed", duration_s=12.0, rate_hz=100.0, seed=4)


def degrees(series: Series, made: exoshell.ExoshellRecording) -> FloatArray:
    return np.degrees(np.abs(series.position - made.truth_position))


@pytest.mark.parametrize("way", WAYS)
def test_frozen_hall_sensors_are_left_out_until_they_change(way: str, made: exoshell.ExoshellRecording) -> None:
    """A filter that believes them takes the motion for a gyro bias, and needs a minute to unlearn it."""
    assert made.recording.hall is not None
    hall = made.recording.hall.copy()
    hall[500:700] = hall[500]
    whole, series = (WAYS[way](made.robot).run(r) for r in (made.recording, replace(made.recording, hall=hall)))
    assert (series.status[600:700] & Status.DISTURBED).any(axis=0).all()
    assert not (series.status[700:] & Status.DISTURBED).any()
    assert degrees(series, made)[500:700].max() < 3.0
    late = slice(900, None)
    assert np.sqrt((degrees(series, made)[late] ** 2).mean()) < 2.0 * np.sqrt((degrees(whole, made)[late] ** 2).mean())


@pytest.mark.parametrize("way", WAYS)
def test_a_filter_that_is_led_out_of_the_range_of_its_hall_sensors_comes_back(
    way: str, made: exoshell.ExoshellRecording
) -> None:
    """There the curve is flat: a linear step would never find back."""
    gyro = {name: rates.copy() for name, rates in made.recording.gyro.items()}
    generator = np.random.default_rng(5)
    gyro["imu_3"][500:650] = np.array([3.0, -3.0, 0.0]) + generator.normal(0.0, 0.01, (150, 3))
    series = WAYS[way](made.robot).run(replace(made.recording, gyro=gyro))
    found = degrees(series, made)
    assert np.sqrt((found[850:] ** 2).mean()) < 3.0
    assert np.isfinite(series.position).all()


def test_a_gyro_that_starts_again_in_the_middle_says_that_it_knows_nothing(made: exoshell.ExoshellRecording) -> None:
    frames = list(made.recording.part(0, 300).frames())
    frames[200] = replace(frames[200], reset=True)
    estimator = Gyro(made.robot)
    estimates = [estimator.update(frame) for frame in frames]
    assert max(estimates[199].variance) < math.radians(5.0) ** 2
    assert min(estimates[299].variance) > 1.0
    again = Gyro(made.robot).run(Recording.from_frames(frames))
    np.testing.assert_allclose(again.variance[299], estimates[299].variance)


def test_hall_readings_that_stand_still_with_the_joint_are_believed() -> None:
    """However long, to the last bit, and while the filter still moves towards them."""
    robot = exoshell.exoshell("bench")
    volts = tuple(float(sensor.voltage(math.radians(40.0))) for sensor in robot.hall)
    gyro = dict.fromkeys(exoshell.GYROS, (0.0, 0.0, 0.0))
    estimator = Kckf(robot)
    estimates = [estimator.update(Frame(k * 10 * MS, gyro, hall=volts)) for k in range(3000)]
    assert not any(flags & Status.DISTURBED for estimate in estimates for flags in estimate.status)


# ---------------------------------------------------------------- the hinge of pcf


def test_a_hinge_that_is_sure_of_a_wrong_angle_returns_within_two_seconds() -> None:
    """A gyro that was wrong for two seconds by no bias that a filter would expect."""
    robot, recording, truth = swing(lambda time: 0.3 * np.sin(time), seconds=20.0, parent=rest, seed=3)
    wrong = recording.gyro["link"].copy()
    axis = np.array(robot.joints[0].axes[0])
    wrong[800:1000] += math.radians(60.0) * axis
    estimator = Pcf(robot, PcfParams(still_start=0.0))
    series = estimator.run(replace(recording, gyro={**recording.gyro, "link": wrong}))
    found = np.degrees(np.abs(series.position - truth)).max(axis=1)
    assert found[950] > 10.0
    assert found[1200:].max() < 1.0


# ---------------------------------------------------------------- accelerometer arrays


@pytest.mark.parametrize("seed", [1, 2])
def test_what_a_frozen_accelerometer_taught_is_forgotten_when_it_returns(seed: int) -> None:
    """With one sensor on a link, motion and biases cannot be told apart: what it learned then is wrong."""
    made = two_link_arm.simulate("ramp", duration_s=15.0, seed=seed)
    accel = made.recording.accel["b2"].copy()
    accel[400:1000] = accel[400]
    recording = replace(made.recording, accel={**made.recording.accel, "b2": accel})
    estimator = AccelEkf(made.robot, AccelEkfParams(snap_density=1e6))
    series = estimator.run(recording)
    found = np.degrees(np.abs(series.position - made.truth_position))
    assert (series.status[500:900] & Status.DISTURBED).any()
    assert found[1050:].max() < 3.0
    assert (found[1050:] < 4.0 * np.degrees(np.sqrt(series.variance[1050:]))).all()

    half = AccelEkf(made.robot, estimator.params)  # a state in the middle of it is a whole one
    half.run(recording.part(0, 700))
    again = AccelEkf(made.robot, estimator.params)
    again.set_state(json.loads(json.dumps(half.get_state())))
    np.testing.assert_array_equal(again.run(recording.part(700, 1200)).position, series.position[700:1200])
