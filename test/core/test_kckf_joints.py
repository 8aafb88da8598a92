"""Joints of one, two and three axes in any order, mounted gyros, a base that moves: torso by kinematics (figure 7)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import FloatArray, Recording, Vec3
from jointest_ros.core.hall_sensor import HallSensor
from jointest_ros.core.kckf.chain_motion import ChainMotion
from jointest_ros.core.kckf.gyro import Gyro
from jointest_ros.core.kckf.kckf import PAPER, Kckf, KckfParams
from jointest_ros.core.kckf.kf import Kf
from jointest_ros.core.kckf.linkage import gyro_linkage
from jointest_ros.core.kckf.linkage_rates import ComposedRates
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.sim import exoshell
from jointest_ros.sim.exoshell_motion import X, Y, Z, fixed_base, gait, walking_base
from jointest_ros.sim.imu import Imu, ImuNoise, mean_rate

NOISE = ImuNoise(gyro_noise=exoshell.GYRO_NOISE, gyro_bias=np.radians(1.0), gyro_bias_walk=exoshell.GYRO_BIAS_WALK)
OBLIQUE: Vec3 = (0.6, 0.0, 0.8)
CHAINS: dict[str, tuple[tuple[Vec3, ...], ...]] = {
    "three axes": ((X, Y, Z), (X, Y, Z), (X, Y, Z)),
    "other orders": ((Z, X, Y), (X, Z, Y), (Y, X, Z)),
    "mixed": ((X,), (Y, Z), (X, Y, Z), (OBLIQUE,)),
    "coaxial": ((OBLIQUE,), (OBLIQUE,), (X,)),
    "oblique": (((0.6, 0.8, 0.0), (-0.8, 0.6, 0.0)), (Y,), ((0.0, 0.6, 0.8), X)),
}


def chain(
    joints: tuple[tuple[Vec3, ...], ...],
    seconds: float = 40.0,
    noise: ImuNoise = NOISE,
    sigma: float = 0.0345,
    mounted: bool = False,
    fixed: bool = False,
) -> tuple[Robot, Recording, FloatArray, Rotation]:
    """A chain that moves like gait on a walking base: robot, recording, true positions (T, m), true torso."""
    rng = np.random.default_rng(11)
    links = tuple(f"link_{k}" for k in range(len(joints) + 1))
    made = tuple(Joint(f"joint_{k}", links[k], links[k + 1], axes) for k, axes in enumerate(joints))
    names = [name for joint in made for name in joint.coordinates]
    mountings = [Rotation.from_quat(rng.standard_normal(4)) if mounted else Rotation.identity() for _ in links]
    gyros = tuple(
        Sensor(
            link,
            link,
            accel=False,
            mounting=tuple(mounting.as_quat().tolist()),  # type: ignore[arg-type]
            gyro_noise=max(noise.gyro_noise, 1e-6),
            gyro_bias_walk=noise.gyro_bias_walk,
        )
        for link, mounting in zip(links, mountings, strict=True)
    )
    hall = tuple(
        HallSensor(name, mirrored=m, noise=sigma, hall_range=(0.0, 3.3)) for name in names for m in (False, True)
    )
    rate, substeps = 100.0, 4
    fine = np.arange(-substeps, substeps * round(rate * seconds)) / (substeps * rate)
    rows = [(rng.uniform(-8, 8), rng.uniform(8, 20), rng.uniform(0, 360)) for _ in names]
    signals = gait(rows)(fine).joints
    moving = [(fixed_base if fixed else walking_base)(fine)]
    number = 0
    for axes in joints:
        link = moving[-1]
        for axis in axes:
            link = link.child(axis, signals[number])
            number += 1
        moving.append(link)
    seeds = np.random.SeedSequence(5).spawn(len(links))
    gyro = {}
    for sensor, mounting, link, seed in zip(gyros, mountings, moving, seeds, strict=True):
        rates = mean_rate(link.orientation, np.diff(fine))
        rates = np.vstack([rates, rates[-1:]])[: len(fine)].reshape(-1, substeps, 3).mean(axis=1)[:-1]
        gyro[sensor.name] = Imu(noise, mounting, rate, seed).gyro_of(rates)[0]
    kept = slice(substeps, None, substeps)
    position = np.column_stack([signal.value for signal in signals])[kept]
    volts = np.column_stack([sensor.voltage(position[:, k // 2]) for k, sensor in enumerate(hall)])
    volts += sigma * rng.standard_normal(volts.shape)
    stamps = np.round(fine[kept] * 1e9).astype(np.int64)
    torso = moving[0].orientation.inv() * moving[-1].orientation
    recording = Recording(stamps, gyro, {}, hall=volts, period=np.full(len(stamps), 1.0 / rate))
    return Robot(links, made, gyros, hall=hall), recording, position, torso[kept]


def geodesic(found: FloatArray | None, truth: Rotation) -> FloatArray:
    assert found is not None
    return np.degrees((truth.inv() * Rotation.from_quat(found)).magnitude())


@pytest.mark.parametrize("mounted", [False, True])
@pytest.mark.parametrize("name", CHAINS)
def test_gyros_without_errors_integrate_to_the_true_angles(name: str, mounted: bool) -> None:
    robot, recording, position, torso = chain(CHAINS[name], 8.0, ImuNoise(), mounted=mounted)
    series = Gyro(robot).run(recording)
    assert series.position == pytest.approx(position, abs=2e-3)
    assert geodesic(series.torso_orientation, torso).max() < 0.1


@pytest.mark.parametrize("mounted", [False, True])
@pytest.mark.parametrize("name", CHAINS)
def test_any_chain_is_estimated_consistently(name: str, mounted: bool) -> None:
    robot, recording, position, torso = chain(CHAINS[name], mounted=mounted)
    series = Kckf(robot).run(recording)
    settled = slice(1500, None)
    error = (series.position - position)[settled]
    assert np.degrees(np.sqrt((error**2).mean(axis=0))).max() < 0.2
    assert 0.7 < np.sqrt((error**2 / series.variance[settled]).mean()) < 1.3
    assert np.sqrt((geodesic(series.torso_orientation, torso)[settled] ** 2).mean()) < 0.3
    assert (series.status[settled] == 0).all()


@pytest.mark.parametrize("scenario", ["composed", "composed-free"])
def test_torso_by_composed_kinematics(scenario: str) -> None:
    """Figure 7: at most .3 deg whether or not the wearer moves; sums of angles miss by degrees."""
    made = exoshell.simulate(scenario, seed=4)
    truth = Rotation.from_quat(made.truth_torso_orientation)
    composed = geodesic(Kckf(made.robot).run(made.recording).torso_orientation, truth)
    additive = geodesic(Kckf(made.robot, PAPER).run(made.recording).torso_orientation, truth)
    assert np.sqrt((composed**2).mean()) <= 0.3
    assert np.sqrt((additive**2).mean()) > 2.0


def test_hinges_do_not_depend_on_how_the_wearer_moves() -> None:
    fixed, free = (exoshell.simulate(name, seed=1, duration_s=60.0) for name in ("composed", "composed-free"))
    still, moving = (Kckf(made.robot).run(made.recording).position for made in (fixed, free))
    assert np.degrees(np.abs(still - moving)).max() < 0.01


@pytest.mark.parametrize("order", [(X, Y, Z), (X, Z, Y), (Z, X, Y), ((0.6, 0.8, 0.0), (-0.8, 0.6, 0.0)), (OBLIQUE,)])
def test_linearisation_is_the_derivative(order: tuple[Vec3, ...]) -> None:
    """Rows and slopes of `ChainMotion` against differences of its own rates; those against `ComposedRates`."""
    robot = Robot(("a", "b"), (Joint("j", "a", "b", order),), (Sensor("a", "a"), Sensor("b", "b")))
    linkage = gyro_linkage(robot)
    motion, k = ChainMotion(linkage, off_axis=True), len(order)
    rng = np.random.default_rng(2)
    gyro, bias, angles = rng.standard_normal((2, 3)), 0.1 * rng.standard_normal(6), rng.uniform(-1.0, 1.0, k)

    def rates(gyro: FloatArray, angles: FloatArray) -> FloatArray:
        motion.linearise([tuple(row) for row in gyro.tolist()], bias.tolist(), angles.tolist(), [True, True])  # type: ignore[misc]
        return np.append(motion.rates, motion.residuals)

    at = rates(gyro, angles)
    true = (gyro.ravel() - bias).reshape(2, 3)
    assert ComposedRates(linkage)(true.tolist(), angles.tolist()) == pytest.approx(at[:k])
    rows = np.vstack([motion.rows, motion.residual_rows])
    slopes = np.vstack([motion.slopes, motion.residual_slopes])
    step = 1e-6
    for column in range(6):
        moved = gyro.copy()
        moved.ravel()[column] += step
        assert (rates(moved, angles) - at) / step == pytest.approx(rows[:, column], abs=1e-5)
    for column in range(k):
        moved = angles.copy()
        moved[column] += step
        assert (rates(gyro, moved) - at) / step == pytest.approx(slopes[:, column], abs=1e-4)


# ------------------------------------------------------------- off-axis rates


def test_off_axis_rates_help_when_the_base_moves_and_gyros_are_aligned() -> None:
    robot, recording, position, _ = chain(((X,), (Y,), (X,), (Y,)), sigma=0.1)
    plain = Kckf(robot).run(recording)
    helped = Kckf(robot, KckfParams(off_axis=True, alignment_deg=0.1)).run(recording)
    settled = slice(1500, None)
    before, after = (np.sqrt(((one.position - position)[settled] ** 2).mean()) for one in (plain, helped))
    assert after < 0.6 * before
    error = (helped.position - position)[settled]
    assert np.sqrt((error**2 / helped.variance[settled]).mean()) < 1.3


def test_off_axis_rates_tell_the_angle_of_a_joint_without_hall_sensors() -> None:
    robot, recording, position, _ = chain(((X,), (Y,), (X,)))
    assert recording.hall is not None
    bare = replace(robot, hall=tuple(sensor for sensor in robot.hall if sensor.joint != "joint_1"))
    part = replace(recording, hall=recording.hall[:, [0, 1, 4, 5]])
    errors = {}
    for off_axis in (False, True):
        series = Kckf(bare, KckfParams(off_axis=off_axis)).run(part)
        errors[off_axis] = np.degrees(np.abs(series.position - position)[2000:, 1]).max()
    assert errors[True] < 1.0 < errors[False]


# ------------------------------------------------------------- refusals


def test_axes_of_a_joint_must_be_perpendicular() -> None:
    robot = Robot(
        ("a", "b"),
        (Joint("j", "a", "b", (X, OBLIQUE)),),
        (Sensor("a", "a"), Sensor("b", "b")),
        hall=(HallSensor("j_x"),),
    )
    for make in (Kckf, Kf, Gyro):
        with pytest.raises(ConfigurationError, match=r"joint 'j'\.axes.*perpendicular"):
            make(robot)


def test_a_chain_is_required_where_there_is_a_torso() -> None:
    axis = ((1.0, 0.0, 0.0),)
    links = ("palm", "index", "thumb", "tip")
    joints = tuple(
        Joint(f"j_{child}", parent, child, axis)
        for parent, child in zip(("palm", "palm", "index"), links[1:], strict=True)
    )
    robot = Robot(
        links, joints, tuple(Sensor(link, link) for link in links), hall=tuple(HallSensor(j.name) for j in joints)
    )
    for make in (Kckf, Kf):
        with pytest.raises(ConfigurationError, match="'j_thumb' and 'j_tip' lie on different branches") as caught:
            make(robot)
        assert "\n" not in str(caught.value)
    assert set(Gyro(robot).joints) == {"j_index", "j_thumb", "j_tip"}
    one_finger = replace(robot, hall=(HallSensor("j_tip"),))
    assert Kckf(one_finger).joints == ("j_tip",)
    whole_finger = replace(robot, hall=(HallSensor("j_index"), HallSensor("j_tip")))
    assert Kckf(whole_finger).joints == ("j_index", "j_tip")


@pytest.mark.parametrize(
    ("changes", "named"),
    [({"hall": ()}, "no Hall sensors"), ({"sensors": (Sensor("a", "a"),)}, "link 'b' bears no gyro")],
)
def test_sensors_that_lack_are_named(changes: dict[str, tuple[Sensor, ...]], named: str) -> None:
    robot = Robot(
        ("a", "b"), (Joint("j", "a", "b", (X,)),), (Sensor("a", "a"), Sensor("b", "b")), hall=(HallSensor("j"),)
    )
    with pytest.raises(ConfigurationError, match=named):
        Kckf(replace(robot, **changes))
