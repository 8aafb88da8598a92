"""The reference at the stamps of readings, and the advice on a recording."""

from __future__ import annotations

import dataclasses
import math
import re

import numpy as np
import pytest

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.hall_sensor import ExponentialCurve, HallSensor
from jointest_ros.evaluation.hall_calibration import fit_hall
from jointest_ros.evaluation.hall_recording import advice, reference_at

SENSOR = HallSensor("joint", noise=0.015)
TIME = np.arange(0.0, 40.0, 0.01)
LIMITS = (math.radians(-40.0), math.radians(40.0))


def advise(
    angle: FloatArray, *, lag: float = 0.0, limits: tuple[float, float] | None = LIMITS, sensor: HallSensor = SENSOR
) -> list[str]:
    """The advice on a recording of a joint that moves so, rad over `TIME`."""
    rng = np.random.default_rng(1)
    time = TIME[: len(angle)]
    seen = np.interp(time - lag, time, angle)
    volts = np.clip(sensor.voltage(seen) + sensor.noise * rng.standard_normal(len(seen)), *sensor.hall_range)
    return list(advice(fit_hall(time, volts, angle, sensor), time, angle, sensor, limits))


def swing(low_deg: float, high_deg: float, hertz: float = 0.2) -> FloatArray:
    """From one angle to the other and back, rad over `TIME`."""
    return np.radians(low_deg + (high_deg - low_deg) * (0.5 - 0.5 * np.cos(2.0 * math.pi * hertz * TIME)))


def test_a_good_recording_needs_no_advice() -> None:
    assert advise(swing(-39.0, 39.0)) == []
    assert advise(swing(-39.0, 39.0), sensor=dataclasses.replace(SENSOR, mirrored=True)) == []


@pytest.mark.parametrize(("low", "high"), [(-39.0, -12.0), (-15.0, 39.0)])
def test_half_the_range_is_told(low: float, high: float) -> None:
    (text,) = advise(swing(low, high))
    assert text.startswith(f"covers {low:.1f} to ")
    assert " of -40.0 to 1" in text  # and not to 40: there this sensor is at its rail
    assert text.endswith("move the joint further")


def test_without_limits_the_range_is_that_of_the_configured_curve() -> None:
    (text,) = advise(swing(-39.0, 39.0), limits=None)
    assert " of -57." in text and "limits_deg" in text
    assert advise(swing(-58.0, 39.0), limits=None) == []
    narrow = dataclasses.replace(SENSOR, curve=ExponentialCurve(30.0, 1.0, 0.0, 1.0))  # steep nowhere
    assert advise(swing(40.0, 170.0), limits=None, sensor=narrow) == []


def test_few_readings_are_told() -> None:
    assert any("only 1" in text and "readings" in text for text in advise(swing(-39.0, 39.0, 2.0)[:180]))


def test_a_single_sweep_is_told() -> None:
    assert any(text.startswith("too slow") for text in advise(swing(-39.0, 39.0, 0.0125)))


def test_a_motion_faster_than_the_samples_is_told() -> None:
    fast = dataclasses.replace(SENSOR, noise=0.001)
    assert any(text.startswith("too fast") for text in advise(swing(-39.0, 39.0, 2.0), sensor=fast))


@pytest.mark.parametrize(("lag", "which"), [(0.03, "lag behind"), (-0.03, "are ahead of")])
def test_a_lag_is_told(lag: float, which: str) -> None:
    (text,) = advise(swing(-39.0, 39.0), lag=lag)
    found = re.match(f"the voltages {which} the reference by ([0-9.]+) ms", text)
    assert found and float(found[1]) == pytest.approx(30.0, abs=4.0)


def test_the_reference_is_interpolated_between_its_samples() -> None:
    truth_stamps = np.array([1_000_000_000, 1_020_000_000, 1_040_000_000], dtype=np.int64)
    stamps = np.array([999_999_999, 1_000_000_000, 1_005_000_000, 1_040_000_000, 1_040_000_001], dtype=np.int64)
    found = reference_at(stamps, truth_stamps, np.array([1.0, 2.0, 4.0]))
    assert found == pytest.approx(np.array([math.nan, 1.0, 1.25, 4.0, math.nan]), nan_ok=True)


def test_the_reference_is_not_interpolated_over_holes() -> None:
    truth_stamps = np.array([0, 10, 20, 30, 300, 310], dtype=np.int64) * 1_000_000
    values = np.array([0.0, 1.0, math.nan, 3.0, 4.0, 5.0])
    stamps = np.array([15, 20, 31, 299, 305], dtype=np.int64) * 1_000_000
    found = reference_at(stamps, truth_stamps, values)
    assert found == pytest.approx(np.array([1.5, 2.0, math.nan, math.nan, 4.5]), nan_ok=True)
    assert np.isnan(reference_at(stamps, truth_stamps, np.full(6, math.nan))).all()
