"""Posture validation: the size of a grasped disk from the points where links touch it (Santaera et al. 2015, V.A)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from jointest_ros.core.errors import JointestError
from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.kinematics import link_poses
from jointest_ros.core.robot import Robot

Contact = tuple[str, Vec3]  # link, point that touches in the link's frame, m


def contact_points(robot: Robot, positions: Mapping[str, float], contacts: Sequence[Contact]) -> FloatArray:
    """(n, 3) the contacts in the root link, m, by forward kinematics at joint positions (rad) by coordinate."""
    poses = link_poses(robot, positions)
    return np.array([poses[link].point(at) for link, at in contacts])


def fit_circle(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centres (..., 2) and radii (...) of the circles that fit points (..., n, 2) best.

    Least squares of x^2 + y^2 - 2 cx x - 2 cy y - c, which is linear (Kasa 1976).

    Raises:
        JointestError: fewer than three points, or points on a line.
    """
    points = np.asarray(points, dtype=float)
    if points.shape[-2] < 3:
        raise JointestError(f"{points.shape[-2]} points are not enough for a circle; give 3 or more")
    middle = points.mean(axis=-2, keepdims=True)  # about their middle, for the sake of the numbers
    arms = points - middle
    normal = np.swapaxes(arms, -1, -2) @ arms
    if np.any(np.linalg.det(normal) <= 1e-12 * np.trace(normal, axis1=-2, axis2=-1) ** 2):
        raise JointestError("the points lie on a line; no circle fits them")
    squares = np.sum(arms**2, axis=-1)
    centre = 0.5 * np.linalg.solve(normal, np.sum(arms * squares[..., None], axis=-2)[..., None])[..., 0]
    radius = np.sqrt(squares.mean(axis=-1) + np.sum(centre**2, axis=-1))
    return centre + middle[..., 0, :], radius
