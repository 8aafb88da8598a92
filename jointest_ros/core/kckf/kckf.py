"""`kckf`: the kinematically constrained Kalman filter (Yumbla et al. 2023) on link gyros and Hall sensors.

State        angle and gyro bias of every joint coordinate, optionally an offset of every Hall sensor.
Input        rates w_child - R^T w_parent of the joints, from the gyros of their links: (9), corrected.
Process      angle+ = angle + (rate - bias) dt; noise of the gyros, which neighbours share, or the paper's (13).
Measurement  Hall voltages V(angle) + offset, or Hall angles with constant noise: (1), (5), (20).
Torso        phi = sum of the angles (14), or the product of their rotations; with the covariance of the angles.

The torso and its bias are not states: the constraint (15)-(19) makes them sums of the others, exactly. What is left is
the noise that neighbouring joints have in common (process_noise.py). Coordinates without common noise are filtered one
by one in plain floats (hinge_filter.py), others together (coupled_filter.py, chain_motion.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.kckf.chain_motion import ChainMotion
from jointest_ros.core.kckf.coordinate import GapRule
from jointest_ros.core.kckf.fusion import FusionParams, coupled_bank, hinge_bank
from jointest_ros.core.kckf.joint_bank import JointBank
from jointest_ros.core.kckf.linkage import serial_linkage
from jointest_ros.core.kckf.linkage_estimator import LinkageEstimator
from jointest_ros.core.params import param
from jointest_ros.core.robot import Robot
from jointest_ros.core.timing import Timing


@dataclass(frozen=True)
class KckfParams(FusionParams):
    """The `estimators: kckf:` section of a configuration."""

    hall_offset: bool = param(
        False, "estimate a slow voltage offset of every Hall sensor: the error of its assembly or calibration"
    )
    hall_offset_sigma: float = param(
        0.05, "standard deviation of such an offset at the start", unit="V", low=1e-4, high=1.0
    )
    hall_offset_walk: float = param(1e-4, "random walk of such an offset", unit="V/sqrt(s)", low=0.0, high=0.1)
    off_axis: bool = param(
        False,
        "use gyro components off the joint axis too: they tell the angle when the base moves; needs aligned gyros",
    )
    alignment_deg: float = param(
        0.5, "off_axis: standard deviation of a misalignment of neighbouring gyros", unit="deg", low=0.0, high=10.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hall_offset and self.hall_noise != "voltage":
            raise ConfigurationError("hall_offset: true is not allowed with hall_noise: constant; offsets are in volts")
        if self.off_axis and not (self.composed and self.noise == "physical"):
            raise ConfigurationError("off_axis: true is not allowed; it needs kinematics: composed and noise: physical")


PAPER = KckfParams(noise="paper", hall_noise="constant", kinematics="additive")


class Kckf(LinkageEstimator):
    """The estimator of the module text.

    Raises:
        ConfigurationError: see `serial_linkage`.
    """

    name = "kckf"
    Params = KckfParams
    params: KckfParams

    def __init__(self, robot: Robot, params: KckfParams | None = None, timing: Timing | None = None) -> None:
        chosen = params or KckfParams()
        linkage = serial_linkage(robot)
        by_links = chosen.off_axis or (chosen.composed and not linkage.hinges_only)
        super().__init__(
            robot,
            chosen,
            timing,
            linkage,
            chosen.composed,
            by_links,
            gyro_torso=False,
            gap_rate_dps=chosen.gap_rate_dps,
        )

    def _make_bank(self) -> JointBank:
        p, linkage = self.params, self.linkage
        noise = p.process_noise(linkage)
        rule = GapRule.of(self.timing, p.gap_rate_dps)
        motion = None
        if self._by_links and not noise.paper:
            motion = ChainMotion(linkage, p.off_axis), math.radians(p.alignment_deg)
        elif noise.independent and not p.hall_offset:
            return hinge_bank(linkage, self.robot, p, noise, rule, self._by_links)
        offset = (p.hall_offset_sigma, p.hall_offset_walk if p.hall_offset else None)
        return coupled_bank(linkage, self.robot, p, noise, rule, self._by_links, offset, motion)
