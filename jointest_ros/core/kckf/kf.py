"""`kf`: the paper's standard Kalman filter, without the kinematic constraint (Yumbla et al. 2023, section 3.1).

State, input, process and measurement of a joint are those of `kckf` (kckf.py), with nothing in common between joints.
The torso has no measurement: by (8) and (10) it is the integrated difference of the gyros of the last and first link.
"""

from __future__ import annotations

from jointest_ros.core.kckf.coordinate import GapRule
from jointest_ros.core.kckf.fusion import FusionParams, hinge_bank
from jointest_ros.core.kckf.joint_bank import JointBank
from jointest_ros.core.kckf.linkage import serial_linkage
from jointest_ros.core.kckf.linkage_estimator import LinkageEstimator
from jointest_ros.core.robot import Robot
from jointest_ros.core.timing import Timing


class Kf(LinkageEstimator):
    """The estimator of the module text.

    Raises:
        ConfigurationError: see `serial_linkage`.
    """

    name = "kf"
    Params = FusionParams
    params: FusionParams

    def __init__(self, robot: Robot, params: FusionParams | None = None, timing: Timing | None = None) -> None:
        chosen = params or FusionParams()
        linkage = serial_linkage(robot)
        by_links = chosen.composed and not linkage.hinges_only
        super().__init__(
            robot, chosen, timing, linkage, chosen.composed, by_links, gyro_torso=True, gap_rate_dps=chosen.gap_rate_dps
        )

    def _make_bank(self) -> JointBank:
        noise = self.params.process_noise(self.linkage).without_constraint()
        rule = GapRule.of(self.timing, self.params.gap_rate_dps)
        return hinge_bank(self.linkage, self.robot, self.params, noise, rule, self._by_links)
