"""An estimator with settings on a simulated chain, made ready for `cost.measure`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from jointest_ros.benchmark.chain import RATE_HZ, STILL_S, chain
from jointest_ros.benchmark.cost import Task
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Frame, Recording, Vec3
from jointest_ros.core.robot import Robot

SKIP = round((STILL_S + 0.3) * RATE_HZ)  # frames before the first round: the still start, and the first movement


@dataclass(frozen=True)
class Case:
    """What is measured.

    Attributes:
        label: as it stands in the table.
        estimator: by its name in the catalogue.
        axes: of each joint of the chain.
        settings: of the estimator, where they are not the default.
        accelerometers: two on a link in place of IMUs and Hall sensors.
        budget_us: that a step may cost, if there is a budget.
    """

    label: str
    estimator: str
    axes: Sequence[tuple[Vec3, ...]]
    settings: Mapping[str, Any] = field(default_factory=dict)
    accelerometers: bool = False
    budget_us: float | None = None

    def make(self, robot: Robot) -> Estimator:
        """A new estimator."""
        kind = ESTIMATORS[self.estimator]
        return kind(robot, kind.Params.from_mapping(self.settings))


@dataclass(frozen=True)
class Rig:
    """A robot with its recording: a warm-up, then a part for every round, by arrays and as frames."""

    robot: Robot
    parts: list[Recording]
    frames: list[list[Frame]]

    def updates(self, estimator: Estimator) -> Task:
        """Steps by `update`, the state carried on from round to round."""
        warm_up, *rounds = self.frames
        for frame in warm_up:
            estimator.update(frame)

        def task(number: int) -> int:
            update = estimator.update
            for frame in rounds[number]:
                update(frame)
            return len(rounds[number])

        return task

    def arrays(self, estimator: Estimator) -> Task:
        """The same by `run`."""
        warm_up, *rounds = self.parts
        estimator.run(warm_up)

        def task(number: int) -> int:
            estimator.run(rounds[number])
            return len(rounds[number])

        return task


class Rigs:
    """The rigs of some cases, each simulated once: `rounds` parts of `size` frames, and one to warm up with."""

    def __init__(self, rounds: int, size: int) -> None:
        self._starts = range(SKIP, SKIP + (rounds + 1) * size, size)
        self._made: dict[Any, Rig] = {}

    def of(self, case: Case) -> Rig:
        """The rig of a case."""
        key = tuple(case.axes), case.accelerometers
        if key not in self._made:
            robot, recording = chain(case.axes, self._starts.stop, case.accelerometers)
            step = self._starts.step
            parts = [recording.part(0, SKIP), *(recording.part(start, start + step) for start in self._starts)]
            self._made[key] = Rig(robot, parts, [list(part.frames()) for part in parts])
        return self._made[key]
