"""The part of the robot that gyro and Hall estimators work on: joints in order, their gyros and their Hall sensors."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import dot


@dataclass(frozen=True)
class Linkage:
    """Joints with the sensors of their links. A coordinate is one axis of one joint.

    Attributes:
        joints: from the base outward.
        links: that they connect; of a serial linkage in order, links[i] and links[i + 1] at joints[i].
        gyros: one of each link, or empty where none are needed.
        serial: joints and links form one chain, so that there is a torso: the last link in the first.
        names, axes, joint_of: of each coordinate: its name, unit axis, index of its joint.
        ends: of each coordinate: indices of parent and child link.
        hall: of each coordinate: indices of its sensors in `Robot.hall`, the index of their voltages in a frame.
    """

    joints: tuple[Joint, ...]
    links: tuple[str, ...]
    gyros: tuple[Sensor, ...]
    serial: bool
    names: tuple[str, ...]
    axes: tuple[Vec3, ...]
    joint_of: tuple[int, ...]
    ends: tuple[tuple[int, int], ...]
    hall: tuple[tuple[int, ...], ...]

    @property
    def gyro_rows(self) -> FloatArray:
        """(m, 3 g): what each rate takes from the gyros of g links at the zero pose, equations (6), (9)."""
        rows = np.zeros((len(self.axes), 3 * len(self.links)))
        for row, axis, (parent, child) in zip(rows, self.axes, self.ends, strict=True):
            row[3 * parent : 3 * parent + 3] -= axis
            row[3 * child : 3 * child + 3] += axis
        return rows

    @property
    def hinges_only(self) -> bool:
        """No joint has more than one axis."""
        return len(self.axes) == len(self.joints)


def serial_linkage(robot: Robot) -> Linkage:
    """The chain from the first to the last joint that bears Hall sensors; joints without any may lie between them.

    Raises:
        ConfigurationError: there is no Hall sensor, the joints that bear them are not in series, a link of the chain
            has no gyro, or the axes of one joint are not perpendicular.
    """
    wanted = _hall_joints(robot)
    to_parent = {joint.child: joint for joint in robot.joints}
    path: list[Joint] = []
    for joint in wanted:
        upward = [joint]
        while upward[-1].parent in to_parent:
            upward.append(to_parent[upward[-1].parent])
        if len(upward) > len(path):
            path = upward
    for joint in wanted:
        if joint not in path:
            raise ConfigurationError(
                f"hall: joints '{joint.name}' and '{path[0].name}' lie on different branches; "
                "joints with Hall sensors must be in series"
            )
    path.reverse()
    return _linkage(robot, path[min(path.index(joint) for joint in wanted) :], gyros=True)


def gyro_linkage(robot: Robot) -> Linkage:
    """All joints with a gyro on either side.

    Raises:
        ConfigurationError: there are none, or the axes of one joint are not perpendicular.
    """
    borne = {sensor.link for sensor in robot.sensors if sensor.gyro}
    joints = [joint for joint in robot.ordered_joints if joint.parent in borne and joint.child in borne]
    if not joints:
        raise ConfigurationError("sensors: no joint has a gyro on both of its links")
    return _linkage(robot, joints, gyros=True)


def hall_linkage(robot: Robot) -> Linkage:
    """All joints with Hall sensors. Raises ConfigurationError when there are none."""
    return _linkage(robot, _hall_joints(robot), gyros=False)


def _hall_joints(robot: Robot) -> list[Joint]:
    measured = {sensor.joint for sensor in robot.hall}
    joints = [joint for joint in robot.ordered_joints if measured.intersection(joint.coordinates)]
    if not joints:
        raise ConfigurationError("hall: the robot has no Hall sensors; give at least one")
    return joints


def _linkage(robot: Robot, joints: Sequence[Joint], gyros: bool) -> Linkage:
    links = tuple(dict.fromkeys(link for joint in joints for link in (joint.parent, joint.child)))
    numbered = [(number, joint) for number, joint in enumerate(joints) for _ in joint.axes]
    names = tuple(name for joint in joints for name in joint.coordinates)
    for joint in joints:
        _check_axes(joint)
    return Linkage(
        joints=tuple(joints),
        links=links,
        gyros=tuple(_gyro_on(robot, link) for link in links) if gyros else (),
        serial=all(inner.child == outer.parent for inner, outer in itertools.pairwise(joints)),
        names=names,
        axes=tuple(axis for joint in joints for axis in joint.axes),
        joint_of=tuple(number for number, _ in numbered),
        ends=tuple((links.index(joint.parent), links.index(joint.child)) for _, joint in numbered),
        hall=tuple(tuple(i for i, sensor in enumerate(robot.hall) if sensor.joint == name) for name in names),
    )


def _gyro_on(robot: Robot, link: str) -> Sensor:
    for sensor in robot.sensors_on(link):
        if sensor.gyro:
            return sensor
    raise ConfigurationError(f"sensors: link '{link}' bears no gyro; every link of the chain needs one")


def _check_axes(joint: Joint) -> None:
    pairs = [(a, b) for number, a in enumerate(joint.axes) for b in joint.axes[number + 1 :]]
    if any(abs(dot(a, b)) > 1e-6 for a, b in pairs):
        raise ConfigurationError(f"joint '{joint.name}'.axes: {joint.axes} are not perpendicular to each other")
