"""`gyro`: joint angles by integrating gyros alone, from zero: the baseline of Yumbla et al. 2023, equation (2).

angle+ = angle + (rate - bias) dt, rate = w_child - R^T w_parent. Nothing corrects it. The torso is the integrated
difference of the last and the first gyro, as in (10).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.frame import Estimate, Frame, Recording, Series, Status, Vec3
from jointest_ros.core.kckf.coordinate import UNKNOWN, GapRule
from jointest_ros.core.kckf.hinge_filter import HingeFilter
from jointest_ros.core.kckf.joint_bank import HingeBank, JointBank
from jointest_ros.core.kckf.linkage import gyro_linkage
from jointest_ros.core.kckf.linkage_estimator import GAP_RATE_TEXT, KINEMATICS, KINEMATICS_TEXT, LinkageEstimator
from jointest_ros.core.kckf.linkage_rates import ComposedRates
from jointest_ros.core.kckf.process_noise import ProcessNoise
from jointest_ros.core.learned import GYRO_DRIFT, Bias, Learned, by_axis, fingerprint, of_axes
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
    unobservable = "gyro only, as ever with this estimator: it drifts"
    fuses_hall = False
    Params = GyroParams
    params: GyroParams

    def __init__(self, robot: Robot, params: GyroParams | None = None, timing: Timing | None = None) -> None:
        chosen = params or GyroParams()
        linkage = gyro_linkage(robot)
        composed = chosen.kinematics == "composed"
        by_links = composed and not linkage.hinges_only
        super().__init__(
            robot, chosen, timing, linkage, composed, by_links, gyro_torso=True, gap_rate_dps=chosen.gap_rate_dps
        )

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
        """Forget everything of this run, the biases too."""
        self._bias: dict[str, Vec3] = {}  # by gyro, rad/s, sensor frame; subtracted from the inputs
        self._measured = 0.0  # s of rest behind them; 0: they are of an earlier run
        super().reset()
        p = self.params
        still, largest = math.radians(p.still_gyro_dps), math.radians(p.largest_bias_dps)
        self.stillness = Stillness(self._names, still, math.inf, largest, accel=False)

    @property
    def _names(self) -> tuple[str, ...]:
        return tuple([gyro.name for gyro in self.linkage.gyros])

    def _start_warm(self) -> None:
        """Start from the gyro biases of an earlier run."""
        known = self._learned_before([f"{name}.{axis}" for name in self._names for axis in "xyz"])
        if known is None:
            return
        self._bias = {name: of_axes(name, known.biases) for name in self._names}
        own = max(deviation for _, deviation in known.biases.values())
        for hinge in self._hinges:
            hinge.start_from(0.0, 2.0 * (own**2 + GYRO_DRIFT**2))

    def learned(self) -> Learned | None:
        """Gyro biases measured at rest."""
        if not self._bias:
            return None
        if not self._measured:
            return self.robot.learned[self.name]
        biases: dict[str, Bias] = {}
        for gyro in self.linkage.gyros:
            biases |= by_axis(gyro.name, self._bias[gyro.name], gyro.gyro_noise / math.sqrt(self._measured))
        return Learned(fingerprint(self.robot), biases)

    def update(self, frame: Frame) -> Estimate:
        """Integrate the frame's gyros."""
        self.stillness.update(frame)
        return super().update(frame)

    def _update(self, frame: Frame, saturated: Sequence[int]) -> Estimate:
        if not self._bias:
            estimate = super()._update(frame, saturated)
            estimate.status = tuple([flags | Status.UNCALIBRATED for flags in estimate.status])
            return estimate
        gyro = dict(frame.gyro)
        for name, (x, y, z) in self._bias.items():
            if name in gyro:
                u, v, w = gyro[name]
                gyro[name] = (u - x, v - y, w - z)
        return super()._update(replace(frame, gyro=gyro), saturated)

    def run(self, recording: Recording) -> Series:
        """Estimates of a stretch of frames. Equals `update` in a loop."""
        for _ in self.stillness.run(recording):
            pass
        return super().run(recording)

    def _run(self, recording: Recording, saturated: Sequence[Sequence[int]]) -> Series:
        if not self._bias:
            series = super()._run(recording, saturated)
            series.status |= int(Status.UNCALIBRATED)
            return series
        gyro = {name: rates - self._bias.get(name, (0.0, 0.0, 0.0)) for name, rates in recording.gyro.items()}
        return super()._run(replace(recording, gyro=gyro), saturated)

    def calibrate_gyro_bias(self) -> None:
        """Take the means of the present still phase as gyro biases.

        Raises:
            CalibrationError: the robot moves, or has not been still for long enough.
        """
        self._require_stillness()
        self._bias, _ = self.stillness.means()
        self._measured = self.stillness.duration
        for hinge, white in zip(self._hinges, self._white, strict=True):
            hinge.var_bias, hinge.covariance = white / self.stillness.duration, 0.0

    def calibrate_zero(self) -> None:
        """Take the present pose as the zero pose of every joint.

        Raises:
            CalibrationError: the robot moves, or has not been still for long enough.
        """
        self._require_stillness()
        last = self._last
        super()._restart()
        self._last = last

    def _restart(self) -> None:
        """After a jump of the clock: from zero again, though nobody knows the pose."""
        super()._restart()
        for hinge in self._hinges:
            hinge.var_angle = UNKNOWN

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
        bias = {name: list(bias) for name, bias in self._bias.items()}
        return super().get_state() | {"bias": bias, "measured": self._measured}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue identically from what `get_state` returned."""
        super().set_state(state)
        self._bias = {name: (x, y, z) for name, (x, y, z) in state["bias"].items()}
        self._measured = state["measured"]
