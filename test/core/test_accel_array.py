"""Geometry of accelerometer arrays: section 4, item 1 of the specification, and what cannot be an array."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from jointest_ros.core.accel.array import array_matrices, joint_arrays, lever, plane
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import exp, multiply, rotate, rotate_inverse

G = 9.81
Z = (0.0, 0.0, 1.0)


def rigid_body(places: FloatArray, rate: float, acceleration: float, at_joint: FloatArray) -> FloatArray:
    """(N, 3): a_O + alpha x r + w x (w x r), by the cross products of Appendix I."""
    w, alpha = np.array([0, 0, rate]), np.array([0, 0, acceleration])
    r = np.column_stack([places, np.zeros(len(places))])
    return np.asarray(at_joint + np.cross(alpha, r) + np.cross(w, np.cross(w, r)))


@pytest.mark.parametrize("number", range(2, 11))
@pytest.mark.parametrize("gravity", [0.0, G])
@pytest.mark.parametrize("seed", range(3))
def test_any_array_is_exact(number: int, gravity: float, seed: int) -> None:
    random = np.random.default_rng((number, seed))
    places = random.uniform(-0.3, 0.3, (number, 2))
    at_joint = np.array([random.uniform(-5, 5), random.uniform(-5, 5) + gravity, 0.0])
    rate, acceleration = random.uniform(-5, 5, 2)
    channels = rigid_body(places, rate, acceleration, at_joint)[:, :2].ravel()
    g, f = array_matrices(places)
    assert g @ channels == pytest.approx([rate**2, acceleration], abs=1e-12, rel=1e-12)
    assert f @ channels == pytest.approx(at_joint[:2], abs=1e-12, rel=1e-12)


def test_lever_is_the_cross_products() -> None:
    places = np.array([[0.1, -0.2], [0.3, 0.05]])
    turned = np.einsum("nij,j->ni", lever(places), [2.0**2, -3.0])
    assert turned == pytest.approx(rigid_body(places, 2.0, -3.0, np.zeros(3))[:, :2])


@pytest.mark.parametrize("places", [[[0.1, 0.0]], [[0.1, 0.2], [0.1, 0.2]], [[0.0, 0.0]] * 5])
def test_arrays_without_extent_are_refused(places: list[list[float]]) -> None:
    with pytest.raises(ConfigurationError, match="apart"):
        array_matrices(places)


def test_sensors_on_a_line_through_the_joint_or_past_it_will_do() -> None:
    for places in ([[0.0, 0.0], [0.2, 0.0]], [[0.1, 0.1], [0.1, -0.1]], [[1.0, 0.0], [1.0, 0.001]]):
        g, f = array_matrices(places)
        assert np.isfinite(g).all() and np.isfinite(f).all()


@given(arrays(float, 3, elements=st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 0.01))
def test_plane_is_a_right_handed_basis_across_any_axis(direction: FloatArray) -> None:
    axis = direction / np.linalg.norm(direction)
    first, second = plane(tuple(axis.tolist()))
    assert np.cross(first, second) == pytest.approx(axis, abs=1e-12)
    assert [first @ first, second @ second, first @ axis] == pytest.approx([1, 1, 0], abs=1e-12)


def test_plane_across_z_is_x_and_y() -> None:
    assert plane(Z).tolist() == [[1, 0, 0], [0, 1, 0]]


def four_sensors(joint: Joint, mountings: list[tuple[float, float, float]]) -> Robot:
    places = [("a", (0.05, 0.0, 0.02)), ("a", (0.25, 0.03, 0.0)), ("b", (0.1, 0.0, 0.0)), ("b", (0.2, -0.04, 0.01))]
    sensors = [
        Sensor(f"s{k}", link, place, exp(turn))
        for k, ((link, place), turn) in enumerate(zip(places, mountings, strict=True))
    ]
    return Robot(("a", "b"), (joint,), tuple(sensors))


@pytest.mark.parametrize("axis", [Z, (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.6, 0.0, 0.8)])
def test_channels_of_any_axis_and_mounting(axis: tuple[float, float, float]) -> None:
    """Two links turn about a fixed direction: G and F of the channels give back how."""
    random = np.random.default_rng(5)
    robot = four_sensors(
        Joint("j", "a", "b", (axis,), origin=(0.3, 0.02, 0.01)), random.uniform(-3, 3, (4, 3)).tolist()
    )
    found = joint_arrays(robot)[0]
    position, n = 0.7, np.array(axis)
    at_joint = np.array([1.0, -2.0, 9.0])  # in the axes of a
    turned_back = exp((-position * n).tolist())
    rates, accelerations = (1.5, -2.5), (20.0, -7.0)
    readings = []
    for sensor in robot.sensors:
        of_b = sensor.link == "b"
        w, alpha = n * rates[of_b], n * accelerations[of_b]
        r = np.array(sensor.position) - (0.0 if of_b else np.array(robot.joints[0].origin))
        force = np.array(rotate(turned_back, tuple(at_joint.tolist()))) if of_b else at_joint
        acceleration = force + np.cross(alpha, r) + np.cross(w, np.cross(w, r))
        readings.append(rotate_inverse(sensor.mounting, tuple(acceleration.tolist())))
    channels = found.channels(np.array(readings))
    forces = []
    for array, part, rate, alpha in (
        (found.parent, channels[:4], rates[0], accelerations[0]),
        (found.child, channels[4:], rates[1], accelerations[1]),
    ):
        g, f = array_matrices(array.positions)
        assert g @ part == pytest.approx([rate**2, alpha], abs=1e-10)
        forces.append(f @ part)
    (ax, ay), (bx, by) = forces
    assert math.atan2(ax * by - ay * bx, ax * bx + ay * by) == pytest.approx(-position, abs=1e-12)
    stacked = found.channels(np.array([readings, readings]))
    assert stacked == pytest.approx(np.array([channels, channels]))


def test_missing_readings_stay_missing() -> None:
    robot = four_sensors(Joint("j", "a", "b", (Z,)), [(0.0, 0.0, 0.0)] * 4)
    readings = np.ones((4, 3))
    readings[1] = math.nan
    assert np.isnan(joint_arrays(robot)[0].channels(readings)).tolist() == [False] * 2 + [True] * 2 + [False] * 4


def test_sensors_without_accelerometer_are_not_part_of_an_array() -> None:
    robot = four_sensors(Joint("j", "a", "b", (Z,)), [(0.0, 0.0, 0.0)] * 4)
    gyro = Sensor("gyro", "a", (0.5, 0.5, 0.5), accel=False)
    found = joint_arrays(replace(robot, sensors=(gyro, *robot.sensors)))[0]
    assert [sensor.name for sensor in found.sensors] == ["s0", "s1", "s2", "s3"]
    assert found.positions.shape == (4, 2) and found.projections.shape == (4, 2, 3)


def chain(counts: dict[str, int], joints: tuple[Joint, ...]) -> Robot:
    sensors = [
        Sensor(f"{link}{k}", link, (0.1 * k, 0.0, 0.0)) for link, number in counts.items() for k in range(number)
    ]
    return Robot(tuple(counts), joints, tuple(sensors))


def test_every_joint_of_a_tree_with_two_arrays_is_found() -> None:
    joints = (
        Joint("wrist", "arm", "hand", (Z,)),
        Joint("elbow", "upper", "arm", (Z,), origin=(0.3, 0.0, 0.0)),
        Joint("thumb", "hand", "tip", (Z,)),
        Joint("ball", "hand", "finger", (Z, (0.0, 1.0, 0.0))),
    )
    robot = chain({"upper": 2, "arm": 3, "hand": 2, "tip": 1, "finger": 2}, joints)
    found = joint_arrays(robot)
    assert [one.joint.name for one in found] == ["elbow", "wrist"]
    assert found[0].parent.positions == pytest.approx(np.array([[-0.3, 0.0], [-0.2, 0.0]]))
    assert found[1].parent.positions == pytest.approx(np.array([[0.0, 0.0], [0.1, 0.0], [0.2, 0.0]]))


def test_a_rolling_joint_is_refused() -> None:
    rolling = Joint("j", "a", "b", (Z,), roll_link=(0.01, 0.0, 0.0))
    with pytest.raises(ConfigurationError, match="joint 'j': rolls"):
        joint_arrays(chain({"a": 2, "b": 2}, (rolling,)))


@pytest.mark.parametrize(
    ("counts", "axes", "message"),
    [
        ({"a": 1, "b": 2}, (Z,), "link 'a' has fewer than two accelerometers"),
        ({"a": 2, "b": 0}, (Z,), "link 'b' has fewer than two accelerometers"),
        ({"a": 2, "b": 2}, (Z, (1.0, 0.0, 0.0)), "2 axes; accelerometer arrays need one"),
    ],
)
def test_what_is_no_array_is_refused_with_the_reason(
    counts: dict[str, int], axes: tuple[tuple[float, float, float], ...], message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        joint_arrays(chain(counts, (Joint("j", "a", "b", axes),)))


def test_a_robot_without_joints_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="no joints"):
        joint_arrays(chain({"a": 2}, ()))


def test_sensors_that_differ_along_the_axis_alone_coincide() -> None:
    sensors = [Sensor(f"{link}{k}", link, (0.1, 0.0, 0.2 * k)) for link in "ab" for k in range(2)]
    robot = Robot(("a", "b"), (Joint("j", "a", "b", (Z,)),), tuple(sensors))
    with pytest.raises(ConfigurationError, match=r"joint 'j': link 'a' \(a0, a1\): .*coincide"):
        joint_arrays(robot)


def test_turning_a_sensor_in_its_mounting_changes_no_channel() -> None:
    joint = Joint("j", "a", "b", (Z,))
    plain, turn = four_sensors(joint, [(0.0, 0.0, 0.0)] * 4), exp((0.3, -1.0, 2.0))
    turned = replace(plain, sensors=tuple(replace(s, mounting=multiply(turn, s.mounting)) for s in plain.sensors))
    readings = np.random.default_rng(1).standard_normal((4, 3))
    seen = np.array([rotate_inverse(turn, tuple(reading)) for reading in readings.tolist()])
    assert joint_arrays(turned)[0].channels(seen) == pytest.approx(joint_arrays(plain)[0].channels(readings))
