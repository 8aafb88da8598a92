"""Forward kinematics: products of the revolutes, places of the links, joints that roll without slip."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jointest_ros.core.kinematics import Pose, link_poses
from jointest_ros.core.robot import Joint, Robot

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
angles = st.floats(-3.0, 3.0)


def test_orientations_are_the_products_of_the_revolutes() -> None:
    joints = (Joint("elbow", "upper", "lower", (Y,)), Joint("shoulder", "trunk", "upper", (Z, X, Y)))
    robot = Robot(("lower", "trunk", "upper"), joints)
    positions = {"shoulder_z": 0.3, "shoulder_x": -0.8, "shoulder_y": 1.9, "elbow": 2.5}
    found = {link: Rotation.from_quat(pose.orientation) for link, pose in link_poses(robot, positions).items()}
    upper = Rotation.from_euler("ZXY", [0.3, -0.8, 1.9])
    expected = {"trunk": Rotation.identity(), "upper": upper, "lower": upper * Rotation.from_euler("Y", 2.5)}
    assert list(found) == ["lower", "trunk", "upper"]
    for link, orientation in expected.items():
        assert (found[link].inv() * orientation).magnitude() < 1e-12


def test_links_without_joints_are_roots_of_their_own() -> None:
    robot = Robot(("a", "loose", "b"), (Joint("j", "a", "b", (X,), origin=(1.0, 2.0, 3.0)),))
    poses = link_poses(robot, {"j": 1.0})
    assert poses["loose"] == poses["a"] == Pose()
    assert poses["b"].position == (1.0, 2.0, 3.0)


@given(angles, angles, angles)
def test_places_of_links_and_of_their_points(one: float, two: float, three: float) -> None:
    """Origins of the joints, carried by what turns before them; homogeneous matrices say the same."""
    joints = (
        Joint("j", "base", "middle", (Z, X), origin=(0.1, -0.2, 0.3)),
        Joint("k", "middle", "end", (Y,), origin=(0.0, 0.5, 0.0)),
    )
    positions = {"j_z": one, "j_x": two, "k": three}
    poses = link_poses(Robot(("end", "base", "middle"), joints), positions)
    matrix = np.eye(4)
    for axes, origin in (("ZX", (0.1, -0.2, 0.3)), ("Y", (0.0, 0.5, 0.0))):
        step = np.eye(4)
        step[:3, :3] = Rotation.from_euler(axes, [one, two] if axes == "ZX" else [three]).as_matrix()
        step[:3, 3] = origin
        matrix = matrix @ step
    at = (0.03, -0.04, 0.7)
    np.testing.assert_allclose(poses["end"].position, matrix[:3, 3], atol=1e-12)
    np.testing.assert_allclose(poses["end"].point(at), (matrix @ [*at, 1.0])[:3], atol=1e-12)


@pytest.mark.parametrize("axis", [X, (-1.0, 0.0, 0.0)])
@given(st.floats(-2.0, 2.0))
def test_a_rolling_joint_is_two_cylinders_that_roll_without_slip(axis, angle: float) -> None:
    """Both unroll the same arc from the point of contact at the zero pose, which stays on the line of centres."""
    radius = 0.0065
    joint = Joint("j", "parent", "child", (axis,), origin=(0.0, 0.045, 0.02), roll_link=(0.0, 0.0, 2 * radius))
    pose = link_poses(Robot(("parent", "child"), (joint,)), {"j": angle})["child"]
    between = np.subtract(pose.position, joint.origin)
    assert np.linalg.norm(between) == pytest.approx(2 * radius)
    # by how much the point of contact has travelled on the parent's and on the child's cylinder, about the axis
    along = between / (2 * radius)
    in_child = Rotation.from_quat(pose.orientation).inv().apply(along)
    assert math.atan2(-along[1], along[2]) * axis[0] == pytest.approx(angle / 2, abs=1e-9)
    assert math.atan2(-in_child[1], in_child[2]) * axis[0] == pytest.approx(-angle / 2, abs=1e-9)
    np.testing.assert_allclose(
        Rotation.from_quat(pose.orientation).as_rotvec(), angle * np.array(axis), atol=1e-9
    )  # the joint position is the whole relative rotation
