"""A configuration for one's own robot as commented YAML: what `jointest init` writes."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import degrees, pi
from typing import Any

import yaml

from jointest_ros.config.hall import HallSettings
from jointest_ros.config.keys import KEYS, TREE
from jointest_ros.config.reader import SensorSettings
from jointest_ros.config.soundness import MEASURE
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.frame import Quat
from jointest_ros.core.hall_sensor import ExponentialCurve, HallSensor
from jointest_ros.core.params import Params
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import IDENTITY, to_rpy, wrap
from jointest_ros.core.timing import Timing

_WIDTH = 118
_USUAL_DEFAULTS = ("gyro_noise_dps", "gyro_bias_walk_dps", "accel_noise_ug", "gyro_range_dps", "accel_range_g")


@dataclass(frozen=True)
class Draft:
    """What is known of a robot that is to be configured.

    Attributes:
        robot: links, joints, sensors, Hall sensors.
        estimators: name -> parameters that differ from their defaults.
        measure: "sensors.<name>.position", "joints.<name>.origin": values that nobody has measured yet.
        mimics: joint coordinate -> the angle that it has by a <mimic> of the URDF, in words.
    """

    robot: Robot
    estimators: Mapping[str, Mapping[str, Any]]
    measure: frozenset[str] = field(default_factory=frozenset)
    mimics: Mapping[str, str] = field(default_factory=dict)


def template(draft: Draft, heading: str, calibration_file: str) -> str:
    """The text of the configuration; `heading` becomes its first comment, `calibration_file` is the name in it."""
    robot = draft.robot
    lines = [
        *_comment(heading),
        "",
        "robot:",
        f"  name: {_value(robot.name)}",
        f"  links: {_value(list(robot.links))}",
    ]
    if robot.world:
        lines += [*_comment(KEYS["world"], "  "), f"  world: {_value(robot.world)}"]
    if robot.joints:
        lines += _comment(TREE, "  ")
        lines += [line for key in _joint_keys(robot) for line in _comment(f"{key}: {KEYS[key]}", "  ")]
        lines += [
            "  joints:",
            *(line for joint in robot.joints for line in (*_mimicking(joint, draft), _joint(joint, draft))),
        ]
    lines += ["", *_comment("The same for every sensor below unless it says otherwise; figures of the data sheet.")]
    lines += ["sensor_defaults:", *_sensor_defaults(robot)]
    lines += ["", *(line for key in _sensor_keys(robot) for line in _comment(f"{key}: {KEYS[key]}"))]
    lines += ["sensors:", *(_sensor(sensor, draft) for sensor in robot.sensors)]
    if robot.hall:
        lines += ["", *_hall(robot)]
    lines += ["", *_comment(KEYS["calibration_file"]), f"calibration_file: {_value(calibration_file)}"]
    lines += ["", *_comment("How samples become frames. These are the defaults: a line without # counts.")]
    lines += ["timing:", *_parameters(Timing, {"stale_after": Timing.stale_after}, "  ")]
    lines += ["", "estimators:"]
    for name, chosen in draft.estimators.items():
        lines += [f"  {name}:", *_parameters(ESTIMATORS[name].Params, chosen, "    ")]
    return "\n".join(lines) + "\n"


# ---------------------------------------------------------------- parts


def _joint_keys(robot: Robot) -> Iterator[str]:
    yield "axis"
    if any(joint.names for joint in robot.joints):
        yield "names"
    yield from ("origin", "limits_deg")
    if any(joint.continuous for joint in robot.joints):
        yield "continuous"


def _mimicking(joint: Joint, draft: Draft) -> Iterator[str]:
    for name in joint.coordinates:
        if name in draft.mimics:
            yield from _comment(
                f"{name} mimics another in the URDF ({draft.mimics[name]}). That is not used here: it is estimated "
                f"like the others, from the sensors on its links. Without one on '{joint.child}', take it out.",
                "    ",
            )


def _joint(joint: Joint, draft: Draft) -> str:
    entry: dict[str, Any] = {"parent": joint.parent, "child": joint.child}
    axes = [_axis(axis) for axis in joint.axes]
    entry |= {"axis": axes[0]} if len(axes) == 1 else {"axes": axes}
    if joint.names:
        entry["names"] = list(joint.names)
    entry["origin"] = [_short(v) for v in joint.origin]
    if joint.limits is not None:
        limits = [[_short(degrees(low), 3), _short(degrees(high), 3)] for low, high in joint.limits]
        entry["limits_deg"] = limits[0] if len(limits) == 1 else limits
    if joint.continuous:
        entry["continuous"] = True
    return _entry("    ", joint.name, entry, "origin" if f"joints.{joint.name}.origin" in draft.measure else "")


def _sensor_keys(robot: Robot) -> Iterator[str]:
    yield from ("link", "topic", "position", "mounting")
    if any(sensor.frame_id for sensor in robot.sensors):
        yield "frame_id"


def _sensor(sensor: Sensor, draft: Draft) -> str:
    entry: dict[str, Any] = {"link": sensor.link}
    if sensor.topic != f"imu/{sensor.name}":
        entry["topic"] = sensor.topic
    if sensor.frame_id:
        entry["frame_id"] = sensor.frame_id
    entry["position"] = [_short(v) for v in sensor.position]
    entry["mounting"] = {"rpy_deg": _rpy_deg(sensor.mounting)}
    return _entry("  ", sensor.name, entry, "position" if f"sensors.{sensor.name}.position" in draft.measure else "")


def _rpy_deg(mounting: Quat) -> list[float | int]:
    """Of the two (roll, pitch, yaw) of a rotation the one of the smaller angles: as somebody would write it."""
    if mounting == IDENTITY:
        return [0, 0, 0]
    roll, pitch, yaw = to_rpy(mounting)
    other = (wrap(roll + pi), wrap(pi - pitch), wrap(yaw + pi))
    chosen = min((roll, pitch, yaw), other, key=lambda angles: round(sum(map(abs, angles)), 9))
    return [_short(degrees(angle), 4) for angle in chosen]


def _sensor_defaults(robot: Robot) -> Iterator[str]:
    chosen = {key: getattr(SensorSettings, key) for key in _USUAL_DEFAULTS}
    for key in ("gyro", "accel"):
        if robot.sensors and not any(getattr(sensor, key) for sensor in robot.sensors):
            chosen[key] = False
    yield from _parameters(SensorSettings, chosen, "  ")


def _hall(robot: Robot) -> Iterator[str]:
    curve = dataclasses.asdict(ExponentialCurve())
    yield from _comment(f"hall: {KEYS['hall']}.")
    yield "hall_defaults:"
    yield f"  curve: {_value(curve)}  # {MEASURE} by jointest calibrate hall: angle = a exp(b V) - c exp(-d V)"
    yield f"  hall_range: {_value(list(HallSensor.hall_range))}  # V, what a sensor can put out"
    scalars = {key: default for key, default in _defaults(HallSettings).items() if key != "mirrored"}
    yield from _parameters(HallSettings, scalars, "  ", scalars)
    yield "hall:"
    for hall in robot.hall:
        yield f"  - {_value({'joint': hall.joint, 'mirrored': hall.mirrored})}"


def _defaults(kind: type[Params]) -> dict[str, Any]:
    return {spec.name: spec.default for spec in dataclasses.fields(kind)}


def _parameters(
    kind: type[Params], chosen: Mapping[str, Any], indent: str, only: Mapping[str, Any] | None = None
) -> Iterator[str]:
    """A line for each parameter with its description: the chosen ones first, the others as comments."""
    specs = {spec.name: spec for spec in dataclasses.fields(kind) if only is None or spec.name in only}
    for name in (*chosen, *(name for name in specs if name not in chosen)):
        spec = specs[name]
        meta = spec.metadata
        unit = f"{meta['unit']}: " if meta["unit"] else ""
        choices = f" ({', '.join(meta['choices'])})" if meta["choices"] else ""
        setting = f"{name}: {_value(chosen.get(name, spec.default))}"
        start = f"{indent}{'' if name in chosen else '# '}{setting}"
        first, *rest = textwrap.wrap(f"{unit}{meta['description']}{choices}", max(40, _WIDTH - len(start) - 4))
        yield f"{start}  # {first}"
        yield from (f"{indent}{' ' * (len(start) - len(indent))}  # {line}" for line in rest)


# ---------------------------------------------------------------- values


def _entry(indent: str, name: str, entry: Mapping[str, Any], unmeasured: str) -> str:
    mark = f"  # {MEASURE} {unmeasured}" if unmeasured else ""
    return f"{indent}{_value(name)}: {_value(dict(entry))}{mark}"


def _value(value: Any) -> str:
    """As YAML in one line."""
    text = yaml.safe_dump(value, default_flow_style=True, width=10**6, sort_keys=False).strip()
    return text.removesuffix("...").strip()


def _axis(axis: tuple[float, float, float]) -> Any:
    for letter, component in zip("xyz", axis, strict=True):
        if abs(abs(component) - 1.0) < 1e-9:
            return letter if component > 0 else f"-{letter}"
    return [_short(component, 9) for component in axis]


def _short(value: float, digits: int = 6) -> float | int:
    """Without the noise of a change of units; a whole number as such."""
    rounded = round(value, digits) + 0.0
    return int(rounded) if rounded == int(rounded) else rounded


def _comment(text: str, indent: str = "") -> list[str]:
    lines: list[str] = []
    for line in text.splitlines():
        lines += textwrap.wrap(line, _WIDTH - len(indent) - 2, subsequent_indent="  ") if len(line) > _WIDTH else [line]
    return [f"{indent}# {line}".rstrip() for line in lines]
