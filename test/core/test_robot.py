"""The kinematic tree: what it refuses, how it names coordinates, its order."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import Vec3
from jointest_ros.core.kinematics import link_poses
from jointest_ros.core.robot import Joint, Robot, Sensor

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
OBLIQUE = (0.6, 0.0, 0.8)


def hinge(name: str, parent: str, child: str) -> Joint:
    return Joint(name, parent, child, (X,))


@pytest.mark.parametrize(
    ("make", "parts"),
    [
        (lambda: Robot(("a", "a")), ("links", "'a'", "twice")),
        (lambda: Robot(("a", "b", "c"), (hinge("j", "a", "b"), hinge("j", "b", "c"))), ("joints", "'j'", "twice")),
        (lambda: Robot(("a",), (), (Sensor("s", "a"), Sensor("s", "a"))), ("sensors", "'s'", "twice")),
        (lambda: Robot(("palm", "b"), (hinge("j", "plam", "b"),)), ("joint 'j'.parent", "'plam'", "'palm'?")),
        (lambda: Robot(("palm", "b"), (hinge("j", "palm", "zz"),)), ("joint 'j'.child", "'zz'", "known: palm, b")),
        (lambda: Robot(("a",), (), (Sensor("s", "q"),)), ("sensor 's'.link", "'q'", "known: a")),
        (
            lambda: Robot(("a", "b", "c"), (hinge("j", "a", "c"), hinge("k", "b", "c"))),
            ("joint 'k'.child", "'c'", "'a' already", "one parent"),
        ),
        (
            lambda: Robot(("a", "b", "c"), (hinge("j", "a", "b"), hinge("k", "b", "c"), hinge("l", "c", "a"))),
            ("joint 'l'.child", "'a'", "tree"),
        ),
        (lambda: Robot(("a",), (hinge("j", "a", "a"),)), ("joint 'j'.child", "'a'", "tree")),
        (
            lambda: Robot(("a", "b", "c"), (Joint("j", "a", "b", (X, Y)), hinge("j_x", "b", "c"))),
            ("joint coordinates", "'j_x'", "twice"),
        ),
        (lambda: Joint("j", "a", "b", ()), ("joint 'j'.axes", "0", "one to three")),
        (lambda: Joint("j", "a", "b", (X, Y, Z, X)), ("joint 'j'.axes", "4", "one to three")),
        (lambda: Joint("j", "a", "b", ((1.0, 1.0, 0.0),)), ("joint 'j'.axes", "(1.0, 1.0, 0.0)", "length must be 1")),
        (lambda: Joint("j", "a", "b", ((math.nan, 1.0, 0.0),)), ("joint 'j'.axes", "nan", "length must be 1")),
        (lambda: Joint("j", "a", "b", (X, Y), limits=((-1.0, 1.0),)), ("joint 'j'.limits", "each axis")),
        (lambda: Joint("j", "a", "b", (X, Y, Y)), ("joint 'j'.axes", "(0.0, 1.0, 0.0)", "parallel")),
        (lambda: Joint("j", "a", "b", (X, Y), names=("a",)), ("joint 'j'.names: ['a']", "each axis")),
        (
            lambda: Robot(("a", "b", "c"), (Joint("j", "a", "b", (X, Y), names=("k", "l")), hinge("k", "b", "c"))),
            ("joint coordinates", "'k'", "twice"),
        ),
        (
            lambda: Joint("j", "a", "b", (X,), roll_link=(0.013, 0.0, 0.0)),
            ("joint 'j'.roll_link", "(0.013, 0.0, 0.0)", "one axis, perpendicular"),
        ),
        (lambda: Joint("j", "a", "b", (X, Y), roll_link=(0.0, 0.0, 0.013)), ("joint 'j'.roll_link", "one axis")),
        (lambda: Robot(("a", "b"), (hinge("j", "a", "b"),), world="c"), ("world: 'c'", "known: a, b")),
        (lambda: Robot(("a", "b"), (hinge("j", "a", "b"),), world="b"), ("world: 'b'", "on 'a'", "no parent")),
        (lambda: Robot(("a",), (), (Sensor("s", "a"),), world="a"), ("sensor 's'.link", "'a' is the world")),
        (lambda: Robot(("a",)).sensor("imu"), ("sensor 'imu'", "known: none")),
        (lambda: Robot(("a",), (), (Sensor("imu_1", "a"),)).sensor("imu_l"), ("sensor 'imu_l'", "'imu_1'?")),
    ],
)
def test_a_wrong_tree_is_one_line_that_says_what_is_wrong(make, parts) -> None:
    with pytest.raises(ConfigurationError) as caught:
        make()
    message = str(caught.value)
    assert "\n" not in message
    for part in parts:
        assert part in message


@pytest.mark.parametrize(
    ("axes", "names"),
    [
        ((X,), ("j",)),
        ((OBLIQUE,), ("j",)),
        ((X, Y), ("j_x", "j_y")),
        ((Z, (0.0, -1.0, 0.0), X), ("j_z", "j_y", "j_x")),
        ((X, OBLIQUE), ("j_x", "j_2")),
        ((Z, X, Z), ("j_1", "j_2", "j_3")),
    ],
)
def test_coordinates_are_named_by_their_axes(axes: tuple[Vec3, ...], names: tuple[str, ...]) -> None:
    joint = Joint("j", "a", "b", axes)
    assert joint.coordinates == names
    assert Robot(("a", "b"), (joint,)).coordinates == names


def test_coordinates_may_have_names_of_their_own() -> None:
    assert Joint("hip", "a", "b", (X, Y), names=("flexion", "abduction")).coordinates == ("flexion", "abduction")


def test_base_link_may_stand_anywhere_in_the_list_and_joints_in_any_order() -> None:
    joints = (hinge("distal", "middle", "tip"), hinge("proximal", "palm", "middle"))
    robot = Robot(("tip", "palm", "middle"), joints)
    assert [joint.name for joint in robot.ordered_joints] == ["proximal", "distal"]
    assert robot.coordinates == ("distal", "proximal")


def test_joints_below_a_link_are_those_that_carry_what_hangs_on_it() -> None:
    joints = (hinge("c", "b", "c"), hinge("b", "a", "b"), hinge("d", "a", "d"), hinge("e", "c", "e"))
    robot = Robot(("a", "b", "c", "d", "e"), joints)
    assert [joint.name for joint in robot.joints_below("b")] == ["c", "e"]
    assert {joint.name for joint in robot.joints_below("a")} == {"b", "c", "d", "e"}
    assert not list(robot.joints_below("e"))


@given(st.lists(st.integers(0, 1000), min_size=30, max_size=30), st.randoms(use_true_random=False))
def test_thirty_branching_joints(parents: list[int], random) -> None:
    """Any tree: joint k hangs link k + 1 on one of the links before it; the order of the configuration is arbitrary."""
    numbered = [(parent % (k + 1), k + 1) for k, parent in enumerate(parents)]
    joints = [Joint(f"j{child}", f"l{parent}", f"l{child}", (random.choice((X, Y, Z)),)) for parent, child in numbered]
    links = [f"l{k}" for k in range(31)]
    random.shuffle(joints)
    random.shuffle(links)
    robot = Robot(tuple(links), tuple(joints))
    placed = {"l0"}
    for joint in robot.ordered_joints:
        assert joint.parent in placed
        placed.add(joint.child)
    assert placed == set(links)
    positions = {joint.name: random.uniform(-3.0, 3.0) for joint in joints}
    turned = {link: Rotation.from_quat(pose.orientation) for link, pose in link_poses(robot, positions).items()}
    for joint in joints:
        step = Rotation.from_rotvec(positions[joint.name] * np.array(joint.axes[0]))
        assert (turned[joint.child].inv() * turned[joint.parent] * step).magnitude() < 1e-9


def test_sensors_of_a_link_in_their_order() -> None:
    sensors = (Sensor("front", "palm"), Sensor("tip", "tip"), Sensor("back", "palm"))
    robot = Robot(("palm", "tip"), (hinge("j", "palm", "tip"),), sensors)
    assert [sensor.name for sensor in robot.sensors_on("palm")] == ["front", "back"]
    assert robot.sensor("tip").link == "tip"
