"""The rig `two_link_arm`: two links of 30 cm, a hinge, two accelerometers on each (Woods & Vikas, section V).

The accelerometers are 4.75 and 27.5 cm from the hinge (Fig. 8). The arm moves in a vertical plane; at the zero pose
both links lie level in a row, x along them and y up. link_a begins at the clamp, link_b at the hinge.

Of the four canonical movements the text of the paper tells the character only: "slow and continuous back-and-forth",
"fast sinusoidal", "slow with pauses", "fast, sudden with pauses". Assumed here: all between 0 and 90 deg; the first
two at 0.2 and 1 Hz; ramps of 45 deg in 2 s and sudden moves of 90 deg in 0.4 s, both of minimum jerk. They begin at
rest and have continuous accelerations.

The calibration poses turn the arm as a whole: the paper's seven have x or y of the links along gravity. Which of the
four directions came twice is not in its text; here the arm is turned there and back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray, Recording, Vec3
from jointest_ros.core.params import param
from jointest_ros.core.robot import Joint, Robot
from jointest_ros.sim.accelerometers import Accelerometers, AccelOptions, accelerometer
from jointest_ros.sim.motion import LinkMotion, Signal, constant, minimum_jerk, raised_cosine, sine, tree_motion
from jointest_ros.sim.simulated import SimulatedRobot, SimulationError, SimulationOptions, read_options

LINKS = ("link_a", "link_b")
JOINT = "elbow"
LENGTH = 0.30  # m
SENSORS = {"a1": (0, 0.2525), "a2": (0, 0.025), "b1": (1, 0.0475), "b2": (1, 0.275)}  # link, x in its frame, m
AXIS: Vec3 = (0.0, 0.0, 1.0)
_ACROSS: Vec3 = (1.0, 0.0, 0.0)

STILL_S = 1.0  # s at the start of the periodic movements
ONSET_S = 2.0  # s until they have their full amplitude
SWING_DEG, SWING_HZ = 30.0, 0.3  # of a swinging base

_Course = Callable[[FloatArray], Signal]


def _rest(time: FloatArray) -> Signal:
    return constant(time, 0.0)


def _sway(wave: _Course, amplitude_deg: float) -> _Course:
    """A wave that sets in smoothly."""

    def course(time: FloatArray) -> Signal:
        moving = time - STILL_S
        return minimum_jerk(moving, ONSET_S) * wave(moving) * math.radians(amplitude_deg)

    return course


def _steps(stops_deg: Sequence[float], move_s: float, pause_s: float) -> _Course:
    """A pause at each of the stops, moves of minimum jerk between them, and from the beginning again."""
    stops = np.radians(stops_deg)

    def course(time: FloatArray) -> Signal:
        number = np.floor(time / (pause_s + move_s)).astype(int)
        start, end = stops[number % len(stops)], stops[(number + 1) % len(stops)]
        move = minimum_jerk(time - number * (pause_s + move_s) - pause_s, move_s)
        change = end - start
        return Signal(start + change * move.value, change * move.rate, change * move.acceleration)

    return course


@dataclass(frozen=True)
class ArmScenario:
    """One movement: angle of the joint, and turn of the whole arm, first about the horizontal x, then about z."""

    description: str
    joint: _Course = _rest
    tilt: _Course = _rest
    turn: _Course = _rest


_POSE_S, _TURN_S = 2.5, 1.5  # s

SCENARIOS = {
    "slow_periodic": ArmScenario("back and forth at 0.2 Hz", _sway(lambda t: raised_cosine(t, 0.2), 90.0)),
    "fast_periodic": ArmScenario("back and forth at 1 Hz", _sway(lambda t: raised_cosine(t, 1.0), 90.0)),
    "ramp": ArmScenario("slow moves of 45 deg with pauses", _steps((0.0, 45.0, 90.0, 45.0), 2.0, 1.5)),
    "impulse": ArmScenario("sudden moves of 90 deg with pauses", _steps((0.0, 90.0), 0.4, 1.6)),
    "poses": ArmScenario(
        "calibration: seven still poses, x or y of both links along gravity (28 s)",
        turn=_steps((0.0, 90.0, 180.0, 270.0, 180.0, 90.0, 0.0), _TURN_S, _POSE_S),
    ),
    "poses_xyz": ArmScenario(
        "calibration: seven still poses, x, y and z of both links along gravity (28 s)",
        tilt=_steps((0.0, 0.0, 0.0, 0.0, 90.0, -90.0, 0.0), _TURN_S, _POSE_S),
        turn=_steps((0.0, 90.0, 180.0, 270.0, 270.0, 270.0, 0.0), _TURN_S, _POSE_S),
    ),
}


@dataclass(frozen=True)
class ArmOptions(AccelOptions, SimulationOptions):
    """What can be chosen of a recording of the arm."""

    rate_hz: float = param(100.0, "samples per second of every sensor", unit="Hz", low=100.0, high=1000.0)
    duration_s: float = param(30.0, "length of the recording", unit="s", low=0.1, high=86400.0)
    scenario: str = param("slow_periodic", "which movement", choices=tuple(SCENARIOS))
    base: str = param(
        "clamped",
        f"link_a is clamped, as in the paper; or it swings by +-{SWING_DEG:g} deg at {SWING_HZ:g} Hz about its end",
        choices=("clamped", "swinging"),
    )


def simulate(scenario: str = "slow_periodic", **options: Any) -> SimulatedRobot:
    """A whole recording, its first stamp 0; `options` are the fields of `ArmOptions`.

    Raises:
        SimulationError: an unknown scenario or option, or a value that is not allowed.
    """
    chosen = read_options(ArmOptions, {"scenario": scenario, **options})
    return next(stretches(chosen, chosen.duration_s))


def stretches(options: ArmOptions, chunk_s: float = 10.0) -> Iterator[SimulatedRobot]:
    """The recording of `simulate` in consecutive stretches of `chunk_s` seconds, in the memory of one of them.

    Raises:
        SimulationError: a swinging base in a scenario that turns the whole arm.
    """
    scenario, swinging = SCENARIOS[options.scenario], options.base == "swinging"
    if swinging and scenario.turn is not _rest:
        raise SimulationError(f"base: 'swinging' is not allowed with scenario {options.scenario}; give clamped")
    turn = _sway(lambda time: sine(time, SWING_HZ), SWING_DEG) if swinging else scenario.turn
    robot = arm(options)
    sensors = Accelerometers(robot, options, options.rate_hz, options.seed)
    samples, size = round(options.duration_s * options.rate_hz), max(1, round(chunk_s * options.rate_hz))
    for start in range(0, samples, size):
        stamps = np.round(np.arange(start, min(start + size, samples)) * (1e9 / options.rate_hz)).astype(np.int64)
        time: FloatArray = stamps.astype(np.float64) * 1e-9
        joint = scenario.joint(time)
        level = LinkMotion.translating(np.zeros((len(time), 3))).child(_ACROSS, constant(time, math.pi / 2.0))
        link_a = level.child(_ACROSS, scenario.tilt(time)).child(AXIS, turn(time))
        readings = sensors.read(tree_motion(robot, link_a, {JOINT: joint}))
        period = np.full(len(time), 1.0 / options.rate_hz)
        recording = Recording(stamps, {}, readings, period=period)
        yield SimulatedRobot(robot, recording, (JOINT,), joint.value[:, None], joint.rate[:, None])


def arm(options: AccelOptions) -> Robot:
    """The robot with its sensors as they should be."""
    sensors = [accelerometer(name, LINKS[link], (x, 0.0, 0.0), options) for name, (link, x) in SENSORS.items()]
    joint = Joint(JOINT, *LINKS, (AXIS,), origin=(LENGTH, 0.0, 0.0))
    return Robot(LINKS, (joint,), tuple(sensors), name="two_link_arm")
