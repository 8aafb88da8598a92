"""The rig `gripper`: a palm and two fingers of the Pisa/IIT SoftHand, seven IMUs, nine angles.

The gripper of Santaera et al. 2015, section V: each finger has three roll-articular (Hillberry) joints and three links;
the palm turns freely on the world (yaw, pitch, roll). Its dimensions are those of the specification, section 3, Disk.
Palm frame: z along the straight fingers, which is up when all angles are zero, x along the axes of their joints. The
left finger stands at +y, the right one at -y; positive angles close them. They are a finger's width apart along x, and
so pass each other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.params import param
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.sim import hand
from jointest_ros.sim.hand import PALM_TURNS, HandOptions, HandRecording
from jointest_ros.sim.motion import LinkMotion, Signal, constant, raised_cosine, smoothstep, tree_motion
from jointest_ros.sim.simulated import read_options

WORLD, PALM = "world", "palm"
PALM_ANGLES = ("palm_z", "palm_y", "palm_x")  # yaw, pitch, roll
SIDES: dict[str, float] = {"left": 1.0, "right": -1.0}  # side of the palm along y
JOINTS, LINKS = ("mcp", "pip", "dip"), ("proximal", "middle", "distal")
LIMITS = (math.radians(-20.0), math.radians(120.0))  # the SoftHand's joints turn by less than 120 deg

HALF_WIDTH = 0.045  # m, from the middle of the palm to the first joints
STAGGER = 0.010  # m, of the fingers along x, each to its side
PHALANGES = (0.035, 0.025, 0.025)  # m
ROLL_RADIUS = 0.0065  # m
HALF_THICKNESS = 0.008  # m, of the phalanges
PAD = 0.020  # m, height of the palm's pad over the first joints
# radius of a disk, m -> the joint angles, deg, at which both fingers hold it
DISKS: dict[float, Vec3] = {
    0.0245: (10.0, 0.4, 42.0),
    0.0325: (0.0, 16.8, 45.7),
    0.0415: (-10.0, 25.3, 38.4),
}

CLOSING_DEG, CLOSING_HZ = (45.0, 60.0, 40.0), 0.4
HALF_CLOSED_DEG = (20.0, 30.0, 20.0)
PUSHED_DEG = (-20.0, 12.0, 8.0)  # the left proximal link gives way, the tendon closes the others
ONSET_S = 2.0

Angles = Callable[[FloatArray], Mapping[str, Signal]]  # tau (n,) s -> joint angle, rad, by coordinate of the fingers


def _closing(tau: FloatArray) -> Mapping[str, Signal]:
    wave = smoothstep(tau, ONSET_S) * raised_cosine(tau, CLOSING_HZ)
    return {f"{side}_{joint}": wave * a for side in SIDES for joint, a in _radians(CLOSING_DEG)}


def _push(tau: FloatArray) -> Mapping[str, Signal]:
    held, pushed = smoothstep(tau, ONSET_S), _pulses(tau - ONSET_S, 3.0, rise=0.25, hold=0.75)
    angles = {f"{side}_{joint}": held * a for side in SIDES for joint, a in _radians(HALF_CLOSED_DEG)}
    return angles | {f"left_{joint}": angles[f"left_{joint}"] + pushed * a for joint, a in _radians(PUSHED_DEG)}


def _grasp(radius: float, tau: FloatArray) -> Mapping[str, Signal]:
    held = _pulses(tau, 10.0, rise=1.5, hold=4.0)
    return {f"{side}_{joint}": held * a for side in SIDES for joint, a in _radians(DISKS[radius])}


def _rest(tau: FloatArray) -> Mapping[str, Signal]:
    return {f"{side}_{joint}": constant(tau, 0.0) for side in SIDES for joint in JOINTS}


def _radians(degrees: Vec3) -> list[tuple[str, float]]:
    return [(joint, math.radians(value)) for joint, value in zip(JOINTS, degrees, strict=True)]


def _pulses(tau: FloatArray, period: float, rise: float, hold: float) -> Signal:
    """From tau = 0 on, in every period: up to 1 in `rise` s, there for `hold` s, and back in `rise` s."""
    since = np.where(tau > 0.0, tau % period, 0.0)
    return smoothstep(since, rise) + smoothstep(since - rise - hold, rise) * -1.0


@dataclass(frozen=True)
class GripperScenario:
    """What moves: the fingers by `angles`, and the palm or not."""

    description: str
    angles: Angles
    palm: bool = False


SCENARIOS = {
    "rest": GripperScenario("nothing moves: the noise floor", _rest),
    "closing": GripperScenario("the fingers close and open in free air, palm still", _closing),
    "push": GripperScenario("half closed; a link of the left finger is pushed again and again", _push),
    "palm": GripperScenario("as closing, and the palm turns about all axes", _closing, palm=True),
    **{
        f"grasp_{size}": GripperScenario(
            f"a disk of {radius * 1e3:g} mm is grasped, held and let go", partial(_grasp, radius)
        )
        for size, radius in zip(("small", "medium", "large"), DISKS, strict=True)
    },
}


@dataclass(frozen=True)
class GripperOptions(HandOptions):
    """What can be chosen of a gripper recording."""

    scenario: str = param("closing", "which motion", choices=tuple(SCENARIOS))


def simulate(scenario: str = "closing", **options: Any) -> HandRecording:
    """A whole recording, its first stamp 0; `options` are the fields of `GripperOptions`.

    Raises:
        SimulationError: an unknown scenario or option, or a value that is not allowed.
    """
    chosen = read_options(GripperOptions, {"scenario": scenario, **options})
    return next(stretches(chosen, chosen.duration_s))


def stretches(options: GripperOptions, chunk_s: float = 10.0) -> Iterator[HandRecording]:
    """The recording of `simulate` in consecutive stretches of `chunk_s` seconds, in the memory of one of them."""
    robot = gripper(options.lever_arm)
    return hand.stretches(options, robot, partial(_motion, options, robot), chunk_s)


def gripper(lever_arm: bool = True) -> Robot:
    """The robot, its sensors ideally mounted; without lever arm every length is zero."""
    scale = 1.0 if lever_arm else 0.0
    joints = [Joint(PALM, WORLD, PALM, tuple(axis for axis, *_ in PALM_TURNS))]
    sensors = [Sensor(PALM, PALM)]
    for side, sign in SIDES.items():
        parent, origin = PALM, (STAGGER * scale * sign, HALF_WIDTH * scale * sign, 0.0)
        for joint, link, length in zip(JOINTS, LINKS, PHALANGES, strict=True):
            child = f"{side}_{link}"
            roll = (0.0, 0.0, 2.0 * ROLL_RADIUS * scale)
            axis = (sign, 0.0, 0.0)
            joints.append(Joint(f"{side}_{joint}", parent, child, (axis,), (LIMITS,), origin=origin, roll_link=roll))
            sensors.append(Sensor(child, child, (0.0, 0.0, 0.5 * length * scale)))
            parent, origin = child, (0.0, 0.0, length * scale)
    links = (WORLD, *(joint.child for joint in joints))
    return Robot(links, tuple(joints), tuple(sensors), name="gripper", world=WORLD)


def _motion(
    options: GripperOptions, robot: Robot, time: FloatArray
) -> tuple[Mapping[str, Signal], Mapping[str, LinkMotion]]:
    """All angles (rad) and the motion of all links at `time` (n,), s."""
    scenario = SCENARIOS[options.scenario]
    tau = time - options.zero_pose_s
    palm = hand.palm_turns(tau) if scenario.palm else [constant(time, 0.0)] * len(PALM_ANGLES)
    angles = dict(zip(PALM_ANGLES, palm, strict=True)) | dict(scenario.angles(tau))
    return angles, tree_motion(robot, LinkMotion.translating(np.zeros((len(time), 3))), angles)
