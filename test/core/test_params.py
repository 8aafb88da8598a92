"""Parameters: what is refused, with an error that names parameter, value and what is allowed."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError, dataclass, fields

import pytest

from jointest_ros.core.errors import ConfigurationError, JointestError
from jointest_ros.core.params import Params, allowed_text, param
from jointest_ros.core.timing import Timing


@dataclass(frozen=True)
class Example(Params):
    gain: float = param(1.0, "a gain", unit="1/s", low=0.0, high=100.0)
    offset: float = param(0.0, "any number", unit="m")
    floor: float = param(0.5, "has a lower end", unit="deg", low=0.1)
    ceiling: float = param(-1.0, "has an upper end", high=0.0)
    count: int = param(3, "a whole number", low=1, high=9)
    mode: str = param("fast", "one of some", choices=("fast", "slow"))
    label: str = param("", "any text")
    active: bool = param(True, "a switch")


@pytest.mark.parametrize(
    ("values", "parts"),
    [
        ({"gain": -0.1}, ("gain", "-0.1", "0 to 100 1/s")),
        ({"gain": 101}, ("gain", "101", "0 to 100 1/s")),
        ({"gain": math.nan}, ("gain", "nan", "0 to 100 1/s")),
        ({"gain": "1.0"}, ("gain", "'1.0'", "0 to 100 1/s")),
        ({"gain": True}, ("gain", "True", "0 to 100 1/s")),
        ({"gain": None}, ("gain", "None", "0 to 100 1/s")),
        ({"gain": [1.0]}, ("gain", "[1.0]", "0 to 100 1/s")),
        ({"offset": math.inf}, ("offset", "inf", "a number m")),
        ({"offset": 10**400}, ("offset", "a number m")),
        ({"floor": 0.0}, ("floor", "0.0", "0.1 or more deg")),
        ({"ceiling": 1.0}, ("ceiling", "1.0", "0 or less")),
        ({"count": 2.0}, ("count", "2.0", "whole number", "1 to 9")),
        ({"count": 10}, ("count", "10", "whole number", "1 to 9")),
        ({"count": False}, ("count", "False", "whole number", "1 to 9")),
        ({"mode": "slwo"}, ("mode", "'slwo'", "fast, slow")),
        ({"mode": 1}, ("mode", "1", "fast, slow")),
        ({"label": 3}, ("label", "3", "text")),
        ({"active": "yes"}, ("active", "'yes'", "true or false")),
        ({"active": 1}, ("active", "1", "true or false")),
        ({"gian": 1.0}, ("gian", "unknown", "'gain'?")),
        ({"zzz": 1.0}, ("zzz", "unknown", "gain, offset, floor")),
        ({3: 1.0}, ("3", "unknown")),
    ],
)
def test_error_names_parameter_value_and_what_is_allowed(values: dict[str, object], parts: tuple[str, ...]) -> None:
    with pytest.raises(ConfigurationError) as caught:
        Example.from_mapping(values, "estimators.example")
    message = str(caught.value)
    assert message.startswith("estimators.example.") and "\n" not in message
    for part in parts:
        assert part in message
    assert isinstance(caught.value, JointestError)


def test_bounds_belong_to_what_is_allowed() -> None:
    assert Example(gain=0.0, floor=0.1, ceiling=0.0, count=1).gain == 0.0
    assert Example(gain=100.0, count=9).count == 9


def test_whole_numbers_become_floats_where_a_float_is_meant() -> None:
    chosen = Example.from_mapping({"gain": 2, "count": 2})
    assert (type(chosen.gain), type(chosen.count)) == (float, int)


def test_defaults_and_partial_mappings() -> None:
    assert Example.from_mapping({}) == Example()
    assert Example.from_mapping({"mode": "slow"}) == Example(mode="slow")


def test_parameters_do_not_change() -> None:
    with pytest.raises(FrozenInstanceError):
        Example().gain = 2.0  # type: ignore[misc]


def test_text_of_what_is_allowed() -> None:
    found = {spec.name: allowed_text(spec) for spec in fields(Example)}
    assert found["gain"] == "0 to 100 1/s"
    assert found["mode"] == "one of fast, slow"
    assert found["label"] == "a text"
    assert found["active"] == "true or false"


@pytest.mark.parametrize(
    ("values", "parts"),
    [
        ({"sync_tolerance": -1e-3}, ("timing.sync_tolerance", "-0.001", "0 to 1 s")),
        ({"max_gap": 0.0}, ("timing.max_gap", "0.0", "0.001 to 60 s")),
        ({"hall_per_frame": "no"}, ("timing.hall_per_frame", "'no'", "true or false")),
        ({"stale": 1.0}, ("timing.stale", "'stale_after'?")),
    ],
)
def test_timing(values: dict[str, object], parts: tuple[str, ...]) -> None:
    with pytest.raises(ConfigurationError) as caught:
        Timing.from_mapping(values, "timing")
    for part in parts:
        assert part in str(caught.value)
