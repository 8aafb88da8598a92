"""`accel_ekf`: joint angles from two or more accelerometers on either link of a joint, by an extended Kalman filter.

model: joint   rates, angle, angular accelerations and jerks of both links, measured by the readings themselves; a bias
               of every channel (see joint/model.py for states and equations, joint/filter.py for start and recovery).
model: paper   rates and angle; the angular accelerations of (10) are its input, w^2 and the force at the joint its
               measurement, (13)-(22) with the noise that both have in common done right (see paper/model.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointest_ros.core.accel.array import JointArrays
from jointest_ros.core.accel.estimator import AccelEstimator
from jointest_ros.core.accel.joint.filter import JointFilter
from jointest_ros.core.accel.joint.model import ModelNoise
from jointest_ros.core.accel.joint.smoother import Snapshot, smooth_steps
from jointest_ros.core.accel.pair_filter import PairFilter
from jointest_ros.core.accel.paper.linearise import linearise_ekf
from jointest_ros.core.accel.paper.pair import PaperPair
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import Estimate, Recording, Series
from jointest_ros.core.learned import Bias, Learned, fingerprint
from jointest_ros.core.params import Params, param
from jointest_ros.core.robot import STANDARD_GRAVITY


@dataclass(frozen=True)
class AccelEkfParams(Params):
    """The `estimators: accel_ekf:` section of a configuration."""

    model: str = param("joint", "which state: see the estimator's page", choices=("joint", "paper"))
    bias: bool = param(True, "joint: estimate a bias of every channel; false for sensors that are known to have none")
    bias_std: float = param(
        0.2, "joint: standard deviation of such a bias at the start", unit="m/s^2", low=1e-4, high=10.0
    )
    bias_walk: float = param(0.015, "joint: random walk of such a bias", unit="m/s^2/sqrt(s)", low=0.0, high=1.0)
    noise_floor_ug: float = param(
        1000.0,
        "joint with biases: the noise of a sensor is taken to be at least this; with less the filter trusts its own "
        "linearisation too far, and is led astray by errors that are no noise",
        unit="ug/sqrt(Hz)",
        low=0.0,
        high=1e6,
    )
    snap_density: float = param(
        1e5,
        "joint: density of the white snap (third derivative of the angular velocity) of a link; the estimate follows "
        "faster movements when it is higher, and is noisier",
        unit="rad^2/s^7",
        low=1.0,
        high=1e12,
    )


class AccelEkf(AccelEstimator):
    """The estimator of the module text. Joint positions are child relative to parent about +axis.

    `smooth` is for recordings.

    Raises:
        ConfigurationError: see `joint_arrays`.
    """

    name = "accel_ekf"
    Params = AccelEkfParams
    params: AccelEkfParams

    def _least_noise(self) -> float:
        p = self.params
        return 1e-6 * STANDARD_GRAVITY * p.noise_floor_ug if p.model == "joint" and p.bias else 0.0

    def _make_filter(self, arrays: JointArrays) -> PairFilter:
        p = self.params
        if p.model == "paper":
            return PaperPair(arrays, linearise_ekf, self.timing.max_gap)
        return JointFilter(arrays, ModelNoise(p.snap_density, p.bias, p.bias_std, p.bias_walk), self.timing.max_gap)

    def reset(self) -> None:
        """Forget everything of this run."""
        super().reset()
        known = self._learned_before(self.biases())
        if known is not None:
            for one, channels in zip(self._filters, self._channel_names, strict=True):
                if isinstance(one, JointFilter):
                    one.start_from([known.biases[name] for name in channels])

    def learned(self) -> Learned | None:
        """Biases of the channels; None where none are estimated, and before the first frame."""
        biases: dict[str, Bias] = {}
        for one, channels in zip(self._filters, self._channel_names, strict=True):
            if isinstance(one, JointFilter):
                biases |= zip(channels, zip(one.biases(), one.bias_deviations(), strict=True), strict=False)
        return Learned(fingerprint(self.robot), biases) if biases and self._last is not None else None

    def _changed_frozen(self, began: set[str], ended: set[str]) -> None:
        for one, names in zip(self._filters, self._names, strict=True):
            if isinstance(one, JointFilter):
                if not began.isdisjoint(names):
                    one.keep_biases()
                if not ended.isdisjoint(names):
                    one.take_back_biases()

    def smooth(self, recording: Recording) -> Series:
        """Estimates of a whole recording, each from all of it: what was before and what comes after.

        It starts afresh. Memory grows with the recording: 2 kB for each joint and frame with two sensors on a link.

        Raises:
            ConfigurationError: `model: paper` has no smoother.
        """
        filters = [one for one in self._filters if isinstance(one, JointFilter)]
        if len(filters) < len(self._filters):
            raise ConfigurationError(f"model: '{self.params.model}' is not allowed with smoothing; give joint")
        self.reset()
        filters = [one for one in self._filters if isinstance(one, JointFilter)]
        steps: list[list[Snapshot | None]] = [[] for _ in filters]
        estimates: list[Estimate] = []
        last: int | None = None
        for frame in recording.frames():
            estimates.append(self.update(frame))
            dt = 0.0 if last is None or frame.reset else (frame.stamp - last) * 1e-9
            last = frame.stamp
            for one, row in zip(filters, steps, strict=True):
                row.append(one.snapshot(dt))
        series = Series.from_estimates(estimates, len(self.joints))
        for column, (one, row) in enumerate(zip(filters, steps, strict=True)):
            w_a, w_b, angle, variance = smooth_steps(one.model, row).T
            known = np.isfinite(angle)
            for table, values in ((series.position, -angle), (series.velocity, w_b - w_a), (series.variance, variance)):
                table[known, column] = values[known]
        return series
