"""Semi-synthetic recordings: computed accelerometer readings on the real motion of a double pendulum.

The motion was measured by the encoders of the multi-arm pendulum of Kaheman, Fasel, Bramburger, Strom, Kutz and Brunton
(The Experimental Multi-Arm Pendulum on a Cart, HardwareX 15, 2023), in free swing with the cart held: angles of both
arms from the vertical, 0 upward, so that pi hangs down. The data confirm that they are absolute, and the length of the
first arm: the equation of motion of the second explains 99.94 % of its angular acceleration, with 0.1729 m.

No inertial sensor was there. A quintic spline by least squares, a knot every 20 ms, makes of the angles a motion whose
derivatives are exact, at any instant. Two accelerometers on each arm, 2 cm from its ends, are assumed; their readings
are computed. Link frames have x along the arm, away from the cart, and coincide when both arms point alike; z is level.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline

from jointest_ros.core.frame import FloatArray, Recording, Vec3
from jointest_ros.core.params import param
from jointest_ros.core.robot import Joint, Robot
from jointest_ros.sim.accelerometers import Accelerometers, AccelOptions, accelerometer
from jointest_ros.sim.motion import LinkMotion, Signal, constant, tree_motion
from jointest_ros.sim.simulated import SimulatedRobot

LINKS = ("arm_1", "arm_2")
JOINT = "elbow"
LENGTHS = (0.1727, 0.2286)  # m, as the authors simulate it (TriplePendulumSimWithX0.m)
MARGIN = 0.02  # m, from the ends of an arm to its accelerometers
KNOTS_S = 0.020
_DEGREE = 5
_STRETCH_S = 10.0
_X: Vec3 = (1.0, 0.0, 0.0)
_Z: Vec3 = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class PendulumOptions(AccelOptions):
    """What can be chosen of the accelerometers on the pendulum."""

    rate_hz: float = param(1000.0, "samples per second of every sensor", unit="Hz", low=100.0, high=1000.0)
    seed: int = param(0, "of every random number: the same seed gives the same recording", low=0)


def smooth(angles: FloatArray, period: float) -> BSpline:
    """The motion through `angles` (T, n), rad, sampled every `period` s from time 0: values (..., n) at any time.

    Raises:
        ValueError: there are too few samples for a spline.
    """
    time: FloatArray = period * np.arange(len(angles), dtype=np.float64)
    inner = np.arange(KNOTS_S, time[-1] - KNOTS_S / 2.0, KNOTS_S)
    ends = np.ones(_DEGREE + 1)
    return make_lsq_spline(time, angles, np.concatenate([time[0] * ends, inner, time[-1] * ends]), k=_DEGREE)


def stretches(motion: BSpline, duration_s: float, options: PendulumOptions) -> Iterator[SimulatedRobot]:
    """The recording on a `motion` of both arms, absolute angles in rad, in consecutive stretches."""
    robot = pendulum(options)
    sensors = Accelerometers(robot, options, options.rate_hz, options.seed)
    samples, size = math.floor(duration_s * options.rate_hz + 1e-6) + 1, round(_STRETCH_S * options.rate_hz)
    for start in range(0, samples, size):
        stamps = np.round(np.arange(start, min(start + size, samples)) * (1e9 / options.rate_hz)).astype(np.int64)
        time: FloatArray = stamps.astype(np.float64) * 1e-9
        first, second = (Signal(*(motion(time, order)[:, arm] for order in range(3))) for arm in range(2))
        relative = first * -1.0 + second
        # from a level x, y to the plane of the arms: x upward, z towards the viewer, who sees y on the left
        upright = LinkMotion.translating(np.zeros((len(time), 3))).child(_X, constant(time, math.pi / 2.0))
        arm_1 = upright.child(_Z, constant(time, math.pi / 2.0)).child(_Z, first)
        readings = sensors.read(tree_motion(robot, arm_1, {JOINT: relative}))
        recording = Recording(stamps, {}, readings, period=np.full(len(time), 1.0 / options.rate_hz))
        yield SimulatedRobot(robot, recording, (JOINT,), relative.value[:, None], relative.rate[:, None])


def pendulum(options: AccelOptions) -> Robot:
    """The robot with its assumed sensors."""
    sensors = [
        accelerometer(f"{link}_{end}", link, (x, 0.0, 0.0), options)
        for link, length in zip(LINKS, LENGTHS, strict=True)
        for end, x in (("upper", MARGIN), ("lower", round(length - MARGIN, 4)))
    ]
    joint = Joint(JOINT, *LINKS, (_Z,), origin=(LENGTHS[0], 0.0, 0.0))
    return Robot(LINKS, (joint,), tuple(sensors), name="multiarm")
