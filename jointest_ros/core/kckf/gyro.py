"""`gyro`: joint angles by integrating gyros alone, from zero: the baseline of Yumbla et al. 2023, equation (2).

angle+ = angle + (rate - bias) dt, rate = w_child - R^T w_parent. Nothing corrects it. The torso is the integrated
difference of the last and the first gyro, as in (10).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.frame import Estimate, Frame, Recording, Series, Status, Vec3
from jointest_ros.core.kckf.coordinate import GapRule
from jointest_ros.core.kckf.hinge_filter import HingeFilter
from jointest_ros.core.kckf.joint_bank import HingeBank, JointBank
from jointest_ros.core.kckf.linkage import gyro_linkage
from jointest_ros.core.kckf.linkage_estimator import GAP_RATE_TEXT, KINEMATICS, KINEMATICS_TEXT, LinkageEstimator
from jointest_ros.core.kckf.linkage_rates import ComposedRates
from jointest_ros.core.kckf.process_noise import ProcessNoise
from jointest_ros.core.params import Params, param
from jointest_ros.core.robot import Robot
from jointest_ros.core.stillness import Stillness
from jointest_ros.core.timing import Timing


@dataclass(frozen=True)
class GyroParams(Params):
    """The `estimators: gyro:` section of a configuration."""

    kinematics: str = param("composed", KINEMATICS_TEXT, choices=KINEMATICS)
    bias_dps: float = param(
        1.0, "standard deviation of an uncalibrated gyro bias difference", unit="deg/s", low=0.0, high=100.0
    )
    still_gyro_dps: float = param(
        1.0, "still: largest standard deviation of a gyro axis", unit="deg/s", low=1e-3, high=100.0
    )
    largest_bias_dps: float = param(
        5.0, "still: a mean rate above this is motion, not bias", unit="deg/s", low=1e-3, high=100.0
    )
    gap_rate_dps: float = param(200.0, GAP_RATE_TEXT, unit="deg/s", low=0.0, high=1e4)


class Gyro(LinkageEstimator):
    """The estimator of the module text, on all joints with a gyro on either side.

    Raises:
        ConfigurationError: there are none.
    """

    name = "gyro"
    Params = GyroParams
    params: GyroParams

    def __init__(self, robot: Robot, params: GyroParams | None = None, timing: Timing | None = None) -> None:
        chosen = params or GyroParams()
        linkage = gyro_linkage(robot)
        composed = chosen.kinematics == "composed"
        by_links = composed and not linkage.hinges_only
        super().__init__(robot, chosen, timing, linkage, composed, by_links, gyro_torso=True)

    def _make_bank(self) -> JointBank:
        noise = ProcessNoise.physical(self.linkage)
        start = (0.0, math.radians(self.params.bias_dps) ** 2)
        rule = GapRule.of(self.timing, self.params.gap_rate_dps)
        self._white = noise.white.diagonal().tolist()
        self._hinges = [
            HingeFilter([], (False, float(white), float(walk)), start, rule)
            for white, walk in zip(noise.white.diagonal(), noise.walk.diagonal(), strict=True)
        ]
        rates_of = ComposedRates(self.linkage) if self._by_links else None
        return HingeBank(self.linkage, self._hinges, len(self.robot.hall), rates_of)

    def reset(self) -> None:
        """Forget everything but parameters, the biases too."""
        super().reset()
        self._bias: dict[str, Vec3] = {}  # by gyro, rad/s, sensor frame; subtracted from the inputs
        p = self.params
        names = tuple(gyro.name for gyro in self.linkage.gyros)
        still, largest = math.radians(p.still_gyro_dps), math.radians(p.largest_bias_dps)
        self.stillness = Stillness(names, still, math.inf, largest, accel=False)

    def update(self, frame: Frame) -> Estimate:
        """Integrate the frame's gyros."""
        self.stillness.update(frame)
        if not self._bias:
            estimate = super().update(frame)
            estimate.status = tuple([flags | Status.UNCALIBRATED for flags in estimate.status])
            return estimate
        gyro = dict(frame.gyro)
        for name, (x, y, z) in self._bias.items():
            if name in gyro:
                u, v, w = gyro[name]
                gyro[name] = (u - x, v - y, w - z)
        return super().update(replace(frame, gyro=gyro))

    def run(self, recording: Recording) -> Series:
        """Estimates of a stretch of frames. Equals `update` in a loop."""
        for _ in self.stillness.run(recording):
            pass
        if not self._bias:
            series = super().run(recording)
            series.status |= int(Status.UNCALIBRATED)
            return series
        gyro = {name: rates - self._bias.get(name, (0.0, 0.0, 0.0)) for name, rates in recording.gyro.items()}
        return super().run(replace(recording, gyro=gyro))

    def calibrate_gyro_bias(self) -> None:
        """Take the means of the present still phase as gyro biases.

        Raises:
            CalibrationError: the robot moves, or has not been still for long enough.
        """
        self._require_stillness()
        self._bias, _ = self.stillness.means()
        for hinge, white in zip(self._hinges, self._white, strict=True):
            hinge.var_bias, hinge.covariance = white / self.stillness.duration, 0.0

    def calibrate_zero(self) -> None:
        """Take the present pose as the zero pose of every joint.

        Raises:
            CalibrationError: the robot moves, or has not been still for long enough.
        """
        self._require_stillness()
        last = self._last
        self._restart()
        self._last = last

    def _require_stillness(self) -> None:
        if self.stillness.duration <= 0.0:
            raise CalibrationError(
                "the robot moves, or has not been still for half a second: hold it still and try again"
            )

    def biases(self) -> dict[str, float]:
        """Calibrated biases `<sensor>.x`, `.y`, `.z`, rad/s; none before the calibration."""
        return {f"{name}.{axis}": b for name, bias in self._bias.items() for axis, b in zip("xyz", bias, strict=True)}

    def get_state(self) -> dict[str, Any]:
        """The whole state but for the still window of the moment."""
        return super().get_state() | {"bias": {name: list(bias) for name, bias in self._bias.items()}}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue identically from what `get_state` returned."""
        super().set_state(state)
        self._bias = {name: (x, y, z) for name, (x, y, z) in state["bias"].items()}
