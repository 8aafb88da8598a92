"""Parameters that a user sets: declared once, with default, unit, range and description, and validated from there.

The same declaration is the YAML key, the ROS parameter and the text in the documentation.
"""

from __future__ import annotations

import dataclasses
import sys
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from jointest_ros.core.errors import ConfigurationError, did_you_mean

ParamsT = TypeVar("ParamsT", bound="Params")


def param(
    default: Any,
    description: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """Declare one field of a `Params` class: its default, what it means, its unit and what is allowed (inclusive)."""
    metadata = {"description": description, "unit": unit, "low": low, "high": high, "choices": choices}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Params:
    """Base of all parameter sets: immutable, validated when made.

    Raises:
        ConfigurationError: a value of the wrong type or outside its range; the text names parameter, value and range.
    """

    def __post_init__(self) -> None:
        types = typing.get_type_hints(type(self))
        for spec in dataclasses.fields(self):
            value = _checked(spec, types[spec.name], getattr(self, spec.name))
            object.__setattr__(self, spec.name, value)

    @classmethod
    def from_mapping(cls: type[ParamsT], values: Mapping[str, Any], where: str = "") -> ParamsT:
        """Build the parameters from `values` (YAML, ROS parameters); `where` is put before the name in an error."""
        prefix = f"{where}." if where else ""
        reject_unknown(values, [spec.name for spec in dataclasses.fields(cls)], where)
        try:
            return cls(**values)
        except ConfigurationError as error:
            raise ConfigurationError(f"{prefix}{error}") from None


def reject_unknown(values: Iterable[str], allowed: Iterable[str], where: str = "", what: str = "key") -> None:
    """Raise a `ConfigurationError` that names the first of `values` which is not among `allowed`."""
    names = list(allowed)
    for name in values:
        if name not in names:
            hint = did_you_mean(str(name).lower(), names, f"allowed: {', '.join(names)}")
            raise ConfigurationError(f"{where + '.' if where else ''}{name}: unknown {what}; {hint}")


def allowed_text(spec: dataclasses.Field[Any]) -> str:
    """What a field of a `Params` class allows, for errors, `--help` and the ROS parameter description."""
    meta = spec.metadata
    if meta["choices"]:
        return "one of " + ", ".join(meta["choices"])
    if isinstance(spec.default, bool):
        return "true or false"
    if isinstance(spec.default, str):
        return "a text"
    unit = f" {meta['unit']}" if meta["unit"] else ""
    low, high = meta["low"], meta["high"]
    if low is None and high is None:
        return f"a number{unit}"
    if high is None:
        return f"{low:g} or more{unit}"
    if low is None:
        return f"{high:g} or less{unit}"
    return f"{low:g} to {high:g}{unit}"


def _checked(spec: dataclasses.Field[Any], kind: Any, value: Any) -> Any:
    meta = spec.metadata
    if kind is bool:
        if not isinstance(value, bool):
            raise ConfigurationError(f"{spec.name}: {value!r} is not allowed; give {allowed_text(spec)}")
        return value
    if kind is str:
        if not isinstance(value, str) or (meta["choices"] and value not in meta["choices"]):
            raise ConfigurationError(f"{spec.name}: {value!r} is not allowed; give {allowed_text(spec)}")
        return value
    integer = kind is int
    right_type = isinstance(value, int if integer else (int, float)) and not isinstance(value, bool)
    if (
        not right_type
        or not abs(value) <= sys.float_info.max  # false for NaN, infinity and whole numbers that are no float
        or (meta["low"] is not None and value < meta["low"])
        or (meta["high"] is not None and value > meta["high"])
    ):
        whole = "a whole number, " if integer else ""
        raise ConfigurationError(f"{spec.name}: {value!r} is not allowed; give {whole}{allowed_text(spec)}")
    return value if integer else float(value)
