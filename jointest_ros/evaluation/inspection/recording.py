"""The inspection of a recording: every sensor by itself, then the joints between them, if there is a configuration."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.progress import Progress, no_progress
from jointest_ros.core.robot import Robot
from jointest_ros.core.stillness import Stillness
from jointest_ros.core.timing import Timing
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.inspection import hall
from jointest_ros.evaluation.inspection.advice import noise_advice, pcf_advice, shaking
from jointest_ros.evaluation.inspection.findings import LOOK, OK, WRONG, Advice, Finding
from jointest_ros.evaluation.inspection.grid import common_phases
from jointest_ros.evaluation.inspection.hinge_motion import STILL
from jointest_ros.evaluation.inspection.joints import JointReport, Joints, biases, with_still
from jointest_ros.evaluation.inspection.magnetometers import field_findings
from jointest_ros.evaluation.inspection.sensors import (
    SHORTEST_STILL,
    SensorReport,
    beside_each_other,
    judge_motion,
    judge_units,
    means_of,
    take,
    without_frozen,
)
from jointest_ros.evaluation.inspection.stream import Stream, lags, timing_findings
from jointest_ros.evaluation.truth import Truth

_START_WITHIN = 5.0  # s, in which a still start begins, as pcf has it
Voltages = tuple[NDArray[np.int64], FloatArray]  # record times (N,) ns, and (N, h) V
_TURNED = 0.15  # m/s^2 rms, of an accelerometer by turning: 1 deg; noise is less
_SPOILS = ("polarity", "clock", "scale", "finite")  # what makes a sensor useless to judge joints by


@dataclass
class Inspection:
    """All of it; `still_start`: s that all sensors stand still at the start."""

    findings: list[Finding] = field(default_factory=list)
    sensors: list[SensorReport] = field(default_factory=list)
    joints: list[JointReport] = field(default_factory=list)
    advice: list[Advice] = field(default_factory=list)
    still_start: float = 0.0


@dataclass(frozen=True)
class Setup:
    """What the configuration says; the defaults stand for none.

    Attributes:
        pcf: its parameters; None: it is not configured.
        places_given: positions and origins stand in the configuration.
    """

    robot: Robot | None = None
    timing: Timing = field(default_factory=Timing)
    pcf: PcfParams | None = None
    places_given: bool = False


def inspect(
    streams: Mapping[str, Stream],
    setup: Setup,
    span: tuple[int, int],
    truth: Truth,
    voltages: Voltages | None = None,
    fields: Mapping[str, Stream] | None = None,
    progress: Progress = no_progress,
) -> Inspection:
    """Inspect the streams by sensor; without a robot in `setup`, each by itself.

    Args:
        span: record times of the first and of the last message of the recording, ns.
        voltages: of the Hall sensors.
        fields: of the magnetometers, see `field_findings`.
    """
    done = Inspection()
    _look_at_sensors(done, streams, setup, span, progress)
    spoiled = {f.subject for f in done.findings if f.level == WRONG and f.kind in _SPOILS}
    usable = {report.name: report for report in done.sensors if report.name not in spoiled}
    gyros = {name: report for name, report in usable.items() if report.gyro}
    done.findings += field_findings(fields or {}, gyros)
    if not done.sensors:
        return done
    phases = common_phases({r.name: r.phases for r in done.sensors if r.gyro}, SHORTEST_STILL)
    first = min(int(report.si.stamps[0]) for report in done.sensors)
    start = next((phase for phase in phases if (phase[0] - first) * 1e-9 <= _START_WITHIN), None)
    done.still_start = (start[1] - start[0]) * 1e-9 if start is not None else 0.0
    done.findings += _start_findings(done, setup)
    if not any(_moves(report) for report in done.sensors):
        text = "nothing moves in the recording: axes, signs and mountings are not judged"
        done.findings.append(Finding(LOOK, "recording", "motion", text, "move every joint in another one"))
    if setup.robot is None:
        return done
    means = means_of(done.sensors)
    takes_zero = setup.pcf is not None and setup.pcf.zero_at_start and done.still_start >= setup.pcf.still_start
    cone = math.radians((setup.pcf or PcfParams()).gravity_cone_deg)
    judge = Joints(setup.robot, usable, with_still(means, usable, phases), start, takes_zero, cone, truth)
    done.findings += [
        Finding(LOOK, joint, "unjudged", f"not judged: first mend {', '.join(lacking)}", "then inspect again")
        for joint, lacking in judge.unjudged.items()
        if any(report.name in lacking for report in done.sensors)
    ]
    done.findings += judge.findings()
    done.joints = judge.reports()
    if voltages is not None and voltages[1].shape[1] == len(setup.robot.hall):
        done.findings += _hall_findings(done, setup.robot, means, usable, voltages)
    done.advice += _advice(setup, setup.robot, means, usable)
    return done


def _look_at_sensors(
    done: Inspection,
    streams: Mapping[str, Stream],
    setup: Setup,
    span: tuple[int, int],
    progress: Progress,
) -> None:
    """Everything about single sensors."""
    configured = {} if setup.robot is None else {sensor.name: sensor for sensor in setup.robot.sensors}
    steps, findings = 2 * len(streams), done.findings
    for name, stream in streams.items():
        findings += timing_findings(stream, name, setup.timing, span)
        report = take(name, stream, configured.get(name), findings)
        if report is not None:
            done.sensors.append(report)
    means = means_of(done.sensors)
    for number, report in enumerate(done.sensors):
        judge_units(report, means, configured.get(report.name), findings)
        progress(number, steps)
    done.sensors = without_frozen(done.sensors, findings)
    clocks = {finding.subject for finding in findings if finding.level == WRONG and finding.kind == "clock"}
    means = means_of(done.sensors)
    for number, report in enumerate(done.sensors):
        judge_motion(report, means, _stillness(setup.pcf), report.name not in clocks, findings)
        progress(len(streams) + number, steps)
    findings += beside_each_other(done.sensors, setup.timing)


def _hall_findings(
    done: Inspection, robot: Robot, means: WindowMeans, usable: Mapping[str, SensorReport], voltages: Voltages
) -> Iterator[Finding]:
    """Hall messages have no stamp: their record times are moved to the clock of the gyros."""
    turns = hall.joint_turns(robot, means, biases(usable))
    if turns.by_gyro:
        late = float(np.median([lags(report.stream) for report in done.sensors]))
        yield from hall.hall_findings(robot, voltages[0] - round(late * 1e9), voltages[1], turns)


def _advice(setup: Setup, robot: Robot, means: WindowMeans, usable: Mapping[str, SensorReport]) -> Iterator[Advice]:
    yield from noise_advice(robot.sensors, {name: report.rest for name, report in usable.items()})
    if setup.pcf is not None:
        shaken = {name: shaking(means.accel[name]) for name, report in usable.items() if report.accel}
        rates = {
            name: float(np.sqrt(np.nanmean(np.sum(means.gyro[name] ** 2, axis=1))))
            for name, report in usable.items()
            if report.gyro
        }
        yield from pcf_advice(robot, setup.pcf, shaken, setup.places_given, rates)


def _stillness(pcf: PcfParams | None) -> Stillness:
    p = pcf or PcfParams()
    return Stillness((), math.radians(p.still_gyro_dps), p.still_accel, math.radians(p.largest_bias_dps))


def _moves(report: SensorReport) -> bool:
    """The sensor turns at all, by its gyro, or else by what it sees of gravity."""
    readings, least = (report.si.gyro, STILL) if report.gyro else (report.si.accel, _TURNED)
    return bool(np.nanmax(np.nanstd(readings, axis=0), initial=0.0) > least)


def _start_findings(done: Inspection, setup: Setup) -> Iterator[Finding]:
    gyros = [report for report in done.sensors if report.gyro]
    if not gyros:
        return
    if done.still_start:
        yield Finding(OK, "start", "still", f"all sensors stand still for {done.still_start:.1f} s at the start")
    pcf = setup.pcf
    if pcf is None or done.still_start >= pcf.still_start or not pcf.still_start:
        return
    restless = [r.name for r in gyros if r.rest is None or r.rest.start < pcf.still_start]
    who = f" ({', '.join(restless)} move)" if restless and len(restless) < len(gyros) else ""
    text = f"the robot does not stand still for {pcf.still_start:g} s at the start{who}"
    action = "hold it still for some seconds first: gyro biases are calibrated there"
    if pcf.zero_at_start:
        yield Finding(WRONG, "start", "still", f"{text}, but zero_at_start wants its zero pose there", action)
    else:
        yield Finding(
            LOOK, "start", "still", text, f"{action} (still_start: 0 tells that there is nothing to wait for)"
        )
