"""How a hinge moves in a recording by its configured axes, mountings and signs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import STANDARD_GRAVITY
from jointest_ros.core.rotation import perpendicular, rotate_inverse
from jointest_ros.evaluation.hinge_equations import (
    BIAS_1,
    BIAS_2,
    PARAMETERS,
    Frames,
    Hinge,
    HingeData,
    Scatter,
    hinge_data,
)
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.joint_pairs import Pair

STILL = math.radians(2.0)  # rad/s rms of a joint: less is no motion
_SCATTER = Scatter(math.radians(1.0), 0.5)  # what is left over where all is well, coarsely
_FEWEST = 100  # windows
_QUIET = 0.05  # of g, by which the norm of an accelerometer may differ where it tells the vertical
_FEW_QUIET = 25  # windows


@dataclass(frozen=True)
class HingeMotion:
    """What a recording holds of one hinge as it is configured.

    Attributes:
        angle: (n,) rad, of the windows in `data`, by mountings, gyros and gravity; within half a turn of the middle of
            the limits, or of the mean.
        rate: (n,) rad/s about the axis, child less parent.
        joint_rate, across_rate: rms of the motion about the axis, and of what the axis does not explain, rad/s.
        gravity: (n,) rad, angle between axis and vertical, 0 to pi / 2.
        tilt: median of the elevation of the axis by the child's accelerometer less that by the parent's, rad; NaN:
            never quiet enough.
    """

    pair: Pair
    data: HingeData
    angle: FloatArray
    rate: FloatArray
    joint_rate: float
    across_rate: float
    gravity: FloatArray
    tilt: float

    @property
    def moves(self) -> bool:
        """Enough to judge it."""
        return self.joint_rate > STILL


def hinge_motion(means: WindowMeans, pair: Pair, biases: Mapping[str, FloatArray]) -> HingeMotion | None:
    """The motion of a hinge as configured; None where its sensors gave too little together.

    Args:
        biases: of the gyros, (3,) rad/s, where they are known.
    """
    data = hinge_data(means, pair.parent.name, pair.child.name)
    if len(data) < _FEWEST:
        return None
    parameters = np.zeros(PARAMETERS)
    nothing = np.zeros(3)
    parameters[BIAS_1], parameters[BIAS_2] = (biases.get(sensor.name, nothing) for sensor in pair.sensors)
    frames = _frames(pair)
    hinge = Hinge(data, frames, parameters, _SCATTER)
    rates = [w - parameters[b] for w, b in zip(data.gyro, (BIAS_1, BIAS_2), strict=True)]
    rate = rates[1] @ frames[1][2] - rates[0] @ frames[0][2]
    across = _SCATTER.gyro * math.sqrt(float(np.mean(abs(hinge.across) ** 2)))
    ups = [a @ frame[2] / STANDARD_GRAVITY for a, frame in zip(data.accel, frames, strict=True)]
    norms = [np.linalg.norm(a, axis=1) / STANDARD_GRAVITY for a in data.accel]
    quiet = np.logical_and(*(abs(norm - 1.0) < _QUIET for norm in norms))
    slanted = [np.arcsin(np.clip(up, -1.0, 1.0)) for up in ups]
    tilt = float(np.median((slanted[1] - slanted[0])[quiet])) if quiet.sum() >= _FEW_QUIET else math.nan
    return HingeMotion(
        pair,
        data,
        _wrapped(hinge.turn, pair),
        rate,
        float(rate.std()),
        across,
        np.arccos(np.clip(abs(ups[0] / norms[0]), 0.0, 1.0)),
        tilt,
    )


def _wrapped(turn: NDArray[np.complex128], pair: Pair) -> FloatArray:
    middle = float(np.angle(turn.mean()))
    if pair.joint.limits is not None:
        middle = 0.5 * sum(pair.joint.limits[0])
    return np.asarray(middle + np.angle(turn * np.exp(-1j * middle)))


def _frames(pair: Pair) -> Frames:
    """Rows u, v, axis of the links, which coincide at the zero pose, in either sensor: so phases are joint angles."""
    axis = pair.joint.axes[0]
    rows = (*perpendicular(axis), axis)
    one, two = (np.array([rotate_inverse(sensor.mounting, row) for row in rows]) for sensor in pair.sensors)
    return one, two
