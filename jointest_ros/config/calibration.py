"""Calibration files: what a recording or a node found out about a robot's sensors, kept apart from its configuration.

A configuration names its file by `calibration_file:`, relative to its own folder. What stands there takes precedence
over the configuration. The file need not exist. Each `jointest calibrate` writes its own section and leaves the others,
and so does `~/save_calibration` of a node:

    hall:  # in the order of the configuration
    - {joint: knee, mirrored: false, curve: {a_deg: .07, b: 2.87, c_deg: 2.22e5, d: 8.43}, noise_v: .02, offset_v: 0}
    accel:  # acceleration = matrix reading + offset, sensor frame, m/s^2
      imu_1: {matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], offset: [0, 0, 0]}
    gyro:  # rate = scale times reading of each axis, sensor frame
      imu_1: {scale: [1, 1, 1]}
    mountings:  # rotation sensor frame to link frame, x, y, z, w
      imu_1: {quaternion: [0, 0, 0, 1]}
    learned:  # where estimators start: biases with their standard deviation (rad/s, V, m/s^2), zero poses (learned.py)
      pcf: {robot: robot-2ea1c0d4, saved: 2026-11-22 19:04:31 UTC, biases: {imu_1.x: [0.01, 1e-4]}, zero: {knee: [0.1]}}
"""

from __future__ import annotations

import itertools
import math
import os
import re
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from jointest_ros.config import values as read
from jointest_ros.config.hall import HallSettings, curve
from jointest_ros.config.text import hall_entry, mounting_entry
from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.hall_sensor import HallSensor
from jointest_ros.core.learned import Learned
from jointest_ros.core.robot import Robot, Sensor

SECTIONS = ("hall", "accel", "gyro", "mountings", "learned")

_SCALES = (0.5, 2.0)  # of a gyro
_LARGEST_BIAS = 10.0  # rad/s, V or m/s^2: beyond every sensor
_IDENTITY = ("joint", "mirrored")
_FITTED = ("curve", "noise_v", "offset_v")
_AS_CONFIGURED = "as in the configuration, or remove the file and calibrate again"


def load(path: Path, robot: Robot) -> Robot:
    """The robot with what the calibration file says of its sensors; as it is where there is no file.

    Raises:
        ConfigurationError: the file cannot be read, is damaged or belongs to other sensors: file, key, what is allowed.
    """
    text = read.read_file(path, "calibration")
    if text is None:
        return robot
    try:
        return _calibrated(read.section(read.read_yaml(text), "", SECTIONS), robot)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None


def save_hall(path: Path, sensors: Sequence[HallSensor], heading: str) -> None:
    """Write the section `hall` of a calibration file; `heading` becomes its comment.

    The file is written whole or not at all; its other sections stay.

    Raises:
        CalibrationError: it cannot be written.
        ConfigurationError: what is there cannot be read.
    """
    entries = []
    for sensor in sensors:
        entry = {**hall_entry(sensor), "offset_v": sensor.offset}
        entries.append({key: entry[key] for key in (*_IDENTITY, *_FITTED)})
    _save(path, "hall", entries, heading)


def save_accel(path: Path, sensors: Collection[Sensor], heading: str) -> None:
    """Write matrix and offset of these accelerometers into the section `accel`, as `save_hall` does its own."""
    entries = {
        sensor.name: {"matrix": [list(row) for row in sensor.accel_matrix], "offset": list(sensor.accel_offset)}
        for sensor in sensors
    }
    _save(path, "accel", entries, heading)


def save_gyro(path: Path, sensors: Collection[Sensor], heading: str) -> None:
    """Write the scales of these gyros into the section `gyro`, as `save_hall` does its own."""
    _save(path, "gyro", {sensor.name: {"scale": list(sensor.gyro_scale)} for sensor in sensors}, heading)


def save_mountings(path: Path, sensors: Collection[Sensor], heading: str) -> None:
    """Write the mountings of these sensors into the section `mountings`, as `save_hall` does its own."""
    _save(path, "mountings", {sensor.name: mounting_entry(sensor) for sensor in sensors}, heading)


def save_learned(path: Path, estimator: str, learned: Learned, heading: str) -> None:
    """Write what one estimator learned into the section `learned`, as `save_hall` does its own."""
    entry = {
        "robot": learned.robot,
        "saved": learned.saved,
        "biases": {name: list(bias) for name, bias in learned.biases.items()},
        "zero": {joint: list(numbers) for joint, numbers in learned.zero.items()},
    }
    _save(path, "learned", {estimator: entry}, heading)


def heading(path: Path, section: str) -> str:
    """The comment before a section of a calibration file; empty where there is none. Raises ConfigurationError."""
    lines = _split(read.read_file(path, "calibration") or "").get(section, "").splitlines()
    comment = itertools.takewhile(lambda line: line.startswith("#"), lines)
    return "\n".join(line[1:].removeprefix(" ") for line in comment)


def sections_of(path: Path) -> list[str]:
    """The sections that a calibration file has; none where there is no file. Raises ConfigurationError."""
    return list(_split(read.read_file(path, "calibration") or ""))


# ---------------------------------------------------------------- reading


def _calibrated(document: dict[str, Any], robot: Robot) -> Robot:
    if not document:
        raise ConfigurationError(f"no section; give some of {', '.join(SECTIONS)}, or remove the file")
    if "hall" in document:
        robot = replace(robot, hall=_hall(document["hall"], robot.hall))
    sensors = {sensor.name: sensor for sensor in robot.sensors}
    for name, where, values in _by_sensor(document, "accel", sensors):
        given = _whole(values, where, ("matrix", "offset"))
        matrix, offset = given["matrix"], read.vector(given["offset"], f"{where}.offset", "m/s^2")
        if not isinstance(matrix, list) or len(matrix) != 3:
            raise read.refusal(f"{where}.matrix", matrix, "three rows of three numbers")
        x, y, z = (read.vector(row, f"{where}.matrix[{k}]", "of a row") for k, row in enumerate(matrix))
        sensors[name] = replace(sensors[name], accel_matrix=(x, y, z), accel_offset=offset)
    for name, where, values in _by_sensor(document, "gyro", sensors):
        given = _whole(values, where, ("scale",))["scale"]
        scale = read.vector(given, f"{where}.scale", "of the axes")
        if not all(_SCALES[0] <= one <= _SCALES[1] for one in scale):
            raise read.refusal(f"{where}.scale", given, f"three numbers from {_SCALES[0]:g} to {_SCALES[1]:g}")
        sensors[name] = replace(sensors[name], gyro_scale=scale)
    for name, where, values in _by_sensor(document, "mountings", sensors):
        sensors[name] = replace(sensors[name], mounting=read.mounting(_whole(values, where, ("quaternion",)), where))
    return replace(robot, sensors=tuple(sensors.values()), learned=_learned(document))


def _learned(document: dict[str, Any]) -> dict[str, Learned]:
    """The section `learned`; whether an entry suits an estimator is for that to judge."""
    if "learned" not in document:
        return {}
    section = read.section(document["learned"], "learned")
    if not section:
        raise read.refusal("learned", document["learned"], "an entry for each estimator")
    found = {}
    for estimator, values in section.items():
        where = f"learned.{estimator}"
        given = _whole(values, where, ("robot", "saved", "biases", "zero"))
        robot, saved = (read.text(given[key], f"{where}.{key}") for key in ("robot", "saved"))
        biases = {}
        for name, bias in read.section(given["biases"], f"{where}.biases").items():
            biases[name] = read.pair(bias, f"{where}.biases.{name}", "value, standard deviation")
            if abs(biases[name][0]) > _LARGEST_BIAS:
                raise read.refusal(f"{where}.biases.{name}", bias, f"a value of no more than {_LARGEST_BIAS:g}")
            if biases[name][1] < 0.0:
                raise read.refusal(f"{where}.biases.{name}", bias, "a standard deviation of 0 or more")
        zero = {}
        for joint, numbers in read.section(given["zero"], f"{where}.zero").items():
            zero[joint] = read.number_list(numbers, f"{where}.zero.{joint}")
            angle = len(numbers) == 1 and abs(zero[joint][0]) <= math.tau
            rotation = len(numbers) == 4 and abs(math.hypot(*zero[joint]) - 1.0) <= 1e-6
            if not (angle or rotation):
                raise read.refusal(f"{where}.zero.{joint}", numbers, "an angle (rad) or x, y, z, w of length 1")
        found[estimator] = Learned(robot, biases, zero, saved)
    return found


def _by_sensor(document: dict[str, Any], key: str, sensors: dict[str, Sensor]) -> list[tuple[str, str, Any]]:
    """Sensor, path of keys and values of each entry of a section."""
    if key not in document:
        return []
    section = read.section(document[key], key)
    if not section:
        raise read.refusal(key, document[key], "an entry for each sensor")
    for name in section:
        if name not in sensors:
            raise ConfigurationError(f"{key}.{name}: no sensor of the configuration; known: {', '.join(sensors)}")
    return [(name, f"{key}.{name}", values) for name, values in section.items()]


def _hall(entries: Any, configured: Sequence[HallSensor]) -> tuple[HallSensor, ...]:
    if not isinstance(entries, list) or len(entries) != len(configured):
        raise read.refusal("hall", entries, f"{len(configured)} entries {_AS_CONFIGURED}")
    pairs = enumerate(zip(entries, configured, strict=True))
    return tuple(_merged(entry, sensor, f"hall[{number}]") for number, (entry, sensor) in pairs)


def _merged(entry: Any, sensor: HallSensor, where: str) -> HallSensor:
    given = _whole(entry, where, (*_IDENTITY, *_FITTED))
    for key, value in zip(_IDENTITY, (sensor.joint, sensor.mirrored), strict=True):
        if given[key] != value:
            raise read.refusal(f"{where}.{key}", given[key], f"{value!r} {_AS_CONFIGURED}")
    points = isinstance(given["curve"], dict) and "volts" in given["curve"]
    keys = ("volts", "angles_deg") if points else ("a_deg", "b", "c_deg", "d")
    values = _whole(given["curve"], f"{where}.curve", keys)
    settings = HallSettings.from_mapping({key: given[key] for key in ("noise_v", "offset_v")}, where)
    try:
        fitted = curve(values, f"{where}.curve")
        return replace(sensor, curve=fitted, noise=settings.noise_v, offset=settings.offset_v)
    except ConfigurationError as error:
        raise ConfigurationError(f"{where}: {error}" if where not in str(error) else str(error)) from None


def _whole(value: Any, where: str, keys: tuple[str, ...]) -> dict[str, Any]:
    """A section with all of `keys`: there is no default for what was measured."""
    given = read.section(value, where, keys)
    for key in keys:
        if key not in given:
            raise ConfigurationError(f"{where}.{key}: missing")
    return given


# ---------------------------------------------------------------- writing


def _save(path: Path, key: str, values: Any, heading: str) -> None:
    """Replace one section with its comment; sensors of it that are not in `values` stay, without their comment."""
    sections = _split(read.read_file(path, "calibration") or "")
    if key in sections and isinstance(values, dict):
        values = {**read.section(read.read_yaml(sections[key]), "", SECTIONS).get(key, {}), **values}
    comment = "".join(f"# {line}".rstrip() + "\n" for line in heading.splitlines())
    sections[key] = comment + yaml.safe_dump({key: values}, sort_keys=False, default_flow_style=None, width=110)
    target = path.resolve()  # a link stays one
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        try:
            part.write_text("".join(sections[name] for name in SECTIONS if name in sections), encoding="utf-8")
            os.replace(part, target)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be written: {error.strerror}") from None


def _split(text: str) -> dict[str, str]:
    """Section -> its text, the comment before it included."""
    sections: dict[str, str] = {}
    waiting, key = "", ""
    for line in text.splitlines(keepends=True):
        found = re.match(r"(\w+):", line)
        if found:
            key, waiting = found[1], waiting + line
        elif line.startswith("#"):
            waiting, key = waiting + line, ""
            continue
        else:
            waiting += line
        if key:
            sections[key] = sections.get(key, "") + waiting
            waiting = ""
    return sections
