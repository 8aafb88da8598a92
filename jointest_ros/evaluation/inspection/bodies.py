"""Sensors that turn as one body though the configuration has them on different links."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import Robot
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.inspection.findings import LOOK, WRONG, Finding

_TURNING = math.radians(5.0)  # rad/s, rms
_ACCELERATING = 1.0  # m/s^2, rms
_SAME_SHARE = 0.03  # of the rms, by which vectors of one body may differ,
_SAME_RATE, _SAME_FORCE = math.radians(0.5), 0.3  # or rad/s and m/s^2
_FEWEST = 100  # windows


def one_body_findings(robot: Robot, means: WindowMeans, gyros: Collection[str]) -> Iterator[Finding]:
    """Two sensors, one link below the other, that turn as one while a sensor between them does not turn with them.

    Where their accelerometers agree too, they sit on one link; else a linkage may keep the links parallel.
    """
    parent = {joint.child: joint.parent for joint in robot.joints}
    sensors = [sensor for sensor in robot.sensors if sensor.name in gyros]
    for one, two in itertools.permutations(sensors, 2):
        between = _between(parent, one.link, two.link)
        if not between or not turn_as_one(means.gyro[one.name], means.gyro[two.name], _TURNING, _SAME_RATE):
            continue
        apart = [
            sensor.name
            for sensor in sensors
            if sensor.link in between
            and not turn_as_one(means.gyro[one.name], means.gyro[sensor.name], _TURNING, _SAME_RATE)
        ]
        if apart:
            same = turn_as_one(means.accel[one.name], means.accel[two.name], _ACCELERATING, _SAME_FORCE)
            text = f"it turns as one with '{one.name}', though '{apart[0]}' moves between them"
            action = f"does it sit on link '{one.link}' (link:), or is its topic that of '{one.name}'?"
            yield Finding(WRONG if same else LOOK, two.name, "body", text, action)


def turn_as_one(one: FloatArray, two: FloatArray, least: float, same: float) -> bool:
    """Whether two vectors (K, 3) differ by a constant rotation and a bias alone.

    Args:
        least: rms by which the first must vary, to tell anything; `same`: that the difference may have.
    """
    whole = np.isfinite(one).all(axis=1) & np.isfinite(two).all(axis=1)
    if whole.sum() < _FEWEST:
        return False
    a, b = one[whole] - one[whole].mean(axis=0), two[whole] - two[whole].mean(axis=0)
    rate = math.sqrt(float(np.mean(np.sum(a**2, axis=1))))
    if rate < least:
        return False
    left, _, right = np.linalg.svd(a.T @ b)  # Kabsch 1976: a = R b
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    over = math.sqrt(float(np.mean(np.sum((a - b @ turn.T) ** 2, axis=1))))
    return over < max(_SAME_SHARE * rate, same)


def _between(parent: dict[str, str], upper: str, lower: str) -> set[str]:
    """The links between a link and one below it; none where it is not below, or next to it."""
    line: list[str] = []
    link = lower
    while link in parent:
        link = parent[link]
        if link == upper:
            return set(line)
        line.append(link)
    return set()
