"""Filters for all coordinates of a linkage: what an estimator needs of them, and the bank that has them one by one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.kckf.coordinate import UNKNOWN
from jointest_ros.core.kckf.hinge_filter import HingeFilter
from jointest_ros.core.kckf.linkage import Linkage
from jointest_ros.core.learned import GYRO_DRIFT, Bias

Rates = Callable[[Sequence[Vec3], Sequence[float]], list[float]]


class JointBank(Protocol):
    """What an estimator needs.

    Attributes:
        angles, velocities, variances: (m) rad, rad/s, rad^2.
        status: (m) flags.
    """

    angles: list[float]
    velocities: list[float]
    variances: list[float]
    status: list[int]

    def step(self, dt: float, gap: float, rates: Sequence[Any], hall: Sequence[float] | None) -> None:
        """One frame: `rates` are (m) rad/s, or (g) rates of links where the joints need kinematics; NaN: missing."""
        ...

    def restart(self) -> None:
        """Start the angles afresh; keep what is known of biases and offsets."""
        ...

    def forget(self, coordinate: int) -> None:
        """What is known of a coordinate is wrong: start its angle and bias afresh."""
        ...

    def spread(self, coordinate: int, variance: float) -> None:
        """The angle of a coordinate is less sure by so much, rad^2."""
        ...

    def covariance(self) -> FloatArray:
        """(m, m) rad^2."""
        ...

    def biases(self) -> dict[str, float]:
        """By name, rad/s and V."""
        ...

    def learned(self) -> dict[str, Bias]:
        """`biases` with their standard deviations."""
        ...

    def start_from(self, biases: Mapping[str, Bias]) -> None:
        """Before the first frame: what another one has `learned`, as a prior (learned.py)."""
        ...

    def innovations(self) -> list[float]:
        """Normalised, one for each Hall sensor of the robot; NaN: not used."""
        ...

    def gated(self) -> list[int]:
        """Readings since the start that were refused for being outside or near the end of the range, by Hall sensor."""
        ...

    def get_state(self) -> Any:
        """All that changes, as plain numbers."""
        ...

    def set_state(self, state: Any) -> None:
        """Continue from `get_state`."""


class HingeBank:
    """Coordinates one by one. `rates_of`: kinematics of joints with several axes, where needed."""

    def __init__(self, linkage: Linkage, filters: Sequence[HingeFilter], sensors: int, rates_of: Rates | None) -> None:
        self.filters = list(filters)
        self._linkage, self._sensors, self._rates_of = linkage, sensors, rates_of
        self._collect()

    def step(self, dt: float, gap: float, rates: Sequence[Any], hall: Sequence[float] | None) -> None:
        """See `JointBank`."""
        if self._rates_of is not None:
            half = 0.5 * dt
            middle = [q + half * v for q, v in zip(self.angles, self.velocities, strict=True)]
            rates = self._rates_of(rates, middle)
        for one, rate in zip(self.filters, rates, strict=True):
            one.step(dt, gap, rate, hall)
        self._collect()

    def _collect(self) -> None:
        filters = self.filters
        self.angles = [one.angle for one in filters]
        self.velocities = [one.velocity for one in filters]
        self.variances = [one.var_angle for one in filters]
        self.status = [one.status for one in filters]

    def restart(self) -> None:
        """See `JointBank`."""
        for one in self.filters:
            one.restart()
        self._collect()

    def forget(self, coordinate: int) -> None:
        """See `JointBank`."""
        self.filters[coordinate].forget()
        self._collect()

    def spread(self, coordinate: int, variance: float) -> None:
        """See `JointBank`."""
        one = self.filters[coordinate]
        one.var_angle = max(one.var_angle, min(one.var_angle + variance, UNKNOWN))

    def covariance(self) -> FloatArray:
        """See `JointBank`: no two are correlated."""
        return np.diag(self.variances)

    def biases(self) -> dict[str, float]:
        """Differences of gyro biases along the axis, child minus parent, by coordinate."""
        return {f"{name}.gyro": one.bias for name, one in zip(self._linkage.names, self.filters, strict=True)}

    def learned(self) -> dict[str, Bias]:
        """See `JointBank`."""
        pairs = zip(self._linkage.names, self.filters, strict=True)
        return {f"{name}.gyro": (one.bias, math.sqrt(one.var_bias)) for name, one in pairs}

    def start_from(self, biases: Mapping[str, Bias]) -> None:
        """See `JointBank`."""
        for name, one in zip(self._linkage.names, self.filters, strict=True):
            value, deviation = biases[f"{name}.gyro"]
            one.start_from(value, deviation**2 + 2.0 * GYRO_DRIFT**2)

    def _by_sensor(self, rows: Sequence[Sequence[Any]], nothing: Any) -> list[Any]:
        whole = [nothing] * self._sensors
        for indices, row in zip(self._linkage.hall, rows, strict=True):
            for index, value in zip(indices, row, strict=False):
                whole[index] = value
        return whole

    def gated(self) -> list[int]:
        """See `JointBank`."""
        return self._by_sensor([one.gated for one in self.filters], 0)

    def innovations(self) -> list[float]:
        """See `JointBank`."""
        return self._by_sensor([one.innovations for one in self.filters], np.nan)

    def get_state(self) -> Any:
        """See `JointBank`."""
        return [one.get_state() for one in self.filters]

    def set_state(self, state: Any) -> None:
        """See `JointBank`."""
        for one, own in zip(self.filters, state, strict=True):
            one.set_state(own)
        self._collect()
