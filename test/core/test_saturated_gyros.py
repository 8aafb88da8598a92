"""A gyro at the end of its range: counted, told of, and not trusted silently."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pcf_swing import rest, swing

from jointest_ros.core.assembler import FrameAssembler
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import FloatArray, Recording, Series, Status
from jointest_ros.core.kckf.gyro import Gyro
from jointest_ros.core.kckf.kckf import Kckf, KckfParams
from jointest_ros.core.kckf.kf import Kf
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.robot import Robot, Sensor
from jointest_ros.core.saturated_gyros import SaturatedGyros
from jointest_ros.sim import exoshell

MS = 1_000_000
RANGE = 2.0  # rad/s

WAYS: dict[str, Callable[[Robot], Estimator]] = {
    "gyro": Gyro,
    "kf": Kf,
    "kckf": Kckf,
    "kckf offset": lambda robot: Kckf(robot, KckfParams(hall_offset=True)),
    "kckf off axis": lambda robot: Kckf(robot, KckfParams(off_axis=True)),
    "pcf": Pcf,
    "pcf relative": lambda robot: Pcf(robot, PcfParams(formulation="relative")),
    "pcf absolute": lambda robot: Pcf(robot, PcfParams(formulation="absolute")),
}
Case = tuple[Robot, Recording, FloatArray]


def with_range(robot: Robot, full_scale: float) -> Robot:
    return replace(robot, sensors=tuple(replace(sensor, gyro_range=full_scale) for sensor in robot.sensors))


@pytest.fixture(scope="module")
def cases() -> dict[str, Case]:
    """A swing at up to 4 rad/s in the middle, for IMUs and for gyros with Hall sensors."""

    def angle(time: FloatArray) -> FloatArray:
        return np.where((time > 4.0) & (time < 6.0), 0.6 * (1.0 - np.cos(2.0 * math.pi * (time - 4.0))), 0.0)

    hinge = swing(angle, seconds=12.0, parent=rest, seed=2)
    made = exoshell.simulate("composed", duration_s=12.0, rate_hz=100.0, seed=4)
    return {"hinge": hinge, "exoshell": (made.robot, made.recording, made.truth_position)}


def case_of(way: str, cases: dict[str, Case]) -> Case:
    return cases["hinge" if way.startswith("pcf") else "exoshell"]


def fast(recording: Recording, limit: float) -> FloatArray:
    """Rows in which any gyro is at the limit."""
    return np.any([(np.abs(rates) >= 0.99 * limit).any(axis=1) for rates in recording.gyro.values()], axis=0)


@pytest.mark.parametrize("way", WAYS)
def test_a_joint_says_so_and_its_variance_grows(way: str, cases: dict[str, Case]) -> None:
    robot, recording, _ = case_of(way, cases)
    limit = 0.6 * max(np.abs(rates).max() for rates in recording.gyro.values())
    gyro = {name: np.clip(rates, -limit, limit) for name, rates in recording.gyro.items()}
    recording = replace(recording, gyro=gyro)
    known, unknown = (WAYS[way](with_range(robot, one)).run(recording) for one in (limit, math.inf))
    at_limit = fast(recording, limit)
    assert 10 < at_limit.sum() < len(recording) / 2
    disturbed = (known.status & Status.DISTURBED).any(axis=1)
    np.testing.assert_array_equal(disturbed, at_limit)
    assert not (unknown.status & Status.DISTURBED).any()
    first = int(np.flatnonzero(at_limit)[0])
    np.testing.assert_array_equal(known.position[:first], unknown.position[:first])
    grown = known.variance[at_limit].max() / unknown.variance[at_limit].max()
    assert grown > 3.0


@pytest.mark.parametrize("way", WAYS)
def test_steps_are_the_same_as_arrays_and_a_state_in_the_middle_is_whole(way: str, cases: dict[str, Case]) -> None:
    robot, recording, _ = case_of(way, cases)
    limit = 0.6 * max(np.abs(rates).max() for rates in recording.gyro.values())
    recording = replace(recording, gyro={name: np.clip(rates, -limit, limit) for name, rates in recording.gyro.items()})
    robot = with_range(robot, limit)
    whole = WAYS[way](robot).run(recording)
    one = WAYS[way](robot)
    single = Series.from_estimates([one.update(frame) for frame in recording.frames()], len(one.joints))
    middle = int(np.flatnonzero(fast(recording, limit))[5])
    half, again = WAYS[way](robot), WAYS[way](robot)
    half.run(recording.part(0, middle))
    again.set_state(json.loads(json.dumps(half.get_state())))
    rest_of_it = again.run(recording.part(middle, len(recording)))
    for name in ("position", "variance", "status"):
        np.testing.assert_allclose(getattr(single, name), getattr(whole, name), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(getattr(rest_of_it, name), getattr(whole, name)[middle:], rtol=1e-9, atol=1e-12)


def test_the_error_that_it_hides_is_within_what_is_stated(cases: dict[str, Case]) -> None:
    robot, recording, truth = cases["hinge"]
    gyro = {name: np.clip(rates, -RANGE, RANGE) for name, rates in recording.gyro.items()}
    recording = replace(recording, gyro=gyro)
    errors = {}
    for name, full_scale in (("known", RANGE), ("unknown", math.inf)):
        series = Pcf(with_range(robot, full_scale)).run(recording)
        error = np.abs(series.position - truth.reshape(series.position.shape))
        errors[name] = float((error / np.sqrt(series.variance)).max())
        after = float(error[900:].max())
        assert after < math.radians(1.0) or name == "unknown"
    assert errors["known"] < 4.0 < errors["unknown"]


def test_the_limit_is_that_of_the_raw_reading_of_each_axis() -> None:
    sensor = Sensor("a", "one", gyro_range=2.0, gyro_scale=(0.5, 1.0, 2.0))
    gyros = SaturatedGyros([sensor, Sensor("b", "two")], 1.0)
    assert gyros
    assert not SaturatedGyros([Sensor("b", "two")], 1.0)
    for axis, limit in enumerate((0.99, 1.98, 3.96)):
        for sign in (-1.0, 1.0):
            below, at = [0.0] * 3, [0.0] * 3
            below[axis], at[axis] = sign * 0.999 * limit, sign * limit * 1.0001
            assert not gyros.any({"a": (below[0], below[1], below[2])})
            assert gyros.any({"a": (at[0], at[1], at[2]), "b": (9.0, 9.0, 9.0)})
    rows = np.array([[0.5, 1.0, 1.0], [np.nan] * 3, [0.99, 0.0, 0.0]])
    np.testing.assert_array_equal(gyros.rows({"a": rows}, 3), [False, False, True])


def test_every_saturated_sample_of_a_gyro_is_counted() -> None:
    sensors = [Sensor("a", "one", gyro_range=2.0, accel_range=20.0), Sensor("b", "two", gyro_range=2.0, accel=False)]
    assembler = FrameAssembler(sensors)
    for k in range(100):
        rate = min(2.0, 0.03 * k)
        assembler.add_imu("a", k * 10 * MS, (0.5, -rate, 0.9), (0.0, 0.0, 9.81))
        assembler.add_imu("b", k * 10 * MS, (1.5, 1.5, 1.4 + 0.001 * k), (math.nan, math.nan, math.nan))
    assembler.flush()
    expected = sum(0.03 * k >= 1.98 for k in range(100))
    assert assembler.quality.saturated == {"a": 0, "a gyro": expected, "b gyro": 0}
    assert assembler.sources["b"].used == 100
    (text,) = [one for one in assembler.quality.summary({"a": 100, "b": 100}) if "saturated" in one]
    assert text == f"a gyro: {expected} samples saturated at the full scale of 114.6 deg/s, {expected}.0% of all"
