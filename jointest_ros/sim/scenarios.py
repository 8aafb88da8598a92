"""The rigs that can be simulated by name: what `jointest simulate` and the simulated hardware accept."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from jointest_ros.sim import crank_rig, exoshell, finger, gripper, slider_crank, two_link_arm
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
            {"pcf": {"zero_at_start": True, "lever_arms": True}},
        ),
        Rig(
            "gripper",
            "palm and two soft fingers of three links, seven IMUs, nine angles, roll-articular joints",
            {name: scenario.description for name, scenario in gripper.SCENARIOS.items()},
            gripper.GripperOptions,
            gripper.simulate,
            gripper.stretches,
            {"pcf": {"zero_at_start": True, "lever_arms": True}},
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
        Rig(
            "two_link_arm",
            "two links and a hinge in a vertical plane, two accelerometers on each link",
            {name: scenario.description for name, scenario in two_link_arm.SCENARIOS.items()},
            two_link_arm.ArmOptions,
            two_link_arm.simulate,
            two_link_arm.stretches,
            {"accel_analytical": {}, "accel_ekf": {"snap_density": 1e6}, "accel_ukf": {}},
        ),
        Rig(
            "slider_crank",
            "crank and connecting rod, two accelerometers on each",
            {name: scenario.description for name, scenario in slider_crank.SCENARIOS.items()},
            crank_rig.CrankOptions,
            crank_rig.simulate,
            crank_rig.stretches,
            {"accel_analytical": {}, "accel_ekf": {"bias": False}, "accel_ukf": {}},
        ),
    )
}
