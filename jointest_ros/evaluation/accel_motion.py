"""Typical motions of two links, as the truth along which the bound of accelerometer arrays is computed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointest_ros.core.accel.array import lever, plane
from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.robot import STANDARD_GRAVITY, Joint
from jointest_ros.sim.motion import sine

DURATION_S = 10.0  # at least
PERIODS = 2.0  # of the slowest swing, at least


@dataclass(frozen=True)
class Swing:
    """A motion of two links, either angle an amplitude times sin(2 pi f t); rad and Hz.

    Attributes:
        amplitude, frequency: of the child against the parent.
        parent_amplitude, parent_frequency: of the parent about the origin of its frame; 0: it is clamped.
    """

    amplitude: float = 0.0
    frequency: float = 0.0
    parent_amplitude: float = 0.0
    parent_frequency: float = 0.0

    def __str__(self) -> str:
        child = _text(self.amplitude, self.frequency) or "still"
        parent = _text(self.parent_amplitude, self.parent_frequency)
        return f"{child}, parent {parent}" if parent else child


def _text(amplitude: float, frequency: float) -> str:
    return f"{math.degrees(amplitude):g} deg {frequency:g} Hz" if amplitude * frequency else ""


TYPICAL = (
    Swing(),
    Swing(math.radians(45.0), 0.25),
    Swing(math.radians(30.0), 2.0),
    Swing(math.radians(45.0), 0.25, math.radians(45.0), 0.2),
)


@dataclass(frozen=True, eq=False)
class Course:
    """The truth of a motion, T samples.

    Attributes:
        swing: what it is.
        gravity: what of gravity lies in the plane of motion, m/s^2.
        period: of the samples, s.
        state: (T, 3) w_a, w_b (rad/s) and th_ab (rad), a the parent; the joint position is -th_ab.
        joint_acceleration: (T, 2) specific force at the joint in the axes of a, m/s^2.
    """

    swing: Swing
    gravity: float
    period: float
    state: FloatArray
    joint_acceleration: FloatArray


def course(joint: Joint, swing: Swing, up: Vec3, rate_hz: float) -> Course:
    """Two links in a motion.

    Args:
        joint: of one axis.
        up: unit vector upward in the parent's frame while the parent's angle is 0; what of it lies along the axis is
            not felt in the plane of motion.
    """
    slowest = min((f for f in (swing.frequency, swing.parent_frequency) if f), default=math.inf)
    period = 1.0 / rate_hz
    samples = math.ceil(max(DURATION_S, PERIODS / slowest) * rate_hz) + 1
    time = period * np.arange(samples, dtype=np.float64)
    child = sine(time, swing.frequency) * swing.amplitude
    parent = sine(time, swing.parent_frequency) * swing.parent_amplitude
    across = plane(joint.axes[0])
    moved = np.stack([parent.rate**2, parent.acceleration], axis=-1) @ lever(across @ np.array(joint.origin)).T
    x, y = (STANDARD_GRAVITY * across @ np.array(up)).tolist()
    c, s = np.cos(parent.value), np.sin(parent.value)
    return Course(
        swing,
        math.hypot(x, y),
        period,
        np.stack([parent.rate, parent.rate + child.rate, -child.value], axis=-1),
        moved + np.stack([c * x + s * y, c * y - s * x], axis=-1),
    )
