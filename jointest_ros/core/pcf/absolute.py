"""The `absolute` formulation of the PCF: R12 = R1^T R2 of the filters of two IMUs."""

from __future__ import annotations

from collections.abc import Sequence

from jointest_ros.core.frame import Frame, Quat, Vec3
from jointest_ros.core.pcf.attitude import Gains, heading_difference
from jointest_ros.core.pcf.imu import AbsoluteImu, Gaps
from jointest_ros.core.pcf.pair import JointOutput, Pair
from jointest_ros.core.pcf.settings import BiasNoise
from jointest_ros.core.robot import Joint
from jointest_ros.core.rotation import conjugate, multiply, rotate_inverse


class AbsolutePair(Pair):
    """R1^T R2 of two filters of Algorithm 1, which the estimator has updated already.

    Without magnetometers every IMU has a heading of its own. Where the pair starts, the child and all IMUs `below` it
    in the tree are turned about the vertical, so that the joint is in its place.
    """

    def __init__(
        self,
        joint: Joint,
        parent: AbsoluteImu,
        child: AbsoluteImu,
        below: Sequence[AbsoluteImu],
        gains: Gains,
        gaps: Gaps,
        bias: BiasNoise,
    ) -> None:
        self._one, self._two, self._below = parent, child, below
        super().__init__(joint, parent.imu.sensor, child.imu.sensor, gains, gaps, bias)

    def update(self, frame: Frame) -> JointOutput:
        """Take the angles from the two attitudes."""
        one, two = self._one, self._two
        if one.stamp != frame.stamp or two.stamp != frame.stamp:
            return self._extrapolate(frame.stamp)
        self._saturated = bool(self._saturation) and self._saturation.any(frame.gyro)
        a2 = frame.accel[self.child.name]
        elapsed = 0.0 if self.stamp is None else (frame.stamp - self.stamp) * 1e-9
        if self.stamp is None or (len(self.axes) == 1 and elapsed > self.gaps.max_gap):
            self._turn_to(self.first_guess(frame.accel[self.parent.name], a2))
        if one.mag_stamp is not None and two.mag_stamp is not None:
            self.mag_stamp, self.disturbed = min(one.mag_stamp, two.mag_stamp), one.disturbed or two.disturbed
            self.field = frame.mag.get(self.child.name, self.field)
        r12 = multiply(conjugate(one.attitude.rotation), two.attitude.rotation)
        w1, w2, i1, i2 = one.imu.before, two.imu.before, one.attitude.integral, two.attitude.integral
        x, y, z = rotate_inverse(r12, (w1[0] + i1[0], w1[1] + i1[1], w1[2] + i1[2]))
        rate = (w2[0] + i2[0] - x, w2[1] + i2[1] - y, w2[2] + i2[2] - z)
        return self._output(frame.stamp, r12, rate, a2, elapsed)

    def _turn_to(self, r12: Quat) -> None:
        """Give the child the heading with which R1^T R2 comes nearest to `r12`."""
        if self.gains.mag_weight:
            return
        one, two = self._one.attitude, self._two.attitude
        turn = heading_difference(multiply(one.rotation, r12), two.rotation)
        for imu in (self._two, *self._below):
            imu.attitude.rotation = multiply(turn, imu.attitude.rotation)

    def set_zero(self, accel: dict[str, Vec3]) -> None:
        super().set_zero(accel)
        self._turn_to(self.at_zero)

    def biases(self) -> dict[str, float]:
        """None: they are those of the single IMUs."""
        return {}
