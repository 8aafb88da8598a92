"""ROS parameters from the same declarations that the configuration is read with."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.params import Params, allowed_text

ParamsT = TypeVar("ParamsT", bound=Params)


def declare(node: Node, kind: type[ParamsT], defaults: ParamsT | None = None) -> ParamsT:
    """Declare every field of `kind` as a read-only parameter; return what is in force.

    Types are left open so that `-p kp:=1` is as good as `1.0`; the `Params` class checks them.

    Raises:
        ConfigurationError: a value that is not allowed.
    """
    values: dict[str, Any] = {}
    for spec in dataclasses.fields(kind):
        unit = f" [{spec.metadata['unit']}]" if spec.metadata["unit"] else ""
        descriptor = ParameterDescriptor(
            description=f"{spec.metadata['description']}{unit}",
            additional_constraints=allowed_text(spec),
            read_only=True,
            dynamic_typing=True,
        )
        default = getattr(defaults, spec.name) if defaults is not None else spec.default
        values[spec.name] = node.declare_parameter(spec.name, default, descriptor).value
    return kind.from_mapping(values)


def overrides(values: dict[str, Any]) -> list[Parameter]:
    """Keyword arguments of a node as parameter overrides.

    Raises:
        ConfigurationError: a value of a type that no parameter can have.
    """
    parameters = []
    for name, value in values.items():
        try:
            parameters.append(Parameter(name, value=value))
        except (TypeError, AssertionError):
            raise ConfigurationError(f"{name}: {value!r} is not allowed; give a number, a text or true/false") from None
    return parameters
