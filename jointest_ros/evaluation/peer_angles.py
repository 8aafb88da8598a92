"""Hinge angles from the orientations of two IMUs whose headings drift, each on its own: how peers become comparable.

With R1 and R2 the rotations of parent and child link to worlds with z up, and j the joint axis (equal in both links),
the twist of R1^T R2 about j would be the angle, were both worlds one. Without magnetometers they are not: world 2 is
turned about the vertical by an unknown d that wanders. A hinge keeps R1 j = Rz(d) R2 j, which gives d from the
horizontal parts of both; the angle is the twist of R1^T Rz(d) R2 about j. Two ways to take d are usual:

projected  from every sample by itself: what either filter says of rotations about gravity has no influence at all.
tracked    by a low pass over the products of the horizontal parts, which so weigh themselves: steadier where the axis
           comes near gravity and a single sample says nothing of d. After Laidig, Schauer, Seel, "Exploiting kinematic
           constraints to compensate magnetic disturbances when calculating joint angles of approximate hinge joints
           from orientation estimates of inertial sensors" (ICORR 2017).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Vec3

TRACKING_TIME = 5.0  # s, time constant of the low pass of `tracked`


def heading_difference(
    parent: Rotation, child: Rotation, axis: Vec3, period: float, tracking_time: float
) -> FloatArray:
    """(T,) rad, the turn d about the vertical from the child's world to the parent's.

    Args:
        parent, child: T rotations link to world each.
        axis: of the hinge, unit, equal in both links.
        period: between samples, s.
        tracking_time: time constant of the low pass, s; 0: every sample by itself.
    """
    one, two = (link.apply(axis) @ [1.0, 1.0j, 0.0] for link in (parent, child))
    turn = one * np.conj(two)
    if tracking_time > 0.0:
        kept = math.exp(-period / tracking_time)
        turn = lfilter([1.0], [1.0, -kept], turn)  # from zero: at first the mean of all samples so far
    return np.asarray(np.angle(turn))


def hinge_angles(
    parent: Rotation, child: Rotation, axis: Vec3, period: float, tracking_time: float = 0.0
) -> FloatArray:
    """(T,) rad in [-pi, pi], the child in the parent about +axis; arguments as of `heading_difference`."""
    heading = heading_difference(parent, child, axis, period, tracking_time)
    turned = Rotation.from_rotvec(heading[:, None] * np.array([0.0, 0.0, 1.0]))
    x, y, z, w = (parent.inv() * turned * child).as_quat().T
    twist = 2.0 * np.arctan2(axis[0] * x + axis[1] * y + axis[2] * z, w)
    return np.asarray((twist + np.pi) % (2.0 * np.pi) - np.pi)
