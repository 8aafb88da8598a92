"""A warm start: biases and zero poses of an earlier run are a prior, and only where they fit."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Recording, Series, Status
from jointest_ros.core.learned import GYRO_DRIFT, Learned, fingerprint
from jointest_ros.core.robot import Robot
from jointest_ros.sim.scenarios import SCENARIOS


@dataclass(frozen=True)
class Case:
    """An estimator with parameters on a rig."""

    estimator: str
    rig: str
    options: dict[str, Any]
    params: dict[str, Any]


FINGER = {"scenario": "PC", "rate_hz": 100.0, "duration_s": 6.0, "zero_pose_s": 2.0, "seed": 5}
BENCH = {"scenario": "bench", "rate_hz": 100.0, "duration_s": 6.0, "seed": 5}
ARM = {"scenario": "slow_periodic", "rate_hz": 100.0, "duration_s": 6.0, "seed": 5, "sensor": "adxl345"}
CASES = {
    "hinge": Case("pcf", "finger", FINGER, {}),
    "relative": Case("pcf", "finger", FINGER, {"formulation": "relative"}),
    "absolute": Case("pcf", "finger", FINGER, {"formulation": "absolute"}),
    "gyro": Case("gyro", "finger", FINGER, {}),
    "kf": Case("kf", "exoshell", BENCH, {}),
    "kckf": Case("kckf", "exoshell", BENCH, {}),
    "kckf, offsets": Case("kckf", "exoshell", BENCH, {"hall_offset": True}),
    "kckf, off axis": Case("kckf", "exoshell", BENCH, {"off_axis": True}),
    "accel_ekf": Case("accel_ekf", "two_link_arm", ARM, {}),
}


@cache
def simulated(name: str) -> tuple[Robot, Recording]:
    case = CASES[name]
    rig = SCENARIOS[case.rig]
    parts = list(rig.stretches(rig.options(**case.options)))
    return parts[0].robot, Recording.concatenate([part.recording for part in parts])


def make(name: str, robot: Robot | None = None, **params: Any) -> Estimator:
    case = CASES[name]
    kind = ESTIMATORS[case.estimator]
    return kind(robot or simulated(name)[0], kind.Params.from_mapping({**case.params, **params}))


def by_update(estimator: Estimator, recording: Recording) -> Series:
    return Series.from_estimates([estimator.update(frame) for frame in recording.frames()], len(estimator.joints))


@cache
def taught(name: str) -> Learned:
    """What a first run over the recording leaves."""
    estimator = make(name)
    for number, frame in enumerate(simulated(name)[1].frames()):
        estimator.update(frame)
        if number == 150 and hasattr(estimator, "calibrate_gyro_bias"):
            estimator.calibrate_gyro_bias()
    learned = estimator.learned()
    assert learned is not None
    return replace(learned, saved="today")


def warm(name: str, learned: Learned | None = None, **params: Any) -> Estimator:
    robot = simulated(name)[0]
    return make(name, replace(robot, learned={CASES[name].estimator: learned or taught(name)}), **params)


def rest(name: str) -> Recording:
    """The recording without its still start."""
    recording = simulated(name)[1]
    return recording.part(250, len(recording))


@pytest.mark.parametrize("name", CASES)
def test_a_second_run_begins_with_the_biases_of_the_first(name: str) -> None:
    estimator, learned = warm(name), taught(name)
    assert not estimator.unfit
    first = estimator.biases()
    assert first != make(name).biases()
    if name not in ("hinge", "relative", "absolute"):  # they tell what follows from the biases of the sensors
        for key, (value, deviation) in learned.biases.items():
            assert first[key] == value or (first[key] == 0.0 and deviation > 0.1)  # it did not know more than a start
    for frame in rest(name).part(0, 100).frames():
        estimator.update(frame)
    estimator.reset()
    again = estimator.learned()
    assert again is None or again.biases == getattr(warm(name).learned(), "biases", None)
    fresh = warm(name)
    np.testing.assert_array_equal(estimator.run(rest(name)).position, fresh.run(rest(name)).position)


@pytest.mark.parametrize("name", CASES)
def test_by_arrays_and_one_by_one_are_the_same(name: str) -> None:
    one, other = warm(name).run(rest(name)), by_update(warm(name), rest(name))
    np.testing.assert_allclose(one.position, other.position, rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(one.status, other.status)


@pytest.mark.parametrize("name", [name for name in CASES if "accel" not in name])
def test_the_prior_is_wider_than_what_was_known_and_is_refined(name: str) -> None:
    """The biases may have drifted: right after the start the angle's variance grows with that uncertainty."""
    estimator = warm(name, still_start=0.0) if CASES[name].estimator == "pcf" else warm(name)
    again = by_update(estimator, rest(name)) and estimator.learned()
    assert again is not None
    for key, (_, deviation) in taught(name).biases.items():
        value, now = again.biases[key]
        assert math.isfinite(value)
        assert now <= math.hypot(deviation, math.sqrt(2.0) * GYRO_DRIFT) + 1e-12


def test_a_warm_start_in_motion_is_better_than_a_cold_one_also_after_some_drift() -> None:
    """The rates of a finger that moves from the first frame on, against the run that began at rest."""
    truth = make("hinge").run(simulated("hinge")[1]).velocity[250:]
    drifted = taught("hinge")
    shift = {
        key: (value + 0.3 * GYRO_DRIFT * (-1.0) ** k, std)
        for k, (key, (value, std)) in enumerate(drifted.biases.items())
    }

    def error(estimator: Estimator) -> float:
        return float(np.sqrt(np.mean((estimator.run(rest("hinge")).velocity - truth)[:100] ** 2)))

    cold = error(make("hinge"))
    assert error(warm("hinge")) < 0.75 * cold
    assert error(warm("hinge", replace(drifted, biases=shift))) < 0.75 * cold


def test_a_wrong_prior_is_found_out() -> None:
    """Biases that are off by 3 sigma: the hinge filter comes back to what the cold one has."""
    wrong = {
        key: (value + (3.0 * GYRO_DRIFT if key.startswith("middle") else 0.0), std)
        for key, (value, std) in taught("hinge").biases.items()
    }
    estimator = warm("hinge", replace(taught("hinge"), biases=wrong), still_start=0.0)
    expected = make("hinge").run(simulated("hinge")[1]).position[-100:]
    np.testing.assert_allclose(estimator.run(rest("hinge")).position[-100:], expected, rtol=0.0, atol=np.radians(0.5))


def test_a_still_start_measures_anew() -> None:
    for name in ("hinge", "relative", "absolute"):
        estimator = warm(name)
        assert not any(flags & Status.UNCALIBRATED for flags in by_update(estimator, rest(name)).status.ravel())
        again = warm(name)
        again.run(simulated(name)[1].part(0, 200))
        learned = again.learned()
        assert learned is not None
        assert learned.saved == ""  # of this run
        assert warm(name).learned() == replace(taught(name), zero=learned.zero)  # nothing new


@pytest.mark.parametrize("name", ["hinge", "relative", "absolute"])
def test_zero_poses_last(name: str) -> None:
    first, recording = make(name), simulated(name)[1]
    for number, frame in enumerate(recording.frames()):
        first.update(frame)
        if number == 180:
            first.calibrate_zero()  # type: ignore[attr-defined]
    learned = first.learned()
    assert learned is not None
    assert set(learned.zero) == set(first.joints)
    second = warm(name, learned)
    known = second.learned()
    assert known is not None
    assert known.zero == learned.zero
    assert not make(name, zero_at_start=True).unfit
    at_start = warm(name, learned, zero_at_start=True)  # which takes one at each start, and leaves none
    assert at_start.learned() == replace(learned, zero={})


def changed_robots(robot: Robot) -> dict[str, Robot]:
    sensor, joint = robot.sensors[1], robot.joints[0]
    turned = replace(sensor, mounting=(0.0, 0.0, math.sin(0.01), math.cos(0.01)))
    scaled = replace(sensor, gyro_scale=(1.0, 1.01, 1.0))
    offset = replace(sensor, accel_offset=(0.1, 0.0, 0.0))
    other = [replace(robot, sensors=(robot.sensors[0], one, *robot.sensors[2:])) for one in (turned, scaled, offset)]
    axis = replace(joint, axes=(tuple(-a for a in joint.axes[0]),))  # type: ignore[arg-type]
    return dict(zip(("mounting", "scale", "offset"), other, strict=True)) | {
        "axis": replace(robot, joints=(axis, *robot.joints[1:]))
    }


@pytest.mark.parametrize("what", ["mounting", "scale", "offset", "axis"])
def test_what_was_learned_on_another_robot_does_not_count(what: str) -> None:
    robot = changed_robots(simulated("hinge")[0])[what]
    assert fingerprint(robot) != fingerprint(simulated("hinge")[0])
    estimator = make("hinge", replace(robot, learned={"pcf": taught("hinge")}))
    assert estimator.biases() == make("hinge").biases()
    (warning,) = estimator.warnings()
    assert "~/save_calibration" in warning
    assert "\n" not in warning


def test_what_was_learned_with_other_parameters_does_not_count() -> None:
    learned = taught("kckf")
    assert warm("kckf, offsets", learned).unfit
    zeroed = replace(taught("hinge"), zero={"finger_mcp": (0.1,)})
    assert not warm("hinge", zeroed).unfit
    assert warm("relative", zeroed).unfit


def test_noise_and_limits_do_not_count() -> None:
    robot = simulated("hinge")[0]
    other = replace(robot, sensors=tuple(replace(s, gyro_noise=1.0, topic="x" + s.name) for s in robot.sensors))
    assert fingerprint(other) == fingerprint(robot)


@pytest.mark.parametrize("name", ["hall", "accel_analytical", "accel_ukf"])
def test_some_learn_nothing(name: str) -> None:
    assert ESTIMATORS[name].learned is Estimator.learned


def test_nothing_is_learned_before_the_biases_are_measured() -> None:
    for name in ("hinge", "gyro"):
        estimator = make(name)
        estimator.run(rest(name))
        assert estimator.learned() is None
