"""The one reader of `config/*.yaml`: what the nodes and the command line know of a robot.

Sections: `robot` (links, joints), `sensors`, `hall`, `timing`, `estimators`. Angles and rates are in degrees where the
key says so (`_deg`, `_dps`), noise is in the units of data sheets; everything is SI once it is read. What stands in the
file that `calibration_file` names, relative to the configuration, takes precedence; it need not exist.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jointest_ros.config import calibration
from jointest_ros.config import values as read
from jointest_ros.config.hall import hall_sensors
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import Vec3
from jointest_ros.core.params import Params, param
from jointest_ros.core.robot import STANDARD_GRAVITY, Joint, Robot, Sensor
from jointest_ros.core.timing import Timing


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
    """A robot, how its samples become frames, and the parameters of its estimators by name.

    Attributes:
        path: of the file.
        calibration_file: that it names, whether it exists or not.
        calibration_damage: why that file was left out; "" where it was not.
    """

    robot: Robot
    timing: Timing
    estimators: dict[str, Params]
    path: Path | None = None
    calibration_file: Path | None = None
    calibration_damage: str = ""


def load(path: str | Path, calibration_file: Path | None = None, *, tolerant: bool = False) -> Configuration:
    """Read a configuration file.

    Args:
        calibration_file: instead of the one that it names.
        tolerant: a calibration file that is damaged is left out as a whole, and the configuration says why; a node
            has to start, whatever became of the file. Otherwise it is refused.

    Raises:
        ConfigurationError: the file is missing or no YAML, or something in it is wrong; one line that names file,
            key, value and what is allowed.
    """
    path = Path(path)
    text = read.read_file(path, "configuration")
    if text is None:
        raise ConfigurationError(f"{path}: no such configuration file")
    try:
        return parse(text, path, calibration_file, tolerant=tolerant)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None


def parse(
    text: str, path: Path | None = None, calibration_file: Path | None = None, *, tolerant: bool = False
) -> Configuration:
    """Read a configuration from its YAML text, as `load` does. Raises ConfigurationError."""
    sections = (
        "robot",
        "sensors",
        "sensor_defaults",
        "hall",
        "hall_defaults",
        "timing",
        "estimators",
        "calibration_file",
    )
    document = read.section(read.read_yaml(text), "", sections)
    if "robot" not in document:
        raise ConfigurationError("robot: missing; give at least its links")
    estimators = {}
    for name, values in read.section(document.get("estimators"), "estimators", tuple(ESTIMATORS)).items():
        where = f"estimators.{name}"
        estimators[name] = ESTIMATORS[name].Params.from_mapping(read.section(values, where), where)
    robot, damage = _robot(document), ""
    if "calibration_file" in document:
        name = read.text(document["calibration_file"], "calibration_file", "the name of a file")
        calibration_file = calibration_file or (path or Path()).parent / name
    if calibration_file is not None:
        try:
            robot = calibration.load(calibration_file, robot)
        except ConfigurationError as error:
            if not tolerant:
                raise
            damage = str(error)
    return Configuration(
        robot=robot,
        timing=Timing.from_mapping(read.section(document.get("timing"), "timing"), "timing"),
        estimators=estimators,
        path=path,
        calibration_file=calibration_file,
        calibration_damage=damage,
    )


def _robot(document: Mapping[str, Any]) -> Robot:
    section = read.section(document["robot"], "robot", ("name", "links", "joints", "world"))
    links = section.get("links")
    if not isinstance(links, list) or not links or not all(isinstance(link, str) and link for link in links):
        raise read.refusal("robot.links", links, "a list of at least one name")
    joints = read.section(section.get("joints"), "robot.joints")
    sensors = read.section(document.get("sensors"), "sensors")
    defaults = read.section(document.get("sensor_defaults"), "sensor_defaults")
    SensorSettings.from_mapping(defaults, "sensor_defaults")
    return Robot(
        links=tuple(links),
        joints=tuple(_joint(name, values) for name, values in joints.items()),
        sensors=tuple(_sensor(name, values, defaults) for name, values in sensors.items()),
        name=read.text(section.get("name", "robot"), "robot.name"),
        hall=hall_sensors(document.get("hall"), document.get("hall_defaults")),
        world=read.text(section.get("world", ""), "robot.world", "the name of a link"),
    )


_EACH = "[low, high] for each axis, such as [[-110, 30], [-20, 40]]"


def _joint(name: str, values: Any) -> Joint:
    where = f"robot.joints.{name}"
    keys = ("parent", "child", "axis", "axes", "names", "origin", "roll_link", "limits_deg", "continuous")
    section = read.section(values, where, keys)
    parent, child = (read.text(section.get(key), f"{where}.{key}", "the name of a link") for key in ("parent", "child"))
    if ("axis" in section) == ("axes" in section):
        raise ConfigurationError(f"{where}: give either axis (one) or axes (a list of one to three)")
    if isinstance(section.get("axis"), list) and any(isinstance(one, (str, list)) for one in section["axis"]):
        raise read.refusal(f"{where}.axis", section["axis"], "one axis; several are axes: [y, x]")
    if "axis" in section:
        axes: tuple[Vec3, ...] = (read.axis(section["axis"], f"{where}.axis"),)
    else:
        listed = section["axes"]
        if not isinstance(listed, list) or not 1 <= len(listed) <= 3:
            raise read.refusal(f"{where}.axes", listed, "a list of one to three axes")
        axes = tuple(read.axis(axis, f"{where}.axes[{i}]") for i, axis in enumerate(listed))
    continuous = section.get("continuous", False)
    if not isinstance(continuous, bool):
        raise read.refusal(f"{where}.continuous", continuous, "true or false")
    limits = None
    if "limits_deg" in section:
        pairs = section["limits_deg"] if len(axes) > 1 else [section["limits_deg"]]
        if not isinstance(pairs, list) or len(pairs) != len(axes):
            raise read.refusal(f"{where}.limits_deg", pairs, _EACH)
        if len(axes) > 1 and not all(isinstance(pair, list) for pair in pairs):
            raise read.refusal(f"{where}.limits_deg", pairs, _EACH)
        limits = tuple(read.limits(pair, f"{where}.limits_deg") for pair in pairs)
    origin = read.vector(section.get("origin", [0.0, 0.0, 0.0]), f"{where}.origin", "m")
    roll_link = read.vector(section["roll_link"], f"{where}.roll_link", "m") if "roll_link" in section else None
    names = section.get("names", [])
    if not isinstance(names, list) or len(names) not in (0, len(axes)):
        raise read.refusal(f"{where}.names", names, "a name for each axis")
    names = tuple(read.text(one, f"{where}.names[{i}]", "the name of a joint position") for i, one in enumerate(names))
    return Joint(name, parent, child, axes, limits, continuous, origin, roll_link, names)


def _sensor(name: str, values: Any, defaults: Mapping[str, Any]) -> Sensor:
    where = f"sensors.{name}"
    geometry = ("link", "position", "mounting", "topic", "mag_topic", "frame_id")
    scalars = tuple(SensorSettings.__dataclass_fields__)
    section = read.section(values, where, geometry + scalars)
    chosen = {key: section[key] for key in scalars if key in section}
    settings = SensorSettings.from_mapping({**defaults, **chosen}, where)
    return Sensor(
        name,
        link=read.text(section.get("link", name), f"{where}.link", "the name of a link"),
        position=read.vector(section.get("position", [0.0, 0.0, 0.0]), f"{where}.position", "m"),
        mounting=read.mounting(section.get("mounting"), f"{where}.mounting"),
        gyro=settings.gyro,
        accel=settings.accel,
        mag=settings.mag,
        gyro_noise=math.radians(settings.gyro_noise_dps),
        gyro_bias_walk=math.radians(settings.gyro_bias_walk_dps),
        accel_noise=settings.accel_noise_ug * 1e-6 * STANDARD_GRAVITY,
        gyro_range=math.radians(settings.gyro_range_dps) or math.inf,
        accel_range=settings.accel_range_g * STANDARD_GRAVITY or math.inf,
        delay=settings.delay_ms * 1e-3,
        topic=read.topic(section.get("topic", f"imu/{name}"), f"{where}.topic"),
        mag_topic=read.topic(section.get("mag_topic", f"mag/{name}"), f"{where}.mag_topic"),
        frame_id=read.text(section.get("frame_id", ""), f"{where}.frame_id"),
    )
