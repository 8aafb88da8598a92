"""What the estimators on accelerometer arrays share: time, channels, distrusted sensors, status; the joints one by one.

A joint position is that of the child relative to the parent: -th_ab of the filters (`PairFilter`); its velocity is
w_b - w_a, the angular velocities of the links about the joint's axis.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import Counter
from typing import Any

import numpy as np

from jointest_ros.core.accel.array import JointArrays, joint_arrays
from jointest_ros.core.accel.pair_filter import PairFilter
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, FloatArray, Frame, Status, Vec3
from jointest_ros.core.input_quality import Frozen, saturation
from jointest_ros.core.params import Params
from jointest_ros.core.robot import Robot
from jointest_ros.core.timing import Timing

UNKNOWN_PERIOD = 0.01  # s, taken where the period of the stream is not known yet
_LEAST_VARIANCE = 1e-8  # (m/s^2)^2, where somebody states that a sensor has no noise
_MISSING: Vec3 = (math.nan,) * 3
# Sums of IntFlag members cost half a microsecond each: plain numbers here.
_NO_DATA, _GAP, _STALE = int(Status.NO_DATA), int(Status.GAP), int(Status.STALE)
_DISTURBED = int(Status.DISTURBED)


class AccelEstimator(Estimator):
    """Base of `accel_analytical`, `accel_ekf` and `accel_ukf`, which make the filters.

    Raises:
        ConfigurationError: see `joint_arrays`.
    """

    unobservable = "the force at the joint is too weak to tell its angle"

    def __init__(self, robot: Robot, params: Params | None = None, timing: Timing | None = None) -> None:
        super().__init__(robot, params, timing)
        self.arrays = joint_arrays(robot)
        self.joints = tuple(one.joint.name for one in self.arrays)
        sensors = {sensor.name: sensor for one in self.arrays for sensor in one.sensors}
        self._names = [[sensor.name for sensor in one.sensors] for one in self.arrays]
        self._projections = [one.projections for one in self.arrays]
        least = self._least_noise()
        densities = [[max(sensor.accel_noise, least) for sensor in one.sensors] for one in self.arrays]
        self._spectra = [np.repeat(np.square(density), 2) for density in densities]  # (m/s^2)^2/Hz of the channels
        self._saturated = {s.name: saturation(s) for s in sensors.values() if math.isfinite(s.accel_range)}
        self._frozen = Frozen(sensors.values(), after=0)
        self._link_names = _link_names(self.arrays)
        self.reset()

    def _least_noise(self) -> float:
        """The noise density that is assumed of every accelerometer at least, m/s^2/sqrt(Hz)."""
        return 0.0

    def _changed_frozen(self, began: set[str], ended: set[str]) -> None:
        """Sensors began or ceased to be frozen: for filters that learn of their readings more than the motion."""

    @abstractmethod
    def _make_filter(self, arrays: JointArrays) -> PairFilter:
        """A filter of one joint before its first sample."""

    def reset(self) -> None:
        """Forget everything but parameters."""
        self._filters = [self._make_filter(one) for one in self.arrays]
        self._frozen.clear()
        self._last: int | None = None
        self._silent = [0.0] * len(self.joints)  # s since a joint was corrected
        self._set_period(math.nan)

    def _set_period(self, period: float) -> None:
        """Variances of the channels: their noise density over the bandwidth of half the rate."""
        self._period = period
        bandwidth = 0.5 / (period if period == period else UNKNOWN_PERIOD)
        self._variances = [np.maximum(spectrum * bandwidth, _LEAST_VARIANCE) for spectrum in self._spectra]

    def update(self, frame: Frame) -> Estimate:
        """Predict every joint to the stamp of the frame, then correct it with what the frame has of its sensors."""
        if frame.reset:
            self._restart()
        stamp, last = frame.stamp, self._last
        self._last = stamp
        dt = 0.0 if last is None else (stamp - last) * 1e-9
        if frame.period == frame.period and frame.period != self._period:
            self._set_period(frame.period)
        readings, distrusted = self._readings(frame)
        position, velocity, variance, status = [], [], [], []
        for number, (one, names) in enumerate(zip(self._filters, self._names, strict=True)):
            present = [readings.get(name, _MISSING) for name in names]
            channels = np.matmul(self._projections[number], np.array(present)[:, :, None]).ravel()
            corrected = one.step(dt, channels, self._variances[number])
            w_a, w_b = one.rates
            position.append(-one.angle)
            velocity.append(w_b - w_a)
            variance.append(one.variance)
            flags = one.status | self._timing_flags(number, dt, corrected)
            if _MISSING in present:
                doubtful = not distrusted.isdisjoint(names)
                absent = not corrected or any(name not in frame.accel for name in names)
                flags |= (_DISTURBED if doubtful else 0) | (_NO_DATA if absent else 0)
            status.append(flags)
        return Estimate(stamp, tuple(position), tuple(velocity), tuple(variance), tuple(status))

    def _readings(self, frame: Frame) -> tuple[dict[str, Vec3], set[str]]:
        """(accelerations to be used, sensors that are saturated or frozen)."""
        accel = frame.accel
        before = set(self._frozen.since)
        self._frozen.update(frame.stamp, accel, frame.gyro)
        distrusted = set(self._frozen.since)
        if before != distrusted:
            self._changed_frozen(distrusted - before, before - distrusted)
        for name, is_saturated in self._saturated.items():
            if name in accel and is_saturated(accel[name]):
                distrusted.add(name)
        if not distrusted:
            return accel, distrusted
        return {name: reading for name, reading in accel.items() if name not in distrusted}, distrusted

    def _timing_flags(self, number: int, dt: float, corrected: bool) -> int:
        """Note how long a joint has gone without a correction, and say so."""
        silent = self._silent[number] + dt
        self._silent[number] = 0.0 if corrected else silent
        flags = _GAP if silent > self.timing.max_gap else 0
        if not corrected:
            flags |= _NO_DATA | (_STALE if silent > self.timing.stale_after else 0)
        return flags

    def _restart(self) -> None:
        for one in self._filters:
            one.restart()
        self._frozen.clear()
        self._last = None
        self._silent = [0.0] * len(self.joints)

    def get_state(self) -> dict[str, Any]:
        """The whole state as plain numbers, lists and dicts."""
        return {
            "last": self._last,
            "period": self._period,
            "silent": list(self._silent),
            "frozen": self._frozen.get_state(),
            "joints": {name: one.get_state() for name, one in zip(self.joints, self._filters, strict=True)},
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue identically from what `get_state` returned."""
        self._last, self._silent = state["last"], list(state["silent"])
        self._set_period(state["period"])
        self._frozen.set_state(state["frozen"])
        for name, one in zip(self.joints, self._filters, strict=True):
            one.set_state(state["joints"][name])

    def covariance(self) -> FloatArray:
        """Diagonal: the joints are estimated one by one."""
        return np.diag([one.variance for one in self._filters])

    def innovations(self) -> list[float]:
        """Of the newest frame over their standard deviations, joint after joint in the order of the channels."""
        return [value for one in self._filters for value in one.innovations()]

    def innovation_joints(self) -> tuple[str, ...]:
        """See `Estimator`."""
        rows = zip(self.joints, self._filters, strict=True)
        return tuple([joint for joint, one in rows for _ in one.innovations()])

    def biases(self) -> dict[str, float]:
        """Accelerometer biases, m/s^2: `<sensor>.x` and `.y` in the plane of motion, axes of the link.

        `<joint>.<sensor>.x` where a sensor serves two joints.
        """
        biases: dict[str, float] = {}
        for channels, one in zip(self._channel_names, self._filters, strict=True):
            biases.update(zip(channels, one.biases(), strict=False))
        return biases

    @property
    def _channel_names(self) -> list[list[str]]:
        """Of the channels of each joint, as in `biases`."""
        shared = _repeated(name for names in self._names for name in names)
        return [
            [f"{joint}.{name}.{c}" if name in shared else f"{name}.{c}" for name in names for c in "xy"]
            for joint, names in zip(self.joints, self._names, strict=True)
        ]

    def link_velocities(self) -> dict[str, float]:
        """Angular velocities of the links about the joint's axis, rad/s: `<link>`; `<joint>.<link>` of two joints."""
        rates = [rate for one in self._filters for rate in one.rates]
        return dict(zip(self._link_names, rates, strict=True))


def _repeated(names: Any) -> set[str]:
    return {name for name, number in Counter(names).items() if number > 1}


def _link_names(arrays: tuple[JointArrays, ...]) -> list[str]:
    joints = [one.joint for one in arrays]
    shared = _repeated(link for joint in joints for link in (joint.parent, joint.child))
    return [
        f"{joint.name}.{link}" if link in shared else link for joint in joints for link in (joint.parent, joint.child)
    ]
