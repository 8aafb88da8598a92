"""The torso: orientation of the last link of a chain in the first, from the joint angles or from two gyros."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Quat, Vec3
from jointest_ros.core.rotation import IDENTITY, exp, log, multiply


@dataclass(frozen=True)
class TorsoChain:
    """Which torso: the last link of a chain in `first`, from the coordinates `joints` about `axes`, in order."""

    first: str
    joints: tuple[str, ...]
    axes: tuple[Vec3, ...]
    composed: bool  # rotations in succession; otherwise sums of the angles about the same axis


def torso_of(axes: Sequence[Vec3], angles: Sequence[float], composed: bool) -> tuple[Vec3, Quat]:
    """(phi rad, orientation) for the angles (m) of all coordinates in order.

    composed: R_phi = prod exp(theta_i e_i), phi its rotation vector (erratum to (14)); otherwise phi = sum theta_i e_i,
    equation (14), which is the same for coaxial joints only.
    """
    if composed:
        x, y, z, w = IDENTITY
        for (a, b, c), angle in zip(axes, angles, strict=True):  # times exp(angle axis), written out
            s, k = math.sin(0.5 * angle), math.cos(0.5 * angle)
            a, b, c = a * s, b * s, c * s
            x, y, z, w = (
                w * a + x * k + y * c - z * b,
                w * b - x * c + y * k + z * a,
                w * c + x * b - y * a + z * k,
                w * k - x * a - y * b - z * c,
            )
        return log((x, y, z, w)), (x, y, z, w)
    x = y = z = 0.0
    for axis, angle in zip(axes, angles, strict=True):
        x, y, z = x + axis[0] * angle, y + axis[1] * angle, z + axis[2] * angle
    return (x, y, z), exp((x, y, z))


def torsos_of(axes: Sequence[Vec3], angles: FloatArray, composed: bool) -> tuple[FloatArray, FloatArray]:
    """`torso_of` of T rows of angles (T, m): (T, 3) and (T, 4)."""
    if not len(angles):  # scipy 1.11 has no array of zero rotations
        return np.empty((0, 3)), np.empty((0, 4))
    if not composed:
        torso = angles @ np.array(axes)
        return torso, Rotation.from_rotvec(torso).as_quat()
    rotation = Rotation.identity(len(angles))
    for column, axis in enumerate(axes):
        rotation = rotation * Rotation.from_rotvec(angles[:, column, None] * np.asarray(axis))
    return rotation.as_rotvec(), rotation.as_quat()


class GyroTorso:
    """Torso from the gyros of the first and the last link alone, equation (10): what no constraint corrects."""

    def __init__(self, composed: bool) -> None:
        self._composed = composed
        self.restart()

    def restart(self) -> None:
        """Back to zero."""
        self.angle: Vec3 = (0.0, 0.0, 0.0)
        self.orientation: Quat = IDENTITY
        self._held = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def step(self, dt: float, first: Vec3, last: Vec3) -> None:
        """`dt` s with the gyros of both links (rad/s, link frames; NaN: missing, the newest is held)."""
        first, last = (new if new[0] == new[0] else old for new, old in zip((first, last), self._held, strict=True))
        self._held = (first, last)
        if self._composed:
            back = exp((-first[0] * dt, -first[1] * dt, -first[2] * dt))
            forth = exp((last[0] * dt, last[1] * dt, last[2] * dt))
            self.orientation = multiply(multiply(back, self.orientation), forth)
            self.angle = log(self.orientation)
        else:
            x, y, z = self.angle
            self.angle = (x + (last[0] - first[0]) * dt, y + (last[1] - first[1]) * dt, z + (last[2] - first[2]) * dt)
            self.orientation = exp(self.angle)

    def get_state(self) -> list[Any]:
        """All that changes."""
        return [list(self.angle), list(self.orientation), [list(rate) for rate in self._held]]

    def set_state(self, state: list[Any]) -> None:
        """Continue from `get_state`."""
        angle, orientation, (first, last) = state
        self.angle, self.orientation = tuple(angle), tuple(orientation)
        self._held = (tuple(first), tuple(last))
