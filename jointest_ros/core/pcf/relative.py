"""The `relative` formulation of the PCF: R12 is the state of one filter."""

from __future__ import annotations

import math
from typing import Any

from jointest_ros.core.frame import Frame, Vec3
from jointest_ros.core.pcf.attitude import STILL, ComplementaryFilter, Gains
from jointest_ros.core.pcf.imu import Gaps, Imu, bridge
from jointest_ros.core.pcf.lever_arm import arms
from jointest_ros.core.pcf.pair import JointOutput, Pair
from jointest_ros.core.pcf.settings import NO_SMOOTHING, BiasNoise, Smoothing
from jointest_ros.core.robot import Joint, Sensor
from jointest_ros.core.rotation import rotate_inverse


class RelativePair(Pair):
    """Algorithm 2 on the two sensors of a joint."""

    def __init__(
        self,
        joint: Joint,
        parent: Sensor,
        child: Sensor,
        gains: Gains,
        gaps: Gaps,
        bias: BiasNoise,
        smoothing: Smoothing = NO_SMOOTHING,
    ) -> None:
        arm1, arm2 = arms(joint, parent, child) if smoothing.lever_arms else (None, None)
        self._imu1, self._imu2 = Imu(parent, smoothing, arm1), Imu(child, smoothing, arm2)
        self.filter = ComplementaryFilter(gains)
        super().__init__(joint, parent, child, gains, gaps, bias)

    def update(self, frame: Frame) -> JointOutput:
        """One step."""
        one_filter, gaps = self.filter, self.gaps
        elapsed = since = 0.0 if self.stamp is None else (frame.stamp - self.stamp) * 1e-9
        if self.stamp is None or elapsed > gaps.max_gap:
            since = math.nan
        one, two = self._imu1.read(frame, since, STILL), self._imu2.read(frame, since, one_filter.integral)
        if one is None or two is None:
            return self._extrapolate(frame.stamp)
        self._saturated = bool(self._saturation) and self._saturation.any(frame.gyro)
        (w1, a1), (w2, a2) = one, two
        measured = elapsed if elapsed <= 1.5 * frame.period else gaps.measured(elapsed, frame.period)
        mean1, mean2, turned = w1, w2, elapsed
        if since != since:  # nobody knows: gravity alone, and no turn
            turned = 0.0
            if self.stamp is None or len(self.axes) == 1:
                one_filter.rotation = self.first_guess(a1, a2)
            else:
                one_filter.align(a1, a2)
        elif measured < elapsed:
            mean1 = bridge(self._imu1.before, w1, elapsed, measured)
            mean2 = bridge(self._imu2.before, w2, elapsed, measured)
        m1 = m2 = None
        field_time = 0.0
        if self.gains.mag_weight:
            m1, m2 = self._imu1.sound_field(frame), self._imu2.sound_field(frame)
            self.disturbed = self._imu1.watch.disturbed or self._imu2.watch.disturbed
            if m1 is not None and m2 is not None:
                field_time = gaps.hold(frame.stamp, self.mag_stamp, measured)
                self.mag_stamp, self.field = frame.stamp, m2
        axes = STILL
        if self._two_axes is not None and self.gains.axes_weight:
            axes, seen = self._two_axes.correction(one_filter.rotation, a2)
            self._axes_seen = self.gains.axes_weight * seen
        rate = one_filter.step(turned, measured, mean1, mean2, a1, a2, m1, m2, field_time, axes)
        self._imu1.before, self._imu2.before = w1, w2
        return self._output(frame.stamp, one_filter.rotation, rate, a2, elapsed)

    def set_bias(self, gyro: dict[str, Vec3], deviation: float) -> None:
        """Gyro biases measured at rest, rad/s by sensor, and the standard deviation of their difference."""
        super().set_bias(gyro, deviation)
        self._imu1.bias, self._imu2.bias = gyro[self.parent.name], gyro[self.child.name]
        self.filter.integral = STILL

    def set_zero(self, accel: dict[str, Vec3]) -> None:
        super().set_zero(accel)
        self.filter.rotation = self.at_zero

    def reset(self) -> None:
        """Forget angles and biases; the zero pose is kept."""
        super().reset()
        self.filter.integral = STILL
        for imu in (self._imu1, self._imu2):
            imu.reset()

    def restart(self) -> None:
        super().restart()
        for imu in (self._imu1, self._imu2):
            imu.restart()

    def biases(self) -> dict[str, float]:
        """Bias difference, child minus parent in the child's sensor, rad/s: calibrated part less the integral."""
        parent = rotate_inverse(self.filter.rotation, self._imu1.bias)
        parts = zip("xyz", self._imu2.bias, parent, self.filter.integral, strict=True)
        return {f"{self.joint.name}.gyro_{c}": b2 - b1 - i for c, b2, b1, i in parts}

    def get_state(self) -> dict[str, Any]:
        return super().get_state() | {
            "rotation": list(self.filter.rotation),
            "integral": list(self.filter.integral),
            "imus": [imu.get_state() for imu in (self._imu1, self._imu2)],
        }

    def set_state(self, state: dict[str, Any]) -> None:
        super().set_state(state)
        self.filter.rotation, self.filter.integral = tuple(state["rotation"]), tuple(state["integral"])
        for imu, saved in zip((self._imu1, self._imu2), state["imus"], strict=True):
            imu.set_state(saved)
