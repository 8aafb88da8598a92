"""YAML text to values, and the checks of single values that the reader of configurations is made of.

`where` is the path of keys to a value, such as `robot.joints.knee.axis`. All raise ConfigurationError.
"""

from __future__ import annotations

import math
import re
import reprlib
from pathlib import Path
from typing import Any

import yaml

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import Quat, Vec3
from jointest_ros.core.params import reject_unknown
from jointest_ros.core.rotation import IDENTITY, from_rpy, norm, normalized, unit

_AXES: dict[str, Vec3] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_AXES |= {f"-{name}": (-x, -y, -z) for name, (x, y, z) in _AXES.items()}
_AXES |= {f"+{name}": _AXES[name] for name in "xyz"}
_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_LARGEST_INTEGER = 2**63

_shown = reprlib.Repr()  # a value in an error: part of a line, however much was given
_shown.maxlevel, _shown.maxstring, _shown.maxother = 2, 60, 60


def read_file(path: Path, what: str) -> str | None:
    """The text of a file that is to be read as `what`; None where there is no file."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read as a {what}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: cannot be read as a {what}: it is not a text in UTF-8") from None


def read_yaml(text: str) -> Any:
    """The document in `text`, of any type."""
    try:
        return yaml.load(text, Loader=_StrictLoader)
    except ConfigurationError:
        raise
    except RecursionError:
        raise ConfigurationError("no valid YAML: too many levels in one another") from None
    except Exception as error:  # YAMLError, and whatever PyYAML trips over in dates, numbers and explicit tags
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}: " if mark is not None else ""
        raise ConfigurationError(f"{where}no valid YAML: {getattr(error, 'problem', None) or error}") from None


def refusal(where: str, value: Any, allowed: str) -> ConfigurationError:
    """The error for a value that is not `allowed`."""
    return ConfigurationError(f"{where}: {_shown.repr(value)} is not allowed; give {allowed}")


def section(value: Any, where: str, allowed: tuple[str, ...] | None = None) -> dict[str, Any]:
    """Keys with values, none but `allowed` ones; an absent section is an empty one."""
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise refusal(where or "configuration", value, "keys with values")
    for key in value:
        if not isinstance(key, str) or not key:
            raise refusal(f"{where or 'configuration'}: the key", key, "a name, in quotes if it looks like a value")
    if allowed is not None:
        reject_unknown(value, allowed, where)
    return value


def text(value: Any, where: str, allowed: str = "a text") -> str:
    """A text, which may be empty."""
    if not isinstance(value, str):
        raise refusal(where, value, allowed)
    return value


def topic(value: Any, where: str) -> str:
    """The name of a ROS topic (http://design.ros2.org/articles/topic_and_service_names.html)."""
    if not isinstance(value, str) or not _TOPIC.fullmatch(value):
        raise refusal(where, value, "a topic: words of letters, digits and _ with / between, none begins with a digit")
    return value


def vector(value: Any, where: str, unit_name: str) -> Vec3:
    """Three numbers."""
    x, y, z = _numbers(value, where, unit_name, 3)
    return x, y, z


def pair(value: Any, where: str, unit_name: str) -> tuple[float, float]:
    """Two numbers."""
    one, two = _numbers(value, where, unit_name, 2)
    return one, two


def number(value: Any, where: str) -> float:
    """One number."""
    if not _is_number(value):
        raise refusal(where, value, "a number")
    return float(value)


def number_list(value: Any, where: str) -> tuple[float, ...]:
    """Any count of numbers."""
    if not isinstance(value, list) or not all(map(_is_number, value)):
        raise refusal(where, value, "a list of numbers")
    return tuple(float(v) for v in value)


def axis(value: Any, where: str) -> Vec3:
    """A direction of length 1."""
    if isinstance(value, str) and value in _AXES:
        return _AXES[value]
    if _are_numbers(value, 3):
        given = (float(value[0]), float(value[1]), float(value[2]))
        if 1e-6 < norm(given) < math.inf:
            return unit(given)
    raise refusal(where, value, "x, y, z, -x, -y, -z or three numbers, not all zero")


def limits(value: Any, where: str) -> tuple[float, float]:
    """Lowest and highest position, degrees to rad."""
    if not _are_numbers(value, 2) or value[0] >= value[1]:
        raise refusal(where, value, "[low, high] in degrees, low below high")
    return math.radians(value[0]), math.radians(value[1])


def mounting(value: Any, where: str) -> Quat:
    """A rotation by roll, pitch, yaw or as a quaternion; none where there is no value."""
    given = section(value, where, ("rpy_deg", "quaternion"))
    if len(given) > 1:
        raise ConfigurationError(f"{where}: give either rpy_deg or quaternion, not both")
    if "rpy_deg" in given:
        roll, pitch, yaw = vector(given["rpy_deg"], f"{where}.rpy_deg", "degrees")
        return from_rpy(math.radians(roll), math.radians(pitch), math.radians(yaw))
    if "quaternion" in given:
        x, y, z, w = _numbers(given["quaternion"], f"{where}.quaternion", "x, y, z, w", 4)
        if abs(math.hypot(x, y, z, w) - 1.0) > 0.01:
            raise refusal(f"{where}.quaternion", given["quaternion"], "x, y, z, w of length 1")
        return normalized((x, y, z, w))
    return IDENTITY


def _numbers(value: Any, where: str, unit_name: str, length: int) -> list[float]:
    if not _are_numbers(value, length):
        raise refusal(where, value, f"{length} numbers ({unit_name})")
    return [float(v) for v in value]


def _are_numbers(value: Any, length: int) -> bool:
    return isinstance(value, list) and len(value) == length and all(map(_is_number, value))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


class _StrictLoader(yaml.SafeLoader):
    """Refuses a key that is given twice, of which YAML would silently keep the last, and reads 1e-4 as a number."""

    def compose_mapping_node(self, anchor: Any) -> Any:
        node: Any = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise ConfigurationError(f"line {key.start_mark.line + 1}: the key '{key.value}' is given twice")
                seen.add(key.value)
        return node

    def construct_integer(self, node: Any) -> int:
        value: int = self.construct_yaml_int(node)
        if abs(value) > _LARGEST_INTEGER:  # neither a float nor even its text need be possible
            raise refusal(f"line {node.start_mark.line + 1}", node.value, f"a number up to {_LARGEST_INTEGER}")
        return value


_StrictLoader.add_constructor("tag:yaml.org,2002:int", _StrictLoader.construct_integer)
_StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$"),
    list("-+0123456789."),
)
