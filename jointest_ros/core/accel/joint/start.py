"""When and from where the filter on the joint model starts: at samples that tell the angle."""

from __future__ import annotations

import numpy as np

from jointest_ros.core.accel.array import JointArrays
from jointest_ros.core.accel.joint.model import ANGLE
from jointest_ros.core.accel.reader import Reader
from jointest_ros.core.accel.start import evidence, hypotheses
from jointest_ros.core.frame import FloatArray


class JointStart:
    """Watches for such samples; one is enough where the force at the joint is well above noise and biases.

    Attributes:
        told: 1/rad^2, of the latest samples in a row.
    """

    def __init__(self, arrays: JointArrays) -> None:
        self._reader = Reader(arrays)
        self._variances: tuple[FloatArray, FloatArray] | None = None  # as given, and with the biases
        self.told = 0.0

    def clear(self) -> None:
        """Forget the latest samples, and the uncertainty of the biases."""
        self._variances = None
        self.told = 0.0

    def offer(
        self, channels: FloatArray, variances: FloatArray, bias: FloatArray, bias_covariance: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """States [w_a, w_b, th] (4, 3) to start from with this sample, and their variances; None: not with this one.

        Args:
            channels, variances: see `PairFilter.step`.
            bias, bias_covariance: (C), (C, C) of the channels; (0), (0, 0) where the model has none. The covariance is
                looked at once for all samples until a start.
        """
        if self._variances is None or self._variances[0] is not variances:
            self._variances = variances, variances + (np.diagonal(bias_covariance) if len(bias) else 0.0)
        read = self._reader.read(channels - bias if len(bias) else channels, self._variances[1])
        if read is None:
            return None
        starts = hypotheses(*read)
        states, spreads = np.array([state for state, _ in starts]), np.array([spread for _, spread in starts])
        self.told, enough = evidence(self.told, float(spreads[0, ANGLE]))
        if not enough:
            return None
        self.clear()
        return states, spreads
