"""Joints from the world link, which has no IMU: absolute relative to gravity, and about it relative to the start."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from pcf_swing import X, Y, Z, lose, swing, take

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import FloatArray, Recording, Series, Status, Vec3
from jointest_ros.core.pcf.params import FORMULATIONS, PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import unit
from jointest_ros.sim.gripper import simulate

RPY = (Z, Y, X)
FAULTS = Status.NO_DATA | Status.GAP | Status.STALE | Status.STARTING
START = np.radians([70.0, -20.0, 25.0])  # yaw, pitch, roll


def tumble(time: FloatArray) -> FloatArray:
    """Yaw, pitch and roll from a tilted start; still until 3 s."""
    tau = np.maximum(time - 3.0, 0.0)[:, None]
    return START + np.radians([50.0, 30.0, 40.0]) * (1.0 - np.cos(tau * [0.7, 1.1, 0.9])) / 2.0


def nodding(time: FloatArray) -> FloatArray:
    """Only pitch and roll; still until 2 s."""
    tau = np.maximum(time - 2.0, 0.0)
    return np.column_stack([0.0 * tau, 0.3 * np.sin(tau), 0.2 * np.sin(1.7 * tau)])


def on_world(motion, axes: tuple[Vec3, ...] = RPY, **options: object) -> tuple[Robot, Recording, FloatArray]:
    """A link that turns on the world; the IMU that `swing` puts on the base is left out."""
    robot, recording, truth = swing(motion, axes, **options)
    robot = Robot(robot.links, robot.joints, (robot.sensor("link"),), world="base")
    gyro, accel, mag = ({n: t for n, t in table.items() if n == "link"} for table in _tables(recording))
    return robot, Recording(recording.stamps, gyro, accel, mag, period=recording.period), truth


def _tables(recording: Recording) -> tuple[dict[str, FloatArray], ...]:
    return recording.gyro, recording.accel, recording.mag


def degrees(series: Series, truth: FloatArray) -> FloatArray:
    return np.degrees(series.position - truth)


def by_update(estimator: Pcf, recording: Recording) -> Series:
    return Series.from_estimates([estimator.update(frame) for frame in recording.frames()], len(estimator.joints))


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_pitch_and_roll_are_absolute_and_yaw_begins_at_zero(formulation: str) -> None:
    robot, recording, truth = on_world(tumble, seconds=40.0, bias=math.radians(3.0), seed=1)
    series = Pcf(robot, PcfParams(formulation=formulation)).run(recording)
    found = degrees(series, truth - [START[0], 0.0, 0.0])
    assert abs(found[0, 0]) < 0.01  # one sample of a gyro that is not calibrated yet
    # the bias is calibrated after a second, during which it has turned the heading
    turned = found[300, 0]
    assert np.sqrt(np.mean((found[400:] - [turned, 0.0, 0.0]) ** 2, axis=0)) == pytest.approx(0.0, abs=0.15)
    assert (series.status[:, 0] & Status.UNOBSERVABLE).all()
    assert not (series.status[:, 1:] & Status.UNOBSERVABLE).any()


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_the_angle_about_gravity_has_a_variance_that_covers_its_drift(formulation: str) -> None:
    """With the bias calibrated and without, over many biases: as large as the error, not ten times as large."""
    for still_start, seconds in ((1.0, 60.0), (0.0, 20.0)):
        scores = []
        for seed in range(6):
            robot, recording, _ = on_world(nodding, seconds=seconds, rate=50.0, bias=math.radians(3.0), seed=seed)
            estimator = Pcf(robot, PcfParams(formulation=formulation, still_start=still_start, floor_deg=0.0))
            series = estimator.run(recording.part(0, 100))
            estimator.calibrate_zero()
            series = estimator.run(recording.part(100, len(recording)))
            assert np.all(np.diff(series.variance[:, 0]) > 0.0)
            scores.append(series.position[-1, 0] / math.sqrt(series.variance[-1, 0]))
        assert 0.1 < math.sqrt(np.mean(np.square(scores))) < 2.0


@pytest.mark.parametrize(
    ("formulation", "axis"),
    [("hinge", unit((0.6, -0.5, 0.5))), *((formulation, axis) for formulation in FORMULATIONS for axis in (X, Y))],
)
def test_a_hinge_on_the_world_needs_one_imu(formulation: str, axis: Vec3) -> None:
    robot, recording, truth = on_world(
        lambda time: 0.9 * np.sin(np.maximum(time - 2.0, 0.0)) + 0.4, (axis,), seconds=30.0, bias=0.05, seed=2
    )
    estimator = Pcf(robot, PcfParams(formulation=formulation))
    found = degrees(estimator.run(recording), truth)
    assert np.sqrt(np.mean(found[300:] ** 2)) < 0.15
    assert estimator.joints == ("joint",)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_zero_pose_leaves_what_is_relative_to_gravity(formulation: str) -> None:
    robot, recording, _ = on_world(lambda time: np.tile(START, (len(time), 1)), seconds=4.0)
    estimator = Pcf(robot, PcfParams(formulation=formulation, zero_at_start=True))
    estimator.run(recording)
    estimator.calibrate_zero()
    last = estimator.update(next(recording.part(399, 400).frames()))
    assert np.degrees(last.position) == pytest.approx([0.0, -20.0, 25.0], abs=0.15)
    hinge, recording, _ = on_world(lambda time: np.full(len(time), 0.5), (X,), seconds=4.0)
    estimator = Pcf(hinge, PcfParams(formulation=formulation))
    estimator.run(recording.part(0, 300))
    estimator.calibrate_zero()
    assert estimator.run(recording.part(300, 400)).position == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("axes", [(Z,), RPY])
def test_zero_pose_makes_the_angle_about_gravity_zero(formulation: str, axes: tuple[Vec3, ...]) -> None:
    """Wherever it has got to, turns included; its standard deviation begins anew."""
    count = len(axes)
    robot, recording, _ = on_world(
        lambda time: np.outer(np.clip(3.0 * (time - 2.0), 0.0, 9.0), np.eye(3)[0, :count]), axes, seconds=10.0
    )
    estimator = Pcf(robot, PcfParams(formulation=formulation))
    before = estimator.run(recording.part(0, 900))
    assert before.position[-1, 0] == pytest.approx(9.0, abs=0.02)
    estimator.calibrate_zero()
    after = estimator.run(recording.part(900, 1000))
    assert after.position[:, 0] == pytest.approx(0.0, abs=0.01)
    assert (after.variance[:, 0] < before.variance[-1, 0]).all()
    assert (after.status[:, 0] & Status.UNOBSERVABLE).all()


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_magnetometers_make_yaw_absolute(formulation: str) -> None:
    """The field of the simulation points along the world's x: north is y, so yaw reads 90 deg more."""
    robot, recording, truth = on_world(tumble, seconds=30.0, mag=True, bias=0.02, seed=4)
    estimator = Pcf(robot, PcfParams(formulation=formulation, mag_weight=1.0, zero_at_start=True))
    series = estimator.run(recording)
    found = np.degrees(np.arctan2(*(f(series.position - truth - [math.pi / 2, 0.0, 0.0]) for f in (np.sin, np.cos))))
    assert np.sqrt(np.mean(found[500:] ** 2, axis=0)) == pytest.approx(0.0, abs=0.5)
    assert not (series.status & Status.UNOBSERVABLE).any()


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_gaps_silence_and_resets(formulation: str) -> None:
    """Pitch and roll recover at once; yaw keeps what it had before a gap and begins anew after a reset."""
    robot, recording, truth = on_world(tumble, seconds=30.0, seed=5)
    silent = (np.arange(3000) >= 1000) & (np.arange(3000) < 1120)
    recording = lose(recording, silent, ("link",))
    recording = take(recording, np.r_[0:1500, 1600:3000])
    truth = np.delete(truth, np.r_[1500:1600], axis=0)
    recording.reset = np.arange(2900) == 2200
    series = Pcf(robot, PcfParams(formulation=formulation)).run(recording)
    assert (series.status[1000:1120] & Status.NO_DATA).all()
    assert (series.status[1060:1120] & Status.STALE).all()
    assert (series.status[[1120, 1500]] & Status.GAP).all()
    clean = np.ones(2900, dtype=bool)
    clean[1000:1121] = clean[1500] = False
    assert not (series.status[clean] & FAULTS).any()
    found = degrees(series, truth)[:, 1:]
    for after in (1120, 1500, 2200):
        assert np.abs(found[after + 150 : after + 300]).max() < 1.5
    assert abs(series.position[2200, 0]) < 1e-2
    heading = series.position[:, 0] - truth[:, 0]
    assert np.degrees(np.ptp(heading[2201:])) < 0.5
    assert series.variance[1120, 0] > 4.0 * series.variance[999, 0]


@pytest.fixture(scope="module")
def damaged() -> tuple[Robot, Recording]:
    """A gripper with losses, gaps, resets and unknown periods."""
    recorded = simulate("palm", rate_hz=100.0, duration_s=16.0, zero_pose_s=4.0, seed=21, mag=True, mounting="mounted")
    recording, generator = recorded.recording, np.random.default_rng(22)
    for sensor in ("palm", "left_middle"):
        recording = lose(recording, generator.random(1600) < 0.05, (sensor,))
    recording = lose(recording, np.r_[900:980], ("palm",))
    recording.reset = np.zeros(1600, dtype=bool)
    recording.reset[[0, 700, 930, 1300]] = True
    recording.stamps[1300:] -= 10_000_000_000
    assert recording.period is not None
    recording.period[:5] = np.nan
    return recorded.robot, take(recording, np.r_[0:600, 603:1100, 1160:1600])


MODES = [
    *({"formulation": formulation, "zero_at_start": True} for formulation in FORMULATIONS),
    {"formulation": "hinge", "still_start": 0.0},
    {"formulation": "hinge", "mag_weight": 0.5},
]


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: "-".join(map(str, mode.values())))
def test_run_equals_the_loop_and_a_restored_state_continues(
    damaged: tuple[Robot, Recording], mode: dict[str, object]
) -> None:
    robot, recording = damaged
    loop, arrays, restored = (Pcf(robot, PcfParams(**mode)) for _ in range(3))
    expected = by_update(loop, recording)
    found = Series.concatenate([arrays.run(part) for part in recording.parts(313)])
    for name in ("position", "velocity", "variance"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9, atol=1e-9, err_msg=name)
    np.testing.assert_array_equal(found.status, expected.status)
    np.testing.assert_allclose(found.orientation["palm"], expected.orientation["palm"], atol=1e-9)
    assert arrays.biases() == pytest.approx(loop.biases(), abs=1e-12)
    np.testing.assert_allclose(arrays.covariance(), loop.covariance(), rtol=1e-9)
    for cut in (60, 450, 935):
        whole = Pcf(robot, PcfParams(**mode))
        before = [whole.update(frame) for frame in recording.part(0, cut).frames()]
        restored.set_state(json.loads(json.dumps(whole.get_state())))
        rest = [restored.update(frame) for frame in recording.part(cut, cut + 200).frames()]
        again = Series.from_estimates(before + rest, len(whole.joints))
        np.testing.assert_allclose(again.position, expected.position[: len(again)], atol=1e-12)
        np.testing.assert_allclose(again.variance, expected.variance[: len(again)], rtol=1e-12)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_the_world_takes_no_part_in_what_sensors_are_for(formulation: str) -> None:
    """A frame is not changed, the palm's orientation is given, and no bias is reported for the world."""
    recorded = simulate("rest", rate_hz=100.0, duration_s=2.0)
    estimator = Pcf(recorded.robot, PcfParams(formulation=formulation))
    for frame in recorded.recording.frames():
        sensors = set(frame.gyro)
        estimate = estimator.update(frame)
        assert set(frame.gyro) == sensors
    assert "palm" in estimate.orientation
    assert set(estimate.orientation) <= sensors
    assert not any("world" in name for name in estimator.biases())
    assert estimator.calibrated


def test_what_is_refused() -> None:
    sensor = Sensor("imu", "link")
    two = Robot(("base", "link"), (Joint("tilt", "base", "link", (Y, X)),), (sensor,), world="base")
    with pytest.raises(
        ConfigurationError, match=r"^joint 'tilt'.axes: 2 are not allowed on the world link 'base'; give"
    ):
        Pcf(two)
    blind = Robot(("base", "link"), (Joint("tilt", "base", "link", (X,)),), (), world="base")
    with pytest.raises(ConfigurationError, match=r"^joint 'tilt': link 'link' carries no sensor with gyro"):
        Pcf(blind)
    unsaid = Robot(("base", "link"), (Joint("tilt", "base", "link", (X,)),), (sensor,))
    with pytest.raises(ConfigurationError, match=r"^joint 'tilt': link 'base' carries no sensor"):
        Pcf(unsaid)
