"""A configuration as YAML text: what `jointest simulate` writes beside a recording."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from math import degrees, isfinite
from typing import Any

import yaml

from jointest_ros.core.hall_sensor import HallSensor
from jointest_ros.core.robot import STANDARD_GRAVITY, Joint, Robot, Sensor
from jointest_ros.core.rotation import IDENTITY


def robot_yaml(robot: Robot, estimators: Mapping[str, Mapping[str, Any]], heading: str) -> str:
    """The text that `config.load` reads as this robot; `heading` becomes its comment."""
    document = {
        "robot": {
            "name": robot.name,
            "links": list(robot.links),
            **({"world": robot.world} if robot.world else {}),
            "joints": {joint.name: _joint(joint) for joint in robot.joints},
        },
        "sensors": {sensor.name: _sensor(sensor) for sensor in robot.sensors},
        **({"hall": [hall_entry(hall) for hall in robot.hall]} if robot.hall else {}),
        "estimators": {name: dict(values) for name, values in estimators.items()},
    }
    comment = "".join(f"# {line}\n" for line in heading.splitlines())
    return comment + yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110)


def _joint(joint: Joint) -> dict[str, Any]:
    entry: dict[str, Any] = {"parent": joint.parent, "child": joint.child, "axes": [list(axis) for axis in joint.axes]}
    if joint.names:
        entry["names"] = list(joint.names)
    if any(joint.origin):
        entry["origin"] = list(joint.origin)
    if joint.roll_link is not None:
        entry["roll_link"] = list(joint.roll_link)
    if joint.limits is not None:
        limits = [[_degrees(low), _degrees(high)] for low, high in joint.limits]
        entry["limits_deg"] = limits if len(limits) > 1 else limits[0]
    if joint.continuous:
        entry["continuous"] = True
    return entry


def _sensor(sensor: Sensor) -> dict[str, Any]:
    entry: dict[str, Any] = {"link": sensor.link, "position": list(sensor.position)}
    for key, usual in (("topic", f"imu/{sensor.name}"), ("mag_topic", f"mag/{sensor.name}"), ("frame_id", "")):
        if getattr(sensor, key) != usual:
            entry[key] = getattr(sensor, key)
    if sensor.mounting != IDENTITY:
        entry["mounting"] = mounting_entry(sensor)
    for field in ("gyro", "accel"):
        if not getattr(sensor, field):
            entry[field] = False
    if sensor.mag:
        entry["mag"] = True
    entry["gyro_noise_dps"] = _degrees(sensor.gyro_noise)
    entry["gyro_bias_walk_dps"] = _degrees(sensor.gyro_bias_walk)
    entry["accel_noise_ug"] = _short(sensor.accel_noise / STANDARD_GRAVITY * 1e6)
    if isfinite(sensor.gyro_range):
        entry["gyro_range_dps"] = _degrees(sensor.gyro_range)
    if isfinite(sensor.accel_range):
        entry["accel_range_g"] = _short(sensor.accel_range / STANDARD_GRAVITY)
    if sensor.delay:
        entry["delay_ms"] = _short(sensor.delay * 1e3)
    return entry


def mounting_entry(sensor: Sensor) -> dict[str, Any]:
    """The mounting of a sensor as the value of `mounting:`."""
    return {"quaternion": list(sensor.mounting)}


def hall_entry(hall: HallSensor) -> dict[str, Any]:
    """One Hall sensor as an entry of `hall:`."""
    curve = {key: list(v) if isinstance(v, tuple) else v for key, v in dataclasses.asdict(hall.curve).items()}
    entry: dict[str, Any] = {"joint": hall.joint, "mirrored": hall.mirrored, "noise_v": hall.noise}
    entry |= {"resolution_v": hall.resolution, "hall_range": list(hall.hall_range), "curve": curve}
    if hall.offset:
        entry["offset_v"] = hall.offset
    return entry


def _degrees(radians: float) -> float:
    return _short(degrees(radians))


def _short(value: float) -> float:
    """Without the noise that a change of units leaves in the last digits."""
    return float(f"{value:.9g}")
