"""Rotations in plain floats against scipy and against their own definitions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jointest_ros.core import rotation
from jointest_ros.core.frame import Quat, Vec3

component = st.floats(-4.0, 4.0)
vectors = st.tuples(component, component, component)
directions = vectors.filter(lambda v: rotation.norm(v) > 1e-3).map(rotation.unit)
quaternions = st.tuples(component, component, component, component)
attitudes = quaternions.filter(lambda q: math.hypot(*q) > 1e-3).map(rotation.normalized)
angles = st.floats(-3.1, 3.1)


def same_rotation(p: Quat, q: Quat) -> bool:
    return abs(abs(sum(a * b for a, b in zip(p, q, strict=True))) - 1.0) < 1e-12


@given(attitudes, attitudes, vectors)
def test_products_and_turns_are_those_of_scipy(p: Quat, q: Quat, v: Vec3) -> None:
    one, two = Rotation.from_quat(p), Rotation.from_quat(q)
    assert same_rotation(rotation.multiply(p, q), tuple((one * two).as_quat()))
    np.testing.assert_allclose(rotation.rotate(q, v), two.apply(v), atol=1e-12)
    np.testing.assert_allclose(rotation.rotate_inverse(q, v), two.inv().apply(v), atol=1e-12)
    np.testing.assert_allclose(rotation.rotate(rotation.conjugate(q), v), two.inv().apply(v), atol=1e-12)


@given(vectors, vectors)
def test_cross_and_dot(a: Vec3, b: Vec3) -> None:
    np.testing.assert_allclose(rotation.cross(a, b), np.cross(a, b), atol=1e-12)
    assert rotation.dot(a, b) == pytest.approx(np.dot(a, b), abs=1e-12)
    assert rotation.norm(a) == pytest.approx(np.linalg.norm(a))


@given(directions, angles)
def test_log_undoes_exp(axis: Vec3, angle: float) -> None:
    vector = tuple(angle * a for a in axis)
    q = rotation.exp(vector)
    assert math.hypot(*q) == pytest.approx(1.0, abs=1e-15)
    assert same_rotation(q, tuple(Rotation.from_rotvec(vector).as_quat()))
    np.testing.assert_allclose(rotation.log(q), vector, atol=1e-12)
    np.testing.assert_allclose(rotation.log(tuple(-c for c in q)), vector, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 1e-8, 0.99e-4, 1.01e-4, 1e-3, math.pi - 1e-9, math.pi])
def test_exp_and_log_near_their_switches(angle: float) -> None:
    q = rotation.exp((0.0, angle, 0.0))
    np.testing.assert_allclose(q, (0.0, math.sin(angle / 2), 0.0, math.cos(angle / 2)), rtol=1e-15, atol=1e-16)
    np.testing.assert_allclose(rotation.log(q), (0.0, angle, 0.0), rtol=1e-12, atol=1e-300)


@given(directions)
def test_perpendicular_completes_a_right_handed_frame(a: Vec3) -> None:
    u, v = rotation.perpendicular(a)
    np.testing.assert_allclose(np.linalg.det([u, v, a]), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.array([u, v, a]) @ np.array([u, v, a]).T, np.eye(3), atol=1e-12)


@given(directions, directions, st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_between_turns_one_direction_into_the_other_the_short_way(a: Vec3, b: Vec3, k: float, m: float) -> None:
    q = rotation.between(tuple(k * c for c in a), tuple(m * c for c in b))
    np.testing.assert_allclose(rotation.rotate(q, a), b, atol=1e-9)
    angle = math.atan2(rotation.norm(rotation.cross(a, b)), rotation.dot(a, b))
    assert rotation.norm(rotation.log(q)) == pytest.approx(angle, abs=1e-9)


@given(directions)
def test_between_opposite_directions_is_half_a_turn(a: Vec3) -> None:
    opposite = tuple(-c for c in a)
    np.testing.assert_allclose(rotation.rotate(rotation.between(a, opposite), a), opposite, atol=1e-6)


def test_between_and_a_vector_without_direction_is_no_turn() -> None:
    assert rotation.between((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)) == rotation.IDENTITY
    assert rotation.between((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)) == rotation.IDENTITY


@given(st.floats(-1e4, 1e4))
def test_wrap_takes_whole_turns_away(angle: float) -> None:
    wrapped = rotation.wrap(angle)
    assert -math.pi <= wrapped <= math.pi
    turns = (angle - wrapped) / (2.0 * math.pi)
    assert turns == pytest.approx(round(turns), abs=1e-9)


@given(angles, angles, angles)
def test_rpy_is_that_of_urdf(roll: float, pitch: float, yaw: float) -> None:
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    assert same_rotation(rotation.from_rpy(roll, pitch, yaw), tuple(expected.as_quat()))


@given(
    st.one_of(attitudes, st.builds(rotation.from_rpy, angles, st.sampled_from([-0.5 * math.pi, 0.5 * math.pi]), angles))
)
def test_to_rpy_gives_the_angles_of_the_same_rotation(q: Quat) -> None:
    assert same_rotation(rotation.from_rpy(*rotation.to_rpy(q)), q)
