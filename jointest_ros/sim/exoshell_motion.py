"""How the exoshell moves in each scenario: section 4 of the specification of the KCKF (Yumbla et al. 2023).

Angles here are in degrees where a name says so. s(t) is a smoothstep over the first 3 s.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.sim.motion import LinkMotion, Signal, raised_cosine, sine, smoothstep

X: Vec3 = (1.0, 0.0, 0.0)
Y: Vec3 = (0.0, 1.0, 0.0)
Z: Vec3 = (0.0, 0.0, 1.0)
GAIT_HZ = 0.8
ONSET_S = 3.0
BEND_HZ = 0.1
BEND_DEG = 30.0
SHIFT_DEG = 6.5

# offset, amplitude, phase, deg, of each joint
MOTION_B = ((5.0, 22.0, 0.0), (0.0, 18.0, 90.0), (-4.0, 12.0, 30.0), (3.0, 15.0, 120.0))
TABLE_1 = ((-1.15, 41.60, 0.0), (7.38, 35.04, 0.0), (-2.81, 22.80, 0.0), (9.88, 26.98, 0.0))
POSTURE_DEG = (20.0, -12.0, 8.0, 15.0)
BEND_SHARES = (0.5, 0.0, 0.5, 0.0)  # of the bend in each joint
SWAY_DEG = (0.0, 3.0, 0.0, -2.0)
TURNS = ((30.0, 90.0), (60.0, 90.0), (80.0, -180.0), (100.0, 90.0))  # s, deg about the vertical, 2 s each


@dataclass(frozen=True, slots=True)
class Pose:
    """Motion at n instants.

    Attributes:
        joints: angle of every joint, rad.
        seen: what the Hall sensors see of it, rad (n, joints): differs where a sensor is shifted.
    """

    joints: list[Signal]
    seen: FloatArray


def gait(parameters: Sequence[tuple[float, float, float]], scale: float = 1.0) -> Callable[[FloatArray], Pose]:
    """theta_i = s [o_i + a_i sin(w t + p_i) + .15 a_i sin(2 w t + 2 p_i)], w = 2 pi .8 Hz; rows (o, a, p) in deg."""

    def move(time: FloatArray) -> Pose:
        onset = smoothstep(time, ONSET_S)
        omega = 2.0 * math.pi * GAIT_HZ
        joints = []
        for offset, amplitude, phase in parameters:
            a = math.radians(amplitude) * scale
            first, second = omega * time + math.radians(phase), 2.0 * (omega * time + math.radians(phase))
            swing = Signal(
                math.radians(offset) + a * np.sin(first) + 0.15 * a * np.sin(second),
                omega * a * (np.cos(first) + 0.3 * np.cos(second)),
                -(omega**2) * a * (np.sin(first) + 0.6 * np.sin(second)),
            )
            joints.append(onset * swing)
        return plain(joints)

    return move


def hold(hall_errors_deg: Sequence[float] = (0.0, 0.0, 0.0, 0.0)) -> Callable[[FloatArray], Pose]:
    """A posture reached in 5 s and held; the Hall sensors of each joint are wrong by `hall_errors_deg`."""

    def move(time: FloatArray) -> Pose:
        pose = plain([smoothstep(time, 5.0) * math.radians(angle) for angle in POSTURE_DEG])
        return Pose(pose.joints, pose.seen + np.radians(hall_errors_deg))

    return move


def bend(time: FloatArray) -> Pose:
    """A user bends forward by 30 deg and stands up again, with a little sway to the sides.

    Section 4.3 of the paper: the robot is compressed while the user stands, and over-extended while he is bent; both
    shift the sensors. Here the shift grows with the square of the way into either end, up to `SHIFT_DEG` in each joint
    that bends: chosen so that the paper's filter misses by as much as in the paper, 4.85 deg.
    """
    onset = smoothstep(time, ONSET_S)
    bending = onset * raised_cosine(time, BEND_HZ)
    sway = onset * sine(time, 0.27)
    joints = [
        _sum(bending * (math.radians(BEND_DEG) * share), sway * math.radians(to_side))
        for share, to_side in zip(BEND_SHARES, SWAY_DEG, strict=True)
    ]
    pose = plain(joints)
    compressed, extended = np.clip(1.0 - 4.0 * bending.value, 0.0, 1.0), np.clip(4.0 * bending.value - 3.0, 0.0, 1.0)
    shift = math.radians(SHIFT_DEG) * (extended**2 - compressed**2)
    return Pose(joints, pose.seen + shift[:, None] * (np.array(BEND_SHARES) > 0.0))


def plain(joints: list[Signal]) -> Pose:
    """The Hall sensors see the joints as they are."""
    return Pose(joints, np.column_stack([joint.value for joint in joints]))


def _sum(a: Signal, b: Signal) -> Signal:
    return Signal(a.value + b.value, a.rate + b.rate, a.acceleration + b.acceleration)


def fixed_base(time: FloatArray) -> LinkMotion:
    """The first link does not move."""
    return LinkMotion.translating(np.zeros((len(time), 3)))


def walking_base(time: FloatArray) -> LinkMotion:
    """The first link sways like the pelvis of someone who walks, and turns about the vertical now and then."""
    link = fixed_base(time)
    for start, angle in TURNS:
        link = link.child(Z, smoothstep(time - start, 2.0) * math.radians(angle))
    link = link.child(Z, sine(time, GAIT_HZ) * math.radians(8.0))
    link = link.child(Y, sine(time, 2.0 * GAIT_HZ) * math.radians(3.0))
    return link.child(X, sine(time, 2.0 * GAIT_HZ) * math.radians(4.0))
