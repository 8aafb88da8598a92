"""The disks of the posture validation: exact grasps, and the figures of the specification, section 4 item 6."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from jointest_ros.evaluation.posture import contact_points
from jointest_ros.reproduction.pcf_disk import AT_ONE_DEGREE, Grasp, estimated, grasp, noise_error, radius_of
from jointest_ros.sim.gripper import DISKS, PALM_ANGLES, gripper

ROBOT = gripper()
RADII = tuple(DISKS)


@pytest.fixture(scope="module", params=RADII, ids=lambda radius: f"{1e3 * radius:g}mm")
def held(request: pytest.FixtureRequest) -> Grasp:
    return grasp(ROBOT, request.param)


def test_the_disk_touches_the_links_where_the_contacts_are(held: Grasp) -> None:
    """On the inner faces, within the links, tangent; at the angles of the specification to within their rounding."""
    assert len(held.contacts) == (5 if held.radius == max(RADII) else 4)
    points = contact_points(ROBOT, held.positions, held.contacts)
    np.testing.assert_allclose(np.hypot(points[:, 1], points[:, 2] - held.height), held.radius, atol=1e-12)
    for link, (_, y, z) in held.contacts:
        assert (y, z) == (0.0, 0.020) if link == "palm" else (abs(y) == 0.008 and 0.0 < z < 0.025)
    angles = np.degrees([held.positions[f"left_{joint}"] for joint in ("mcp", "pip", "dip")])
    np.testing.assert_allclose(angles, DISKS[held.radius], atol=0.05)


def test_exact_angles_give_the_exact_radius(held: Grasp) -> None:
    assert radius_of(ROBOT, held.positions, held.contacts) == pytest.approx(held.radius, rel=1e-6)


def test_the_palm_may_point_anywhere(held: Grasp) -> None:
    turned = held.positions | dict(zip(PALM_ANGLES, (1.0, -0.7, 0.4), strict=True))
    assert radius_of(ROBOT, turned, held.contacts) == pytest.approx(held.radius, rel=1e-6)


def test_error_at_one_degree_of_joint_noise(held: Grasp) -> None:
    found = noise_error(ROBOT, held, math.radians(1.0), draws=3000, seed=1)
    assert found == pytest.approx(AT_ONE_DEGREE[held.radius], rel=0.08)


def test_a_plain_revolute_in_place_of_the_rolling_joint_would_not_do(held: Grasp) -> None:
    """The virtual link stands still where only the angle turns: millimetres off."""
    joints = [
        joint if joint.roll_link is None else replace(joint, roll_link=None, origin=_sum(joint.origin, joint.roll_link))
        for joint in ROBOT.joints
    ]
    plain = replace(ROBOT, joints=tuple(joints))
    assert abs(radius_of(plain, held.positions, held.contacts) - held.radius) > 0.3e-3


def _sum(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def test_the_estimated_posture_gives_the_radius(held: Grasp) -> None:
    """Better than the paper's real hand: IMU noise alone."""
    errors = [estimated(held, seed) / held.radius - 1.0 for seed in (1, 2)]
    assert 0.0 < max(map(abs, errors)) < 0.005
