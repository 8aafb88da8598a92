"""Circles through contact points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jointest_ros.core.errors import JointestError
from jointest_ros.core.robot import Joint, Robot
from jointest_ros.evaluation.posture import contact_points, fit_circle


@given(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(0.01, 100.0), st.floats(0.0, 6.0), st.integers(3, 9))
def test_points_on_a_circle_give_it_back(x: float, y: float, radius: float, first: float, count: int) -> None:
    turn = first + np.linspace(0.0, 2.5, count)
    centre, found = fit_circle(np.column_stack([x + radius * np.cos(turn), y + radius * np.sin(turn)]))
    np.testing.assert_allclose(centre, [x, y], atol=1e-7 * (1.0 + radius))
    assert found == pytest.approx(radius, rel=1e-7)


def test_many_circles_at_once_are_the_single_ones() -> None:
    points = np.random.default_rng(0).standard_normal((5, 4, 2))
    centres, radii = fit_circle(points)
    assert centres.shape == (5, 2) and radii.shape == (5,)
    for four, centre, radius in zip(points, centres, radii, strict=True):
        alone, its = fit_circle(four)
        np.testing.assert_allclose(alone, centre)
        assert its == pytest.approx(radius)


def test_no_other_circle_fits_better_in_the_sense_of_the_method() -> None:
    points = np.random.default_rng(1).standard_normal((6, 2))
    centre, radius = fit_circle(points)

    def misfit(x: float, y: float, r: float) -> float:
        return float(np.sum((np.sum((points - [x, y]) ** 2, axis=1) - r**2) ** 2))

    best = misfit(*centre, radius)
    for change in np.vstack([np.eye(3), -np.eye(3)]) * 1e-3:
        assert misfit(centre[0] + change[0], centre[1] + change[1], radius + change[2]) > best


@pytest.mark.parametrize(
    ("points", "text"),
    [
        ([[0.0, 0.0], [1.0, 0.0]], "2 points are not enough"),
        ([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]], "on a line"),
        ([[1.0, 1.0]] * 4, "on a line"),
    ],
)
def test_what_is_no_circle_is_refused(points: list[list[float]], text: str) -> None:
    with pytest.raises(JointestError, match=text):
        fit_circle(np.array(points))


def test_contacts_move_with_their_links() -> None:
    robot = Robot(("palm", "finger"), (Joint("j", "palm", "finger", ((1.0, 0.0, 0.0),), origin=(0.0, 0.1, 0.0)),))
    contacts = [("palm", (0.0, 0.0, 0.02)), ("finger", (0.0, 0.0, 0.03))]
    found = contact_points(robot, {"j": np.pi / 2}, contacts)
    np.testing.assert_allclose(found, [[0.0, 0.0, 0.02], [0.0, 0.07, 0.0]], atol=1e-15)
