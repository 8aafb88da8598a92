"""The rig `finger`: a palm and three links, four IMUs, three hinges about x.

Scenarios of the specification of the passive complementary filter on IMU pairs (Santaera et al. 2015), section 3. After
the zero pose the joints follow q_i = s A_i (1 - cos 2 pi f_i tau) / 2 and, where the palm moves, its orientation in the
world is Rz(60 sin .10 Hz) Ry(30 sin .17 Hz) Rx(30 sin .13 Hz) deg; both set in with a smoothstep s.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.params import param
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.sim import hand
from jointest_ros.sim.hand import PALM_ONSET_S, PALM_TURNS, HandOptions, HandRecording
from jointest_ros.sim.imu import GRAVITY
from jointest_ros.sim.motion import LinkMotion, Signal, constant, raised_cosine, sine, smoothstep, tree_motion
from jointest_ros.sim.simulated import read_options

LINKS = ("palm", "proximal", "middle", "distal")  # each bears one IMU, named like its link
JOINTS = ("finger_mcp", "finger_pip", "finger_dip")
AXIS: Vec3 = (1.0, 0.0, 0.0)
LENGTHS = (0.050, 0.040, 0.025, 0.020)  # m, along y; of the palm: from its reference point to the first joint

JOINT_AMPLITUDES_DEG = (70.0, 60.0, 40.0)
JOINT_FREQUENCIES_HZ = (0.35, 0.35, 0.5)
JOINT_ONSET_S = 2.0
SHAKING_PEAK = 0.3 * GRAVITY  # m/s^2
SHAKING_HZ = (1.5, 1.9, 2.3)  # world x, y, z


@dataclass(frozen=True)
class FingerScenario:
    """What moves: the joints at `tempo` times their frequencies (0: not at all), the palm, and the whole hand."""

    description: str
    tempo: float = 1.0
    palm: bool = False
    shaking: bool = False


SCENARIOS = {
    "PA": FingerScenario("joints move, palm still"),
    "PC": FingerScenario("joints move, palm turns about all axes", palm=True),
    "PD": FingerScenario("as PC, and the hand is shaken by 0.3 g on every axis", palm=True, shaking=True),
    "PE": FingerScenario("as PA, three times as fast", tempo=3.0),
    "still": FingerScenario("nothing moves: the noise floor", tempo=0.0),
}


@dataclass(frozen=True)
class FingerOptions(HandOptions):
    """What can be chosen of a finger recording."""

    scenario: str = param("PA", "which motion", choices=tuple(SCENARIOS))
    elevation_deg: float = param(0.0, "elevation of the hinge axes above horizontal", unit="deg", low=0.0, high=90.0)


def simulate(scenario: str = "PA", **options: Any) -> HandRecording:
    """A whole recording, its first stamp 0; `options` are the fields of `FingerOptions`.

    Raises:
        SimulationError: an unknown scenario or option, or a value that is not allowed.
    """
    chosen = read_options(FingerOptions, {"scenario": scenario, **options})
    return next(stretches(chosen, chosen.duration_s))


def chunks(scenario: str = "PA", *, chunk_s: float = 10.0, **options: Any) -> Iterator[HandRecording]:
    """The recording of `simulate` in consecutive stretches of `chunk_s` seconds, in the memory of one of them.

    Raises:
        SimulationError: an unknown scenario or option, or a value that is not allowed.
    """
    return stretches(read_options(FingerOptions, {"scenario": scenario, **options}), chunk_s)


def stretches(options: FingerOptions, chunk_s: float = 10.0) -> Iterator[HandRecording]:
    """`chunks` for options that are made already."""
    robot = finger(options.lever_arm)
    return hand.stretches(options, robot, partial(_motion, options, robot), chunk_s)


def finger(lever_arm: bool = True) -> Robot:
    """The robot, its sensors ideally mounted; without lever arm every length is zero."""
    lengths = LENGTHS if lever_arm else (0.0,) * len(LENGTHS)
    joints = tuple(
        Joint(name, LINKS[i], LINKS[i + 1], (AXIS,), origin=(0.0, lengths[i], 0.0)) for i, name in enumerate(JOINTS)
    )
    middles = (0.0, *(0.5 * length for length in lengths[1:]))
    sensors = tuple(Sensor(link, link, (0.0, y, 0.0)) for link, y in zip(LINKS, middles, strict=True))
    return Robot(LINKS, joints, sensors, name="finger")


def _motion(
    options: FingerOptions, robot: Robot, time: FloatArray
) -> tuple[Mapping[str, Signal], Mapping[str, LinkMotion]]:
    """Joint angles (rad) and the motion of palm and links at `time` (n,), s."""
    scenario = SCENARIOS[options.scenario]
    tau = time - options.zero_pose_s
    shaking = np.zeros((len(time), 3))
    if scenario.shaking:
        onset = smoothstep(tau, PALM_ONSET_S)
        shaking = SHAKING_PEAK * np.column_stack([(onset * sine(tau, f)).value for f in SHAKING_HZ])
    palm = LinkMotion.translating(shaking)
    if scenario.palm:
        for (axis, *_), angle in zip(PALM_TURNS, hand.palm_turns(tau), strict=True):
            palm = palm.child(axis, angle)
    # about -y: raises the x axis
    palm = palm.child((0.0, -1.0, 0.0), constant(time, math.radians(options.elevation_deg)))
    onset = smoothstep(tau, JOINT_ONSET_S)
    waves = [raised_cosine(tau, scenario.tempo * frequency_hz) for frequency_hz in JOINT_FREQUENCIES_HZ]
    angles = {
        name: onset * wave * math.radians(amplitude)
        for name, wave, amplitude in zip(JOINTS, waves, JOINT_AMPLITUDES_DEG, strict=True)
    }
    return angles, tree_motion(robot, palm, angles)
