"""The elements of a URDF (http://wiki.ros.org/urdf/XML): what they say, and what is wrong with them."""

from __future__ import annotations

import math
import xml.etree.ElementTree as xml
from dataclasses import dataclass

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import Quat, Vec3
from jointest_ros.core.rotation import from_rpy, norm, unit

TURNING = ("revolute", "continuous")
FREE = ("floating", "planar")
_TYPES = (*TURNING, *FREE, "prismatic", "fixed")


@dataclass(frozen=True)
class Edge:
    """A joint of the URDF: the child's frame in the parent's."""

    name: str
    kind: str
    parent: str
    child: str
    at: Vec3
    turn: Quat
    axis: Vec3
    limits: tuple[float, float] | None
    mimics: str


def read_joint(joint: xml.Element) -> Edge:
    """Raises ConfigurationError."""
    name, kind = name_of(joint, "joint"), joint.get("type", "")
    where = f"joint '{name}'"
    if kind not in _TYPES:
        raise ConfigurationError(f"{where}: type '{kind}' is not allowed; give one of {', '.join(_TYPES)}")
    parent, child = (_attribute(joint, tag, "link", where) for tag in ("parent", "child"))
    origin, axis, limit = joint.find("origin"), joint.find("axis"), joint.find("limit")
    at = _numbers(origin, "xyz", where, (0.0, 0.0, 0.0))
    turn = from_rpy(*_numbers(origin, "rpy", where, (0.0, 0.0, 0.0)))
    direction = _numbers(axis, "xyz", where, (1.0, 0.0, 0.0))
    if kind in TURNING and norm(direction) < 1e-9:
        raise ConfigurationError(f"{where}: its axis has no length")
    limits = None
    if limit is not None and kind == "revolute":
        low, high = (_number(limit.get(key, "0"), f"{where}: limit") for key in ("lower", "upper"))
        limits = (low, high) if low != high else None
    direction = unit(direction) if norm(direction) else direction
    return Edge(name, kind, parent, child, at, turn, direction, limits, _mimicked(joint, where))


def _mimicked(joint: xml.Element, where: str) -> str:
    """The angle that a <mimic> gives a joint, such as 0.5 knee + 0.1 rad; "": it has none."""
    mimic = joint.find("mimic")
    if mimic is None:
        return ""
    master = _attribute(joint, "mimic", "joint", where)
    multiplier, offset = (
        _number(mimic.get(key, usual), f"{where}: mimic {key}") for key, usual in (("multiplier", "1"), ("offset", "0"))
    )
    scaled = master if multiplier == 1.0 else f"{multiplier:g} {master}"
    return f"{scaled} {'-' if offset < 0 else '+'} {abs(offset):g} rad" if offset else scaled


def name_of(element: xml.Element, what: str) -> str:
    """Raises ConfigurationError."""
    name = element.get("name")
    if not name:
        raise ConfigurationError(f"a <{what}> has no name")
    return name


def _attribute(joint: xml.Element, tag: str, key: str, where: str) -> str:
    element = joint.find(tag)
    if element is None or not element.get(key):
        raise ConfigurationError(f'{where}: <{tag} {key}="..."/> is missing')
    return element.get(key, "")


def _numbers(element: xml.Element | None, key: str, where: str, default: Vec3) -> Vec3:
    if element is None or element.get(key) is None:
        return default
    values = [_number(part, f"{where}: {key}") for part in element.get(key, "").split()]
    if len(values) != len(default):
        raise ConfigurationError(f"{where}: {key} '{element.get(key)}' is not allowed; give three numbers")
    return values[0], values[1], values[2]


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigurationError(f"{where} '{text}' is not allowed; give a number")
    return value
