"""All coordinates of a linkage in one filter."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray, Status, Vec3
from jointest_ros.core.kckf.chain_motion import MotionFilter
from jointest_ros.core.kckf.coordinate import Coordinate, GapRule
from jointest_ros.core.kckf.coupled_filter import CoupledFilter
from jointest_ros.core.kckf.joint_bank import Rates
from jointest_ros.core.kckf.linkage import Linkage
from jointest_ros.core.learned import GYRO_DRIFT, HALL_DRIFT, Bias

_NO_DATA = int(Status.NO_DATA)


class CoupledBank:
    """Coordinates in one filter.

    Args:
        filter_: its Hall sensors in the order of `linkage.hall`.
        sensors: how many Hall sensors the robot has.
        rates_of: kinematics of joints with several axes, where the filter does not do them itself.
        in_volts: the filter measures volts, not angles.
    """

    def __init__(
        self,
        linkage: Linkage,
        filter_: CoupledFilter,
        sensors: int,
        rule: GapRule,
        rates_of: Rates | None,
        in_volts: bool,
    ) -> None:
        self.filter = filter_
        self._linkage, self._sensors, self._rates_of, self._in_volts = linkage, sensors, rates_of, in_volts
        self._indices = [index for own in linkage.hall for index in own]
        self._take = np.array(self._indices, dtype=np.int64)
        self._coordinate_of = np.array([k for k, own in enumerate(linkage.hall) for _ in own], dtype=np.int64)
        self._coordinates = [Coordinate(rule, bool(own)) for own in linkage.hall]
        self._links: list[Vec3] = [(0.0, 0.0, 0.0)] * len(linkage.links)
        self._all_measured = all(linkage.hall)
        self._nothing = np.full(len(self._indices), np.nan)
        self._unused = np.zeros(len(self._indices), dtype=bool)
        self._gated = [0] * sensors
        self.status = [int(Status.STARTING)] * len(linkage.names)
        self._collect()

    def step(self, dt: float, gap: float, rates: Sequence[Any], hall: Sequence[float] | None) -> None:
        """See `JointBank`."""
        joint_rates = self._joint_rates(dt, gap, rates)
        flags = [0] * len(joint_rates)
        spread = None
        known = math.isfinite(sum(joint_rates))
        if known and not gap and not any([c.missing for c in self._coordinates]):
            for coordinate, rate in zip(self._coordinates, joint_rates, strict=True):
                coordinate.rate = rate
            self.filter.look(dt)
        else:
            spread = self._bridge(dt, gap, joint_rates, flags)
        readings, used, present = self._nothing, self._unused, self._unused
        if hall is not None:
            readings = np.array(hall, dtype=float)[self._take]
            present = used = self.filter.hall.usable(readings, gated=self._in_volts)
            if not used.all():
                present = readings == readings
                for number in np.flatnonzero(present & ~used).tolist():
                    self._gated[self._indices[number]] += 1
            if not known:
                ready = ~np.array([c.waiting for c in self._coordinates])[self._coordinate_of]
                used, present = used & ready, present & ready
            if not self._in_volts:
                readings = self.filter.hall.angles(readings)
        self.filter.step(dt, np.array(joint_rates), readings, used, spread)
        self._set_status(dt, flags, used, present)
        self._collect()

    def _joint_rates(self, dt: float, gap: float, rates: Sequence[Any]) -> list[float]:
        """(m) rates, NaN where a gyro is missing; for a `MotionFilter` also its equations for this interval."""
        half = 0.5 * dt
        motion = self.filter.motion if isinstance(self.filter, MotionFilter) else None
        if motion is None and self._rates_of is None:
            return list(rates)
        middle = [q + half * v for q, v in zip(self.angles, self.velocities, strict=True)]
        if motion is None:
            assert self._rates_of is not None
            return self._rates_of(rates, middle)
        silent = [link[0] != link[0] for link in rates]
        self._links = [old if gone else new for old, new, gone in zip(self._links, rates, silent, strict=True)]
        m = self.filter.m
        trusted = [not (gap or gone) for gone in silent]
        motion.linearise(self._links, self.filter.x[m : m + self.filter.d].tolist(), middle, trusted)
        if not any(silent):
            return motion.rates.copy()
        return [
            np.nan if silent[inner] or silent[outer] else rate
            for rate, (inner, outer) in zip(motion.rates, self._linkage.ends, strict=True)
        ]

    def _bridge(self, dt: float, gap: float, rates: list[float], flags: list[int]) -> FloatArray | None:
        """Fill in the rates that are missing; return the variance that this adds."""
        spread = np.zeros(len(rates))
        biases = self.filter.rate_biases().tolist()
        for k, coordinate in enumerate(self._coordinates):
            if dt:
                rates[k], shift, spread[k], flags[k] = coordinate.bridge(rates[k], dt, gap)
                self.filter.x[k] += shift
            elif rates[k] != rates[k]:
                rates[k], flags[k] = coordinate.rate, _NO_DATA
            if rates[k] != rates[k]:  # unknown: taken as standing still
                rates[k] = biases[k]
            coordinate.rate = rates[k]
        if dt and any([coordinate.lost for coordinate in self._coordinates]):
            self.filter.look_back()
        return spread if dt else None

    def _set_status(self, dt: float, flags: list[int], used: Any, present: Any) -> None:
        self.status = flags
        if self._all_measured and used.all():
            for coordinate in self._coordinates:
                coordinate.blind, coordinate.started = 0.0, True
            return
        used, present = used.tolist(), present.tolist()
        number = 0
        for k, coordinate in enumerate(self._coordinates):
            end = number + len(self._linkage.hall[k])
            if any(used[number:end]):
                coordinate.blind, coordinate.started = 0.0, True
            else:
                flags[k] |= coordinate.without_hall(dt, any(present[number:end]))
            number = end

    def _collect(self) -> None:
        x, m = self.filter.x, self.filter.m
        self.angles = x[:m].tolist()
        self.velocities = [
            coordinate.rate - bias
            for coordinate, bias in zip(self._coordinates, self.filter.rate_biases().tolist(), strict=True)
        ]
        self.variances = self.filter.covariance.diagonal()[:m].tolist()

    def restart(self) -> None:
        """See `JointBank`."""
        self.filter.restart()
        for coordinate in self._coordinates:
            coordinate.restart()
        self.status = [int(Status.STARTING)] * len(self.status)
        self._collect()

    def forget(self, coordinate: int) -> None:
        """See `JointBank`. What coordinates have in common is as doubtful: all start afresh."""
        self.filter.reset()
        self._collect()

    def spread(self, coordinate: int, variance: float) -> None:
        """See `JointBank`."""
        self.filter.spread(coordinate, variance)

    def covariance(self) -> FloatArray:
        """See `JointBank`."""
        m = self.filter.m
        return self.filter.covariance[:m, :m].astype(float)

    def biases(self) -> dict[str, float]:
        """Gyro biases (`<sensor>.x`, rad/s) or their differences (`<coordinate>.gyro`), and Hall offsets (V)."""
        linkage, filter_ = self._linkage, self.filter
        if isinstance(filter_, MotionFilter):
            names = [f"{gyro.name}.{letter}" for gyro in linkage.gyros for letter in "xyz"]
        else:
            names = [f"{name}.gyro" for name in linkage.names]
        if len(filter_.x) > filter_.m + filter_.d:
            for name, own in zip(linkage.names, linkage.hall, strict=True):
                names += [f"{name}.hall_{number}" for number in range(1, len(own) + 1)]
        return dict(zip(names, filter_.x[filter_.m :].tolist(), strict=True))

    def learned(self) -> dict[str, Bias]:
        """See `JointBank`."""
        deviations = np.sqrt(self.filter.covariance.diagonal()[self.filter.m :]).tolist()
        pairs = zip(self.biases().items(), deviations, strict=True)
        return {name: (value, deviation) for (name, value), deviation in pairs}

    def start_from(self, biases: Mapping[str, Bias]) -> None:
        """See `JointBank`."""
        values, deviations = np.array([biases[name] for name in self.biases()]).T
        covariance = np.diag(deviations**2) + self.filter.drift(GYRO_DRIFT, HALL_DRIFT)
        usual = self.filter.covariance[self.filter.m :, self.filter.m :]
        wide = covariance.diagonal() >= usual.diagonal()  # than the usual start: that counts instead
        values[wide] = 0.0
        covariance[wide] = usual[wide]
        covariance[:, wide] = usual[:, wide]
        self.filter.start_from(values, covariance)

    def innovations(self) -> list[float]:
        """See `JointBank`."""
        whole = [np.nan] * self._sensors
        for index, value in zip(self._indices, self.filter.innovations.tolist(), strict=True):
            whole[index] = value
        return whole

    def gated(self) -> list[int]:
        """See `JointBank`."""
        return list(self._gated)

    def get_state(self) -> Any:
        """See `JointBank`."""
        return {
            "filter": self.filter.get_state(),
            "coordinates": [coordinate.get_state() for coordinate in self._coordinates],
            "links": [list(link) for link in self._links],
            "gated": self.gated(),
            "status": list(self.status),
        }

    def set_state(self, state: Any) -> None:
        """See `JointBank`."""
        self.filter.set_state(state["filter"])
        for coordinate, own in zip(self._coordinates, state["coordinates"], strict=True):
            coordinate.set_state(own)
        self._links = [(link[0], link[1], link[2]) for link in state["links"]]
        self._gated, self.status = list(state["gated"]), list(state["status"])
        self._collect()
