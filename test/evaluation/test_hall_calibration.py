"""Fits of Hall sensors whose true curve is known: simulated readings of a joint that swings."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import chi2

from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.hall_sensor import ExponentialCurve, HallSensor, SplineCurve
from jointest_ros.evaluation.hall_calibration import CURVES, HallFit, fit_hall
from jointest_ros.sim import exoshell

CONFIGURED = HallSensor("joint")
TRUE = HallSensor("joint", ExponentialCurve(0.09, 2.7, 1.6e5, 8.0), offset=0.03, noise=0.015)
TIME = np.arange(0.0, 60.0, 0.01)
SWING = np.radians(3.0 + 32.0 * np.sin(2.0 * math.pi * 0.31 * TIME) + 6.0 * np.sin(2.0 * math.pi * 0.07 * TIME))
PARAMETERS = {"exponential": 4, "spline": 10}
SPLINE_ERROR_DEG = 0.05  # of a spline through ten points of equation (1), over 50 deg


def read(sensor: HallSensor, angle: FloatArray, seed: int = 0) -> FloatArray:
    """What the sensor gives, with noise, rails and converter."""
    volts = sensor.voltage(angle) + sensor.noise * np.random.default_rng(seed).standard_normal(len(angle))
    return np.round(np.clip(volts, *sensor.hall_range) / sensor.resolution) * sensor.resolution


def configured(sensor: HallSensor) -> HallSensor:
    """The sensor as its user knows it: with the paper's curve and noise."""
    return dataclasses.replace(CONFIGURED, mirrored=sensor.mirrored)


def error_deg(fit: HallFit, true: HallSensor) -> FloatArray:
    """Fitted minus true angle over the covered part of the curve."""
    return np.degrees(fit.sensor.angle(fit.volts) - true.angle(fit.volts))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("curve", CURVES)
def test_the_true_curve_is_found_within_the_stated_uncertainty(curve: str, mirrored: bool) -> None:
    true = dataclasses.replace(TRUE, mirrored=mirrored)
    scores = []
    for seed in range(5):
        fit = fit_hall(TIME, read(true, SWING, seed), SWING, configured(true), curve)
        excess = np.maximum(abs(error_deg(fit, true)) - (SPLINE_ERROR_DEG if curve == "spline" else 0.0), 0.0)
        # of m parameters, no point of the curve can be further off than all of them together
        assert (excess < math.sqrt(chi2.ppf(0.999, PARAMETERS[curve])) * fit.std_deg).all()
        assert fit.sensor.noise == pytest.approx(true.noise, rel=0.05)
        assert fit.sensor.offset == 0.0
        assert abs(fit.lag) < 4.0 * fit.lag_std
        scores.append(np.mean((error_deg(fit, true) / fit.std_deg) ** 2))
    # neither too small nor too large an uncertainty: 5 times 4 degrees of freedom and more
    assert 0.4 < np.mean(scores) < 2.0


def test_rails_do_not_bend_the_curve() -> None:
    """A third of the readings is clipped, and the noise is large: readings near the rail are one-sided."""
    true = dataclasses.replace(TRUE, noise=0.05)
    errors = []
    for seed in range(6):
        fit = fit_hall(TIME, read(true, SWING, seed), SWING, CONFIGURED)
        assert 0.4 < fit.used.mean() < 0.7
        errors.append(error_deg(fit, true)[-1] / fit.std_deg[-1])
    assert abs(np.mean(errors)) < 4.0 / math.sqrt(len(errors))


def test_residuals_and_covered_range_are_those_of_the_used_readings() -> None:
    volts = read(TRUE, SWING)
    fit = fit_hall(TIME, volts, SWING, CONFIGURED)
    assert fit.rms_volts == pytest.approx(0.015, rel=0.05)
    assert fit.residual[fit.used] == pytest.approx((volts - fit.sensor.voltage(SWING))[fit.used], abs=1e-6)
    angles = fit.sensor.angle(volts[fit.used])
    assert fit.rms_deg == pytest.approx(np.degrees(np.sqrt(np.mean((angles - SWING[fit.used]) ** 2))))
    highest = np.degrees(TRUE.angle(np.array(1.8 - 4.0 * TRUE.noise)))  # beyond it, noise would reach the rail
    assert np.degrees(fit.covered) == pytest.approx((np.degrees(SWING.min()), highest), abs=0.3)


@pytest.mark.parametrize(
    "start",
    [
        ExponentialCurve(0.3, 1.8, 2e4, 5.0),
        ExponentialCurve(a_deg=0.07, b=2.87, c_deg=0.0, d=8.43),
        SplineCurve((0.2, 1.0, 1.8), (-90.0, 0.0, 90.0)),
    ],
    ids=["far off", "one term", "spline"],
)
@pytest.mark.parametrize("curve", CURVES)
def test_the_start_does_not_matter(start: ExponentialCurve | SplineCurve, curve: str) -> None:
    volts = read(TRUE, SWING)
    usual = fit_hall(TIME, volts, SWING, CONFIGURED, curve)
    other = fit_hall(TIME, volts, SWING, dataclasses.replace(CONFIGURED, curve=start, offset=-0.1), curve)
    assert other.sensor.angle(usual.volts) == pytest.approx(usual.sensor.angle(usual.volts), abs=np.radians(0.05))


def test_what_the_recording_does_not_tell_stays_as_configured() -> None:
    true = HallSensor("joint", noise=0.015)
    small = 0.2 * SWING
    fit = fit_hall(TIME, read(true, small), small, CONFIGURED)
    outside = np.linspace(1.0, 1.1, 20)  # V, -48 to -19 deg; seen were -7 to 8
    assert np.degrees(fit.sensor.angle(outside)) == pytest.approx(np.degrees(true.angle(outside)), rel=0.5)


def test_missing_readings_and_a_reference_with_holes_are_passed_over() -> None:
    volts, reference = read(TRUE, SWING), SWING.copy()
    volts[100:300], reference[2000:2500] = math.nan, math.nan
    fit = fit_hall(TIME, volts, reference, CONFIGURED)
    assert (np.isnan(fit.residual) == (np.isnan(volts) | np.isnan(reference))).all()
    assert not fit.used[np.isnan(fit.residual)].any()
    assert abs(error_deg(fit, TRUE)).max() < 5.0 * fit.std_deg.max()


def test_outliers_weigh_little() -> None:
    rng = np.random.default_rng(4)
    volts = read(TRUE, SWING)
    hit = rng.random(len(volts)) < 0.02
    volts[hit] = rng.uniform(0.3, 1.7, hit.sum())
    fit = fit_hall(TIME, volts, SWING, CONFIGURED)
    assert abs(error_deg(fit, TRUE)).max() < 0.5
    assert fit.sensor.noise < 1.3 * TRUE.noise < fit.rms_volts


@pytest.mark.parametrize("lag", [-0.08, -0.01, 0.03, 0.15])
def test_a_lag_is_found_and_does_not_bend_the_curve(lag: float) -> None:
    seen = np.interp(TIME - lag, TIME, SWING)
    fit = fit_hall(TIME, read(TRUE, seen), SWING, CONFIGURED)
    assert abs(fit.lag - lag) < 4.0 * fit.lag_std < 0.01
    assert abs(error_deg(fit, TRUE)).max() < 5.0 * fit.std_deg.max()
    assert fit.scatter == pytest.approx(TRUE.noise, rel=0.1)


def test_a_lag_stays_in_residual_and_noise() -> None:
    seen = np.interp(TIME - 0.15, TIME, SWING)
    fit = fit_hall(TIME, read(TRUE, seen), SWING, CONFIGURED)
    assert fit.rms_volts > 3.0 * TRUE.noise
    assert fit.sensor.noise > 3.0 * TRUE.noise


@pytest.mark.parametrize("sensor", range(4))
def test_hysteresis_is_tolerated_and_told_from_lag(sensor: int) -> None:
    run = exoshell.simulate("clipped", hysteresis_deg=2.0, duration_s=60.0, seed=5)
    true, joint = run.robot.hall[sensor], sensor // 2
    assert run.recording.hall is not None
    volts, reference = run.recording.hall[:, sensor], run.truth_position[:, joint]
    fit = fit_hall(run.recording.stamps * 1e-9, volts, reference, configured(true))
    assert fit.hysteresis_deg == pytest.approx(2.0, abs=0.6)
    assert abs(fit.lag) < 0.004  # s; as a lag it would be 9 ms
    assert abs(error_deg(fit, true)).max() < 0.4


def test_many_readings_are_thinned() -> None:
    time = np.arange(0.0, 120.0, 0.001)
    angle = np.interp(time % 60.0, TIME, SWING)
    fit = fit_hall(time, read(TRUE, angle), angle, CONFIGURED)
    assert fit.used.sum() > 50_000
    assert abs(error_deg(fit, TRUE)).max() < 5.0 * fit.std_deg.max()


@pytest.mark.parametrize(
    ("volts", "cause"),
    [
        (np.full(len(TIME), 1.8), "0 of 6000 readings are between the rails at 0.2 and 1.8 V; 20 are needed"),
        (np.full(len(TIME), math.nan), "0 of 0 readings are between the rails"),
        (np.full(len(TIME), 1.2), "voltage or reference never changes"),
        (read(TRUE, -SWING), "is 'mirrored: false' wrong"),
        (np.random.default_rng(0).uniform(0.4, 1.6, len(TIME)), "does not follow the reference"),
    ],
    ids=["rail", "nothing", "constant", "mirrored", "noise"],
)
def test_a_sensor_that_cannot_be_fitted_is_refused(volts: FloatArray, cause: str) -> None:
    with pytest.raises(CalibrationError, match=r"^[^\n]*$") as caught:
        fit_hall(TIME, volts, SWING, CONFIGURED)
    assert cause in str(caught.value)


def test_readings_that_scatter_by_all_of_the_range_are_refused() -> None:
    narrow = dataclasses.replace(TRUE, hall_range=(1.2, 1.5))
    volts = read(narrow, np.interp(TIME - 0.2, TIME, 3.0 * SWING))
    with pytest.raises(CalibrationError, match="scatter by"):
        fit_hall(TIME, volts, 3.0 * SWING, dataclasses.replace(CONFIGURED, hall_range=(1.2, 1.5), noise=0.02))
