"""Accelerometers averaged where gravity does not turn: in the frame that the gyro carries along."""

from __future__ import annotations

import math

from jointest_ros.core.frame import Vec3


class AccelAverage:
    """Average of an accelerometer over the last `time` s in the frame that its gyro carries along, read in its own.

    There the accelerations of links that go back and forth cancel, and gravity stays; an angle made of single samples
    keeps what is in step with the motion. Only for gyros without bias, which would carry the average away. The idea is
    VQF's (Laidig, Seel 2023), whose low pass is of second order.
    """

    def __init__(self, time: float) -> None:
        self.time = time  # s
        self.restart()

    def restart(self) -> None:
        """Start afresh from the next sample."""
        self.value: Vec3 | None = None
        self.age = 0.0  # s, mean age of what is in the average

    def add(self, rate: Vec3, accel: Vec3, elapsed: float) -> Vec3:
        """Take a sample (rad/s, m/s^2) `elapsed` s after the last one; NaN: it is the first one, or after a gap."""
        if elapsed != elapsed or self.value is None:
            self.value, self.age = accel, 0.0
            return accel
        # at first the mean of all samples, later exponentially forgotten
        share = elapsed / min(self.time + elapsed, 2.0 * (self.age + elapsed))
        self.age = (1.0 - share) * (self.age + elapsed)
        x, y, z = rate[0] * elapsed, rate[1] * elapsed, rate[2] * elapsed
        square = x * x + y * y + z * z
        if square < 0.01:  # sin(t)/t and (1 - cos t)/t^2 by their series: exact to 1e-12 here
            s, c = 1.0 - square * (1.0 / 6.0 - square / 120.0), 0.5 - square * (1.0 / 24.0 - square / 720.0)
        else:
            angle = math.sqrt(square)
            s, c = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
        gx, gy, gz = self.value
        px, py, pz = y * gz - z * gy, z * gx - x * gz, x * gy - y * gx
        gx, gy, gz = (
            gx - s * px + c * (y * pz - z * py),
            gy - s * py + c * (z * px - x * pz),
            gz - s * pz + c * (x * py - y * px),
        )
        self.value = (
            gx + share * (accel[0] - gx),
            gy + share * (accel[1] - gy),
            gz + share * (accel[2] - gz),
        )
        return self.value

    def get_state(self) -> list[float]:
        """All that changes, as plain numbers; empty before the first sample."""
        return [] if self.value is None else [*self.value, self.age]

    def set_state(self, state: list[float]) -> None:
        """Continue from `get_state`."""
        self.restart()
        if state:
            x, y, z, self.age = state
            self.value = (x, y, z)
