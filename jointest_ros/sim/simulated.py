"""What every simulated rig takes and gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from jointest_ros.core.errors import ConfigurationError, JointestError
from jointest_ros.core.frame import FloatArray, Recording
from jointest_ros.core.params import Params, param
from jointest_ros.core.robot import Robot

OptionsT = TypeVar("OptionsT", bound="SimulationOptions")


class SimulationError(JointestError):
    """A simulation was asked for that there is not: names the option, the value and what is allowed."""


@dataclass(frozen=True)
class SimulationOptions(Params):
    """What every rig lets one choose; a rig adds its `scenario` and whatever else it offers."""

    rate_hz: float = param(1000.0, "samples per second of every sensor", unit="Hz", low=100.0, high=1000.0)
    duration_s: float = param(70.0, "length of the recording", unit="s", low=0.1, high=86400.0)
    seed: int = param(0, "of every random number: the same seed gives the same recording", low=0)


@dataclass(frozen=True, slots=True)
class SimulatedRobot:
    """A recording with its ground truth; row k of every array belongs to `recording.stamps[k]`.

    Attributes:
        robot: with the true mountings, positions and noise figures of its sensors.
        recording: what the sensors gave, as in a real recording: only `robot` tells how they are mounted.
        joint_names: columns of the truth.
        truth_position, truth_velocity: (T, n), rad and rad/s, at the stamp itself.
    """

    robot: Robot
    recording: Recording
    joint_names: tuple[str, ...]
    truth_position: FloatArray
    truth_velocity: FloatArray


def read_options(kind: type[OptionsT], values: Mapping[str, Any]) -> OptionsT:
    """The options of one rig. Raises SimulationError for an unknown name or a value that is not allowed."""
    try:
        return kind.from_mapping(values)
    except ConfigurationError as error:
        raise SimulationError(str(error)) from None
