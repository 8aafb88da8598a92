"""How regularly the sensors of a recording delivered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray, Recording
from jointest_ros.core.timing import GAP, jitter

HALL = "hall voltages"


@dataclass(frozen=True)
class Delivery:
    """The frames in which a sensor is.

    Attributes:
        stamps: (N,) ns, of these frames.
        rate_hz: by the median interval; NaN of fewer than two.
        jitter_s: see `core.timing.jitter`.
        gaps: number of intervals longer than `GAP` median ones.
        longest_s: longest interval.
        missing: share of the samples that a steady stream would have, and this one has not.
    """

    stamps: NDArray[np.int64]
    rate_hz: float
    jitter_s: float
    gaps: int
    longest_s: float
    missing: float

    def intervals(self) -> tuple[NDArray[np.int64], FloatArray]:
        """((N - 1,) stamps at which an interval ends, its length in ms)."""
        return self.stamps[1:], np.diff(self.stamps) * 1e-6


def deliveries(recording: Recording) -> dict[str, Delivery]:
    """By sensor; and of the Hall voltages, where there are any."""
    present: dict[str, NDArray[np.bool_]] = {}
    for tables in (recording.gyro, recording.accel, recording.mag):
        for sensor, table in tables.items():
            rows = np.asarray(np.isfinite(table).all(axis=1))
            present[sensor] = present[sensor] | rows if sensor in present else rows
    if recording.hall is not None:
        present[HALL] = np.asarray(np.isfinite(recording.hall).any(axis=1))
    return {sensor: _delivery(recording.stamps[rows]) for sensor, rows in present.items()}


def _delivery(stamps: NDArray[np.int64]) -> Delivery:
    steps = np.diff(stamps) * 1e-9
    steps = steps[steps > 0.0]  # a clock that was set back
    if not len(steps):
        return Delivery(stamps, float("nan"), float("nan"), 0, 0.0, 0.0)
    usual = float(np.median(steps))
    longer = steps > GAP * usual
    lacking = float(np.sum(np.round(steps[longer] / usual) - 1.0))
    return Delivery(
        stamps,
        1.0 / usual,
        jitter(steps, usual),
        int(longer.sum()),
        float(steps.max()),
        lacking / (lacking + len(stamps)),
    )
