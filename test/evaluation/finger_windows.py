"""Recordings of the simulated finger for calibrations by motion, and robots that do not know their mountings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from jointest_ros.core.frame import FloatArray, Recording
from jointest_ros.core.robot import Robot
from jointest_ros.core.rotation import IDENTITY, rotate_inverse
from jointest_ros.core.stillness import Stillness
from jointest_ros.evaluation.axis_fit import Axis
from jointest_ros.evaluation.inertial_windows import WindowMeans, Windows
from jointest_ros.evaluation.measures import angle_between


def unmounted(robot: Robot) -> Robot:
    """The robot with all IMUs taken for aligned with their links."""
    return replace(robot, sensors=tuple(replace(sensor, mounting=IDENTITY) for sensor in robot.sensors))


def stillness(*sensors: str) -> Stillness:
    """With the thresholds of the PCF."""
    return Stillness(sensors, math.radians(1.0), 0.5, math.radians(5.0))


def means_of(recording: Recording, chunk: int = 2048) -> WindowMeans:
    """Of all sensors, taken chunk after chunk."""
    sensors = tuple(recording.gyro)
    windows = Windows(sensors, stillness(*sensors))
    for part in recording.parts(chunk):
        windows.add(part)
    return windows.means()


def tilt(axis: Axis, true: FloatArray) -> FloatArray:
    """(2,) rad: the tilt of `axis` about its directions `across` that makes the true one of it."""
    off = true - axis.axis * (true @ axis.axis)
    return np.array([-off @ axis.across[1], off @ axis.across[0]])


def error_deg(axis: Axis, true: FloatArray) -> float:
    """Angle between an identified and the true axis."""
    return math.degrees(angle_between(axis.axis, true))


def true_axis(robot: Robot, sensor: str, joint: int) -> FloatArray:
    """(3,) the axis of a joint in the frame of a sensor, by its true mounting."""
    return np.array(rotate_inverse(robot.sensor(sensor).mounting, robot.joints[joint].axes[0]))
