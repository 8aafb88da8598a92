"""`accel_analytical`: the angle between the force at the joint as either link sees it (Woods & Vikas, III.A).

Angle        th_ab = atan2(o_a x o_b, o_a . o_b) (12), o what the array of a link reads of the specific force at the
             joint, in the axes of the link.
Smoothing    over a causal window: the mean of the vectors (o_a . o_b, o_a x o_b) of its samples, which weighs each as
             it should (their noise is that of the angle times their length) and knows no jump at 180 deg. It lags by
             half the window: the angle is that of the middle of the window.
Velocity     from the angle between the means of the window's older and newer half; of the links alone nothing is known
             but |w|: their velocities are NaN.
Variance     (|F| sigma / |a_O|)^2 of both links over the window, and the square of what the joint turns during the lag.
             Where the force at the joint is within the noise the angle is arbitrary: UNOBSERVABLE.

The angle is that within pi of the middle of the joint's limits (of zero, where it has none); of a continuous joint, or
with limits wider than a turn, that nearest to the one before. While samples are missing the newest angle stands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointest_ros.core.accel.analytical_pair import AnalyticalPair
from jointest_ros.core.accel.array import JointArrays
from jointest_ros.core.accel.estimator import AccelEstimator
from jointest_ros.core.frame import Recording, Series, Vec3
from jointest_ros.core.params import Params, param


@dataclass(frozen=True)
class AccelAnalyticalParams(Params):
    """The `estimators: accel_analytical:` section of a configuration."""

    window: int = param(
        25,
        "mean of the newest samples, which lags by half of them; 1: each by itself",
        unit="samples",
        low=1,
        high=1000,
    )


class AccelAnalytical(AccelEstimator):
    """The estimator of the module text.

    Raises:
        ConfigurationError: see `joint_arrays`.
    """

    name = "accel_analytical"
    Params = AccelAnalyticalParams
    params: AccelAnalyticalParams

    def _make_filter(self, arrays: JointArrays) -> AnalyticalPair:
        return AnalyticalPair(arrays, self.params.window, self.timing.max_gap)

    def link_velocities(self) -> dict[str, float]:
        """NaN: their signs are not known."""
        return dict.fromkeys(super().link_velocities(), math.nan)

    def run(self, recording: Recording) -> Series:
        """Estimates of a stretch of frames, by arrays where nothing is wrong with them. Equal to `update` in a loop."""
        parts = [self._run_sound(part) or super(AccelAnalytical, self).run(part) for part in recording.parts()]
        return Series.concatenate(parts) if parts else super().run(recording)

    def _run_sound(self, part: Recording) -> Series | None:
        """By arrays; None, with nothing done, unless all samples are there, steady and to be trusted."""
        if len(part) < 2 or (part.reset is not None and part.reset.any()):
            return None
        first = part.stamps[0] if self._last is None else self._last
        intervals = np.diff(part.stamps, prepend=first) * 1e-9
        if intervals.max() + max(self._silent) > self.timing.max_gap or not self._sound(part):
            return None
        if part.period is not None and not np.isnan(part.period).all():
            if (part.period != part.period[0]).any():
                return None
            if part.period[0] != self._period:
                self._set_period(float(part.period[0]))
        self._frozen.clear()  # every reading was new
        self._frozen.update(*_newest(part))
        self._last = int(part.stamps[-1])
        self._silent = [0.0] * len(self.joints)
        columns = []
        for arrays, names, one, variances in zip(self.arrays, self._names, self._filters, self._variances, strict=True):
            assert isinstance(one, AnalyticalPair)
            channels = arrays.channels(np.stack([part.accel[name] for name in names], axis=1))
            columns.append(one.run(intervals, channels, variances))
        position, velocity, variance, status = (np.column_stack(table) for table in zip(*columns, strict=True))
        return Series(part.stamps, position, velocity, variance, status)

    def _sound(self, part: Recording) -> bool:
        """No sample of the arrays is missing, saturated, or a repetition of the one before."""
        for name in dict.fromkeys(name for names in self._names for name in names):
            table = part.accel.get(name)
            if table is None or not np.isfinite(table).all() or (table[1:] == table[:-1]).all(axis=1).any():
                return False
            if name in self._saturated and any(map(self._saturated[name], map(tuple, table.tolist()))):
                return False
        self._frozen.update(*_newest(part.part(0, 1)))
        return not self._frozen.since


def _newest(part: Recording) -> tuple[int, dict[str, Vec3]]:
    """Stamp and accelerations of the last frame."""
    frame = next(part.part(len(part) - 1, len(part)).frames())
    return frame.stamp, frame.accel
