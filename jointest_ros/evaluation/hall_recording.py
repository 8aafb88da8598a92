"""What the recording behind a fitted Hall sensor was like: how far, how fast, how late, and what to do better."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.hall_sensor import HallSensor, SplineCurve
from jointest_ros.evaluation.hall_calibration import HallFit
from jointest_ros.evaluation.measures import rms

_LONGEST_HOLE = 0.1  # s, between samples of the reference that are interpolated over
_STEP = 0.05  # s
_ENOUGH = 200  # readings
_MISSING = 0.1  # share of the range that may be missing at either end
_FLAT = math.radians(500.0)  # rad/V; a sensor that tells less does not count as seeing: below -60 deg, the paper's
_EVIDENT = 4.0  # sigma


def reference_at(stamps: NDArray[np.int64], reference_stamps: NDArray[np.int64], reference: FloatArray) -> FloatArray:
    """(N,) the reference (M,) at `stamps` (N,), both stamps in ns and rising; NaN outside of it and in its holes."""
    known = np.isfinite(reference)
    stamps_known, values = reference_stamps[known], reference[known]
    if len(values) < 2:
        return np.full(len(stamps), np.nan)
    after = np.searchsorted(stamps_known, stamps).clip(1, len(values) - 1)
    before_ns, after_ns = stamps_known[after - 1], stamps_known[after]
    share = (stamps - before_ns) / (after_ns - before_ns)
    inside = (share >= 0.0) & (share <= 1.0) & (after_ns - before_ns <= _LONGEST_HOLE * 1e9)
    return np.where(inside, values[after - 1] + share * (values[after] - values[after - 1]), np.nan)


def advice(
    fit: HallFit, time: FloatArray, reference: FloatArray, configured: HallSensor, limits: tuple[float, float] | None
) -> Iterator[str]:
    """What makes a fit doubtful, one line each.

    Args:
        time, reference, configured: (N,) s, (N,) rad and the sensor that were given to `fit_hall`.
        limits: of the joint, rad, where they are known; the range of the configured curve stands for them.
    """
    low, high = np.degrees(fit.covered)
    wanted_low, wanted_high = np.degrees(_visible(fit, limits or _range(configured)))
    missing = _MISSING * (wanted_high - wanted_low)
    if low > wanted_low + missing or high < wanted_high - missing:
        yield (
            f"covers {low:.1f} to {high:.1f} deg of {wanted_low:.1f} to {wanted_high:.1f} deg; "
            "beyond it the curve is extrapolated: move the joint further"
            + ("" if limits else ", or give its limits_deg if it cannot go there")
        )
    if fit.used.sum() < _ENOUGH:
        yield f"only {fit.used.sum()} usable readings; record at least {_ENOUGH}"
    if _sweeps(reference[fit.used]) < 2:
        yield "too slow: the joint did not go through its range and back, so that drift looks like curve"
    period, speed = float(np.median(np.diff(time))), math.degrees(_speed(time[fit.used], reference[fit.used]))
    if 0.5 * period * speed > fit.rms_deg:
        yield (
            f"too fast: at {speed:.0f} deg/s half a sample is {0.5 * period * speed:.2f} deg, more than the residual: "
            "move slower"
        )
    if abs(fit.lag) > max(_EVIDENT * fit.lag_std, 0.5 * period):
        which = "lag behind" if fit.lag > 0.0 else "are ahead of"
        yield (
            f"the voltages {which} the reference by {abs(fit.lag) * 1e3:.1f} ms, {abs(fit.lag) * speed:.2f} deg at the "
            "speed of this recording: not in the curve, but in residual and noise"
        )


def _speed(time: FloatArray, angle: FloatArray) -> float:
    """Root mean square of the rate, rad/s, over steps in which an encoder's digits are small."""
    even = np.arange(time[0], time[-1], _STEP)
    return rms(np.diff(np.interp(even, time, angle)) / _STEP) if len(even) > 1 else 0.0


def _sweeps(angle: FloatArray) -> int:
    """How often the angle went from the lowest quarter of its range to the highest one, or back."""
    middle, quarter = 0.5 * (angle.min() + angle.max()), 0.25 * np.ptp(angle)
    ends = np.sign(angle - middle)[abs(angle - middle) > quarter]
    return int(np.count_nonzero(np.diff(ends)))


def _range(sensor: HallSensor) -> tuple[float, float]:
    """Joint angles, rad, that the curve of a sensor is made for."""
    volts = np.linspace(*sensor.hall_range, 1000)
    if isinstance(sensor.curve, SplineCurve):
        volts = sensor.offset + np.array(sensor.curve.volts)
    elif (sharp := abs(sensor.slope(volts)) < _FLAT).any():
        volts = volts[sharp]
    low, high = sorted(sensor.angle(volts[[0, -1]]).tolist())
    return low, high


def _visible(fit: HallFit, limits: tuple[float, float]) -> tuple[float, float]:
    """The part of `limits`, rad, in which the fitted sensor is off its rails."""
    sensor = replace(fit.sensor, noise=fit.scatter)
    margin = sensor.gate_margin + 3.0 * sensor.noise
    ends = np.array([sensor.hall_range[0] + margin, sensor.hall_range[1] - margin])
    low, high = sorted(sensor.angle(ends).clip(*limits).tolist())
    return low, high
