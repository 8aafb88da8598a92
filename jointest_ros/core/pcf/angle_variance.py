"""How well Algorithm 2 knows an angle of the rotation between two IMUs.

With the error d of the angle (rad) and b of the difference of the gyro biases about it (rad/s), a step makes of them

    d+ = d - (Kp s d + b) dt,    b+ = b + Ki s d dt

where s is what is seen of d: 1 for the tilt, by the accelerometers; for the turn about gravity what magnetometers and
the axes of the joint show of it. Their covariance follows, with the noise N^2 dt of both gyros, that of the correction,
(Kp^2 + Ki) s r dt (section 4 of the specification), and the walk of the bias. What is not seen has N^2 t + (bias t)^2.
"""

from __future__ import annotations

import math

from jointest_ros.core.pcf.attitude import Gains
from jointest_ros.core.pcf.settings import BiasNoise

UNKNOWN_VARIANCE = math.pi**2 / 3.0  # rad^2, of an angle of which nothing is known


class AngleVariance:
    """The covariance of (d, b) of the module text."""

    def __init__(self, gains: Gains, gyro_density2: float, correction_density2: float, bias: BiasNoise) -> None:
        """`gyro_density2` N^2 in (rad/s)^2/Hz, `correction_density2` r in rad^2 s."""
        self._kp, self._ki, self._gyro_density2, self._bias = gains.kp, gains.ki, gyro_density2, bias
        self._correction_density2 = (gains.kp**2 + gains.ki) * correction_density2
        self._bias_walk2 = bias.walk**2
        self.p00 = self.p01 = 0.0
        self.calibrate()

    def begin(self, variance: float) -> None:
        """The angle is known up to `variance`, rad^2, and the bias as it was calibrated."""
        self.p00, self.p01, self.p11 = variance, 0.0, self.calibrated

    def calibrate(self, deviation: float | None = None) -> None:
        """The bias is known up to `deviation`, rad/s; None: not at all."""
        self.calibrated = (self._bias.std if deviation is None else deviation) ** 2
        self.p01, self.p11 = 0.0, self.calibrated

    def step(self, dt: float, seen: float, added: float) -> float:
        """`dt` s later, of which `seen` is s, and with `added` rad^2 that nobody measured: the variance of d."""
        p00, p01, p11 = self.p00, self.p01, self.p11
        kept, learnt = self._kp * seen * dt, self._ki * seen * dt
        kept = 1.0 - kept if kept < 1.0 else 0.0
        before = kept * p01 - dt * p11
        p01 = learnt * (kept * p00 - dt * p01) + before
        p11 += learnt * (learnt * p00 + 2.0 * self.p01) + self._bias_walk2 * dt
        p00 = kept * (kept * p00 - dt * self.p01) - dt * before
        p00 += (self._gyro_density2 + self._correction_density2 * seen) * dt + added
        if p00 > UNKNOWN_VARIANCE:
            p00, p01 = UNKNOWN_VARIANCE, p01 * math.sqrt(UNKNOWN_VARIANCE / p00)
        self.p00, self.p01, self.p11 = p00, p01, p11
        return p00

    def get_state(self) -> list[float]:
        """All that changes."""
        return [self.p00, self.p01, self.p11, self.calibrated]

    def set_state(self, state: list[float]) -> None:
        """Continue from `get_state`."""
        self.p00, self.p01, self.p11, self.calibrated = state
