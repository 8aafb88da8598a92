"""`gyro`: joint angles by integrating gyros alone, from zero: the baseline of Yumbla et al. 2023, equation (2).

angle+ = angle + (rate - bias) dt, rate = w_child - R^T w_parent. Nothing corrects it. The torso is the integrated
difference of the last and the first gyro, as in (10).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from jointest_ros.core.coordinate import GapRule
from jointest_ros.core.joint_bank import HingeBank, JointBank
from jointest_ros.core.kckf_hinge import HingeFilter
from jointest_ros.core.linkage import gyro_linkage
from jointest_ros.core.linkage_estimator import GAP_RATE_TEXT, KINEMATICS, KINEMATICS_TEXT, LinkageEstimator
from jointest_ros.core.linkage_rates import ComposedRates
from jointest_ros.core.params import Params, param
from jointest_ros.core.process_noise import ProcessNoise
from jointest_ros.core.robot import Robot
from jointest_ros.core.timing import Timing


@dataclass(frozen=True)
class GyroParams(Params):
    """The `estimators: gyro:` section of a configuration."""

    kinematics: str = param("composed", KINEMATICS_TEXT, choices=KINEMATICS)
    bias_dps: float = param(
        1.0, "standard deviation of the difference of two gyro biases, for the variance", unit="deg/s", low=0.0, high=100.0
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
        filters = [
            HingeFilter([], (False, float(noise.white[k, k]), float(noise.walk[k, k])), start, rule)
            for k in range(len(self.joints))
        ]
        return HingeBank(self.linkage, filters, len(self.robot.hall), ComposedRates(self.linkage) if self._by_links else None)
