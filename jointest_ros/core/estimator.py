"""The one interface that every estimator has, online (`update`) and offline (`run`)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from typing import Any, ClassVar

from jointest_ros.core.frame import Estimate, FloatArray, Frame, Recording, Series
from jointest_ros.core.learned import Learned, fingerprint
from jointest_ros.core.params import Params as ParameterSet
from jointest_ros.core.robot import Robot
from jointest_ros.core.timing import Timing
from jointest_ros.core.torso import TorsoChain


class Estimator(ABC):
    """Turns frames into joint estimates.

    Class attributes:
        name: section of the configuration and stem of the node's executable.
        Params: what a user can set.
        innovation_limit: root mean square of the `innovations` over a second above which something is wrong with the
            model; 1 where all is well.
        unobservable: what it means that one of its joints is flagged UNOBSERVABLE.

    Instance attributes:
        joints: names of the positions that it estimates, the order of every tuple and column that it returns.
        unfit: why it did not start from what it learned in an earlier run, though there is something; or "".
    """

    name: ClassVar[str]
    Params: ClassVar[type[ParameterSet]]
    innovation_limit: ClassVar[float] = 5.0
    unobservable: ClassVar[str] = "axis near gravity: gyro only"
    joints: tuple[str, ...]
    unfit: str = ""

    def __init__(self, robot: Robot, params: ParameterSet | None = None, timing: Timing | None = None) -> None:
        self.robot = robot
        self.params = self.Params() if params is None else params
        self.timing = timing or Timing()

    @abstractmethod
    def update(self, frame: Frame) -> Estimate:
        """One step. Stamps must increase; the frame assembler sees to it."""

    def run(self, recording: Recording) -> Series:
        """Estimates of a stretch of frames, carrying on from the stretch before. Equals `update` in a loop."""
        joints = len(self.joints)
        parts = (map(self.update, part.frames()) for part in recording.parts())
        series = [Series.from_estimates(list(estimates), joints) for estimates in parts]
        return Series.concatenate(series or [Series.from_estimates([], joints)])

    @abstractmethod
    def reset(self) -> None:
        """Forget everything but parameters."""

    @abstractmethod
    def get_state(self) -> dict[str, Any]:
        """The whole state as plain numbers, lists and dicts (it can be written to YAML or JSON)."""

    @abstractmethod
    def set_state(self, state: dict[str, Any]) -> None:
        """Continue identically from what `get_state` returned."""

    def covariance(self) -> FloatArray:
        """Covariance of the latest joint positions, (n, n), rad^2, in the order of `joints`."""
        raise NotImplementedError

    def innovations(self) -> list[float]:
        """Innovations of the newest frame over their standard deviations; NaN: that reading was not used."""
        return []

    def innovation_joints(self) -> tuple[str, ...]:
        """The joint that each of the `innovations` belongs to."""
        return ()

    @property
    def torso(self) -> TorsoChain | None:
        """The chain whose torso it estimates, if it does."""
        return None

    def warnings(self) -> list[str]:
        """What its inputs so far tell of the sensors that a user should know, one line each."""
        return [self.unfit] if self.unfit else []

    def biases(self) -> dict[str, float]:
        """The latest sensor biases by name (rad/s for gyros, V for Hall sensors, m/s^2 for accelerometers)."""
        return {}

    def link_velocities(self) -> dict[str, float]:
        """The latest angular velocities of single links about their joint's axis, rad/s, by link; where estimated."""
        return {}

    def learned(self) -> Learned | None:
        """What it found out that holds beyond this run, for `Robot.learned`; None: nothing yet, or it never does."""
        return None

    def _learned_before(self, biases: Collection[str], zero: Mapping[str, int] | None = None) -> Learned | None:
        """What `Robot.learned` has for it, if it fits; otherwise `unfit` says so.

        It fits if it is of this robot, has just these `biases`, and zero poses of so many numbers as `zero` says.
        """
        known = self.robot.learned.get(self.name)
        if known is None:
            return None
        same_names = set(known.biases) == set(biases) and all(
            len(numbers) == (zero or {}).get(joint) for joint, numbers in known.zero.items()
        )
        if same_names and known.robot == fingerprint(self.robot):
            return known
        self.unfit = (
            f"what {self.name} learned before (calibration file, learned.{self.name}) was saved with other joints, "
            "mountings, calibrations or parameters: it starts without; save it anew by ~/save_calibration"
        )
        return None
