"""From a rotation to the angles and rates of joints of one, two and three axes, and back."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import Quat, Vec3
from jointest_ros.core.pcf.attitude import (
    heading_difference,
    heading_north,
    joint_angles,
    joint_rates,
    lever,
    world_field,
    zero_rotation,
)
from jointest_ros.core.rotation import conjugate, cross, dot, exp, log, multiply, norm, perpendicular, rotate, unit

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
Axes = tuple[Vec3, ...]

component = st.floats(-1.0, 1.0)
directions = st.tuples(component, component, component).filter(lambda v: norm(v) > 0.1).map(unit)
whole = st.floats(-3.1, 3.1)
half = st.floats(-1.55, 1.55)
ORDERS = [(Z, Y, X), (X, Y, Z), (Y, X, Z), (X, Z, Y), (X, Y, X), (Z, X, Z), (Y, Z, Y)]


def composed(axes: Axes, angles: tuple[float, ...]) -> Quat:
    """The revolutes in succession."""
    turned = (0.0, 0.0, 0.0, 1.0)
    for axis, angle in zip(axes, angles, strict=True):
        turned = multiply(turned, exp(tuple(angle * c for c in axis)))
    return turned


def vector(*components: float) -> Vec3:
    x, y, z = components
    return x, y, z


@given(directions, whole)
def test_one_axis_of_any_direction(axis: Vec3, angle: float) -> None:
    assert joint_angles((axis,), composed((axis,), (angle,))) == pytest.approx((angle,), abs=1e-9)


@given(directions, st.floats(-math.radians(60), math.radians(60)), st.floats(0.0, 0.02), whole)
def test_what_is_not_about_the_axis_does_not_leak_in(axis: Vec3, angle: float, off: float, where: float) -> None:
    """A disturbance about any perpendicular axis is a second-order effect on the angle."""
    u, v = perpendicular(axis)
    about = vector(*(off * (math.cos(where) * a + math.sin(where) * b) for a, b in zip(u, v, strict=True)))
    (found,) = joint_angles((axis,), multiply(composed((axis,), (angle,)), exp(about)))
    assert found == pytest.approx(angle, abs=off**2 + 1e-12)


@given(directions, whole, whole, whole)
def test_two_perpendicular_axes(first: Vec3, turn: float, one: float, two: float) -> None:
    u, v = perpendicular(first)
    second = vector(*(math.cos(turn) * a + math.sin(turn) * b for a, b in zip(u, v, strict=True)))
    angles = (one, two)
    assert joint_angles((first, second), composed((first, second), angles)) == pytest.approx(angles, abs=1e-9)


@given(directions, directions, whole, whole)
def test_two_oblique_axes(first: Vec3, second: Vec3, one: float, two: float) -> None:
    assume(norm(cross(first, second)) > 0.3)
    angles = (one, two)
    assert joint_angles((first, second), composed((first, second), angles)) == pytest.approx(angles, abs=1e-8)


@pytest.mark.parametrize("axes", ORDERS)
@given(first=whole, middle=half, last=whole)
def test_three_axes(axes: Axes, first: float, middle: float, last: float) -> None:
    """Round trip; the middle angle lies in [-90, 90] deg, or in [0, 180] deg where the third axis repeats the first."""
    if axes[0] == axes[2]:
        middle += math.pi / 2
    assume(abs(dot(axes[0], rotate(composed(axes, (first, middle, last)), axes[2]))) < 0.9999)  # not in gimbal lock
    angles = (first, middle, last)
    assert joint_angles(axes, composed(axes, angles)) == pytest.approx(angles, abs=1e-6)


@pytest.mark.parametrize("axes", ORDERS)
@given(middle=st.sampled_from([-1, 0, 1]), first=half, last=half)
def test_in_gimbal_lock_the_rotation_is_still_the_right_one(axes: Axes, middle: int, first: float, last: float) -> None:
    lock = middle * math.pi / 2 if axes[0] != axes[2] else (middle + 1) * math.pi / 2
    turned = composed(axes, (first, lock, last))
    found = joint_angles(axes, turned)
    assert norm(log(multiply(conjugate(composed(axes, found)), turned))) < 1e-6


@pytest.mark.parametrize("axes", [(X,), (Y, X), (X, unit((0.3, 1.0, 0.2))), *ORDERS])
@given(angles=st.tuples(half, half, half), rates=st.tuples(component, component, component))
def test_rates_are_the_derivatives_of_the_angles(axes: Axes, angles: Vec3, rates: Vec3) -> None:
    """Relative rate in the child's frame by differences of the rotation."""
    count = len(axes)
    if count == 3 and axes[0] == axes[2]:
        angles = (angles[0], angles[1] + math.pi / 2, angles[2])
    if count == 3:
        assume(abs(dot(axes[0], rotate(composed(axes, angles), axes[2]))) < 0.99)
    step = 1e-6
    before, after = (
        composed(axes, tuple(a + sign * step * r for a, r in zip(angles[:count], rates[:count], strict=True)))
        for sign in (-1.0, 1.0)
    )
    x, y, z = log(multiply(conjugate(before), after))
    relative = vector(x / (2 * step), y / (2 * step), z / (2 * step))
    assert joint_rates(axes, angles[:count], relative) == pytest.approx(rates[:count], abs=1e-6)


def test_rates_in_gimbal_lock_are_finite() -> None:
    for axes in ORDERS:
        lock = math.pi / 2 if axes[0] != axes[2] else 0.0
        rates = joint_rates(axes, (0.3, lock, 0.1), (1.0, 2.0, 3.0))
        assert all(abs(rate) < 10.0 for rate in rates)


@given(directions, whole, directions)
def test_zero_rotation_of_a_hinge_is_about_its_axis(axis: Vec3, offset: float, up: Vec3) -> None:
    """R_o by TRIAD, axis first and gravity second: it finds by how much the child is turned about the axis."""
    assume(lever(axis, up) > 0.01)
    turned = composed((axis,), (offset,))
    child = rotate(conjugate(turned), up)
    found = zero_rotation((axis,), up, child)
    assert norm(log(multiply(conjugate(found), turned))) < 1e-6


@given(directions, directions)
def test_zero_rotation_of_more_axes_is_the_smallest(up: Vec3, child: Vec3) -> None:
    found = zero_rotation((X, Y), up, child)
    np.testing.assert_allclose(rotate(found, child), up, atol=1e-6)


@given(directions, directions, st.floats(0.1, 100.0))
def test_lever_is_the_squared_sine(axis: Vec3, accel: Vec3, length: float) -> None:
    expected = norm(cross(axis, accel)) ** 2
    assert lever(axis, vector(*(length * c for c in accel))) == pytest.approx(expected, abs=1e-9)


def test_lever_without_gravity_is_nothing() -> None:
    assert lever(X, (0.0, 0.0, 0.0)) == 0.0


@given(directions, whole, st.floats(-1.5, 1.5))
def test_headings(axis: Vec3, angle: float, yaw: float) -> None:
    """What turns one attitude into another about the vertical, and north by the magnetic field (x east, y north)."""
    attitude = composed((axis,), (angle,))
    turned = multiply(composed((Z,), (yaw,)), attitude)
    assert heading_difference(turned, attitude) == pytest.approx(composed((Z,), (yaw,)), abs=1e-9)
    field = Rotation.from_quat(attitude).inv().apply([0.0, 20e-6, -44e-6])
    sensed = vector(*field.tolist())
    np.testing.assert_allclose(world_field(turned, sensed), [0.0, 20e-6, -44e-6], atol=1e-15)
    np.testing.assert_allclose(rotate(heading_north(turned, sensed), sensed), [0.0, 20e-6, -44e-6], atol=1e-15)
