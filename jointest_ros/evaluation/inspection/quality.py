"""The readings of one sensor by themselves: units, full scale, frozen or saturated, and what it reads at rest."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.input_quality import NORM_TOLERANCE, SATURATED, UNITS, saturation_limit
from jointest_ros.core.robot import STANDARD_GRAVITY, Sensor
from jointest_ros.evaluation.inertial_windows import StillPhase, WindowMeans
from jointest_ros.evaluation.inspection.findings import LOOK, WRONG, Finding
from jointest_ros.evaluation.inspection.grid import rows_of
from jointest_ros.evaluation.inspection.stream import Stream

_STEADY = 0.02  # largest change of the norm of the accelerometer between neighbouring windows, as a share of it
_FEW_STEADY = 25  # windows
_ALIKE = 0.2  # range of two thirds of the steady norms, as a share: more is a link that whirls
FROZEN = 0.5  # s
_START_WITHIN = 1.0  # s, after which a phase does not begin at the start of the recording
_NOISELESS = 0.5  # share of repeated readings elsewhere: it may well be a simulation
_FROZEN_SHARE = 0.002  # of a recording
_FASTEST = 70.0  # rad/s, 4000 deg/s: twice what the usual gyros can read
_SATURATED_FEW = 5  # samples
_NEAR_SCALE = 0.03  # share, by which a clipped reading may differ from a usual full scale
_OFTEN = 0.05  # share of the samples
# usual full scales, unit, its inverse size in SI, key of the configuration
_FULL_SCALES = {
    "accel": (
        tuple(g * STANDARD_GRAVITY for g in (1.5, 2.0, 4.0, 6.0, 8.0, 10.24, 16.0, 20.48, 24.0, 32.0, 40.96)),
        "g",
        1.0 / STANDARD_GRAVITY,
        "accel_range_g",
    ),
    "gyro": (
        tuple(math.radians(dps) for dps in (125.0, 245.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)),
        "deg/s",
        180.0 / math.pi,
        "gyro_range_dps",
    ),
}


@dataclass(frozen=True)
class Rest:
    """What a sensor reads at rest, over its still phases.

    Attributes:
        duration: s, together; `start`: of the phase at the start of the recording, 0 where there is none.
        gyro_bias: (3,) rad/s.
        gyro_noise, accel_noise: white noise density, of the worst axis, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz).
    """

    duration: float
    start: float
    gyro_bias: FloatArray
    gyro_noise: float
    accel_noise: float


def gravity_norm(accel: FloatArray) -> tuple[float, bool]:
    """What the accelerometer reads of gravity, in its unit, and whether its norm was steady there.

    Otherwise it is the median of all; NaN: no idea.

    Args:
        accel: (K, 3) means of successive windows.
    """
    norm = np.linalg.norm(accel, axis=1)
    with np.errstate(invalid="ignore"):
        steady = abs(np.diff(norm)) < _STEADY * norm[1:]
    kept = norm[1:][steady]
    if len(kept) >= _FEW_STEADY:
        low, middle, high = np.quantile(kept, [0.16, 0.5, 0.84]).tolist()
        return middle, high - low < _ALIKE * middle
    norm = norm[np.isfinite(norm)]
    return (float(np.median(norm)) if len(norm) >= _FEW_STEADY else math.nan), False


def accel_unit(norm: float) -> tuple[str, float] | None:
    """The other unit in which gravity has that norm, and what it is in m/s^2."""
    for unit, gravity in UNITS.items():
        if abs(norm / gravity - 1.0) <= 4.0 * NORM_TOLERANCE:
            return unit, STANDARD_GRAVITY / gravity
    return None


def norm_finding(subject: str, norm: float, steady: bool, resting: bool) -> Iterator[Finding]:
    """Gravity is not 9.81 m/s^2.

    Args:
        steady: the norm is not that of a sensor that is shaken all the time.
        resting: the sensor was at rest.
    """
    if math.isnan(norm):
        return
    if found := accel_unit(norm):
        text = f"gravity is {norm:.2g}: the accelerometer is in {found[0]}, not in m/s^2"
        yield Finding(WRONG, subject, "units", text, f"let the driver multiply by {found[1]:.6g} (REP 145: m/s^2)")
        return
    if not steady:
        return
    off = norm / STANDARD_GRAVITY - 1.0
    if abs(off) > 6.0 * NORM_TOLERANCE and resting:
        action = "wrong full scale or unit in the driver?"
        yield Finding(WRONG, subject, "units", f"gravity is {norm:.4g} m/s^2", action)
    elif abs(off) > (NORM_TOLERANCE if resting else 6.0 * NORM_TOLERANCE):
        action = "calibrate it (jointest calibrate accel), or mend the full scale in the driver"
        yield Finding(LOOK, subject, "calibration", f"gravity is {norm:.2f} m/s^2 ({off:+.0%})", action)


def absurd_rates(subject: str, gyro: FloatArray) -> Iterator[Finding]:
    """Rates that no gyro can read."""
    fastest = float(np.quantile(np.abs(gyro).max(axis=1), 0.999)) if len(gyro) else 0.0
    if fastest > _FASTEST:
        text = (
            f"rates up to {fastest:.0f} rad/s are {math.degrees(fastest):.0f} deg/s: the gyro is in deg/s, not in rad/s"
        )
        yield Finding(WRONG, subject, "units", text, "let the driver multiply by pi / 180 (0.0174533)")


# ---------------------------------------------------------------- frozen, saturated


def frozen(
    stream: Stream, subject: str, fields: Sequence[str], moving: NDArray[np.bool_] | None
) -> tuple[Finding, list[tuple[int, int]]] | None:
    """The fields in use repeat one reading to the last bit, together or one of them alone: (finding, rows of the runs).

    Args:
        fields: "gyro", "accel" or both.
        moving: (T,) whether the link moves by what other sensors say; None where there are none.
    """
    total = (stream.stamps[-1] - stream.stamps[0]) * 1e-9
    same = {name: _repeats(getattr(stream, name)) for name in fields}
    kinds = {" and ".join(fields): np.logical_and.reduce(list(same.values())), **same}
    for what, repeated in kinds.items():
        others = [name for name in fields if len(fields) > 1 and name != what and what in fields]
        runs = [
            (first, last)
            for first, last in _runs(repeated).tolist()
            if (stream.stamps[last] - stream.stamps[first]) * 1e-9 >= FROZEN
            # of one alone: the other one tells that the sensor lives, and moves
            and all(_changes(getattr(stream, other)[first : last + 1], other) for other in others)
        ]
        if not runs:
            continue
        times = [(stream.stamps[last] - stream.stamps[first]) * 1e-9 for first, last in runs]
        longest = int(np.argmax(times))
        begin = (stream.stamps[runs[longest][0]] - stream.stamps[0]) * 1e-9
        repeats = "repeats" if others or len(fields) == 1 else "repeat"
        text = f"{what} {repeats} one reading to the last bit for {times[longest]:.1f} s from {begin:.1f} s on"
        certain = bool(others) or _while_moving(repeated, runs, moving)
        level = WRONG if certain and sum(times) > _FROZEN_SHARE * total else LOOK
        action = "frozen: power, bus or driver? (A simulation without noise does so at rest.)"
        return Finding(level, subject, "frozen", text, action), runs
    return None


def _while_moving(
    repeated: NDArray[np.bool_], runs: Sequence[tuple[int, int]], moving: NDArray[np.bool_] | None
) -> bool:
    """Other links move during a run, and the sensor is not one that repeats readings all the time."""
    if moving is None or not any(moving[first : last + 1].any() for first, last in runs):
        return False
    elsewhere = np.ones(len(repeated), dtype=bool)
    for first, last in runs:
        elsewhere[first : last + 1] = False
    return bool(elsewhere.any() and repeated[elsewhere].mean() < _NOISELESS)


def _repeats(rows: FloatArray) -> NDArray[np.bool_]:
    """(T,) equal to the row before."""
    return np.append(False, (rows[1:] == rows[:-1]).all(axis=1))


def _runs(same: NDArray[np.bool_]) -> NDArray[np.intp]:
    """(n, 2) first and last row of each run of equal rows."""
    edges = np.diff(np.concatenate([[0], same.astype(np.int8), [0]]))
    return np.column_stack([np.flatnonzero(edges == 1) - 1, np.flatnonzero(edges == -1) - 1])


def _changes(rows: FloatArray, field: str) -> bool:
    """A sensor that moves reads so: 1 m/s^2, or 0.2 rad/s, from least to greatest."""
    return bool(np.ptp(rows, axis=0).max() > {"accel": 1.0, "gyro": 0.2}[field])


def saturation_findings(rows: FloatArray, subject: str, what: str, sensor: Sensor | None) -> Iterator[Finding]:
    """Readings at the full scale: that of the configuration, or one that shows.

    Args:
        rows: (T, 3) as sent, rad/s or m/s^2; NaN are left out.
        what: "gyro" or "accel".
    """
    scales, unit, factor, key = _FULL_SCALES[what]
    limit = math.inf
    if sensor is not None:
        limit = saturation_limit(sensor) if what == "accel" else SATURATED * sensor.gyro_range
    largest = np.abs(rows).max(axis=1)
    clipped = int(np.sum(largest >= limit))
    action = f"choose a larger full scale in the driver, and {key} in the configuration accordingly"
    if not clipped and (shown := _clipped_at(rows[np.isfinite(largest)], scales)):
        clipped, limit = shown
    if clipped >= _SATURATED_FEW:
        share = clipped / len(rows)
        text = f"{clipped} samples ({share:.1%}) of the {what} are clipped at {limit * factor:.4g} {unit}"
        yield Finding(WRONG if share > _OFTEN else LOOK, subject, "saturated", text, action)


def _clipped_at(rows: FloatArray, scales: Sequence[float]) -> tuple[int, float] | None:
    """(number of samples, reading) where an axis piles up at its largest reading and that is a usual full scale."""
    for axis in np.abs(rows).T:
        top = float(axis.max())
        if not any(abs(top / scale - 1.0) < _NEAR_SCALE for scale in scales):
            continue
        at_top = int(np.sum(axis >= 0.999 * top))
        beside = int(np.sum((axis >= 0.989 * top) & (axis < 0.999 * top)))
        if at_top >= max(_SATURATED_FEW, beside):  # of ten times the width: motion has its turning points too
            return at_top, top
    return None


# ---------------------------------------------------------------- at rest


def rest(stream: Stream, phases: Sequence[StillPhase]) -> Rest | None:
    """What it reads at rest; None where it never is.

    Args:
        stream: sound, SI.
    """
    if not phases:
        return None
    weights = np.array([phase.duration for phase in phases])
    bias = np.average([_mean(phase) for phase in phases], axis=0, weights=weights)
    squares = np.zeros((2, 3))
    for phase in phases:
        rows = rows_of(stream, (phase.start, phase.end))
        for k, table in enumerate((stream.gyro[rows], stream.accel[rows])):
            # of successive samples: neither a drift nor a slow motion counts
            squares[k] += phase.duration * np.mean(np.diff(table, axis=0) ** 2, axis=0) / 2.0
    densities = np.sqrt(squares / weights.sum() * stream.period).max(axis=1)
    at_start = (phases[0].start - stream.stamps[0]) * 1e-9 <= _START_WITHIN
    return Rest(
        float(weights.sum()), phases[0].duration if at_start else 0.0, bias, float(densities[0]), float(densities[1])
    )


def _mean(phase: StillPhase) -> FloatArray:
    return np.array(next(iter(phase.gyro.values())))


def in_si(stream: Stream, gyro_factor: float, accel_factor: float) -> Stream:
    """The stream with its readings in rad/s and m/s^2."""
    if gyro_factor == accel_factor == 1.0:
        return stream
    return replace(stream, gyro=gyro_factor * stream.gyro, accel=accel_factor * stream.accel)


def moves(means: WindowMeans, sensors: Sequence[str], stamps: NDArray[np.int64]) -> NDArray[np.bool_] | None:
    """(T,) whether other sensors see their links move at these stamps; None without others."""
    rates = [np.linalg.norm(means.gyro[s], axis=1) for s in sensors if np.isfinite(means.gyro[s]).any()]
    shifts = [
        np.linalg.norm(means.accel[s] - np.nanmedian(means.accel[s], axis=0), axis=1)
        for s in sensors
        if np.isfinite(means.accel[s]).any()
    ]
    if not rates and not shifts:
        return None
    moving = np.zeros(len(means.start), dtype=bool)
    with np.errstate(invalid="ignore"):
        for rate in rates:
            moving |= rate > 0.2
        for shift in shifts:
            moving |= shift > 1.0
    rows = np.searchsorted(means.start, stamps, side="right") - 1
    return np.asarray(moving[np.clip(rows, 0, len(moving) - 1)])
