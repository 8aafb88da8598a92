"""Independent kinematics for the planar rigs: what accelerometers read, from differentiated positions."""

from __future__ import annotations

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.sim.simulated import SimulatedRobot

SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])  # 8th order
LOST = 4  # rows at either end
COARSE = 5  # differences over every fifth sample: rounding errors grow with the square of the rate


def along(angle: FloatArray) -> FloatArray:
    """(T, 2) unit vectors at `angle` (T,), in a vertical plane, the second component upward."""
    return np.column_stack([np.cos(angle), np.sin(angle)])


def specific_force(position: FloatArray, angle: FloatArray, period: float) -> FloatArray:
    """(T - 8 COARSE, 2) readings along and across a link at `angle`, of a sensor at `position` (T, 2), m."""
    n, step = len(position), COARSE
    width = n - 2 * LOST * step
    acceleration = sum(w * position[i * step : i * step + width] for i, w in enumerate(SECOND)) / (step * period) ** 2
    force = acceleration + np.array([0.0, 9.81])
    x = along(angle)[LOST * step : n - LOST * step]
    y = np.column_stack([-x[:, 1], x[:, 0]])
    return np.column_stack([(force * x).sum(axis=1), (force * y).sum(axis=1)])


def table(simulated: SimulatedRobot) -> FloatArray:
    """All readings and the truth side by side."""
    readings = [simulated.recording.accel[sensor.name] for sensor in simulated.robot.sensors]
    return np.hstack([*readings, simulated.truth_position, simulated.truth_velocity])
