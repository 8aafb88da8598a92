"""`accel_ukf`: the paper's unscented Kalman filter on accelerometer arrays (Woods & Vikas, III.C).

The model of paper/model.py, one filter for each joint (paper/pair.py) with the linearisation over sigma points
(paper/linearise.py). It gives what `accel_ekf` with `model: paper` gives, within a few percent of its error; the joint
model of `accel_ekf` is better.
"""

from __future__ import annotations

from dataclasses import dataclass

from jointest_ros.core.accel.array import JointArrays
from jointest_ros.core.accel.estimator import AccelEstimator
from jointest_ros.core.accel.paper.linearise import ukf
from jointest_ros.core.accel.paper.pair import PaperPair
from jointest_ros.core.params import Params, param


@dataclass(frozen=True)
class AccelUkfParams(Params):
    """The `estimators: accel_ukf:` section of a configuration."""

    alpha: float = param(1.0, "how far the sigma points lie from the mean, alpha of (22)", low=1e-3, high=1.0)
    kappa: float = param(0.0, "the same, kappa of (22)", low=0.0, high=10.0)


class AccelUkf(AccelEstimator):
    """The estimator of the module text.

    Raises:
        ConfigurationError: see `joint_arrays`.
    """

    name = "accel_ukf"
    Params = AccelUkfParams
    params: AccelUkfParams

    def _make_filter(self, arrays: JointArrays) -> PaperPair:
        return PaperPair(arrays, ukf(self.params.alpha, self.params.kappa), self.timing.max_gap)
