"""A URDF as links, joints and sensors of a configuration (http://wiki.ros.org/urdf/XML).

What is fixed together becomes one link. The frames of a URDF may be turned against each other at the zero pose; those
of a configuration are not: every link takes the orientation of the root, so axes, origins and mountings are turned into
it. The joint positions mean the same as before.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as xml
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from jointest_ros.config import values as read
from jointest_ros.config.urdf_chains import merged
from jointest_ros.config.urdf_elements import FREE, TURNING, Edge, name_of, read_joint
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import Quat, Vec3
from jointest_ros.core.robot import Joint, Sensor
from jointest_ros.core.rotation import IDENTITY, dot, multiply, rotate, unit

_TWO_TURNS = 4.0 * math.pi
_WORLD = "world"
_CONTAINED = ("visual", "collision", "inertial")


@dataclass(frozen=True)
class UrdfRobot:
    """What a URDF says.

    Attributes:
        links: of the configuration, the root first; `world`: its root, where that stands still, or "".
        sensors: IMUs; one for each frame or link that bears one.
        folded: link -> links that are fixed to it.
        mimics: joint -> the angle that it has by a <mimic>, in words.
        warnings: what could not be taken over, one line each.
    """

    name: str
    links: tuple[str, ...]
    joints: tuple[Joint, ...]
    sensors: tuple[Sensor, ...]
    world: str = ""
    folded: dict[str, list[str]] = field(default_factory=dict)
    mimics: dict[str, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


@dataclass
class _Place:
    """Where the frame of a URDF link is: the link of the configuration, its origin there and its orientation."""

    link: str
    at: Vec3 = (0.0, 0.0, 0.0)
    turn: Quat = IDENTITY


def load_urdf(path: Path, imus: Collection[str] = ()) -> UrdfRobot:
    """Read a URDF.

    Args:
        imus: links that are frames of IMUs; without any, those with "imu" in their name.

    Raises:
        ConfigurationError: it cannot be read, is no URDF, or its joints form no tree.
    """
    text = read.read_file(path, "URDF")
    if text is None:
        raise ConfigurationError(f"{path}: no such URDF file")
    try:
        return _parse(text, imus)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None


def _parse(text: str, imus: Collection[str]) -> UrdfRobot:
    try:
        root = xml.fromstring(text)
    except xml.ParseError as error:
        raise ConfigurationError(f"no valid XML: {error}") from None
    if root.tag != "robot":
        raise ConfigurationError(f"no URDF: its first element is <{root.tag}>, not <robot>")
    if any(
        "xacro" in one.tag.partition("}")[0] or any("${" in text for text in one.attrib.values()) for one in root.iter()
    ):
        raise ConfigurationError("it is a xacro file; make the URDF first: xacro FILE > robot.urdf")
    links = [name_of(link, "link") for link in root.iter("link") if link in list(root)]
    edges = [read_joint(joint) for joint in root.findall("joint")]
    _check_names(links, edges, imus)
    bare = {
        name_of(link, "link")
        for link in root.findall("link")
        if not any(link.find(tag) is not None for tag in _CONTAINED)
    }
    sensors = dict.fromkeys(imus or [name for name in links if "imu" in name.lower()])
    if not imus:
        sensors.update(dict.fromkeys(_gazebo_imus(root, links)))
    return _robot(root.get("name", "robot"), links, edges, list(sensors), bare)


def _check_names(links: list[str], edges: list[Edge], imus: Collection[str]) -> None:
    for what, names in (("link", links), ("joint", [edge.name for edge in edges])):
        if repeated := [name for name in names if names.count(name) > 1]:
            raise ConfigurationError(f"{what} '{repeated[0]}' is given twice; names must differ")
    for edge in edges:
        for name in (edge.parent, edge.child):
            if name not in links:
                raise ConfigurationError(f"joint '{edge.name}': '{name}' is not a link")
    for name in imus:
        if name not in links:
            raise ConfigurationError(f"--imu: '{name}' is not a link; known: {', '.join(links)}")


def _gazebo_imus(root: xml.Element, links: Collection[str]) -> Iterator[str]:
    """Links that bear a simulated IMU."""
    for gazebo in root.findall("gazebo"):
        if gazebo.get("reference") in links and any(one.get("type") == "imu" for one in gazebo.iter("sensor")):
            yield gazebo.get("reference", "")


def _robot(name: str, links: list[str], edges: list[Edge], imus: list[str], bare: Collection[str]) -> UrdfRobot:
    if not links:
        raise ConfigurationError("it has no links")
    below = {edge.child for edge in edges}
    roots = [link for link in links if link not in below]
    places, joints, doubts = _placed(roots, edges)
    if len(places) < len(links):
        raise ConfigurationError("its joints form a loop")
    warnings = [*_doubts(edges, roots), *doubts]
    folded: dict[str, list[str]] = {}
    for link, place in places.items():
        if link != place.link:
            folded.setdefault(place.link, []).append(link)
    bearing = {places[imu].link for imu in imus}
    joints, gone = merged(joints, bare, bearing, folded, warnings)
    joints.sort(key=lambda joint: [edge.name for edge in edges].index(joint.coordinates[0]))
    sensors = tuple(Sensor(imu, places[imu].link, _tidy(places[imu].at), places[imu].turn) for imu in imus)
    kept = [link for link in dict.fromkeys(place.link for place in places.values()) if link not in gone]
    world = _WORLD if roots[0] == _WORLD and _WORLD not in bearing else ""
    mimics = {edge.name: edge.mimics for edge in edges if edge.mimics and edge.kind in TURNING}
    return UrdfRobot(name, tuple(kept), tuple(joints), sensors, world, folded, mimics, warnings)


def _placed(roots: list[str], edges: list[Edge]) -> tuple[dict[str, _Place], list[Joint], list[str]]:
    """Where the links are, from the roots outwards, the joints that turn, and what the others were taken for."""
    children: dict[str, list[Edge]] = {}
    for edge in edges:
        children.setdefault(edge.parent, []).append(edge)
    places: dict[str, _Place] = {}
    joints: list[Joint] = []
    doubts: list[str] = []
    waiting = [(root, _Place(root)) for root in reversed(roots)]
    while waiting:
        link, place = waiting.pop()
        if link in places:
            raise ConfigurationError(f"link '{link}' is the child of two joints")
        places[link] = place
        for edge in reversed(children.get(link, [])):
            x, y, z = rotate(place.turn, edge.at)
            at = (place.at[0] + x, place.at[1] + y, place.at[2] + z)
            beyond = _Place(place.link, at, multiply(place.turn, edge.turn))
            if edge.kind in TURNING:
                joints.append(_joint(edge, beyond))
                beyond = _Place(edge.child, turn=beyond.turn)
            elif edge.kind in FREE:
                doubts.append(f"joint '{edge.name}' is {edge.kind}: '{edge.child}' begins a tree of its own")
                beyond = _Place(edge.child)
            elif edge.kind != "fixed":
                doubts.append(
                    f"joint '{edge.name}' is {edge.kind}: taken as fixed, since it does not turn what it moves"
                )
            waiting.append((edge.child, beyond))
    return places, joints, doubts


def _joint(edge: Edge, place: _Place) -> Joint:
    """A revolute at its place on the parent's link."""
    limits = (edge.limits,) if edge.limits is not None and edge.limits[0] < edge.limits[1] else None
    axis = _tidy(rotate(place.turn, edge.axis))
    return Joint(edge.name, place.link, edge.child, (axis,), limits, edge.kind == "continuous", _tidy(place.at))


def _doubts(edges: list[Edge], roots: list[str]) -> Iterator[str]:
    """What may not be as it was meant, one line each."""
    for root in roots[1:]:
        yield f"link '{root}' is a second root: no joint moves it"
    for edge in edges:
        if edge.mimics and edge.kind in TURNING:
            yield (
                f"joint '{edge.name}' mimics one ({edge.mimics}): that is not used, it is estimated like the others; "
                f"without a sensor on '{edge.child}' take it out"
            )
        if edge.limits is None:
            continue
        low, high = edge.limits
        if low > high:
            yield f"joint '{edge.name}': limits {low:g} to {high:g} rad are in the wrong order; left out"
        elif max(-low, high) > _TWO_TURNS:
            yield f"joint '{edge.name}': limits {low:g} to {high:g} rad are more than two turns; are they in deg?"


def _tidy(vector: Vec3) -> Vec3:
    """Without the noise of rotations by right angles; axes along x, y, z become exactly that."""
    x, y, z = (round(component, 9) + 0.0 for component in vector)
    length = dot((x, y, z), (x, y, z)) ** 0.5
    return unit((x, y, z)) if abs(length - 1.0) < 1e-7 else (x, y, z)
