"""`hall`: joint angles from Hall voltages alone, frame by frame: the other baseline of Yumbla et al. 2023.

One sensor     theta_h(V) of equation (1), clipped or not, as in the paper's columns "Hall 1" and "Hall 2".
All (default)  their mean weighted with 1 / (dtheta/dV sigma_V)^2; clipped readings are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from jointest_ros.core.errors import ConfigurationError, counted
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, FloatArray, Frame, Quat, Status, Vec3
from jointest_ros.core.hall_sensor import HallSensor
from jointest_ros.core.kckf.coordinate import UNKNOWN
from jointest_ros.core.kckf.linkage import hall_linkage
from jointest_ros.core.kckf.linkage_estimator import GAP_RATE_TEXT, KINEMATICS, KINEMATICS_TEXT, check_voltages
from jointest_ros.core.params import Params, param
from jointest_ros.core.robot import Robot
from jointest_ros.core.timing import Timing
from jointest_ros.core.torso import torso_of


@dataclass(frozen=True)
class HallParams(Params):
    """The `estimators: hall:` section of a configuration."""

    sensor: int = param(0, "which sensor of each joint: 1 the first, 2 the second, ...; 0: all", low=0, high=16)
    kinematics: str = param("composed", KINEMATICS_TEXT, choices=KINEMATICS)
    gap_rate_dps: float = param(200.0, GAP_RATE_TEXT, unit="deg/s", low=0.0, high=1e4)


class HallJoint:
    """One coordinate: its newest angle and what is known about it.

    `single`: the one sensor is taken as it is, clipped or not.
    """

    def __init__(self, sensors: list[tuple[int, HallSensor]], single: bool, gap_rate: float) -> None:
        self._sensors, self._single, self._gap_rate = sensors, single, gap_rate
        self.restart()

    def restart(self) -> None:
        """Before the first reading."""
        self.angle, self.velocity, self.variance = 0.0, 0.0, UNKNOWN
        self.blind = 0.0  # s since the newest usable reading
        self.started = False
        self.status = int(Status.STARTING)

    def step(self, dt: float, hall: tuple[float, ...] | None) -> None:
        """`dt` s after the frame before, with the voltages of the frame."""
        weights = weighted = 0.0
        present = clipped = False
        for index, sensor in self._sensors:
            reading = hall[index] if hall is not None else math.nan
            if reading != reading:
                continue
            present = True
            if not sensor.hall_range[0] + sensor.gate_margin <= reading <= sensor.hall_range[1] - sensor.gate_margin:
                clipped = True
                if not (self._single and sensor.hall_range[0] <= reading <= sensor.hall_range[1]):
                    continue
            theta = sensor.table.angle(reading - sensor.offset)
            weight = sensor.table.voltage(theta)[1] ** 2 / sensor.variance
            weights += weight
            weighted += weight * sensor.sign * theta
        self.blind += dt
        if weights:
            angle = weighted / weights
            self.velocity = (angle - self.angle) / self.blind if self.started and self.blind else 0.0
            self.angle, self.variance = angle, 1.0 / weights
            self.blind, self.started = 0.0, True
            self.status = int(Status.DISTURBED if self._single and clipped else Status.OK)
            return
        self.velocity = 0.0
        self.variance = min(self.variance + (self._gap_rate * dt) ** 2, UNKNOWN)
        self.status = int(Status.DISTURBED if present else Status.NO_DATA)
        if not self.started:
            self.status |= Status.STARTING


class Hall(Estimator):
    """The estimator of the module text, on all joints with Hall sensors.

    Raises:
        ConfigurationError: there are none, or a joint has fewer than `sensor` asks for.
    """

    name = "hall"
    Params = HallParams
    params: HallParams

    def __init__(self, robot: Robot, params: HallParams | None = None, timing: Timing | None = None) -> None:
        super().__init__(robot, params or HallParams(), timing)
        self.linkage = hall_linkage(robot)
        self.joints = self.linkage.names
        number = self.params.sensor
        self._joints = []
        for name, own in zip(self.joints, self.linkage.hall, strict=True):
            if len(own) < number and own:
                has = counted(len(own), "Hall sensor")
                raise ConfigurationError(f"sensor: {number} is not allowed; '{name}' has {has}")
            chosen = [own[number - 1]] if number and own else own
            sensors = [(index, robot.hall[index]) for index in chosen]
            self._joints.append(HallJoint(sensors, number > 0, math.radians(self.params.gap_rate_dps)))
        self._composed = self.params.kinematics == "composed"
        self._last: int | None = None

    def reset(self) -> None:
        """Forget everything but parameters."""
        self._last = None
        for joint in self._joints:
            joint.restart()

    def update(self, frame: Frame) -> Estimate:
        """The angles that the frame's voltages stand for; without any, the newest ones."""
        if frame.reset:
            self.reset()
        if frame.hall is not None:
            check_voltages(self.robot, len(frame.hall))
        dt = 0.0 if self._last is None else (frame.stamp - self._last) * 1e-9
        self._last = frame.stamp
        for joint in self._joints:
            joint.step(dt, frame.hall)
            if joint.blind > self.timing.stale_after:
                joint.status |= Status.STALE
        angles = tuple([joint.angle for joint in self._joints])
        torso: tuple[Vec3 | None, Quat | None] = (None, None)
        if self.linkage.serial:
            torso = torso_of(self.linkage.axes, angles, self._composed)
        return Estimate(
            frame.stamp,
            angles,
            tuple([joint.velocity for joint in self._joints]),
            tuple([joint.variance for joint in self._joints]),
            tuple([joint.status for joint in self._joints]),
            *torso,
        )

    def get_state(self) -> dict[str, Any]:
        """The whole state as plain numbers."""
        rows = [[j.angle, j.velocity, j.variance, j.blind, j.started, j.status] for j in self._joints]
        return {"last": self._last, "joints": rows}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue identically from what `get_state` returned."""
        self._last = state["last"]
        for j, row in zip(self._joints, state["joints"], strict=True):
            j.angle, j.velocity, j.variance, j.blind, j.started, j.status = row

    def covariance(self) -> FloatArray:
        """Diagonal (m, m), rad^2."""
        return np.diag([joint.variance for joint in self._joints])
