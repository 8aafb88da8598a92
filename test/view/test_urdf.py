"""The URDF of a robot against its configuration, for every configuration that is shipped and for made-up ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jointest_ros import config
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.kinematics import link_poses
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import from_rpy
from jointest_ros.view.urdf import robot_urdf

PROJECT = Path(__file__).resolve().parents[2]
SHIPPED = sorted(file.stem for file in (PROJECT / "urdf").glob("*.urdf"))
CONFIGURATIONS = sorted(file.stem for file in (PROJECT / "config").glob("*.yaml"))
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

Joints = dict[str, ElementTree.Element]


def robot_of(name: str) -> Robot:
    return config.load(PROJECT / "config" / f"{name}.yaml").robot


def leg() -> Robot:
    """A ball joint and an oblique hinge, with a sensor that is turned in its link."""
    joints = (
        Joint("hip", "pelvis", "thigh", (Z, Y, X), ((-1.0, 1.0), (-0.5, 1.5), (-0.3, 0.2)), origin=(0.0, 0.1, -0.05)),
        Joint("knee", "thigh", "shank", ((0.6, 0.8, 0.0),), continuous=True, origin=(0.0, 0.0, -0.4)),
    )
    sensor = Sensor("tibia", "shank", (0.01, -0.02, -0.2), from_rpy(0.3, 0.5 * np.pi, -1.2))
    return Robot(("pelvis", "thigh", "shank"), joints, (sensor,), name="leg")


def joints_of(text: str) -> Joints:
    """The joints by name, of a document that is one tree."""
    root = ElementTree.fromstring(text)
    links = [link.get("name") for link in root.iter("link")]
    joints = {joint.get("name", ""): joint for joint in root.iter("joint")}
    assert len(joints) == len(list(root.iter("joint")))
    children = [joint.find("child").get("link") for joint in joints.values()]
    assert len(set(links)) == len(links) and len(set(children)) == len(children)
    assert len(set(links) - set(children)) == 1
    assert {joint.find("parent").get("link") for joint in joints.values()} <= set(links)
    materials = {material.get("name") for material in root.findall("material")}
    assert {material.get("name") for material in root.iterfind(".//visual/material")} <= materials
    return joints


def numbers(joint: ElementTree.Element, what: str, key: str = "xyz") -> list[float]:
    return [float(number) for number in joint.find(what).get(key).split()]


def poses(joints: Joints, angles: dict[str, float]) -> dict[str, FloatArray]:
    """Where URDF puts every link, as 4 x 4 matrices in the root link."""
    by_child = {joint.find("child").get("link"): (name, joint) for name, joint in joints.items()}

    def pose(link: str) -> FloatArray:
        if link not in by_child:
            return np.eye(4)
        name, joint = by_child[link]
        step, turn = np.eye(4), np.eye(4)
        step[:3, 3] = numbers(joint, "origin")
        roll, pitch, yaw = numbers(joint, "origin", "rpy")
        step[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        if joint.get("type") != "fixed":
            mimic = joint.find("mimic")
            angle = angles[name] if mimic is None else float(mimic.get("multiplier")) * angles[mimic.get("joint")]
            turn[:3, :3] = Rotation.from_rotvec(angle * np.array(numbers(joint, "axis"))).as_matrix()
        return pose(joint.find("parent").get("link")) @ step @ turn

    return {link: pose(link) for link in by_child}


ROBOTS = {**{name: robot_of(name) for name in CONFIGURATIONS}, "leg": leg()}


@pytest.mark.parametrize("name", ROBOTS)
def test_every_position_that_is_published_has_its_joint(name: str) -> None:
    """The same names, axes and limits, in the same succession."""
    robot, joints = ROBOTS[name], joints_of(robot_urdf(ROBOTS[name]))
    moving = {name: joint for name, joint in joints.items() if joint.get("type") != "fixed"}
    assert {name for name, joint in moving.items() if joint.find("mimic") is None} == set(robot.coordinates)
    for joint in robot.joints:
        limits = joint.limits or [None] * len(joint.axes)
        for coordinate, axis, limit in zip(joint.coordinates, joint.axes, limits, strict=True):
            assert numbers(joints[coordinate], "axis") == pytest.approx(axis)
            bounded = limit is not None and not joint.continuous
            assert joints[coordinate].get("type") == ("revolute" if bounded else "continuous")
            if bounded:
                found = joints[coordinate].find("limit")
                assert (float(found.get("lower")), float(found.get("upper"))) == pytest.approx(limit)
        assert joints[joint.coordinates[0]].find("parent").get("link") == joint.parent
        if joint.roll_link is None:
            assert joints[joint.coordinates[-1]].find("child").get("link") == joint.child
            if any(joint.origin):
                assert numbers(joints[joint.coordinates[0]], "origin") == pytest.approx(joint.origin)


@pytest.mark.parametrize("name", [name for name, robot in ROBOTS.items() if any(any(j.origin) for j in robot.joints)])
def test_links_and_sensors_are_where_the_configuration_puts_them(name: str) -> None:
    """Forward kinematics of both at random angles; mimic joints and virtual links must make them equal."""
    robot = ROBOTS[name]
    angles = dict(zip(robot.coordinates, np.random.default_rng(0).uniform(-0.3, 1.5, 9).tolist(), strict=False))
    found, expected = poses(joints_of(robot_urdf(robot)), angles), link_poses(robot, angles)
    for joint in robot.joints:
        pose = expected[joint.child]
        np.testing.assert_allclose(found[joint.child][:3, 3], pose.position, atol=1e-8)
        np.testing.assert_allclose(
            found[joint.child][:3, :3], Rotation.from_quat(pose.orientation).as_matrix(), atol=1e-8
        )
    for sensor in robot.sensors:
        pose = expected[sensor.link]
        turned = Rotation.from_quat(pose.orientation) * Rotation.from_quat(sensor.mounting)
        np.testing.assert_allclose(found[f"{sensor.name}_imu"][:3, 3], pose.point(sensor.position), atol=1e-8)
        np.testing.assert_allclose(found[f"{sensor.name}_imu"][:3, :3], turned.as_matrix(), atol=1e-8)


def test_without_lengths_links_of_ten_centimetres_are_drawn() -> None:
    found = poses(joints_of(robot_urdf(robot_of("exoshell"))), dict.fromkeys(robot_of("exoshell").coordinates, 0.0))
    heights = [found[f"link_{number}"][2, 3] for number in (2, 3, 4, 5)]
    assert heights == pytest.approx([0.1, 0.2, 0.3, 0.4])


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        (Robot(("a", "b", "c"), (Joint("ab", "a", "b", (X,)),)), "links: a, c hang on nothing; a URDF is one tree"),
        (
            Robot(("a", "b_imu"), (Joint("ab", "a", "b_imu", (X,)),), (Sensor("b", "a"),)),
            "link 'b_imu': the URDF needs",
        ),
        (
            replace(leg(), joints=(leg().joints[0], replace(leg().joints[1], name="tibia_mounting"))),
            "joint 'tibia_mounting': the URDF needs",
        ),
    ],
)
def test_what_cannot_be_a_urdf_is_refused(robot: Robot, message: str) -> None:
    with pytest.raises(ConfigurationError, match=f"^{message}"):
        robot_urdf(robot)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_urdf_parser_of_others_reads_them(name: str) -> None:
    parser = pytest.importorskip("urdf_parser_py.urdf", reason="urdfdom-py is not installed")
    read = parser.URDF.from_xml_string((PROJECT / "urdf" / f"{name}.urdf").read_bytes())
    moving = {joint.name for joint in read.joints if joint.type in ("revolute", "continuous") and joint.mimic is None}
    assert moving == set(robot_of(name).coordinates)
    assert {f"{sensor.name}_imu" for sensor in robot_of(name).sensors} <= set(read.link_map)
