"""Hall sensors: the curve of the paper, its inverse, the gate, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.hall_sensor import ExponentialCurve, HallSensor, SplineCurve
from jointest_ros.core.kckf.hall_bank import HallBank
from jointest_ros.core.robot import Joint, Robot

SENSOR = HallSensor("knee")
MEASURED = SplineCurve((0.9, 1.1, 1.3, 1.6, 1.8), (-70.0, -25.0, 0.0, 8.0, 14.0))
VOLTS = np.linspace(0.85, 1.85, 401)


def test_paper_curve_covers_the_range_of_the_sensor_on_one_side_only() -> None:
    low, high = np.degrees(SENSOR.angle(np.array([0.9754, 1.8])))
    assert low == pytest.approx(-59.0, abs=1.0)
    assert high == pytest.approx(12.2, abs=0.1)


@pytest.mark.parametrize("curve", [ExponentialCurve(), MEASURED, SplineCurve((0.0, 3.3), (-165.0, 165.0))])
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_voltage_is_the_inverse_of_the_angle(curve: Any, mirrored: bool, offset: float) -> None:
    sensor = replace(SENSOR, curve=curve, mirrored=mirrored, offset=offset)
    assert sensor.voltage(sensor.angle(VOLTS)) == pytest.approx(VOLTS, abs=1e-8)


@pytest.mark.parametrize("curve", [ExponentialCurve(), MEASURED])
def test_slope_is_the_derivative_of_the_angle(curve: Any) -> None:
    sensor = replace(SENSOR, curve=curve, mirrored=True)
    step = 1e-6
    between = VOLTS + 1.3e-4  # beside the knots, where a spline has two third derivatives
    numeric = (sensor.angle(between + step) - sensor.angle(between - step)) / (2.0 * step)
    assert sensor.slope(between) == pytest.approx(numeric, rel=1e-5)


@pytest.mark.parametrize("curve", [ExponentialCurve(), MEASURED])
def test_table_gives_for_single_numbers_what_the_curve_gives(curve: Any) -> None:
    sensor = replace(SENSOR, curve=curve)
    table = sensor.table
    for volts in VOLTS[::7].tolist():
        angle = float(curve.angle(np.array(volts)))
        assert table.angle(volts) == pytest.approx(angle, abs=1e-7)
        inverse, slope = table.voltage(angle)
        assert inverse == pytest.approx(volts, abs=1e-8)
        assert slope * float(curve.slope(np.array(volts))) == pytest.approx(1.0, rel=1e-4)


def test_the_mirrored_sensor_sees_the_other_side() -> None:
    angle = np.radians(-30.0)
    mirrored = replace(SENSOR, mirrored=True)
    assert mirrored.voltage(-angle) == pytest.approx(SENSOR.voltage(angle))
    assert abs(1.0 / SENSOR.slope(SENSOR.voltage(angle))) < abs(1.0 / mirrored.slope(mirrored.voltage(angle)))


def test_angles_beyond_the_table_are_continued_straight() -> None:
    far = np.radians([-1e5, 500.0])
    volts = SENSOR.voltage(far)
    assert np.isfinite(volts).all() and volts[0] < 0.2 and volts[1] > 2.0


def test_readings_at_the_rails_are_not_usable() -> None:
    """The converter reads 1.79985 V at the rail of 1.8 V: a gate at the rail itself would never close."""
    at_rail = round(1.8 / SENSOR.resolution) * SENSOR.resolution
    assert at_rail < 1.8
    readings = np.array([at_rail, 1.8 - 2.0 * SENSOR.resolution - SENSOR.noise - 1e-6, 1.0, 0.2, math.nan])
    assert SENSOR.usable(readings).tolist() == [False, True, True, False, False]


def test_a_bank_of_different_sensors_equals_its_sensors() -> None:
    sensors = [SENSOR, replace(SENSOR, mirrored=True, offset=0.02), replace(SENSOR, curve=MEASURED, noise=0.01)]
    bank = HallBank(sensors)
    angles = np.radians([-20.0, 9.0, 4.0])
    volts, slopes = bank.voltages(angles)
    assert volts == pytest.approx([float(s.voltage(np.array(a))) for s, a in zip(sensors, angles, strict=True)])
    assert bank.angles(volts) == pytest.approx(angles, abs=1e-8)
    assert 1.0 / slopes == pytest.approx([float(s.slope(v)) for s, v in zip(sensors, volts, strict=True)], rel=1e-4)
    readings = np.array([[1.79, 1.0, math.nan], [1.0, 1.0, 1.0]])
    assert bank.usable(readings, gated=True).tolist() == [[False, True, False], [True, True, True]]
    assert bank.usable(readings, gated=False).tolist() == [[True, True, False], [True, True, True]]


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: replace(SENSOR, noise=0.0), "noise: 0.0"),
        (lambda: replace(SENSOR, resolution=-1.0), "resolution: -1.0"),
        (lambda: replace(SENSOR, offset=math.nan), "offset: nan"),
        (lambda: replace(SENSOR, hall_range=(1.8, 0.2)), "hall_range: (1.8, 0.2)"),
        (lambda: replace(SENSOR, hall_range=(1.0, 1.01)), "hall_range: (1.0, 1.01)"),
        (lambda: ExponentialCurve(b=-1.0), "-1.0"),
        (lambda: ExponentialCurve(a_deg=0.0, c_deg=0.0), "not both 0"),
        (lambda: SplineCurve((1.0,), (0.0,)), "at least 2"),
        (lambda: SplineCurve((1.0, 0.5), (0.0, 1.0)), "volts"),
        (lambda: SplineCurve((0.5, 1.0), (0.0, 0.0)), "angles_deg"),
        (
            lambda: Robot(("a", "b"), (Joint("knee", "a", "b", ((1.0, 0.0, 0.0),)),), hall=(HallSensor("kne"),)),
            "'knee'",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(make: Any, named: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        make()
    assert named in str(caught.value) and "\n" not in str(caught.value)
