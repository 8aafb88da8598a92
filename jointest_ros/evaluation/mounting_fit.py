"""Mountings of sensors from what was seen of joint axes and of a zero pose.

One sensor may belong to several joints: its mounting fits all their axes, the better known ones better. What nothing
was seen of stays as it was: the change is the smallest that does it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Quat, Vec3
from jointest_ros.core.pcf.attitude import joint_angles
from jointest_ros.core.pcf.two_axes import TwoAxes
from jointest_ros.core.robot import Sensor
from jointest_ros.core.rotation import IDENTITY, rotate
from jointest_ros.evaluation.joint_pairs import Pair
from jointest_ros.evaluation.measures import angle_between

_LEAST_STD = math.radians(0.01)  # of an axis: none is known better for this purpose
_UNSEEN = 1e-8  # weight of the mounting as it was, beside the axes
_KEPT = 1e-3  # rad, of an axis that is to be kept
_ZERO = 1e-2  # rad, of a reading that is to be zero
_FREE, _ROOT = 1e4, 1.0  # rad, of a change that nothing asks for: the root stays rather than the others
LEAST_LEVER = math.sin(
    math.radians(10.0)
)  # share of gravity across an axis, below which it says nothing about the angle


@dataclass(frozen=True)
class SeenAxis:
    """A joint axis in the frame of a sensor (3,) and in that of its link (3,), and how well it is known, rad."""

    in_sensor: FloatArray
    in_link: FloatArray
    std: float


def aligned(mounting: Quat, axes: Sequence[SeenAxis]) -> tuple[Quat, list[float]]:
    """The mounting that fits the axes, and what is left over of each, rad."""
    weights = [1.0 / max(axis.std, _LEAST_STD) ** 2 for axis in axes]
    seen = sum(w * np.outer(axis.in_link, axis.in_sensor) for w, axis in zip(weights, axes, strict=True))
    left, _, right = np.linalg.svd(seen / max(weights) + _UNSEEN * Rotation.from_quat(mounting).as_matrix())
    matrix = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    over = [angle_between(matrix @ axis.in_sensor, axis.in_link) for axis in axes]
    return _quaternion(Rotation.from_matrix(matrix)), over


def reading(pair: Pair, parent_accel: Sequence[float], child_accel: Sequence[float]) -> float | None:
    """Angle of a hinge, rad, by accelerometers at rest (sensor frames, m/s^2); None: the axis is near gravity."""
    return _reading(pair.axis, *(np.array(up) for up in _in_links(pair, parent_accel, child_accel)))


def readings(pair: Pair, parent_accel: Sequence[float], child_accel: Sequence[float]) -> tuple[float, ...] | None:
    """`reading` of a joint of one axis or two, one angle an axis; None: gravity does not show them."""
    axes = pair.joint.axes
    if len(axes) == 1:
        angle = reading(pair, parent_accel, child_accel)
        return None if angle is None else (angle,)
    turned = TwoAxes(axes, IDENTITY, (0.0, 0.0)).from_gravity(*_in_links(pair, parent_accel, child_accel))
    return None if turned is None else joint_angles(axes, turned)


def _in_links(pair: Pair, parent_accel: Sequence[float], child_accel: Sequence[float]) -> tuple[Vec3, Vec3]:
    one, two = (
        rotate(sensor.mounting, (float(a[0]), float(a[1]), float(a[2])))
        for sensor, a in zip(pair.sensors, (parent_accel, child_accel), strict=True)
    )
    return one, two


def zeroed(
    pairs: Sequence[Pair], accel: dict[str, tuple[float, float, float]], chosen: Collection[str]
) -> dict[str, Quat]:
    """Mountings by sensor with which the joints `chosen` read zero at rest, and their axes are where they were.

    R_o by TRIAD from axis and gravity, for all joints at once. The sensors on the first links stay if they can.

    Args:
        pairs: all joints of one axis or two, chosen or not; those that are not go on reading what they do.
        accel: sensor -> mean reading at rest, m/s^2, sensor frame, for the sensors of the chosen joints.
    """
    sensors = {sensor.name: sensor for pair in pairs for sensor in pair.sensors}
    names = list(sensors)
    children = {pair.child.name for pair in pairs}
    prior = np.repeat([_FREE if name in children else _ROOT for name in names], 3)
    before = {name: Rotation.from_quat(sensor.mounting) for name, sensor in sensors.items()}

    def residuals(x: FloatArray) -> FloatArray:
        turns = {name: Rotation.from_rotvec(x[3 * k : 3 * k + 3]) for k, name in enumerate(names)}
        rows = [x / prior]
        for pair in pairs:
            one, two = (turns[sensor.name] for sensor in pair.sensors)
            first, second = pair.link_axes
            rows += [(turn.apply(axis) - axis) / _KEPT for turn, axis in ((one, first), (two, second))]
            if pair.joint.name in chosen:
                up, child_up = (
                    (turns[sensor.name] * before[sensor.name]).apply(accel[sensor.name]) for sensor in pair.sensors
                )
                if len(pair.joint.axes) == 1:
                    rows.append(np.array([(_reading(pair.axis, up, child_up) or 0.0) / _ZERO]))
                else:
                    rows.append((up / np.linalg.norm(up) - child_up / np.linalg.norm(child_up)) / _ZERO)
            elif len(pair.joint.axes) == 1:
                rows.append(np.array([pair.axis @ (one.as_rotvec() - two.as_rotvec()) / _ZERO]))
            else:
                rows.append(np.array([first @ one.as_rotvec(), second @ two.as_rotvec()]) / _ZERO)
        return np.concatenate(rows)

    turns = least_squares(residuals, np.zeros(3 * len(names)), x_scale=prior, method="trf").x
    return {
        name: _quaternion(Rotation.from_rotvec(turns[3 * k : 3 * k + 3]) * before[name]) for k, name in enumerate(names)
    }


def turned(sensor: Sensor, mounting: Quat) -> float:
    """Angle between the mounting of a sensor and another one, rad."""
    return float((Rotation.from_quat(sensor.mounting).inv() * Rotation.from_quat(mounting)).magnitude())


def _reading(axis: FloatArray, one: FloatArray, two: FloatArray) -> float | None:
    """The angle about `axis` from the child's gravity `two` to the parent's `one`, both (3,) in link frames."""
    across = [vector - axis * (axis @ vector) for vector in (one, two)]
    for vector, part in zip((one, two), across, strict=True):
        if np.linalg.norm(part) < LEAST_LEVER * np.linalg.norm(vector):
            return None
    return math.atan2(float(axis @ np.cross(across[1], across[0])), float(across[0] @ across[1]))


def _quaternion(rotation: Rotation) -> Quat:
    x, y, z, w = rotation.as_quat().tolist()
    return (-x, -y, -z, -w) if w < 0.0 else (x, y, z, w)
