"""Magnetometers: unit, constancy of the field's strength, and whether the gyro says how the field turns.

The field m in the frame of a sensor that turns with the rate w changes by dm/dt = m x w, as gravity does, so that the
hypotheses of `agreement` hold for it too. The readings of a magnetometer whose axes are exchanged or reversed by P are
P m; that agrees with M = det(P) P of the gyro: of P and -P neither is told from the other, since both turn alike.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation.inspection.agreement import agreement
from jointest_ros.evaluation.inspection.findings import LOOK, OK, WRONG, Finding
from jointest_ros.evaluation.inspection.grid import window_length, window_means
from jointest_ros.evaluation.inspection.sensors import SensorReport
from jointest_ros.evaluation.inspection.stream import Stream

_EARTH = (20e-6, 70e-6)  # tesla, strength of the field on Earth: 22 to 67 by IGRF-13 (Alken et al. 2021)
_UNITS = {"tesla": 1.0, "gauss": 1e-4, "milligauss": 1e-7, "uT": 1e-6, "nT": 1e-9}
_NEARLY = 1.3  # times the limits of the Earth's field: steel in a building
_FEWEST = 50  # readings
_ALIKE = 0.2  # share of the strength, range of two thirds of the readings: more is no field of the Earth alone
_OFFSET = 0.3  # share of the variance of the squares that may remain once a constant offset is taken off
_ROUND = 0.02  # smallest over largest variance of the directions, from which on an offset is known in all of them


def field_findings(fields: Mapping[str, Stream], sensors: Mapping[str, SensorReport]) -> Iterator[Finding]:
    """What there is to say of the magnetometers.

    Args:
        fields: by sensor, or by topic without a configuration; the field as it is sent stands in `accel`.
        sensors: with sound gyros, by name, their samples in SI.
    """
    for name, stream in fields.items():
        sound = stream.sound(False, True)
        if len(sound) < len(stream.stamps[stream.rising]):
            text = f"the magnetic field is not finite in {1.0 - len(sound) / len(stream):.1%} of the messages"
            yield Finding(LOOK, name, "mag_finite", text, "mend the driver, or mag: false")
        if len(sound) < _FEWEST or math.isnan(sound.period):
            yield Finding(LOOK, name, "mag_rate", f"{len(sound)} readings of the magnetic field only", "record longer")
            continue
        factor, unit = 1.0, _unit_finding(name, sound.accel)
        if unit is not None:
            yield unit[0]
            factor = unit[1]
        report = sensors.get(name)
        if not np.ptp(sound.accel, axis=0).any():
            if report is not None and _turns(report):
                text = "the magnetic field never changes while the gyro turns"
                yield Finding(WRONG, name, "mag_frozen", text, "is the magnetometer started, or its driver stuck?")
            continue
        if factor:
            yield from _strength(name, sound.accel * factor)
        if report is not None:
            yield from _direction(name, sound, report)


def _unit_finding(name: str, field: FloatArray) -> tuple[Finding, float] | None:
    """(what is wrong with the strength, factor to tesla; 0: not known), None where nothing is."""
    strength = float(np.median(np.linalg.norm(field, axis=1)))
    low, high = _EARTH[0] / _NEARLY, _EARTH[1] * _NEARLY
    found = next((unit for unit, factor in _UNITS.items() if low < strength * factor < high), None)
    if found == "tesla":
        return None
    if found is not None:
        text = f"the magnetic field is in {found}, not in tesla (its strength reads {strength:.3g})"
        return Finding(WRONG, name, "mag_units", text, f"let the driver multiply by {_UNITS[found]:g}"), _UNITS[found]
    text = f"the magnetic field has {strength * 1e6:.3g} uT, that of the Earth 20 to 70"
    action = "a magnet or steel close by, or a wrong scale? Headings by it would be wrong: mag: false"
    return Finding(LOOK, name, "mag_strength", text, action), 0.0


def _strength(name: str, field: FloatArray) -> Iterator[Finding]:
    """Is it the same in all directions? `field`: (T, 3) tesla."""
    strength = np.linalg.norm(field, axis=1)
    low, middle, high = np.quantile(strength, [1.0 / 6.0, 0.5, 5.0 / 6.0]).tolist()
    if high - low <= _ALIKE * middle:
        yield Finding(OK, name, "mag_strength", f"the magnetic field has {low * 1e6:.1f} to {high * 1e6:.1f} uT")
        return
    text = (
        f"the strength of the magnetic field varies: {low * 1e6:.0f} to {high * 1e6:.0f} uT in two thirds of the time"
    )
    offset = _offset(field)
    if offset is not None:
        numbers = ", ".join(f"{1e6 * value:.0f}" for value in offset.tolist())
        action = "iron or a magnet that turns with the sensor: calibrate the magnetometer, subtract this in the driver"
        yield Finding(LOOK, name, "mag_offset", f"{text}; an offset of [{numbers}] uT explains it (hard iron)", action)
        return
    yield Finding(LOOK, name, "mag_strength", text, "steel, motors or magnets that it comes near: mag: false there")


def _offset(field: FloatArray) -> FloatArray | None:
    """(3,) b of the sphere |m - b| = r, by least squares in 2 m.b + r^2 - b^2 = m^2; None where it explains little."""
    centred = field - field.mean(axis=0)
    spread = np.linalg.eigvalsh(centred.T @ centred)
    if spread[0] < _ROUND * spread[2]:
        return None
    squares = np.sum(field**2, axis=1)
    table = np.column_stack([2.0 * centred, np.full(len(field), np.mean(squares))])  # of one magnitude, nearly
    scale = np.linalg.norm(table, axis=0)
    solution = np.linalg.lstsq(table / scale, np.sum(centred**2, axis=1), rcond=None)[0] / scale
    offset = field.mean(axis=0) + solution[:3]
    left = np.sum((field - offset) ** 2, axis=1)
    return np.asarray(offset) if np.var(left) < _OFFSET * np.var(squares) else None


def _turns(report: SensorReport) -> bool:
    return float(np.nanmax(np.nanstd(report.si.gyro, axis=0), initial=0.0)) > math.radians(2.0)


def _direction(name: str, field: Stream, report: SensorReport) -> Iterator[Finding]:
    """Does it turn as the gyro says?"""
    centred = _offset(field.accel)
    if centred is not None:  # what turns with the sensor has no part in dm/dt = m x w
        field = replace(field, accel=field.accel - centred)
    streams = {name: report.si, f"{name} field": field}
    means = window_means(streams, window_length(streams))
    means = replace(means, accel={name: means.accel[f"{name} field"]})
    both = agreement(means, name, np.zeros(3) if report.rest is None else report.rest.gyro_bias)
    if both is None or not both.judged or both.factor != 1.0:
        return
    if both.usual:
        yield Finding(OK, name, "mag_polarity", f"gyro and magnetometer agree ({both.best:.0%} explained)")
        return
    shares = f"explains {both.best:.0%} of how the field turns, as it is {max(both.explained, 0.0):.0%}"
    text = f"magnetometer axes are not those of the gyro: {_axes(both.matrix)} ({shares})"
    action = "mend signs and order of the axes in the driver; gyro, accelerometer and magnetometer must share one frame"
    yield Finding(WRONG, name, "mag_polarity", text, action)


def _axes(matrix: FloatArray) -> str:
    """What each axis is: the reading P m has P = M, or -M."""

    def words(signed: FloatArray) -> str:
        found = []
        for row, axis in zip(signed, "xyz", strict=True):
            other = int(np.argmax(abs(row)))
            if "xyz"[other] != axis or row[other] < 0.0:
                found.append(f"its {axis} is {'-' if row[other] < 0.0 else ''}{'xyz'[other]}")
        return ", ".join(found) or "none"

    return f"{words(matrix)}; or {words(-matrix)}"
