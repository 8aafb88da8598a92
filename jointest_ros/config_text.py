"""A configuration as YAML text: what `jointest simulate` writes beside a recording."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees
from typing import Any

import yaml

from jointest_ros.core.robot import STANDARD_GRAVITY, Joint, Robot, Sensor
from jointest_ros.core.rotation import IDENTITY


def robot_yaml(robot: Robot, estimators: Mapping[str, Mapping[str, Any]], heading: str) -> str:
    """The text that `config.load` reads as this robot; `heading` becomes its comment."""
    document = {
        "robot": {
            "name": robot.name,
            "links": list(robot.links),
            "joints": {joint.name: _joint(joint) for joint in robot.joints},
        },
        "sensors": {sensor.name: _sensor(sensor) for sensor in robot.sensors},
        "estimators": {name: dict(values) for name, values in estimators.items()},
    }
    comment = "".join(f"# {line}\n" for line in heading.splitlines())
    return comment + yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110)


def _joint(joint: Joint) -> dict[str, Any]:
    entry: dict[str, Any] = {"parent": joint.parent, "child": joint.child, "axes": [list(axis) for axis in joint.axes]}
    if joint.limits is not None:
        limits = [[_degrees(low), _degrees(high)] for low, high in joint.limits]
        entry["limits_deg"] = limits if len(limits) > 1 else limits[0]
    if joint.continuous:
        entry["continuous"] = True
    return entry


def _sensor(sensor: Sensor) -> dict[str, Any]:
    entry: dict[str, Any] = {"link": sensor.link, "position": list(sensor.position)}
    if sensor.mounting != IDENTITY:
        entry["mounting"] = {"quaternion": list(sensor.mounting)}
    for field in ("gyro", "accel"):
        if not getattr(sensor, field):
            entry[field] = False
    if sensor.mag:
        entry["mag"] = True
    entry["gyro_noise_dps"] = _degrees(sensor.gyro_noise)
    entry["gyro_bias_walk_dps"] = _degrees(sensor.gyro_bias_walk)
    entry["accel_noise_ug"] = round(sensor.accel_noise / STANDARD_GRAVITY * 1e6, 6)
    return entry


def _degrees(radians: float) -> float:
    return float(f"{degrees(radians):.9g}")
