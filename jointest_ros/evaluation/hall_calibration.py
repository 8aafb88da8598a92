"""Fits the curve of a Hall sensor to a reference of its joint's angle, such as a goniometer or an encoder.

Curve        theta_h(V) = a exp(b V) - c exp(-d V), equation (1) of Yumbla et al. 2023, or a monotone spline.
Model        reading(t) = V(theta_h(t - lag) - hysteresis / 2 * direction of motion) + noise.
Least squares of the readings, not of the angles: it is the voltage that is noisy, and a fit of theta_h(V) to the angles
             would be off by exp(d^2 sigma^2 / 2), 4 % at 34.5 mV. Outliers weigh little.
Rails        a reading counts where the fitted one is well away from them: a choice by the readings themselves would
             keep those whose noise is one-sided.
Prior        what a recording does not tell stays as configured: each parameter within a factor of a few.

An offset of the voltage becomes part of the curve (a and c absorb it). Lag and hysteresis are estimated so that they do
not bend the curve; they stay in residual and noise, because an estimator that uses the curve will meet them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.hall_sensor import Curve, ExponentialCurve, HallSensor, SplineCurve
from jointest_ros.evaluation.measures import rms

CURVES = ("exponential", "spline")
_FEWEST = 20  # readings for a fit
_MOST = 20_000  # readings in a fit: more take time and tell nothing
_LEAST_CORRELATION = 0.3  # of readings and reference
_ROUNDS = 4  # of choice of readings and fit in turn; two or three do
_KEEP_OFF = 4.0  # sigma between rail and fitted reading
_OUTLIER = 3.0  # sigma from which the loss grows with a residual, not with its square
_FAR_OUT = 5.0  # sigma from which a residual is no noise
_PRIOR = 1.5  # sigma of the logarithm of a parameter: a factor of 4.5
_ABSENT_DEG = 0.1  # where the fit starts with a term that the configured curve does not have
_PRIOR_ANGLE = math.radians(30.0)  # sigma of the first angle of a spline
_PRIOR_LAG = 0.1  # s
_PRIOR_HYSTERESIS = math.radians(5.0)
_LONGEST_LAG = 0.25  # s
_LAG_STEP = 0.01  # s
_PLAY = math.radians(1.0)  # a reversal counts as such after so much of motion
_KNOTS = 10
_GRID = 101
_LEAST_NOISE = 1e-6  # V
_STEP = 5e-3  # V
_LEAST_SLOPE = 1e-3  # rad/V
_ABOVE = 1.0  # V above the range, for angles that the joint reaches after the sensor is at its rail


@dataclass(frozen=True)
class HallFit:
    """A fitted sensor and how well it fits N readings.

    Attributes:
        sensor: with the fitted curve and the noise found; its offset is 0.
        used: (N,) the readings that the fit rests on.
        residual: (N,) V, reading minus V(reference); NaN where either is missing.
        rms_volts, rms_deg: of the residuals of the used readings, and of the errors of the angles they stand for.
        scatter: standard deviation of the used readings about the model, V: without lag, hysteresis and outliers.
        covered: lowest and highest joint angle of the used readings, rad.
        volts: (101,) V, the part of the curve that they cover.
        std_deg: (101,) deg, standard deviation of the curve's angle there that the noise of the readings causes.
        lag, lag_std: of the readings behind the reference, s.
        hysteresis_deg: width of the loop of angle seen over angle.
    """

    sensor: HallSensor
    used: NDArray[np.bool_]
    residual: FloatArray
    rms_volts: float
    rms_deg: float
    scatter: float
    covered: tuple[float, float]
    volts: FloatArray
    std_deg: FloatArray
    lag: float
    lag_std: float
    hysteresis_deg: float


def fit_hall(
    time: FloatArray, volts: FloatArray, reference: FloatArray, sensor: HallSensor, curve: str = "exponential"
) -> HallFit:
    """Fit one sensor.

    Args:
        time: (N,) s, rising.
        volts: (N,) V, NaN where there is no reading.
        reference: (N,) rad, true angle of the joint, NaN where it is not known.
        sensor: as configured; its curve is where the fit starts.
        curve: one of `CURVES`.

    Raises:
        CalibrationError: too few readings are off the rails, or they do not follow the reference.
    """
    known = np.isfinite(volts) & np.isfinite(reference)
    data = _Data(time[known], volts[known], sensor.sign * reference[known], sensor)
    usable = sensor.usable(data.volts)
    lag = _rough_lag(data, usable)
    with np.errstate(all="ignore"):  # a step too far is taken back
        solution = _solve(_exponential(data, usable), data, usable, np.array([lag, 0.0]), sensor.noise)
        if curve == "spline":
            family = _spline(solution.curve, data.angles[solution.used], sensor)
            solution = _solve(family, data, solution.used, solution.delays, solution.sigma)
        used, residual = np.zeros(len(volts), dtype=bool), np.full(len(volts), np.nan)
        used[known] = solution.used
        residual[known] = data.volts - _expected(solution.curve, data.angles, sensor)
        near = used & (abs(residual) < _FAR_OUT * 1.4826 * np.median(abs(residual[used])))
        noise = math.sqrt(max(rms(residual[near]) ** 2 - sensor.resolution**2 / 12.0, _LEAST_NOISE**2))
        try:
            fitted = replace(sensor, curve=solution.curve, offset=0.0, noise=noise)
        except ConfigurationError:  # noise as wide as the sensor's range
            raise _scattered(noise) from None
        seen = sensor.sign * data.seen(solution.delays, np.flatnonzero(solution.used))
        covered = float(seen.min()), float(seen.max())
        low, high = sorted(fitted.voltage(np.array(covered)).tolist())
        grid = np.linspace(low, high, _GRID)
        return HallFit(
            sensor=fitted,
            used=used,
            residual=residual,
            rms_volts=rms(residual[used]),
            rms_deg=math.degrees(rms(fitted.angle(volts[used]) - reference[used])),
            scatter=solution.sigma,
            covered=covered,
            volts=grid,
            std_deg=np.degrees(solution.angle_std(grid)),
            lag=float(solution.delays[0]),
            lag_std=math.sqrt(solution.covariance[-2, -2]),
            hysteresis_deg=math.degrees(solution.delays[1]),
        )


class _Data:
    """Readings (n,) with the angles theta_h at the sensor, rad, and how those are seen through lag and hysteresis."""

    def __init__(self, time: FloatArray, volts: FloatArray, angles: FloatArray, sensor: HallSensor) -> None:
        self.time, self.volts, self.angles, self.sensor = time, volts, angles, sensor
        self._direction = np.empty_like(angles)  # -1 to 1
        half, at = 0.5 * _PLAY, float(angles[0]) if len(angles) else 0.0
        for k, angle in enumerate(angles.tolist()):
            at = min(max(at, angle - half), angle + half)
            self._direction[k] = (angle - at) / half

    def seen(self, delays: FloatArray, rows: NDArray[np.intp]) -> FloatArray:
        """Angles at `rows`, rad; `delays`: lag, s, and hysteresis, rad."""
        lag, width = delays
        return np.interp(self.time[rows] - lag, self.time, self.angles) - 0.5 * width * self._direction[rows]


def _rough_lag(data: _Data, usable: NDArray[np.bool_]) -> float:
    """Where the correlation of readings (their ranks: the curve is not straight) and reference is greatest, s."""
    low, high = data.sensor.hall_range
    if usable.sum() < _FEWEST:
        what = f"{usable.sum()} of {len(usable)} readings are between the rails at {low:g} and {high:g} V"
        raise CalibrationError(f"{what}; {_FEWEST} are needed")
    rows = np.flatnonzero(usable)
    ranks = data.volts[rows].argsort().argsort()
    if not np.ptp(data.volts[rows]) or not np.ptp(data.angles[rows]):
        raise CalibrationError("voltage or reference never changes; did the joint move?")
    lags = np.arange(-_LONGEST_LAG, _LONGEST_LAG + _LAG_STEP / 2.0, _LAG_STEP)
    correlations = [np.corrcoef(ranks, data.seen(np.array([lag, 0.0]), rows))[0, 1] for lag in lags]
    if correlations[len(lags) // 2] < -_LEAST_CORRELATION:
        mirrored = str(data.sensor.mirrored).lower()
        raise CalibrationError(
            f"the voltage falls where it should rise; is 'mirrored: {mirrored}' wrong, or the sign of the reference?"
        )
    if max(correlations) < _LEAST_CORRELATION:
        raise CalibrationError(
            f"the voltage does not follow the reference (correlation {max(correlations):.2f}); is it of this joint?"
        )
    return float(lags[np.argmax(correlations)])


@dataclass(frozen=True)
class _Family:
    """Curves by parameters (m,): where the fit starts, the sigma of the prior about that, and the curve of a set."""

    start: FloatArray
    prior: FloatArray
    curve: Callable[[FloatArray], Curve]


@dataclass(frozen=True)
class _Solution:
    """Parameters (m,), delays (lag, hysteresis), covariance (m + 2, m + 2) of both, scatter of the used readings, V."""

    family: _Family
    parameters: FloatArray
    delays: FloatArray
    covariance: FloatArray
    used: NDArray[np.bool_]
    sigma: float

    @property
    def curve(self) -> Curve:
        return self.family.curve(self.parameters)

    def angle_std(self, volts: FloatArray) -> FloatArray:
        """(n,) rad, of the curve's angles at (n,) V."""
        step, m = 1e-4, len(self.parameters)
        ways = [(self.parameters + step * unit, self.parameters - step * unit) for unit in np.eye(m)]
        moved = [[self.family.curve(p).angle(volts) for p in way] for way in ways]
        gradient = np.array([(above - below) / (2.0 * step) for above, below in moved])
        return np.sqrt(np.einsum("in,ij,jn->n", gradient, self.covariance[:m, :m], gradient))


def _exponential(data: _Data, usable: NDArray[np.bool_]) -> _Family:
    """Logarithms of a exp(b V), b, c exp(-d V) and d at the median V, where a tells apart from b, and c from d."""
    configured = data.sensor.curve if isinstance(data.sensor.curve, ExponentialCurve) else ExponentialCurve()
    middle = float(np.median(data.volts[usable]))

    def curve(p: FloatArray) -> ExponentialCurve:
        b, d = np.exp(p[1]), np.exp(p[3])
        return ExponentialCurve(float(np.exp(p[0] - b * middle)), float(b), float(np.exp(p[2] + d * middle)), float(d))

    at = middle - data.sensor.offset
    terms = configured.a_deg * math.exp(configured.b * at), configured.c_deg * math.exp(-configured.d * at)
    rising, falling = (term or _ABSENT_DEG for term in terms)
    return _Family(np.log([rising, configured.b, falling, configured.d]), np.full(4, _PRIOR), curve)


def _spline(rough: Curve, angles: FloatArray, sensor: HallSensor) -> _Family:
    """First angle, rad, and logarithms of the steps between angles, at fixed voltages.

    The knots are evenly apart in the sum of angle and voltage, each as a share of its range: a spline through points of
    equation (1) is then ten times nearer to it than with even angles.
    """
    low, high = _expected(rough, np.array([angles.min(), angles.max()]), sensor).tolist()
    grid = np.linspace(low, high, 1000)
    way = sum((row - row[0]) / np.ptp(row) for row in (grid, rough.angle(grid)))
    knots = np.interp(np.linspace(0.0, 2.0, _KNOTS), way, grid)
    first = rough.angle(knots)

    def curve(p: FloatArray) -> SplineCurve:
        return SplineCurve(tuple(knots.tolist()), tuple(np.degrees(np.cumsum([p[0], *np.exp(p[1:])])).tolist()))

    start = np.array([first[0], *np.log(np.diff(first))])
    return _Family(start, np.array([_PRIOR_ANGLE, *[_PRIOR] * (_KNOTS - 1)]), curve)


def _solve(family: _Family, data: _Data, used: NDArray[np.bool_], delays: FloatArray, sigma: float) -> _Solution:
    """Robust least squares on the `used` readings; again on those that the fitted curve says the rails leave alone."""
    low, high = data.sensor.hall_range
    start = np.append(family.start, delays)
    prior = np.append(family.prior, [_PRIOR_LAG, _PRIOR_HYSTERESIS])
    everything, parameters = np.arange(len(used)), start
    for _ in range(_ROUNDS):
        rows = np.flatnonzero(used)
        rows = rows[:: math.ceil(len(rows) / _MOST)]

        def residuals(p: FloatArray, rows: NDArray[np.intp] = rows, sigma: float = sigma) -> FloatArray:
            try:
                expected = _expected(family.curve(p[:-2]), data.seen(p[-2:], rows), data.sensor)
            except ConfigurationError:  # such parameters are no curve
                expected = np.full(len(rows), np.inf)
            return np.append((data.volts[rows] - expected) / sigma, (p - start) / prior)

        result = least_squares(residuals, parameters, x_scale="jac", loss="soft_l1", f_scale=_OUTLIER)
        parameters = result.x
        expected = _expected(family.curve(parameters[:-2]), data.seen(parameters[-2:], everything), data.sensor)
        before, sigma = sigma, max(1.4826 * float(np.median(abs(data.volts - expected)[used])), _LEAST_NOISE)
        covariance = np.linalg.pinv(result.jac.T @ result.jac) * (sigma / before) ** 2
        solution = _Solution(family, parameters[:-2], parameters[-2:], covariance, used, sigma)
        keep_off = 2.0 * data.sensor.resolution + _KEEP_OFF * sigma
        chosen = (expected > low + keep_off) & (expected < high - keep_off) & data.sensor.usable(data.volts)
        if chosen.sum() < _FEWEST:
            raise _scattered(sigma)
        if (chosen == used).all() and abs(sigma - before) < 0.05 * sigma:
            break
        used = chosen
    return solution


def _expected(curve: Curve, angles: FloatArray, sensor: HallSensor) -> FloatArray:
    """Readings (n,), V, at sensor angles theta_h (n,), rad: between grid points, then a Newton step (to 1e-7 V)."""
    low, high = sensor.hall_range
    grid = np.arange(low, high + _ABOVE, _STEP)
    rough = np.interp(angles, curve.angle(grid), grid)
    return rough + (angles - curve.angle(rough)) / np.maximum(curve.slope(rough), _LEAST_SLOPE)


def _scattered(volts: float) -> CalibrationError:
    return CalibrationError(f"the readings scatter by {volts:.3g} V about any curve; are they of this joint?")
