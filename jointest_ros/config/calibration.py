"""Calibration files: what a recording or a node found out about a robot's sensors, kept apart from its configuration.

A configuration names its file by `calibration_file:`, relative to its own folder. What stands there takes precedence
over the configuration. The file need not exist.

    hall:  # in the order of the configuration
    - {joint: knee, mirrored: false, curve: {a_deg: .07, b: 2.87, c_deg: 2.22e5, d: 8.43}, noise_v: .02, offset_v: 0}
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from jointest_ros.config import values as read
from jointest_ros.config.hall import HallSettings, curve
from jointest_ros.config.text import hall_entry
from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.hall_sensor import HallSensor

_IDENTITY = ("joint", "mirrored")
_FITTED = ("curve", "noise_v", "offset_v")
_AS_CONFIGURED = "as in the configuration, or remove the file and calibrate again"


def load_hall(path: Path, configured: Sequence[HallSensor]) -> tuple[HallSensor, ...]:
    """The configured sensors with what the calibration file says of them; as they are where there is no file.

    Raises:
        ConfigurationError: the file cannot be read, is damaged or belongs to other sensors: file, key, what is allowed.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return tuple(configured)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read as a calibration: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: no valid YAML: not a text in UTF-8") from None
    try:
        return _parse(text, configured)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None


def save_hall(path: Path, sensors: Iterable[HallSensor], heading: str) -> None:
    """Write a calibration file, whole or not at all; `heading` becomes its comment.

    Raises:
        CalibrationError: it cannot be written.
    """
    entries = []
    for sensor in sensors:
        entry = {**hall_entry(sensor), "offset_v": sensor.offset}
        entries.append({key: entry[key] for key in (*_IDENTITY, *_FITTED)})
    comment = "".join(f"# {line}".rstrip() + "\n" for line in heading.splitlines())
    text = comment + yaml.safe_dump({"hall": entries}, sort_keys=False, default_flow_style=None, width=110)
    target = path.resolve()  # a link stays one
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        try:
            part.write_text(text, encoding="utf-8")
            os.replace(part, target)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be written: {error.strerror}") from None


def _parse(text: str, configured: Sequence[HallSensor]) -> tuple[HallSensor, ...]:
    entries = read.section(read.read_yaml(text), "", ("hall",)).get("hall")
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
