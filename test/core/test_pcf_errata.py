"""Item 1 of the specification of the PCF: of every erratum of its section 1 the printed form fails, ours does not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pcf_printed import UP, Printed, PrintedFilter, project, roll, rotation_matrix, twist
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Frame, Series, Status
from jointest_ros.core.pcf.attitude import ComplementaryFilter, Gains, joint_angles, zero_rotation
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import log, norm
from jointest_ros.sim.finger import AXIS, LINKS, simulate
from jointest_ros.sim.hand import HandRecording
from jointest_ros.sim.imu import GRAVITY

GAINS = Gains(1.0, 0.05, 1.0, 0.0)
STILL = (0.0, 0.0, 0.0)
LATE_S = 15.0


def rms_deg(estimated: FloatArray, truth: FloatArray, stamps: FloatArray) -> float:
    late = stamps > LATE_S * 1e9
    return float(np.degrees(np.sqrt(np.mean((estimated - truth)[late] ** 2))))


def production(recorded: HandRecording, formulation: str, **params: object) -> Series:
    return Pcf(recorded.robot, PcfParams(formulation=formulation, zero_at_start=True, **params)).run(recorded.recording)


def mountings(recorded: HandRecording, joint: int) -> tuple[Rotation, Rotation]:
    parent, child = recorded.robot.sensors[joint : joint + 2]
    return Rotation.from_quat(parent.mounting), Rotation.from_quat(child.mounting)


def algorithm_2(
    recorded: HandRecording, joint: int, printed: Printed, zero: FloatArray | None = None, ki: float = 0.05
) -> FloatArray:
    """Angle of one joint by the printed algorithm, rad; bias removed; R_o from the mountings unless given."""
    parent, child = LINKS[joint : joint + 2]
    m1, m2 = mountings(recorded, joint)
    r_o = (m1.inv() * m2).as_matrix() if zero is None else zero
    axis = m2.inv().apply(AXIS)
    recording = recorded.recording
    one = PrintedFilter(r_o, 1.0, ki, printed)
    dt = float(recording.stamps[1] - recording.stamps[0]) * 1e-9
    angles = np.empty(len(recording))
    gyros = (recording.gyro[name] - recorded.gyro_bias[name] for name in (parent, child))
    samples = zip(*gyros, recording.accel[parent], recording.accel[child], strict=True)
    for k, (w1, w2, a1, a2) in enumerate(samples):
        one.step(dt, w1, w2, a1, a2)
        angles[k] = twist(r_o.T @ one.rotation, axis)
    return angles


@pytest.fixture(scope="module")
def turning_palm() -> HandRecording:
    """PC at 200 Hz, which is enough for matrices in Python."""
    return simulate("PC", seed=11, rate_hz=200.0, duration_s=40.0, mounting="mounted")


def test_reference_of_2_points_up() -> None:
    """Printed: it settles upside down."""
    recorded = simulate("still", seed=3, rate_hz=100.0, duration_s=60.0, bias=False)
    accels, gyros = recorded.recording.accel["palm"], recorded.recording.gyro["palm"]
    found = {}
    for name, printed in (("printed", Printed(reference=True)), ("right", Printed())):
        one = PrintedFilter(np.eye(3), 1.0, 0.05, printed)
        for gyro, accel in zip(gyros, accels, strict=True):
            one.step_single(0.01, gyro, accel)
        found[name] = math.degrees(math.acos(max(-1.0, min(1.0, one.rotation[2, 2]))))
    assert found["printed"] > 170.0
    assert found["right"] < 1.0
    series = production(simulate("still", seed=3, rate_hz=100.0, bias=False), "absolute")
    tilt = Rotation.from_quat(series.orientation["palm"][-1]).apply(UP)
    assert math.degrees(math.acos(min(1.0, tilt[2]))) < 1.0


def test_integral_of_step_8_is_multiplied_by_dt() -> None:
    """Printed: a gain that depends on the rate, and is unstable at 1 kHz."""
    recorded = simulate("PA", seed=4, duration_s=20.0, zero_pose_s=2.0, bias=False)
    angles = algorithm_2(recorded, 0, Printed(integral=True))
    series = production(recorded, "relative")
    stamps, truth = recorded.recording.stamps, recorded.truth_position[:, 0]
    assert rms_deg(angles, truth, stamps) > 10.0
    assert rms_deg(series.position[:, 0], truth, stamps) < 0.2


def test_order_of_the_error_in_19(turning_palm: HandRecording) -> None:
    angles = algorithm_2(turning_palm, 0, Printed(error=True))
    stamps, truth = turning_palm.recording.stamps, turning_palm.truth_position[:, 0]
    assert rms_deg(angles, truth, stamps) > 10.0
    assert rms_deg(production(turning_palm, "relative").position[:, 0], truth, stamps) < 0.2


def test_relative_rate_of_18_is_in_one_frame(turning_palm: HandRecording) -> None:
    """Printed: degrees wrong as soon as the palm turns."""
    series = production(turning_palm, "relative")
    stamps = turning_palm.recording.stamps
    printed, ours = [], []
    for joint in range(3):
        truth = turning_palm.truth_position[:, joint]
        printed.append(rms_deg(algorithm_2(turning_palm, joint, Printed(rate=True)), truth, stamps))
        ours.append(rms_deg(series.position[:, joint], truth, stamps))
    assert math.sqrt(np.mean(np.square(printed))) > 4.0
    assert math.sqrt(np.mean(np.square(ours))) < 0.2


def test_right_form_of_the_printed_algorithm_agrees_with_ours(turning_palm: HandRecording) -> None:
    """Two implementations; the matrices lag by one sample in the correction, as Algorithm 2 does."""
    series = production(turning_palm, "relative")
    stamps = turning_palm.recording.stamps
    for joint in range(3):
        assert rms_deg(algorithm_2(turning_palm, joint, Printed()), series.position[:, joint], stamps) < 0.2


@pytest.mark.parametrize(("rate_hz", "loss"), [(100.0, 0.0025), (1000.0, 0.000025)])
def test_euler_step_loses_angle(rate_hz: float, loss: float) -> None:
    """Steps 11 and 12 at 500 deg/s; ours is exact at any rate."""
    rate, steps = math.radians(500.0), round(rate_hz / 10.0)
    euler = PrintedFilter(np.eye(3), 0.0, 0.0, Printed(euler=True))
    ours = ComplementaryFilter(Gains(0.0, 0.0, 1.0, 0.0))
    up = (0.0, 0.0, GRAVITY)
    for _ in range(steps):
        euler.step(1.0 / rate_hz, np.zeros(3), np.array([rate, 0.0, 0.0]), UP, UP)
        ours.step(1.0 / rate_hz, 1.0 / rate_hz, STILL, (rate, 0.0, 0.0), up, up)
    turned = rate * steps / rate_hz
    assert twist(euler.rotation, np.array(AXIS)) / turned - 1.0 == pytest.approx(-loss, rel=0.05)
    assert log(ours.rotation)[0] / turned - 1.0 == pytest.approx(0.0, abs=1e-12)


def test_projection_of_15_takes_singular_vectors() -> None:
    """Eigenvectors come in another order and with another sign than the singular vectors: not even near."""
    generator = np.random.default_rng(5)
    worst_eigen = worst_singular = 0.0
    for _ in range(20):
        truth = rotation_matrix(generator.standard_normal(3))
        disturbed = truth + 1e-3 * generator.standard_normal((3, 3))
        for eigenvectors in (True, False):
            found = project(disturbed, eigenvectors)
            off = math.degrees(norm(tuple(Rotation.from_matrix(truth.T @ found).as_rotvec())))
            if eigenvectors:
                worst_eigen = max(worst_eigen, off)
            else:
                worst_singular = max(worst_singular, off)
    assert worst_eigen > 90.0
    assert worst_singular < 0.3
    # Ours is a unit quaternion, and stays one.
    one = ComplementaryFilter(GAINS)
    for rate in generator.standard_normal((5000, 3)).tolist():
        one.step(0.01, 0.01, tuple(rate), STILL, (0.0, 0.0, GRAVITY), (0.1, 0.2, GRAVITY))
    assert math.hypot(*one.rotation) == pytest.approx(1.0, abs=1e-12)


def hinge_robot(m1: Rotation | None = None, m2: Rotation | None = None, **joint: object) -> Robot:
    quaternions = [tuple((m or Rotation.identity()).as_quat().tolist()) for m in (m1, m2)]
    sensors = tuple(Sensor(n, n, mounting=q) for n, q in zip(("base", "link"), quaternions, strict=True))  # type: ignore[arg-type]
    return Robot(("base", "link"), (Joint("joint", "base", "link", (AXIS,), **joint),), sensors)  # type: ignore[arg-type]


def resting_frame(stamp: int, angle: float, m1: Rotation, m2: Rotation, up: FloatArray = UP) -> Frame:
    a1 = m1.inv().apply(GRAVITY * up)
    a2 = (Rotation.from_rotvec(angle * np.array(AXIS)) * m2).inv().apply(GRAVITY * up)
    gyro = {"base": STILL, "link": STILL}
    return Frame(stamp, gyro, {"base": tuple(a1), "link": tuple(a2)}, period=0.01)


@pytest.mark.parametrize("formulation", ["hinge", "relative", "absolute"])
@pytest.mark.parametrize("degrees", [-170.0, -120.0, -91.0, 89.0, 120.0, 179.0])
def test_angle_beyond_90_deg_needs_atan2(formulation: str, degrees: float) -> None:
    """(22), (24) as printed fold it into +-90 deg."""
    identity = Rotation.identity()
    matrix = rotation_matrix(np.radians(degrees) * np.array(AXIS))
    printed = math.degrees(math.atan(matrix[2, 1] / matrix[2, 2]))
    assert (abs(printed - degrees) > 90.0) == (abs(degrees) > 90.0)
    estimator = Pcf(hinge_robot(), PcfParams(formulation=formulation))
    estimate = estimator.update(resting_frame(0, math.radians(degrees), identity, identity))
    assert math.degrees(estimate.position[0]) == pytest.approx(degrees, abs=1e-6)


def test_twist_instead_of_roll_pitch_yaw() -> None:
    """(25) with (24): R_o^T R_n = M2^T Rx(q) M2 with an IMU that is 10 deg misaligned."""
    generator = np.random.default_rng(8)
    roll_errors, our_errors = [], []
    for _ in range(50):
        direction = generator.standard_normal(3)
        m2 = Rotation.from_rotvec(np.radians(10.0) * direction / np.linalg.norm(direction))
        axis = tuple(m2.inv().apply(AXIS).tolist())
        for degrees in (20.0, 40.0, 60.0, 80.0):
            turned = m2.inv() * Rotation.from_rotvec(np.radians(degrees) * np.array(AXIS)) * m2
            roll_errors.append(math.degrees(roll(turned.as_matrix())) - degrees)
            (angle,) = joint_angles((axis,), tuple(turned.as_quat().tolist()))  # type: ignore[arg-type]
            our_errors.append(math.degrees(angle) - degrees)
    assert 0.3 < math.sqrt(np.mean(np.square(roll_errors))) < 0.9
    assert np.max(np.abs(our_errors)) < 1e-9


def test_zero_pose_by_triad_and_not_from_the_filter() -> None:
    """Section IV: without a magnetometer the filter's R_o is arbitrary about gravity."""
    recorded = simulate("PC", seed=12, rate_hz=200.0, duration_s=40.0, mounting="mounted")
    stamps, resting = recorded.recording.stamps, recorded.recording.stamps < 10_000_000_000
    printed, ours = [], []
    for joint in range(3):
        parent, child = LINKS[joint : joint + 2]
        truth = recorded.truth_position[:, joint]
        one = PrintedFilter(np.eye(3), 1.0, 0.0)
        gyros = (recorded.recording.gyro[name] - recorded.gyro_bias[name] for name in (parent, child))
        accels = (recorded.recording.accel[name] for name in (parent, child))
        for w1, w2, a1, a2 in zip(*(table[resting] for table in (*gyros, *accels)), strict=True):
            one.step(0.005, w1, w2, a1, a2)
        printed.append(rms_deg(algorithm_2(recorded, joint, Printed(), zero=one.rotation), truth, stamps))
        triad = triad_zero(recorded, joint, resting)
        ours.append(rms_deg(algorithm_2(recorded, joint, Printed(), zero=triad), truth, stamps))
    assert math.sqrt(np.mean(np.square(printed))) > 1.0
    assert math.sqrt(np.mean(np.square(ours))) < 0.25


def triad_zero(recorded: HandRecording, joint: int, resting: FloatArray) -> FloatArray:
    """R_o as `calibrate_zero` has it: by the axis first and gravity second."""
    m1, m2 = mountings(recorded, joint)
    parent, child = (recorded.recording.accel[name][resting].mean(axis=0) for name in LINKS[joint : joint + 2])
    b1, b2 = tuple(m1.apply(parent).tolist()), tuple(m2.apply(child).tolist())
    zero = Rotation.from_quat(zero_rotation((AXIS,), b1, b2))  # type: ignore[arg-type]
    return np.asarray((m1.inv() * zero * m2).as_matrix())


def test_palm_yaw_does_no_harm_to_a_horizontal_hinge() -> None:
    """Section V.A says that joint angles cannot be computed when the palm yaws."""
    recorded = simulate("PC", seed=13, duration_s=40.0, mounting="mounted")
    series = production(recorded, "hinge")
    for joint in range(3):
        assert rms_deg(series.position[:, joint], recorded.truth_position[:, joint], recorded.recording.stamps) < 0.15
    moving = recorded.recording.stamps > LATE_S * 1e9
    assert not (series.status[moving] & Status.UNOBSERVABLE).any()


@pytest.mark.parametrize("formulation", ["hinge", "relative", "absolute"])
def test_what_cannot_be_seen_is_a_hinge_parallel_to_gravity(formulation: str) -> None:
    """The true limit: only the gyro is left, and the estimator says so."""
    recorded = simulate("PA", seed=14, rate_hz=100.0, duration_s=20.0, elevation_deg=90.0)
    series = production(recorded, formulation)
    assert (series.status & Status.UNOBSERVABLE).all()


@pytest.mark.parametrize("scenario", ["PA", "PC"])
def test_algorithm_2_equals_the_pair_of_algorithm_1(scenario: str) -> None:
    """Without noise and bias, Ki = 0, from the true attitudes, 1 kHz."""
    recorded = simulate(scenario, duration_s=30.0, noise=False, bias=False, mounting="mounted")
    one, two = (production(recorded, formulation, ki=0.0, still_start=0.0) for formulation in ("relative", "absolute"))
    for joint in range(3):
        assert rms_deg(one.position[:, joint], two.position[:, joint], recorded.recording.stamps) < 0.01
