"""Every sensor of a recording by itself: its unit, what it repeats, when it rests, whether its two chips agree."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import Sensor
from jointest_ros.core.stillness import Stillness
from jointest_ros.core.timing import Timing
from jointest_ros.evaluation.inertial_windows import StillPhase, WindowMeans
from jointest_ros.evaluation.inspection import quality
from jointest_ros.evaluation.inspection.agreement import Agreement, agreement
from jointest_ros.evaluation.inspection.findings import LOOK, OK, WRONG, Finding
from jointest_ros.evaluation.inspection.grid import still_phases, window_length, window_means
from jointest_ros.evaluation.inspection.quality import Rest
from jointest_ros.evaluation.inspection.stream import Stream, lags

SHORTEST_STILL = 1.0  # s
_SCALE_LOOK, _SCALE_WRONG = 0.15, 0.4
_SCALED = 0.97  # share of the changes that a scale must explain to be believed
_RATES_DIFFER = 0.05


@dataclass
class SensorReport:
    """One sensor.

    Attributes:
        stream: as recorded; `si`: its sound samples in rad/s and m/s^2, calibrated.
        norm: of gravity as it is sent; `steady`: and not of a sensor that is shaken all the time.
        agreement: of gyro and accelerometer, None where one of them is absent.
        phases, rest: when it stood still, and what it reads then.
    """

    name: str
    stream: Stream
    si: Stream
    gyro: bool
    accel: bool
    norm: float = math.nan
    steady: bool = False
    agreement: Agreement | None = None
    phases: list[StillPhase] = field(default_factory=list)
    rest: Rest | None = None


def take(name: str, stream: Stream, sensor: Sensor | None, findings: list[Finding]) -> SensorReport | None:
    """The sensor with its sound samples, calibrated; None where there are none."""
    finite = {key: np.isfinite(getattr(stream, key)).all(axis=1) for key in ("gyro", "accel")}
    used = {key: bool(rows.any()) if sensor is None else getattr(sensor, key) for key, rows in finite.items()}
    for key, rows in finite.items():
        if not used[key] or not len(rows) or rows.all():
            continue
        bad = float(1.0 - rows.mean())
        what = {"gyro": "angular_velocity", "accel": "linear_acceleration"}[key]
        text = f"{what} is not finite in {'all' if bad == 1.0 else f'{bad:.1%}'} of the messages: refused"
        action = f"{key}: false, if it has none" if bad == 1.0 else "mend the driver"
        findings.append(Finding(WRONG if bad > 0.2 else LOOK, name, "finite", text, action))
    sound = stream.sound(used["gyro"], used["accel"])
    if len(sound) < 2 or math.isnan(sound.period):
        return None
    if sensor is not None:
        accel = sound.accel @ np.array(sensor.accel_matrix).T + np.array(sensor.accel_offset)
        sound = replace(
            sound,
            stamps=sound.stamps - round(sensor.delay * 1e9),
            gyro=sound.gyro * np.array(sensor.gyro_scale),
            accel=accel if sensor.accel_calibrated else sound.accel,
        )
    return SensorReport(name, stream, sound, used["gyro"], used["accel"])


def means_of(reports: Sequence[SensorReport]) -> WindowMeans:
    """Of their samples as they are now, on one grid."""
    samples = {report.name: report.si for report in reports}
    return window_means(samples, window_length(samples))


def judge_units(report: SensorReport, means: WindowMeans, sensor: Sensor | None, findings: list[Finding]) -> None:
    """Find the units and what is clipped; the samples of `report` become SI."""
    name, factors = report.name, {"gyro": 1.0, "accel": 1.0}
    if report.accel:
        report.norm, report.steady = quality.gravity_norm(means.accel[name])
        if found := quality.accel_unit(report.norm):
            factors["accel"] = found[1]
    both = agreement(means, name, np.zeros(3)) if report.gyro and report.accel else None
    if both is not None and both.judged and both.factor != 1.0:
        factors["gyro"] = both.factor
        shares = f"explains {both.best:.0%} of what the accelerometer sees, as it is {_share(both)}"
        text = f"the gyro is in {both.unit}, not in rad/s ({shares})"
        findings.append(Finding(WRONG, name, "units", text, f"let the driver multiply by {both.factor:.6g}"))
    elif report.gyro and (absurd := list(quality.absurd_rates(name, report.si.gyro))):
        factors["gyro"] = math.pi / 180.0
        findings += absurd
    for what, field_used in (("gyro", report.gyro), ("accel", report.accel)):
        if field_used and factors[what] == 1.0:
            findings += quality.saturation_findings(getattr(report.stream, what), name, what, sensor)
    report.si = quality.in_si(report.si, factors["gyro"], factors["accel"])


def without_frozen(sensors: Sequence[SensorReport], findings: list[Finding]) -> list[SensorReport]:
    """Find sensors that are frozen; those that are left, without what they repeat."""
    means = means_of(sensors)
    for report in sensors:
        others = [other.name for other in sensors if other is not report]
        fields = [name for name, used in (("gyro", report.gyro), ("accel", report.accel)) if used]
        moving = quality.moves(means, others, report.si.stamps)
        if (found := quality.frozen(report.si, report.name, fields, moving)) is not None:
            findings.append(found[0])
            if found[0].level == WRONG:
                report.si = report.si.without(found[1])
    return [report for report in sensors if len(report.si) > 1 and not math.isnan(report.si.period)]


def judge_motion(
    report: SensorReport, means: WindowMeans, stillness: Stillness, clock: bool, findings: list[Finding]
) -> None:
    """Rest, gravity, agreement of gyro and accelerometer; with a wrong `clock` (False) the rates mean nothing."""
    name = report.name
    if report.gyro:
        report.phases = still_phases(report.si, name, replace(stillness, accel=report.accel))
        report.phases = [phase for phase in report.phases if phase.duration >= SHORTEST_STILL]
        report.rest = quality.rest(report.si, report.phases)
    findings += quality.norm_finding(name, report.norm, report.steady, report.rest is not None)
    if report.gyro and report.accel:
        bias = np.zeros(3) if report.rest is None else report.rest.gyro_bias
        report.agreement = agreement(means, name, bias)
        if report.agreement is not None and clock:
            findings += _agreement_findings(name, report.agreement)


def _share(both: Agreement) -> str:
    return f"{max(both.explained, 0.0):.0%}"


def _agreement_findings(name: str, both: Agreement) -> Iterator[Finding]:
    if not both.judged:
        return
    if not both.usual:
        text = f"{_mistake(both.matrix)} (explains {both.best:.0%} of the accelerometer, as it is {_share(both)})"
        action = "mend signs and order of the axes in the driver: both chips must have the same right-handed frame"
        yield Finding(WRONG, name, "polarity", text, action)
        return
    off = both.scale - 1.0
    if abs(off) > _SCALE_LOOK and both.scaled > _SCALED:
        what = f"1 / {both.scale:.2f}" if off > 0 else f"{1.0 / both.scale:.2f}"
        text = f"the gyro reads {what} of what the accelerometer sees"
        action = "wrong full scale in the driver, or stamps that run at another rate?"
        yield Finding(WRONG if abs(off) > _SCALE_WRONG else LOOK, name, "scale", text, action)
        return
    yield Finding(
        OK, name, "polarity", f"gyro and accelerometer agree ({both.best:.0%} explained, scale {both.scale:.2f})"
    )


def _mistake(matrix: FloatArray) -> str:
    """A signed permutation in words."""
    if (matrix == -np.eye(3)).all():
        return "the gyro turns the wrong way, or the frame is left-handed: one axis is reversed in both chips"
    reads = []
    for row, axis in zip(matrix, "xyz", strict=True):
        other = int(np.argmax(abs(row)))
        if "xyz"[other] != axis or row[other] < 0:
            reads.append(f"{axis} is its {'-' if row[other] < 0 else ''}{'xyz'[other]}")
    diagonal = (matrix == np.diag(np.diag(matrix))).all()
    if diagonal and len(reads) == 2:  # g x w keeps its form when one axis of g is reversed and the other two of w are
        odd = "xyz"[int(np.argmax(np.diag(matrix)))]
        reads[-1] += f"; or that of accelerometer {odd} is"
    return f"gyro axes are {'reversed' if diagonal else 'not those of the accelerometer'}: {', '.join(reads)}"


def beside_each_other(reports: Sequence[SensorReport], timing: Timing) -> Iterator[Finding]:
    """Rates and clocks of the sensors, compared; and with the timing of the configuration."""
    if not reports:
        return
    period = float(np.median([report.stream.period for report in reports]))
    for report in reports:
        own = report.stream.period
        if abs(own / period - 1.0) > _RATES_DIFFER:
            text = f"{1.0 / own:.4g} Hz, the others {1.0 / period:.4g} Hz"
            yield Finding(LOOK, report.name, "rate", text, "set the same output rate; frames are partial meanwhile")
        for key in ("max_gap", "stale_after"):
            if getattr(timing, key) < 1.5 * own:
                text = f"a sample each {own * 1e3:.3g} ms, but timing.{key} is {getattr(timing, key) * 1e3:.3g} ms"
                yield Finding(WRONG, report.name, "timing", text, f"make {key} some periods long")
    late = {report.name: lags(report.stream) for report in reports}
    middle = float(np.median(list(late.values())))
    for name, lag in late.items():
        if abs(lag - middle) > max(period, 0.005):
            where = "behind" if lag > middle else "ahead of"
            text = f"its stamps are {abs(lag - middle) * 1e3:.0f} ms {where} the others'"
            action = "synchronise the clocks, or stamp all on one machine; at 100 deg/s, 10 ms are 1 deg"
            level = WRONG if abs(lag - middle) > timing.reset_jump else LOOK
            yield Finding(level, name, "clock", text, action)
