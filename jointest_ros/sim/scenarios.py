"""What can be simulated: rigs by name, and one's own robot, by its configuration.

What `jointest simulate`, the simulated hardware and the launch files accept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from jointest_ros.core.robot import Robot
from jointest_ros.sim import crank_rig, exoshell, finger, gripper, own_robot, slider_crank, two_link_arm
from jointest_ros.sim.simulated import SimulatedRobot, SimulationOptions


@dataclass(frozen=True)
class Source:
    """Something that can be simulated.

    Attributes:
        name: as the user gives it.
        description: one line.
        options: what can be chosen, with unit, range and description.
        stretches: the recording for a set of options, in consecutive stretches, so that hours need no memory. Raises
            SimulationError.
    """

    name: str
    description: str
    options: type[SimulationOptions]
    stretches: Callable[..., Iterator[SimulatedRobot]]


@dataclass(frozen=True)
class Rig(Source):
    """One rig, whose robot is its own.

    Attributes:
        scenarios: name of each of its motions -> one line about it.
        make: make(scenario, *, rate_hz, duration_s, seed, **others): all optional, the whole recording at once; the
            keyword arguments are the fields of `options`. Raises SimulationError.
        estimators: section `estimators` of the configuration that suits its recordings.
    """

    scenarios: Mapping[str, str]
    make: Callable[..., SimulatedRobot]
    estimators: Mapping[str, Mapping[str, Any]]


SCENARIOS: dict[str, Rig] = {
    rig.name: rig
    for rig in (
        Rig(
            "finger",
            "palm and three finger links, four IMUs, three hinges",
            finger.FingerOptions,
            finger.stretches,
            {name: scenario.description for name, scenario in finger.SCENARIOS.items()},
            finger.simulate,
            {"pcf": {"zero_at_start": True, "lever_arms": True}},
        ),
        Rig(
            "gripper",
            "palm and two soft fingers of three links, seven IMUs, nine angles, roll-articular joints",
            gripper.GripperOptions,
            gripper.stretches,
            {name: scenario.description for name, scenario in gripper.SCENARIOS.items()},
            gripper.simulate,
            {"pcf": {"zero_at_start": True, "lever_arms": True}},
        ),
        Rig(
            "exoshell",
            "five links, four hinges, a gyro on each link and two mirrored Hall sensors on each joint",
            exoshell.ExoshellOptions,
            exoshell.stretches,
            {name: scenario.description for name, scenario in exoshell.SCENARIOS.items()},
            exoshell.simulate,
            {"gyro": {}, "hall": {}, "kf": {}, "kckf": {}},
        ),
        Rig(
            "two_link_arm",
            "two links and a hinge in a vertical plane, two accelerometers on each link",
            two_link_arm.ArmOptions,
            two_link_arm.stretches,
            {name: scenario.description for name, scenario in two_link_arm.SCENARIOS.items()},
            two_link_arm.simulate,
            {"accel_analytical": {}, "accel_ekf": {"snap_density": 1e6}, "accel_ukf": {}},
        ),
        Rig(
            "slider_crank",
            "crank and connecting rod, two accelerometers on each",
            crank_rig.CrankOptions,
            crank_rig.stretches,
            {name: scenario.description for name, scenario in slider_crank.SCENARIOS.items()},
            crank_rig.simulate,
            {"accel_analytical": {}, "accel_ekf": {"bias": False}, "accel_ukf": {}},
        ),
    )
}

OWN = "config"  # the name of the source that is one's own robot
OWN_DESCRIPTION = "your own robot, any configuration: every joint swings within its limits, the root link turns"
OWN_OPTIONS = own_robot.OwnOptions


def own(robot: Robot) -> Source:
    """One's own robot."""
    return Source(OWN, OWN_DESCRIPTION, OWN_OPTIONS, partial(own_robot.stretches, robot))
