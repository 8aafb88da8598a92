"""The section `hall:` of a configuration: the Hall sensors in the order of the voltages in a message."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from jointest_ros.config import values as read
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.hall_sensor import Curve, ExponentialCurve, HallSensor, SplineCurve
from jointest_ros.core.params import Params, param

_POINTS = ("volts", "angles_deg")


@dataclass(frozen=True)
class HallSettings(Params):
    """The scalars of one entry of `hall:`, and of `hall_defaults:`."""

    mirrored: bool = param(False, "it sits on the other side of the joint: it sees the negative angle")
    offset_v: float = param(0.0, "known error of the voltage, subtracted", unit="V", low=-10.0, high=10.0)
    noise_v: float = param(HallSensor.noise, "standard deviation of a reading", unit="V", low=1e-6, high=10.0)
    resolution_v: float = param(
        HallSensor.resolution, "one digit of the converter; 0: none", unit="V", low=0.0, high=1.0
    )


def hall_sensors(entries: Any, defaults: Any) -> tuple[HallSensor, ...]:
    """The sensors from the values of `hall:` (a list with an entry for each voltage) and `hall_defaults:`.

    Raises:
        ConfigurationError: names key, value and what is allowed.
    """
    scalars = tuple(HallSettings.__dataclass_fields__)
    keys = ("joint", "curve", "hall_range", *scalars)
    common = read.section(defaults, "hall_defaults", keys)
    if entries is None:
        return ()
    if not isinstance(entries, list):
        raise read.refusal("hall", entries, "a list with an entry for each voltage")
    return tuple(
        _sensor({**common, **read.section(values, f"hall[{number}]", keys)}, f"hall[{number}]", scalars)
        for number, values in enumerate(entries)
    )


def _sensor(section: Mapping[str, Any], where: str, scalars: tuple[str, ...]) -> HallSensor:
    joint = read.text(section.get("joint"), f"{where}.joint", "the name of a joint")
    settings = HallSettings.from_mapping({key: section[key] for key in scalars if key in section}, where)
    try:
        return HallSensor(
            joint,
            curve(section.get("curve"), f"{where}.curve"),
            settings.mirrored,
            settings.offset_v,
            settings.noise_v,
            read.pair(section.get("hall_range", list(HallSensor.hall_range)), f"{where}.hall_range", "V"),
            settings.resolution_v,
        )
    except ConfigurationError as error:
        raise ConfigurationError(f"{where}: {error}" if where not in str(error) else str(error)) from None


def curve(value: Any, where: str) -> Curve:
    """From voltage to angle: the paper's curve by a_deg, b, c_deg, d, or points by volts and angles_deg."""
    section = read.section(value, where, ("a_deg", "b", "c_deg", "d", *_POINTS))
    if not set(_POINTS) & set(section):
        return ExponentialCurve(**{key: read.number(given, f"{where}.{key}") for key, given in section.items()})
    if set(section) != set(_POINTS):
        raise ConfigurationError(f"{where}: give either volts and angles_deg, or a_deg, b, c_deg and d")
    volts, angles = (read.number_list(section[key], f"{where}.{key}") for key in _POINTS)
    return SplineCurve(volts, angles)
