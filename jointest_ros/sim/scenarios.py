"""The rigs that can be simulated by name: what `jointest simulate` and the simulated hardware accept."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from jointest_ros.sim import exoshell, finger
from jointest_ros.sim.simulated import SimulatedRobot, SimulationOptions


@dataclass(frozen=True)
class Rig:
    """One rig.

    Attributes:
        name: as the user gives it.
        description: one line.
        scenarios: name of each of its motions -> one line about it.
        options: what can be chosen; its fields are the keyword arguments of `make`, with unit, range and description.
        make: make(scenario, *, rate_hz, duration_s, seed, **others): all optional. Raises SimulationError.
        stretches: the same recording for a set of options, in consecutive stretches, so that hours need no memory.
        estimators: section `estimators` of the configuration that suits its recordings.
    """

    name: str
    description: str
    scenarios: Mapping[str, str]
    options: type[SimulationOptions]
    make: Callable[..., SimulatedRobot]
    stretches: Callable[..., Iterator[SimulatedRobot]]
    estimators: Mapping[str, Mapping[str, Any]]


SCENARIOS: dict[str, Rig] = {
    rig.name: rig
    for rig in (
        Rig(
            "finger",
            "palm and three finger links, four IMUs, three hinges",
            {name: scenario.description for name, scenario in finger.SCENARIOS.items()},
            finger.FingerOptions,
            finger.simulate,
            finger.stretches,
            {"pcf": {"zero_at_start": True}},
        ),
        Rig(
            "exoshell",
            "five links, four hinges, a gyro on each link and two mirrored Hall sensors on each joint",
            {name: scenario.description for name, scenario in exoshell.SCENARIOS.items()},
            exoshell.ExoshellOptions,
            exoshell.simulate,
            exoshell.stretches,
            {"gyro": {}, "hall": {}, "kf": {}, "kckf": {}},
        ),
    )
}
