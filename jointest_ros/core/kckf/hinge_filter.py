"""The KCKF of one hinge that shares no noise with others: two states in plain floats, 40 times the speed of numpy.

State        angle (rad), bias (rad/s): difference of the two gyro biases along the axis.
Input        rate (rad/s): difference of the two gyros along the axis, equation (9) with the sign of (6).
Process      angle+ = angle + (rate - bias) dt, bias+ = bias; noise: see process_noise.py.
Measurement  volts: V = V(angle) + noise of `HallSensor.variance`, one scalar update for each reading, linearised at the
             prediction; readings near the ends of the sensor's range are gated out.
             angles (the paper's): theta_h(V) = angle + noise of a constant standard deviation, equation (20).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from jointest_ros.core.frame import Status
from jointest_ros.core.hall_sensor import HallSensor
from jointest_ros.core.kckf.coordinate import LOOK_BACK, Coordinate, GapRule
from jointest_ros.core.kckf.process_noise import increments

# Above this variance, (3 deg)^2, the curve bends within the prior: a reading is taken by Gauss and Newton's iteration,
# from the angle that it stands for.
ITERATE_ABOVE = math.radians(3.0) ** 2
ITERATIONS = 20
SETTLED = 1e-10  # rad
_NO_DATA = int(Status.NO_DATA)
_STATE = ("angle", "bias", "var_angle", "covariance", "var_bias", "velocity", "status", "age")


class HingeFilter(Coordinate):
    """One hinge. Start values and noise are variances in rad and rad/s.

    Args:
        sensors: its Hall sensors with the indices of their voltages in a frame.
        noise: (paper, white rad^2/s, walk rad^2/s^3), see `process_noise.increments`.
        start: variances of angle and bias.
        hall_sigma: constant standard deviation of a Hall angle, rad; 0: measure in volts.
    """

    def __init__(
        self,
        sensors: Sequence[tuple[int, HallSensor]],
        noise: tuple[bool, float, float],
        start: tuple[float, float],
        rule: GapRule,
        hall_sigma: float = 0.0,
    ) -> None:
        self._noise, self._start = noise, start
        self._volts = not hall_sigma
        self._sensors = []
        for number, (index, hall) in enumerate(sensors):
            margin = hall.gate_margin if self._volts else 0.0
            low, high = hall.hall_range[0] + margin, hall.hall_range[1] - margin
            variance = hall.variance if self._volts else hall_sigma**2
            self._sensors.append((number, index, hall.sign, hall.offset, variance, low, high, hall.table))
        self._dt = math.nan
        self.bias, self.var_bias = 0.0, start[1]
        self._remember()
        super().__init__(rule, bool(sensors))
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.gated = [0] * len(self._sensors)
        self.innovations = [math.nan] * len(self._sensors)  # normalised, of the newest step; NaN: not used
        self.forget()

    def forget(self) -> None:
        """Start angle and bias afresh."""
        self.bias, self.var_bias = 0.0, self._start[1]
        self._remember()
        self.restart()

    def _remember(self) -> None:
        """What is known of the bias is all that was known of late."""
        self.earlier = ((self.bias, self.var_bias),) * 2  # two looks back, see `Coordinate`
        self.age = 0.0  # s since the newer one

    def restart(self) -> None:
        """Start the angle afresh; what was known of the bias shortly before is kept."""
        super().restart()
        self.bias, self.var_bias = self.earlier[0]
        self.angle, self.velocity = 0.0, 0.0
        self.var_angle, self.covariance = self._start[0], 0.0
        self.status = int(Status.STARTING)

    def start_from(self, bias: float, variance: float) -> None:
        """Before the first frame: what is known of the bias (rad/s), where that is more than the usual start knows."""
        if variance < self.var_bias:
            self.bias, self.var_bias = bias, variance
            self._remember()

    def step(self, dt: float, gap: float, rate: float, hall: Sequence[float] | None) -> None:
        """Predict over `dt` s (0: the first frame) with the gyro, then correct with the Hall voltages of the frame.

        `rate` rad/s, NaN: missing; `gap` s of `dt` lie before the interval that the gyro sample covers.
        """
        angle, bias = self.angle, self.bias
        paa, pab, pbb = self.var_angle, self.covariance, self.var_bias
        flags = 0
        if dt:
            if rate != rate or gap or self.missing:
                rate, shift, spread, flags = self.bridge(rate, dt, gap)
                angle += shift
                paa += spread
                if self.lost:
                    (bias, pbb), pab = self.earlier[0], 0.0
                if rate != rate:  # unknown: taken as standing still
                    rate = self.rate = bias
            else:
                self.rate = rate
                self.age += dt
                if self.age >= LOOK_BACK:
                    self.earlier, self.age = (self.earlier[1], (bias, pbb)), 0.0
            if dt != self._dt:
                self._dt = dt
                self._q_angle, self._q_cross, self._q_bias = increments(*self._noise, dt)
            angle += (rate - bias) * dt
            paa += dt * (dt * pbb - 2.0 * pab) + self._q_angle
            pab += self._q_cross - dt * pbb
            pbb += self._q_bias
        elif rate == rate:
            self.rate = rate
        else:
            flags = _NO_DATA
        used = present = False
        innovations = self.innovations
        for number, index, sign, offset, variance, low, high, table in self._sensors:
            reading = hall[index] if hall is not None else math.nan
            innovations[number] = math.nan
            if reading != reading or self.waiting:
                continue
            present = True
            if not low <= reading <= high:
                self.gated[number] += 1
                continue
            used = True
            if self._volts:
                steep = paa > ITERATE_ABOVE
                point = sign * table.angle(reading - offset) if steep else angle
                for _ in range(ITERATIONS):
                    expected, slope = table.voltage(sign * point)
                    h = sign * slope
                    innovation = reading - offset - expected - h * (angle - point)
                    total = h * h * paa + variance
                    if not steep:
                        break
                    before, point = point, angle + paa * h / total * innovation
                    if abs(point - before) < SETTLED:
                        break
            else:
                innovation, h = sign * table.angle(reading - offset) - angle, 1.0
                total = paa + variance
            ka, kb = paa * h / total, pab * h / total
            angle += ka * innovation
            bias += kb * innovation
            pbb -= kb * h * pab
            pab -= ka * h * pab
            paa -= ka * h * paa
            innovations[number] = innovation / math.sqrt(total)
        if used:
            self.blind, self.started = 0.0, True
        else:
            flags |= self.without_hall(dt, present)
        self.angle, self.bias, self.var_angle, self.covariance, self.var_bias = angle, bias, paa, pab, pbb
        self.velocity, self.status = self.rate - bias, flags

    def get_state(self) -> list[Any]:
        """All that changes."""
        return [
            *super().get_state(),
            list(self.gated),
            list(self.innovations),
            *(getattr(self, name) for name in _STATE),
            [list(one) for one in self.earlier],
        ]

    def set_state(self, state: list[Any]) -> None:
        """Continue from `get_state`."""
        super().set_state(state[:5])
        self.gated, self.innovations = list(state[5]), list(state[6])
        for name, value in zip(_STATE, state[7:-1], strict=True):
            setattr(self, name, value)
        (bias, variance), (newer_bias, newer_variance) = state[-1]
        self.earlier = (bias, variance), (newer_bias, newer_variance)
