"""The URDF of a robot, from its configuration: what robot_state_publisher, RViz and Foxglove draw.

Joints have the names, axes, origins and limits of the configuration, so that the `joint_states` of an estimator move
them. A joint of several axes is a succession of joints with empty links, <coordinate>_frame, between them. A
roll-articular (Hillberry) joint is two revolutes of half its angle with a virtual link, <joint>_roll, between them:
<joint>_1 and <joint>_2 mimic <joint>, the angle that an estimator publishes, which has an empty link <joint>_angle of
its own (Santaera et al. 2015, section V). Every sensor is a frame, <sensor>_imu, at its position with its mounting.
Shapes are made up: boxes from joint to joint.
"""

from __future__ import annotations

from dataclasses import replace
from statistics import fmean
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import Quat, Vec3
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import IDENTITY, between, norm, to_rpy

_ASSUMED = 0.1  # m, length of links where a configuration has none
_ZERO: Vec3 = (0.0, 0.0, 0.0)
_COLOURS = {"link": "0.45 0.55 0.65 1", "joint": "0.25 0.27 0.30 1", "sensor": "0.95 0.55 0.10 1"}


def robot_urdf(robot: Robot) -> str:
    """The text of the URDF. Where no joint has an `origin`, links of 10 cm are drawn.

    Raises:
        ConfigurationError: the links are no single tree, or a link has the name of a frame that is added here.
    """
    root_link(robot)
    return _Drawing(robot).text()


def root_link(robot: Robot) -> str:
    """The link from which all others hang. Raises ConfigurationError where there are several."""
    children = {joint.child for joint in robot.joints}
    roots = [link for link in robot.links if link not in children]
    if len(roots) > 1:
        raise ConfigurationError(f"links: {', '.join(roots)} hang on nothing; a URDF is one tree, with one root")
    return roots[0]


class _Drawing:
    """The document while it is made."""

    def __init__(self, robot: Robot) -> None:
        self._robot = _with_lengths(robot)
        lengths = [norm(joint.origin) for joint in self._robot.joints if any(joint.origin)]
        self._length = fmean(lengths or [_ASSUMED])
        self._width = 0.15 * self._length
        self._root = Element("robot", name=robot.name)
        self._names: set[tuple[str, str]] = set()

    def text(self) -> str:
        if self._robot.joints and not any(any(joint.origin) for joint in self._robot.joints):
            self._root.append(ElementTree.Comment(" the configuration has no origins of joints "))
        for name, colour in _COLOURS.items():
            SubElement(SubElement(self._root, "material", name=name), "color", rgba=colour)
        for link in self._robot.links:
            self._draw_link(link)
        for joint in self._robot.joints:
            if joint.roll_link is None:
                self._add_revolutes(joint)
            else:
                self._add_rolling(joint, joint.roll_link)
        for sensor in self._robot.sensors:
            self._add_sensor(sensor)
        ElementTree.indent(self._root)
        return '<?xml version="1.0"?>\n' + ElementTree.tostring(self._root, encoding="unicode") + "\n"

    # ------------------------------------------------------------- parts

    def _add(self, kind: str, name: str, **attributes: str) -> Element:
        if (kind, name) in self._names:
            raise ConfigurationError(f"{kind} '{name}': the URDF needs this name for a frame or joint that it adds")
        self._names.add((kind, name))
        return SubElement(self._root, kind, {"name": name, **attributes})

    def _add_link(self, name: str) -> Element:
        return self._add("link", name)

    def _add_joint(self, name: str, kind: str, parent: str, child: str, at: Vec3, mounting: Quat = IDENTITY) -> Element:
        joint = self._add("joint", name, type=kind)
        SubElement(joint, "parent", link=parent)
        SubElement(joint, "child", link=child)
        _origin(joint, at, mounting)
        return joint

    def _add_revolute(self, joint: Joint, number: int, name: str, parent: str, child: str, at: Vec3) -> Element:
        """A revolute about an axis of `joint`, within its limits; without limits it turns on and on."""
        unlimited = joint.limits is None or joint.continuous
        element = self._add_joint(name, "continuous" if unlimited else "revolute", parent, child, at)
        SubElement(element, "axis", xyz=_numbers(joint.axes[number]))
        if joint.limits is not None and not unlimited:
            low, high = joint.limits[number]
            # effort and velocity must be there, and say nothing: nothing here drives a joint
            SubElement(element, "limit", lower=_number(low), upper=_number(high), effort="1", velocity="20")
        return element

    def _add_revolutes(self, joint: Joint) -> None:
        parent, at = joint.parent, joint.origin
        for number, name in enumerate(joint.coordinates):
            last = number == len(joint.axes) - 1
            child = joint.child if last else f"{name}_frame"
            if not last:
                self._add_link(child)
            self._add_revolute(joint, number, name, parent, child, at)
            parent, at = child, _ZERO

    def _add_rolling(self, joint: Joint, roll: Vec3) -> None:
        half = (
            joint
            if joint.limits is None
            else replace(joint, limits=((0.5 * joint.limits[0][0], 0.5 * joint.limits[0][1]),))
        )
        angle, between_them = f"{joint.name}_angle", f"{joint.name}_roll"
        self._add_link(angle)
        self._draw_axis(self._add_link(between_them), joint.axes[0], norm(roll))
        self._add_revolute(joint, 0, joint.name, joint.parent, angle, joint.origin)
        for number, parent, child, at in (
            (1, joint.parent, between_them, joint.origin),
            (2, between_them, joint.child, roll),
        ):
            element = self._add_revolute(half, 0, f"{joint.name}_{number}", parent, child, at)
            SubElement(element, "mimic", joint=joint.name, multiplier="0.5")

    def _add_sensor(self, sensor: Sensor) -> None:
        frame = f"{sensor.name}_imu"
        size = (1.2 * self._width, 1.2 * self._width, 0.5 * self._width)
        _visual(self._add_link(frame), "sensor", "box", size=_numbers(size))
        self._add_joint(f"{sensor.name}_mounting", "fixed", sensor.link, frame, sensor.position, sensor.mounting)

    # ------------------------------------------------------------- shapes

    def _draw_link(self, link: str) -> None:
        element = self._add_link(link)
        if link == self._robot.world:
            return
        for joint in self._robot.joints:
            if joint.child == link:
                self._draw_axis(element, joint.axes[-1], self._width)
        for end in self._ends(link):
            length = norm(end)
            middle: Vec3 = (0.5 * end[0], 0.5 * end[1], 0.5 * end[2])
            size = (length or self._width, self._width, self._width)
            _visual(element, "link", "box", middle, between((1.0, 0.0, 0.0), end), size=_numbers(size))

    def _draw_axis(self, element: Element, axis: Vec3, diameter: float) -> None:
        turn = between((0.0, 0.0, 1.0), axis)
        radius, length = 0.5 * diameter, 1.4 * self._width
        _visual(element, "joint", "cylinder", _ZERO, turn, radius=_number(radius), length=_number(length))

    def _ends(self, link: str) -> list[Vec3]:
        """To where a link reaches: to the joints on it; without any, so far that its sensors sit about the middle."""
        ends = {joint.origin for joint in self._robot.joints if joint.parent == link}
        if ends:
            return sorted(ends)
        positions = [sensor.position for sensor in self._robot.sensors_on(link)]
        if any(any(position) for position in positions):
            x, y, z = (2.0 * fmean(column) for column in zip(*positions, strict=True))
            return [(x, y, z)]
        axes = next((joint.axes for joint in self._robot.joints if joint.child == link), ())
        return [_across(axes, self._length)]


def _with_lengths(robot: Robot) -> Robot:
    """The robot itself; where nothing is known of its lengths, one whose joints are at some distance of each other."""
    if any(any(joint.origin) for joint in robot.joints):
        return robot
    joints = (
        joint if joint.parent == robot.world else replace(joint, origin=_across(joint.axes, _ASSUMED))
        for joint in robot.joints
    )
    return replace(robot, joints=tuple(joints))


def _across(axes: tuple[Vec3, ...], length: float) -> Vec3:
    """Along z, or along x where that is nearer to being perpendicular to the axes."""
    along_z = max((abs(axis[2]) for axis in axes), default=0.0)
    along_x = max((abs(axis[0]) for axis in axes), default=1.0)
    return (length, 0.0, 0.0) if along_x < along_z else (0.0, 0.0, length)


def _visual(
    link: Element, material: str, shape: str, at: Vec3 = _ZERO, turn: Quat = IDENTITY, **dimensions: str
) -> None:
    visual = SubElement(link, "visual")
    _origin(visual, at, turn)
    SubElement(SubElement(visual, "geometry"), shape, dimensions)
    SubElement(visual, "material", name=material)


def _origin(element: Element, at: Vec3, turn: Quat) -> None:
    SubElement(element, "origin", xyz=_numbers(at), rpy=_numbers(to_rpy(turn)))


def _numbers(values: Vec3) -> str:
    return " ".join(map(_number, values))


def _number(value: float) -> str:
    return f"{value + 0.0:.9g}" if abs(value) > 1e-12 else "0"
