"""`kckf`, `kf`, `gyro` and `hall` as estimators: arrays and loop, states, faults in the data, status, refusals."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, Frame, Recording, Series, Status
from jointest_ros.core.kckf.gyro import Gyro, GyroParams
from jointest_ros.core.kckf.hall import Hall, HallParams
from jointest_ros.core.kckf.kckf import PAPER, Kckf, KckfParams
from jointest_ros.core.kckf.kf import Kf
from jointest_ros.core.robot import Joint, Robot
from jointest_ros.core.timing import Timing
from jointest_ros.sim import exoshell

Make = Callable[[Robot], Estimator]
WAYS: dict[str, Make] = {
    "kckf": Kckf,
    "kckf additive": lambda robot: Kckf(robot, KckfParams(kinematics="additive")),
    "kckf paper": lambda robot: Kckf(robot, PAPER),
    "kckf offset": lambda robot: Kckf(robot, KckfParams(hall_offset=True)),
    "kckf constant": lambda robot: Kckf(robot, KckfParams(hall_noise="constant")),
    "kckf off axis": lambda robot: Kckf(robot, KckfParams(off_axis=True)),
    "kckf off axis offset": lambda robot: Kckf(robot, KckfParams(off_axis=True, hall_offset=True)),
    "kf": Kf,
    "kf paper": lambda robot: Kf(robot, Kf.Params(noise="paper", hall_noise="constant", kinematics="additive")),
    "gyro": Gyro,
    "gyro additive": lambda robot: Gyro(robot, GyroParams(kinematics="additive")),
    "hall": Hall,
    "hall first": lambda robot: Hall(robot, HallParams(sensor=1)),
}
KCKF = ("kckf", "kckf paper", "kckf offset", "kckf off axis")
X, Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def universal(robot: Robot) -> Robot:
    """The same links with two joints of two axes each: what the exoshell's four hinges are to three links."""
    joints = (
        Joint("joint_a", "link_1", "link_3", (X, Y)),
        Joint("joint_b", "link_3", "link_5", (X, Y)),
        Joint("unused_1", "link_1", "link_2", (X,)),
        Joint("unused_2", "link_3", "link_4", (X,)),
    )
    names = ("joint_a_x", "joint_a_y", "joint_b_x", "joint_b_y")
    hall = tuple(replace(sensor, joint=names[k // 2]) for k, sensor in enumerate(robot.hall))
    return replace(robot, joints=joints, hall=hall)


@pytest.fixture(scope="module")
def made() -> exoshell.ExoshellRecording:
    return exoshell.simulate("composed-free", duration_s=7.0, seed=2)


def faulty(recording: Recording) -> Recording:
    """Jittered stamps, lost frames and samples, a silent gyro, silent Hall sensors, a gap, a restart."""
    rng = np.random.default_rng(0)
    assert recording.hall is not None
    gyro = {name: rates.copy() for name, rates in recording.gyro.items()}
    hall = recording.hall.copy()
    stamps = recording.stamps + rng.integers(-1_000_000, 1_000_000, len(recording))
    for rates in gyro.values():
        rates[rng.random(len(rates)) < 0.01] = np.nan
    gyro["imu_2"][150:230] = np.nan
    gyro["imu_4"][250:260, 1] = np.nan  # one component is enough
    hall[rng.random(len(hall)) < 0.02] = np.nan
    hall[:, 3][rng.random(len(hall)) < 0.05] = np.nan
    hall[300:400] = np.nan
    hall[50:60, 0] = 1.79985
    kept = np.flatnonzero(rng.random(len(recording)) > 0.02)
    kept = kept[(kept < 450) | (kept >= 490)]
    reset = np.zeros(len(recording), dtype=bool)
    reset[600] = True
    kept = np.union1d(kept, [600])
    assert recording.period is not None
    return Recording(
        stamps[kept],
        {name: rates[kept] for name, rates in gyro.items()},
        {},
        hall=hall[kept],
        period=recording.period[kept],
        reset=reset[kept],
    )


def loop(estimator: Estimator, recording: Recording) -> Series:
    return Series.from_estimates([estimator.update(frame) for frame in recording.frames()], len(estimator.joints))


def assert_equal(a: Series, b: Series, tolerance: float = 1e-9) -> None:
    for name in ("position", "velocity", "variance", "torso", "torso_orientation"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), abs=tolerance), name
    assert (a.status == b.status).all()


@pytest.mark.parametrize("shape", [lambda robot: robot, universal], ids=["hinges", "universal"])
@pytest.mark.parametrize("way", WAYS)
def test_arrays_equal_the_loop(made: exoshell.ExoshellRecording, way: str, shape: Callable[[Robot], Robot]) -> None:
    robot, recording = shape(made.robot), faulty(made.recording)
    looped = WAYS[way](robot)
    by_arrays = WAYS[way](robot)
    whole = loop(looped, recording)
    stretches = [recording.part(start, start + 133) for start in range(0, len(recording), 133)]
    assert_equal(Series.concatenate([by_arrays.run(part) for part in stretches]), whole)
    assert by_arrays.covariance() == pytest.approx(looped.covariance(), abs=1e-12)
    assert by_arrays.biases() == pytest.approx(looped.biases(), abs=1e-12)
    assert np.isfinite(whole.position).all() and (whole.variance >= 0.0).all()


@pytest.mark.parametrize("way", WAYS)
def test_a_restored_state_continues_identically(made: exoshell.ExoshellRecording, way: str) -> None:
    recording = faulty(made.recording)
    estimator, other = WAYS[way](made.robot), WAYS[way](made.robot)
    estimator.run(recording.part(0, 160))
    state = json.loads(json.dumps(estimator.get_state()))
    other.set_state(state)
    rest = recording.part(160, len(recording))
    assert_equal(other.run(rest), estimator.run(rest))
    assert other.biases() == pytest.approx(estimator.biases(), abs=1e-12)


@pytest.mark.parametrize("way", WAYS)
def test_reset_forgets_everything(made: exoshell.ExoshellRecording, way: str) -> None:
    estimator = WAYS[way](made.robot)
    first = estimator.run(made.recording)
    estimator.reset()
    assert_equal(estimator.run(made.recording), first, 0.0)


@pytest.mark.parametrize("way", WAYS)
def test_no_rows_give_no_rows(made: exoshell.ExoshellRecording, way: str) -> None:
    series = WAYS[way](made.robot).run(made.recording.part(0, 0))
    assert series.position.shape == (0, 4)


# ------------------------------------------------------------- faults


def degrees(series: Series, made: exoshell.ExoshellRecording) -> Any:
    return np.degrees(series.position - made.truth_position)


@pytest.mark.parametrize("way", ["kckf", "kckf offset", "kckf off axis"])
def test_lost_samples_and_frames_cost_little(way: str) -> None:
    whole = exoshell.simulate("composed-free", duration_s=40.0, seed=3)
    rng = np.random.default_rng(1)
    gyro = {name: rates.copy() for name, rates in whole.recording.gyro.items()}
    for rates in gyro.values():
        rates[rng.random(len(rates)) < 0.01] = np.nan
    kept = rng.random(len(whole.recording)) > 0.01
    kept[0] = True
    assert whole.recording.hall is not None and whole.recording.period is not None
    part = Recording(
        whole.recording.stamps[kept],
        {name: rates[kept] for name, rates in gyro.items()},
        {},
        hall=whole.recording.hall[kept],
        period=whole.recording.period[kept],
    )
    error = np.degrees(WAYS[way](whole.robot).run(part).position - whole.truth_position[kept])[1000:]
    assert np.sqrt((error**2).mean(axis=0)).max() < 0.12


@pytest.mark.parametrize("way", KCKF)
def test_a_silent_gyro_leaves_its_joints_to_the_hall_sensors(way: str) -> None:
    made = exoshell.simulate("composed", duration_s=30.0, seed=6)
    quiet = made.recording.gyro["imu_5"].copy()
    quiet[1500:2200] = np.nan
    recording = replace(made.recording, gyro={**made.recording.gyro, "imu_5": quiet})
    estimator = WAYS[way](made.robot)
    series = estimator.run(recording)
    error = np.abs(degrees(series, made))
    usual = 2.0 if way == "kckf paper" else 0.6
    assert error[1000:, :3].max() < usual  # the others do not notice
    assert error[1530:2200, 3].max() < (20.0 if way == "kckf paper" else 8.0)
    assert error[2700:, 3].max() < usual  # it recovers by itself
    silent = series.status[1600:2200, 3]
    assert (silent & Status.NO_DATA).all() and (silent & Status.STALE)[-1] and not (silent & Status.STARTING).any()
    assert (series.status[1600:2200, :3] == 0).all() and (series.status[2201:] == 0).all()
    assert series.variance[2100, 3] > 10.0 * series.variance[1400, 3]
    if way != "kckf paper":
        squared = error[1550:2200, 3] ** 2 / np.degrees(np.degrees(series.variance[1550:2200, 3]))
        assert squared.mean() < 2.0


@pytest.mark.parametrize("way", KCKF)
def test_without_hall_sensors_the_gyros_carry_on(way: str) -> None:
    made = exoshell.simulate("composed", duration_s=30.0, seed=6)
    assert made.recording.hall is not None
    hall = made.recording.hall.copy()
    hall[2000:2500] = np.nan
    series = WAYS[way](made.robot).run(replace(made.recording, hall=hall))
    assert np.abs(degrees(series, made)[1000:]).max() < (3.0 if way == "kckf paper" else 1.0)
    gone = series.status[2000:2500]
    assert (gone & Status.NO_DATA).all()
    assert not (gone[:49] & Status.UNOBSERVABLE).any() and (gone[51:] & Status.UNOBSERVABLE).all()
    assert (series.variance[2499] > series.variance[1999]).all()
    assert (series.status[2501:] == 0).all()


@pytest.mark.parametrize("way", KCKF)
def test_a_gap_is_predicted_over_with_grown_variance(way: str) -> None:
    made = exoshell.simulate("composed", duration_s=30.0, seed=6)
    recording = Recording.from_frames([f for k, f in enumerate(made.recording.frames()) if not 2000 <= k < 2050])
    estimator = WAYS[way](made.robot)
    series = estimator.run(recording)
    assert (series.status[2000] & Status.GAP).all() and not (series.status[:2000] & Status.GAP).any()
    assert (series.variance[2000] > series.variance[1999]).all()
    error = np.degrees(series.position - np.delete(made.truth_position, range(2000, 2050), axis=0))
    spread = np.degrees(np.sqrt(series.variance))
    assert (np.abs(error[2000:2100]) < 5.0 * spread[2000:2100] + 0.5).all()
    assert np.abs(error[2500:]).max() < (2.0 if way == "kckf paper" else 1.0)


def test_jittered_stamps_are_taken_as_they_are() -> None:
    """The gyro sample holds for the interval between the stamps."""
    made = exoshell.simulate("composed", duration_s=30.0, seed=6)
    steady = Kckf(made.robot).run(made.recording)
    thinned = Recording.from_frames([f for k, f in enumerate(made.recording.frames()) if k % 3])
    thinned.period = np.full(len(thinned), math.nan)
    thinned.gyro = {
        name: (np.cumsum(rates, axis=0)[np.arange(len(rates)) % 3 > 0]) for name, rates in made.recording.gyro.items()
    }
    steps = np.diff(thinned.stamps)[:, None] / 1e7
    thinned.gyro = {name: np.vstack([sums[:1], np.diff(sums, axis=0) / steps]) for name, sums in thinned.gyro.items()}
    error = np.degrees(Kckf(made.robot).run(thinned).position - made.truth_position[np.arange(3000) % 3 > 0])
    assert np.sqrt((error[1000:] ** 2).mean()) < 1.5 * np.sqrt((degrees(steady, made)[1000:] ** 2).mean())


@pytest.mark.parametrize("way", KCKF)
def test_a_restart_keeps_what_is_known_of_the_sensors(made: exoshell.ExoshellRecording, way: str) -> None:
    estimator = WAYS[way](made.robot)
    estimator.run(made.recording)
    biases, covariance = estimator.biases(), estimator.covariance()
    frame = next(made.recording.part(600, 601).frames())
    estimate = estimator.update(replace(frame, stamp=10, reset=True))
    assert estimator.biases() == pytest.approx(biases, abs=np.radians(0.3))
    assert (np.diag(estimator.covariance()) > 10.0 * np.diag(covariance)).all()
    assert not any(status & (Status.GAP | Status.STARTING) for status in estimate.status)
    assert estimate.position == pytest.approx(made.truth_position[600].tolist(), abs=np.radians(10.0))


@pytest.mark.parametrize("way", ["kckf", "kckf offset"])
@pytest.mark.parametrize("start", [-45.0, 50.0])
def test_a_start_far_from_zero_is_found_within_a_second(way: str, start: float) -> None:
    """The curve bends within the prior: one linear step would miss by far."""
    robot = exoshell.exoshell("bench")
    angle = np.radians([start, 0.0, 0.0, 0.0])
    volts = [float(sensor.voltage(angle[k // 2])) for k, sensor in enumerate(robot.hall)]
    gyro = dict.fromkeys(exoshell.GYROS, (0.0, 0.0, 0.0))
    estimator = WAYS[way](robot)
    angles = [
        np.degrees(estimator.update(Frame(k * 10_000_000, gyro, hall=tuple(volts))).position[0]) for k in range(100)
    ]
    assert angles[0] == pytest.approx(start, abs=20.0)  # the prior, 10 deg about 0, still counts
    if way == "kckf":
        assert angles[-1] == pytest.approx(start, abs=0.5)
    else:  # a joint that stands still does not tell offsets from angle
        assert angles[-1] == pytest.approx(start, abs=12.0)


@pytest.mark.parametrize("way", ["kckf", "kckf offset", "kckf off axis"])
@pytest.mark.parametrize("seed", range(5))
def test_angles_are_found_again_after_a_gap_in_which_they_may_have_been_anything(way: str, seed: int) -> None:
    made = exoshell.simulate("composed-free" if way == "kckf off axis" else "clipped", duration_s=12.0, seed=seed)
    kept = np.r_[0:500, 530 + 40 * seed : 1200]
    recording = Recording.from_frames([f for k, f in enumerate(made.recording.frames()) if k in set(kept.tolist())])
    error = np.degrees(WAYS[way](made.robot).run(recording).position - made.truth_position[kept])
    assert np.abs(error[500:]).max() < 20.0
    assert np.abs(error[600:]).max() < 2.5


def test_clipped_readings_are_gated_and_counted() -> None:
    made = exoshell.simulate("clipped", duration_s=20.0)
    assert made.recording.hall is not None
    for params in (KckfParams(), KckfParams(hall_offset=True)):
        estimator = Kckf(made.robot, params)
        estimator.run(made.recording)
        usable = np.column_stack([s.usable(made.recording.hall[:, k]) for k, s in enumerate(made.robot.hall)])
        assert estimator.gated() == (~usable).sum(axis=0).tolist()
        assert sum(estimator.gated()) > 100


def test_voltages_outside_the_sensor_s_range_are_refused_even_by_the_paper_s_noise() -> None:
    made = exoshell.simulate("clipped", duration_s=20.0)
    assert made.recording.hall is not None
    wild = made.recording.hall.copy()
    wild[500:600, 2] = 0.01  # a loose wire: -210 000 deg by (1)
    estimator = Kckf(made.robot, PAPER)
    series = estimator.run(replace(made.recording, hall=wild))
    assert np.abs(degrees(series, made)).max() < 20.0
    assert estimator.gated() == [0, 0, 100, 0, 0, 0, 0, 0]


def test_status_of_a_joint_of_which_no_reading_can_be_used() -> None:
    robot = exoshell.exoshell("clipped")
    gyro = dict.fromkeys(exoshell.GYROS, (0.0, 0.0, 0.0))
    rails = (1.79985, 1.79985, *(1.3,) * 6)
    for params in (KckfParams(), KckfParams(hall_offset=True)):
        estimator = Kckf(robot, params)
        first = estimator.update(Frame(0, gyro, hall=rails))
        assert first.status == (Status.DISTURBED | Status.STARTING, 0, 0, 0)
        later = [estimator.update(Frame(k * 10_000_000, gyro, hall=rails)) for k in range(1, 100)][-1]
        assert later.status[0] == Status.DISTURBED | Status.STARTING | Status.UNOBSERVABLE


# ------------------------------------------------------------- results


def test_innovations_are_white_and_normalised(made: exoshell.ExoshellRecording) -> None:
    for params in (KckfParams(), KckfParams(hall_offset=True)):
        estimator = Kckf(made.robot, params)
        rows = []
        for frame in made.recording.frames():
            estimator.update(frame)
            rows.append(estimator.innovations())
        innovations = np.array(rows)[200:]
        assert innovations.shape[1] == 8
        assert (innovations**2).sum(axis=1).mean() == pytest.approx(8.0, rel=0.1)


def test_neighbours_that_share_a_gyro_are_correlated() -> None:
    made = exoshell.simulate("monte-carlo", duration_s=20.0)
    estimator = Kckf(made.robot)
    estimator.run(made.recording)
    covariance = estimator.covariance()
    assert covariance[0, 1] < 0.0 and covariance == pytest.approx(covariance.T, abs=0.0)
    alone = Kf(made.robot)
    alone.run(made.recording)
    assert alone.covariance() == pytest.approx(np.diag(np.diag(alone.covariance())), abs=0.0)


def test_biases_are_found_and_named() -> None:
    long = exoshell.simulate("composed-free", duration_s=60.0, seed=2)
    axis = (0, 1, 0, 1)
    truth = [
        float(long.gyro_bias[f"imu_{k + 2}"][-1, axis[k]] - long.gyro_bias[f"imu_{k + 1}"][-1, axis[k]])
        for k in range(4)
    ]
    for params in (KckfParams(), KckfParams(hall_offset=True)):
        estimator = Kckf(long.robot, params)
        estimator.run(long.recording)
        found = [estimator.biases()[f"joint_{k + 1}.gyro"] for k in range(4)]
        assert np.degrees(found) == pytest.approx(np.degrees(truth), abs=0.06)
    offsets = {name: value for name, value in estimator.biases().items() if "hall" in name}
    assert list(offsets)[:3] == ["joint_1.hall_1", "joint_1.hall_2", "joint_2.hall_1"] and len(offsets) == 8
    assert max(map(abs, offsets.values())) < 0.01


def test_offsets_of_the_sensors_are_found() -> None:
    made = exoshell.simulate("offset", duration_s=60.0)
    estimator = Kckf(made.robot, KckfParams(hall_offset=True, kinematics="additive"))
    estimator.run(made.recording)
    for k in range(1, 5):
        assert estimator.biases()[f"joint_{k}.hall_1"] == pytest.approx(-0.040, abs=0.002)
        assert estimator.biases()[f"joint_{k}.hall_2"] == pytest.approx(0.020, abs=0.002)


# ------------------------------------------------------------- refusals


def test_combinations_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="hall_offset: true is not allowed with hall_noise: constant"):
        KckfParams(hall_offset=True, hall_noise="constant")
    for other in ({"kinematics": "additive"}, {"noise": "paper"}):
        with pytest.raises(ConfigurationError, match="off_axis: true is not allowed"):
            KckfParams.from_mapping({"off_axis": True, **other})


@pytest.mark.parametrize("way", ["kckf", "kckf paper", "kf", "hall"])
def test_a_wrong_number_of_voltages_is_named(made: exoshell.ExoshellRecording, way: str) -> None:
    assert made.recording.hall is not None
    estimator = WAYS[way](made.robot)
    with pytest.raises(ConfigurationError, match="7 in a frame; the robot has 8"):
        estimator.run(replace(made.recording, hall=made.recording.hall[:, :7]))
    with pytest.raises(ConfigurationError, match="2 in a frame; the robot has 8"):
        estimator.update(Frame(0, hall=(1.0, 1.0)))


def test_missing_everything_is_no_error() -> None:
    for make in WAYS.values():
        estimator = make(exoshell.exoshell("bench"))
        for stamp in (0, 10_000_000, 20_000_000):
            estimate: Estimate = estimator.update(Frame(stamp))
        assert all(status & Status.NO_DATA for status in estimate.status)
        assert all(math.isfinite(v) for v in (*estimate.position, *estimate.velocity, *estimate.variance))


# ------------------------------------------------------------- gyro alone


def test_gyro_integrates_and_says_so(made: exoshell.ExoshellRecording) -> None:
    estimator = Gyro(made.robot)
    series = estimator.run(made.recording)
    assert (series.status == Status.UNOBSERVABLE | Status.UNCALIBRATED).all()
    error = series.position - made.truth_position
    assert (np.diff(series.variance, axis=0) > 0.0).all()
    assert (np.abs(error[-1]) < 4.0 * np.sqrt(series.variance[-1])).all()


def test_gyro_biases_are_calibrated_at_rest() -> None:
    made = exoshell.simulate("drift", duration_s=60.0)
    still = made.recording.part(600, 3000)
    estimator = Gyro(made.robot)
    with pytest.raises(CalibrationError):
        estimator.calibrate_gyro_bias()
    estimator.run(made.recording.part(0, 300))
    with pytest.raises(CalibrationError):
        estimator.calibrate_zero()
    estimator.run(still)
    estimator.calibrate_gyro_bias()
    estimator.calibrate_zero()
    series = estimator.run(made.recording.part(3000, 6000))
    assert (series.status == Status.UNOBSERVABLE).all()
    assert np.degrees(estimator.biases()["imu_5.x"]) == pytest.approx(0.2528, abs=0.01)
    assert np.abs(np.degrees(series.position)).max() < 0.4
    assert series.torso is not None and np.abs(np.degrees(series.torso)).max() < 0.4
    looped = Gyro(made.robot)
    for frame in still.frames():
        looped.update(frame)
    looped.calibrate_gyro_bias()
    assert looped.biases() == pytest.approx(estimator.biases())


# ------------------------------------------------------------- Hall alone


def test_hall_readings_are_fused_by_their_precision() -> None:
    made = exoshell.simulate("bench", duration_s=30.0)
    errors = {}
    for sensor in (0, 1, 2):
        series = Hall(made.robot, HallParams(sensor=sensor)).run(made.recording)
        errors[sensor] = np.sqrt((degrees(series, made) ** 2).mean(axis=0))
        spread = degrees(series, made) ** 2 / np.degrees(np.degrees(series.variance))
        assert spread.mean() == pytest.approx(1.0, abs=0.3)
    assert (errors[0] < np.minimum(errors[1], errors[2])).all()


def test_clipped_hall_readings_are_left_out_of_the_mean_but_shown_one_by_one() -> None:
    made = exoshell.simulate("clipped", duration_s=30.0)
    fused, single = (Hall(made.robot, HallParams(sensor=k, kinematics="additive")).run(made.recording) for k in (0, 1))
    assert (fused.status == 0).all()
    assert (single.status & Status.DISTURBED).any()
    largest = np.degrees(single.position.max())
    assert largest == pytest.approx(12.2, abs=0.1)  # the rail


def test_hall_holds_the_newest_angle_when_readings_stop() -> None:
    made = exoshell.simulate("bench", duration_s=5.0)
    assert made.recording.hall is not None
    hall = made.recording.hall.copy()
    hall[300:] = np.nan
    series = Hall(made.robot, timing=Timing(stale_after=0.5)).run(replace(made.recording, hall=hall))
    assert (series.position[300:] == series.position[299]).all() and (series.velocity[301:] == 0.0).all()
    assert (np.diff(series.variance[299:], axis=0) >= 0.0).all() and series.variance[320, 0] > series.variance[299, 0]
    assert (series.status[300:340] == Status.NO_DATA).all()
    assert (series.status[351:] == Status.NO_DATA | Status.STALE).all()


def test_a_hall_sensor_that_is_not_there_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="sensor: 3 is not allowed"):
        Hall(exoshell.exoshell("bench"), HallParams(sensor=3))
