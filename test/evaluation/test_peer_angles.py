"""Hinge angles from orientations whose worlds differ by a turn about the vertical: exact where the orientations are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.rotation import norm, unit
from jointest_ros.evaluation.peer_angles import TRACKING_TIME, heading_difference, hinge_angles

PERIOD = 0.01  # s
TIME = np.arange(0.0, 20.0, PERIOD)
UP = np.array([0.0, 0.0, 1.0])

component = st.floats(-1.0, 1.0)
directions = st.tuples(component, component, component).filter(lambda v: norm(v) > 0.1).map(unit)


def swaying() -> Rotation:
    """A parent link that turns about all axes."""
    return Rotation.from_euler("ZYX", np.column_stack([2.0 * np.sin(0.3 * TIME), 0.5 * np.sin(TIME), 0.4 * TIME]))


def child_of(parent: Rotation, axis: Vec3, angle: FloatArray, heading: FloatArray) -> Rotation:
    """The child link in a world of its own, which is turned by -heading about the vertical."""
    return Rotation.from_rotvec(np.outer(-heading, UP)) * parent * Rotation.from_rotvec(np.outer(angle, axis))


@settings(max_examples=30)
@given(axis=directions)
def test_exact_orientations_give_exact_angles_whatever_the_heading(axis: Vec3) -> None:
    angle, heading = 1.5 * np.sin(2.0 * TIME), 0.1 * TIME + 0.5 * np.sin(TIME)
    parent = swaying()
    level = np.hypot(*parent.apply(axis).T[:2]) > 0.05  # an axis along gravity says nothing of the heading
    child = child_of(parent, axis, angle, heading)
    found = hinge_angles(parent, child, axis, PERIOD)
    np.testing.assert_allclose(found[level], angle[level], atol=1e-6)
    turn = heading_difference(parent, child, axis, PERIOD, 0.0) - heading
    np.testing.assert_allclose(np.angle(np.exp(1j * turn))[level], 0.0, atol=1e-6)


def test_without_a_heading_of_its_own_it_is_the_plain_twist() -> None:
    axis, angle = (1.0, 0.0, 0.0), np.linspace(-3.1, 3.1, len(TIME))
    parent = swaying()
    found = hinge_angles(parent, child_of(parent, axis, angle, 0.0 * TIME), axis, PERIOD)
    np.testing.assert_allclose(found, (parent.inv() * child_of(parent, axis, angle, 0.0 * TIME)).as_rotvec()[:, 0])


def test_a_constant_heading_is_tracked_exactly() -> None:
    """From the first sample on: the low pass begins as the mean of what there was."""
    axis, angle = (0.6, 0.8, 0.0), np.sin(TIME)
    parent = swaying()
    child = child_of(parent, axis, angle, np.full_like(TIME, 2.5))
    np.testing.assert_allclose(hinge_angles(parent, child, axis, PERIOD, TRACKING_TIME), angle, atol=1e-9)


def test_tracking_averages_noise_where_the_axis_comes_near_gravity() -> None:
    axis, angle = (1.0, 0.0, 0.0), 0.5 * np.sin(2.0 * TIME)
    generator = np.random.default_rng(1)
    # the axis is 4 to 16 deg off the vertical
    parent = Rotation.from_rotvec(np.outer(1.4 + 0.1 * np.sin(TIME), [0.0, 1.0, 0.0]))
    noise = [Rotation.from_rotvec(np.radians(0.5) * generator.standard_normal((len(TIME), 3))) for _ in range(2)]
    child = child_of(parent, axis, angle, 0.01 * TIME)
    errors = {
        time: np.std(hinge_angles(parent * noise[0], child * noise[1], axis, PERIOD, time) - angle)
        for time in (0.0, TRACKING_TIME)
    }
    assert errors[TRACKING_TIME] < 0.3 * errors[0.0]


@pytest.mark.parametrize("tracking_time", [0.0, TRACKING_TIME])
def test_a_tilt_error_about_the_axis_is_the_error_of_the_angle(tracking_time: float) -> None:
    """What the filter under test gets wrong there is not hidden."""
    axis, angle = (1.0, 0.0, 0.0), np.sin(TIME)
    parent = Rotation.from_rotvec(np.outer(0.3 * TIME, UP))
    child = child_of(parent, axis, angle, 0.2 * TIME) * Rotation.from_rotvec([0.03, 0.0, 0.0])
    np.testing.assert_allclose(hinge_angles(parent, child, axis, PERIOD, tracking_time) - angle, 0.03, atol=2e-3)
