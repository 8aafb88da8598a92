"""The one reader of `config/*.yaml`: what the nodes and the command line know of a robot.

Sections: `robot` (links, joints), `sensors`, `timing`, `estimators`. Angles and rates are in degrees where the key
says so (`_deg`, `_dps`), noise is in the units of data sheets; everything is SI once it is read.
"""

from __future__ import annotations

import math
import re
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import Quat, Vec3
from jointest_ros.core.params import Params, param, reject_unknown
from jointest_ros.core.robot import STANDARD_GRAVITY, Joint, Robot, Sensor
from jointest_ros.core.rotation import IDENTITY, from_rpy, norm, normalized, unit
from jointest_ros.core.timing import Timing

_AXES: dict[str, Vec3] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_AXES |= {f"-{name}": (-x, -y, -z) for name, (x, y, z) in _AXES.items()}
_AXES |= {f"+{name}": _AXES[name] for name in "xyz"}

_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")

_shown = reprlib.Repr()  # of a value in an error: a line, however much was given
_shown.maxlevel, _shown.maxstring, _shown.maxother = 2, 60, 60


@dataclass(frozen=True)
class SensorSettings(Params):
    """The scalars of one entry of `sensors:`, and of `sensor_defaults:`, in the units of data sheets."""

    gyro: bool = param(True, "it has a gyro that is to be used")
    accel: bool = param(True, "it has an accelerometer that is to be used")
    mag: bool = param(False, "it has a magnetometer that is to be used")
    gyro_noise_dps: float = param(0.005, "white noise density of the gyro", unit="deg/s/sqrt(Hz)", low=0.0, high=10.0)
    gyro_bias_walk_dps: float = param(0.001, "random walk of the gyro bias", unit="deg/s/sqrt(s)", low=0.0, high=10.0)
    accel_noise_ug: float = param(
        400.0, "white noise density of the accelerometer", unit="ug/sqrt(Hz)", low=0.0, high=1e6
    )
    gyro_range_dps: float = param(0.0, "full scale of the gyro; 0: unknown", unit="deg/s", low=0.0, high=1e5)
    accel_range_g: float = param(0.0, "full scale of the accelerometer; 0: unknown", unit="g", low=0.0, high=1e4)
    delay_ms: float = param(
        0.0, "delay of the sensor's low-pass filter, subtracted from its stamps", unit="ms", low=0.0, high=1e3
    )


@dataclass(frozen=True)
class Configuration:
    """A robot, how its samples become frames, and the parameters of its estimators by name."""

    robot: Robot
    timing: Timing
    estimators: dict[str, Params]
    path: Path | None = None


def load(path: str | Path) -> Configuration:
    """Read a configuration file.

    Raises:
        ConfigurationError: the file is missing or no YAML, or something in it is wrong; one line that names file,
            key, value and what is allowed.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: no such configuration file") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read as a configuration: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: no valid YAML: not a text in UTF-8") from None
    try:
        return parse(text, path)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None


def parse(text: str, path: Path | None = None) -> Configuration:
    """Read a configuration from its YAML text. Raises ConfigurationError."""
    try:
        document = yaml.load(text, Loader=_StrictLoader)
    except ConfigurationError:
        raise
    except RecursionError:
        raise ConfigurationError("no valid YAML: too many levels in one another") from None
    except Exception as error:  # besides YAMLError: whatever PyYAML trips over in dates, numbers and explicit tags
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}: " if mark is not None else ""
        raise ConfigurationError(f"{where}no valid YAML: {getattr(error, 'problem', None) or error}") from None
    document = _section(document, "", ("robot", "sensors", "sensor_defaults", "timing", "estimators"))
    if "robot" not in document:
        raise ConfigurationError("robot: missing; give at least its links")
    estimators = {}
    for name, values in _section(document.get("estimators"), "estimators", tuple(ESTIMATORS)).items():
        where = f"estimators.{name}"
        estimators[name] = ESTIMATORS[name].Params.from_mapping(_section(values, where), where)
    return Configuration(
        robot=_robot(document),
        timing=Timing.from_mapping(_section(document.get("timing"), "timing"), "timing"),
        estimators=estimators,
        path=path,
    )


# -------------------------------------------------------------------- robot and sensors


def _robot(document: Mapping[str, Any]) -> Robot:
    section = _section(document["robot"], "robot", ("name", "links", "joints"))
    name, links = section.get("name", "robot"), section.get("links")
    if not isinstance(name, str):
        raise _refusal("robot.name", name, "a text")
    if not isinstance(links, list) or not links or not all(isinstance(link, str) and link for link in links):
        raise _refusal("robot.links", links, "a list of at least one name")
    joints = _section(section.get("joints"), "robot.joints")
    sensors = _section(document.get("sensors"), "sensors")
    defaults = _section(document.get("sensor_defaults"), "sensor_defaults")
    SensorSettings.from_mapping(defaults, "sensor_defaults")
    return Robot(
        links=tuple(links),
        joints=tuple(_joint(name, values) for name, values in joints.items()),
        sensors=tuple(_sensor(name, values, defaults) for name, values in sensors.items()),
        name=name,
    )


def _joint(name: str, values: Any) -> Joint:
    where = f"robot.joints.{name}"
    section = _section(values, where, ("parent", "child", "axis", "axes", "limits_deg", "continuous"))
    for key in ("parent", "child"):
        if not isinstance(section.get(key), str):
            raise _refusal(f"{where}.{key}", section.get(key), "the name of a link")
    if ("axis" in section) == ("axes" in section):
        raise ConfigurationError(f"{where}: give either axis (one) or axes (a list of one to three)")
    if "axis" in section:
        axes: tuple[Vec3, ...] = (_axis(section["axis"], f"{where}.axis"),)
    else:
        listed = section["axes"]
        if not isinstance(listed, list) or not 1 <= len(listed) <= 3:
            raise _refusal(f"{where}.axes", listed, "a list of one to three axes")
        axes = tuple(_axis(axis, f"{where}.axes[{i}]") for i, axis in enumerate(listed))
    continuous = section.get("continuous", False)
    if not isinstance(continuous, bool):
        raise _refusal(f"{where}.continuous", continuous, "true or false")
    limits = None
    if "limits_deg" in section:
        pairs = section["limits_deg"] if len(axes) > 1 else [section["limits_deg"]]
        if not isinstance(pairs, list) or len(pairs) != len(axes):
            raise _refusal(f"{where}.limits_deg", pairs, "[low, high] for each axis")
        limits = tuple(_limits(pair, f"{where}.limits_deg") for pair in pairs)
    return Joint(name, section["parent"], section["child"], axes, limits, continuous)


def _sensor(name: str, values: Any, defaults: Mapping[str, Any]) -> Sensor:
    where = f"sensors.{name}"
    geometry = ("link", "position", "mounting", "topic", "mag_topic", "frame_id")
    scalars = tuple(SensorSettings.__dataclass_fields__)
    section = _section(values, where, geometry + scalars)
    for key in ("link", "frame_id"):
        if not isinstance(section.get(key, ""), str):
            raise _refusal(f"{where}.{key}", section[key], "a text")
    chosen = {key: section[key] for key in scalars if key in section}
    settings = SensorSettings.from_mapping({**defaults, **chosen}, where)
    return Sensor(
        name,
        link=section.get("link", name),
        position=_vector(section.get("position", [0.0, 0.0, 0.0]), f"{where}.position", "m"),
        mounting=_mounting(section.get("mounting"), f"{where}.mounting"),
        gyro=settings.gyro,
        accel=settings.accel,
        mag=settings.mag,
        gyro_noise=math.radians(settings.gyro_noise_dps),
        gyro_bias_walk=math.radians(settings.gyro_bias_walk_dps),
        accel_noise=settings.accel_noise_ug * 1e-6 * STANDARD_GRAVITY,
        gyro_range=math.radians(settings.gyro_range_dps) or math.inf,
        accel_range=settings.accel_range_g * STANDARD_GRAVITY or math.inf,
        delay=settings.delay_ms * 1e-3,
        topic=_topic(section.get("topic", f"imu/{name}"), f"{where}.topic"),
        mag_topic=_topic(section.get("mag_topic", f"mag/{name}"), f"{where}.mag_topic"),
        frame_id=section.get("frame_id", ""),
    )


# -------------------------------------------------------------------- values


def _section(value: Any, where: str, allowed: tuple[str, ...] | None = None) -> dict[str, Any]:
    if value is None:
        return {}
    where_or_all = where or "configuration"
    if not isinstance(value, dict):
        raise _refusal(where_or_all, value, "keys with values")
    for key in value:
        if not isinstance(key, str) or not key:
            raise _refusal(f"{where_or_all}: the key", key, "a name, in quotes where YAML takes it for something else")
    if allowed is not None:
        reject_unknown(value, allowed, where)
    return value


def _numbers(value: Any, where: str, unit_name: str, length: int) -> list[float]:
    if not isinstance(value, list) or len(value) != length or not all(_is_number(v) for v in value):
        raise _refusal(where, value, f"{length} numbers ({unit_name})")
    return [float(v) for v in value]


def _vector(value: Any, where: str, unit_name: str) -> Vec3:
    x, y, z = _numbers(value, where, unit_name, 3)
    return x, y, z


def _axis(value: Any, where: str) -> Vec3:
    if isinstance(value, str) and value in _AXES:
        return _AXES[value]
    if isinstance(value, list) and len(value) == 3 and all(_is_number(v) for v in value):
        vector = (float(value[0]), float(value[1]), float(value[2]))
        if 1e-6 < norm(vector) < math.inf:
            return unit(vector)
    raise _refusal(where, value, "x, y, z, -x, -y, -z or three numbers, not all zero")


def _limits(value: Any, where: str) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2 or not all(_is_number(v) for v in value) or value[0] >= value[1]:
        raise _refusal(where, value, "[low, high] in degrees, low below high")
    return math.radians(value[0]), math.radians(value[1])


def _mounting(value: Any, where: str) -> Quat:
    section = _section(value, where, ("rpy_deg", "quaternion"))
    if len(section) > 1:
        raise ConfigurationError(f"{where}: give either rpy_deg or quaternion, not both")
    if "rpy_deg" in section:
        roll, pitch, yaw = _vector(section["rpy_deg"], f"{where}.rpy_deg", "degrees")
        return from_rpy(math.radians(roll), math.radians(pitch), math.radians(yaw))
    if "quaternion" in section:
        x, y, z, w = _numbers(section["quaternion"], f"{where}.quaternion", "x, y, z, w", 4)
        if abs(math.hypot(x, y, z, w) - 1.0) > 0.01:
            raise _refusal(f"{where}.quaternion", section["quaternion"], "x, y, z, w of length 1")
        return normalized((x, y, z, w))
    return IDENTITY


def _topic(value: Any, where: str) -> str:
    if not isinstance(value, str) or not _TOPIC.fullmatch(value):
        raise _refusal(where, value, "a topic: names of letters, digits and _ with / between, none begins with a digit")
    return value


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _refusal(where: str, value: Any, allowed: str) -> ConfigurationError:
    return ConfigurationError(f"{where}: {_shown.repr(value)} is not allowed; give {allowed}")


class _StrictLoader(yaml.SafeLoader):
    """Refuses a key that is given twice, of which YAML would silently keep the last, and reads 1e-4 as a number."""

    def compose_mapping_node(self, anchor: Any) -> Any:
        node = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and (key.tag, key.value) in seen:
                raise ConfigurationError(f"line {key.start_mark.line + 1}: the key '{key.value}' is given twice")
            seen.add((key.tag, key.value if isinstance(key, yaml.ScalarNode) else id(key)))
        return node

    def construct_yaml_int(self, node: Any) -> int:
        value = super().construct_yaml_int(node)
        if abs(value) > _LARGEST_INTEGER:
            raise ConfigurationError(f"line {node.start_mark.line + 1}: the number {_shown.repr(node.value)} is too large")
        return value


_StrictLoader.add_constructor("tag:yaml.org,2002:int", _StrictLoader.construct_yaml_int)
_StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$"),
    list("-+0123456789."),
)
