"""ROS parameters from the same declarations that the configuration is read with."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.parameter import Parameter

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.params import Params, allowed_text, param, reject_unknown

ParamsT = TypeVar("ParamsT", bound=Params)


@dataclass(frozen=True)
class ProcessParams(Params):
    """What every node has that is an executable of its own."""

    executor: str = param(
        "events", "events: EventsExecutor; single: SingleThreadedExecutor", choices=("events", "single")
    )


def declare(node: Node, kind: type[ParamsT], defaults: ParamsT | None = None, tunable: Collection[str] = ()) -> ParamsT:
    """Declare every field of `kind` as a parameter, read-only unless it is `tunable`; return what is in force.

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
            read_only=spec.name not in tunable,
            dynamic_typing=True,
        )
        default = getattr(defaults, spec.name) if defaults is not None else spec.default
        values[spec.name] = node.declare_parameter(spec.name, default, descriptor).value
    return kind.from_mapping(values)


def tunable(kind: type[Params]) -> frozenset[str]:
    """The fields that can change while an estimator runs: numbers with a fraction. The others shape its state."""
    return frozenset(spec.name for spec in dataclasses.fields(kind) if isinstance(spec.default, float))


def follow(node: Node, params: ParamsT, prepare: Callable[[ParamsT], Callable[[], None]]) -> None:
    """Let the tunable fields of `params` be set while the node runs.

    `prepare` is called with the new parameters and gives what is to be done once they are in force; it refuses by a
    ConfigurationError, whose text is the reason that the caller of the service gets.
    """
    names, pending = tunable(type(params)), [lambda: None]

    def on_set(changes: list[Parameter]) -> SetParametersResult:
        changed = {one.name: one.value for one in changes if one.name in names}
        pending[0] = lambda: None
        if not changed:
            return SetParametersResult(successful=True)
        try:
            wanted = type(params).from_mapping({**dataclasses.asdict(params), **changed})
            apply = prepare(wanted)
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))

        def confirmed() -> None:
            nonlocal params
            params = wanted
            apply()

        pending[0] = confirmed
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)
    node.add_post_set_parameters_callback(lambda _: pending[0]())


def check_names(node: Node, *kinds: type[Params]) -> None:
    """Refuse a parameter that was given to the node and that none of `kinds` has: a misspelt one, which ROS ignores.

    Raises:
        ConfigurationError: names it, and what it may have been meant for.
    """
    known = [spec.name for kind in kinds for spec in dataclasses.fields(kind)]
    given = node._parameter_overrides  # there is no public way to ask for them
    reject_unknown(given, dict.fromkeys([*known, *node.get_parameters_by_prefix("")]), what="parameter")


def overrides(values: dict[str, Any]) -> list[Parameter]:
    """Keyword arguments of a node as parameter overrides; a path is a text.

    Raises:
        ConfigurationError: a value of a type that no parameter can have.
    """
    parameters = []
    for name, value in values.items():
        try:
            parameters.append(Parameter(name, value=str(value) if isinstance(value, Path) else value))
        except (TypeError, AssertionError):
            raise ConfigurationError(f"{name}: {value!r} is not allowed; give a number, a text or true/false") from None
    return parameters


@contextmanager
def construction(node: Node) -> Iterator[None]:
    """Around all that a node's constructor does: where it fails, the node is destroyed.

    Raises:
        ConfigurationError: besides those from within: a topic has a name that ROS does not allow.
    """
    try:
        yield
    except NameValidationException as error:
        node.destroy_node()
        reason, name, *_ = str(error).splitlines()  # and in a third line where in the name
        raise ConfigurationError(f"{name.strip()}: {reason.rstrip(':')}") from None
    except Exception:
        node.destroy_node()
        raise
