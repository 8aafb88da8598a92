"""What in a configuration is allowed but can hardly be meant: for `jointest inspect`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from jointest_ros.config import values as read
from jointest_ros.config.reader import Configuration
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.errors import ConfigurationError, counted
from jointest_ros.core.hall_sensor import ExponentialCurve
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.rotation import norm
from jointest_ros.core.timing import Timing
from jointest_ros.evaluation.inspection.findings import LOOK, OK, WRONG, Finding

MEASURE = "MEASURE"  # `jointest init` marks by it what nobody has measured yet
_HOUSE = 10.0  # m


def soundness(configuration: Configuration) -> Iterator[Finding]:
    """What there is to say of a configuration that could be read."""
    findings = [
        *_estimators(configuration),
        *_sensors(configuration),
        *_geometry(configuration),
        *_timing(configuration.timing),
    ]
    file = configuration.calibration_file
    if file is not None and not file.exists():
        text = f"'{file.name}' does not exist yet"
        findings.append(
            Finding(LOOK, "calibration_file", "calibration", text, "jointest calibrate axis, zero, accel, ...")
        )
    if all(finding.level == OK for finding in findings):
        robot = configuration.robot
        names = ", ".join(configuration.estimators)
        angles, sensors = counted(len(robot.coordinates), "joint angle"), counted(len(robot.sensors), "sensor")
        text = f"{angles}, {sensors}; {names} can be made of it"
        findings.append(Finding(OK, "configuration", "configuration", text))
    yield from findings


def _estimators(configuration: Configuration) -> Iterator[Finding]:
    robot = configuration.robot
    if not configuration.estimators:
        suited = []
        for name, kind in ESTIMATORS.items():
            try:
                kind(robot, None, configuration.timing)
                suited.append(name)
            except ConfigurationError:
                continue
        action = f"one of {', '.join(suited)} suits it" if suited else "none suits these joints and sensors"
        yield Finding(LOOK if suited else WRONG, "estimators", "estimator", "no section", action)
    for name, params in configuration.estimators.items():
        try:
            ESTIMATORS[name](robot, params, configuration.timing)
        except ConfigurationError as error:
            yield Finding(WRONG, f"estimators.{name}", "estimator", str(error), "mend it, or leave the estimator out")


def _sensors(configuration: Configuration) -> Iterator[Finding]:
    robot = configuration.robot
    jointed = {link for joint in robot.joints for link in (joint.parent, joint.child)}
    for link in robot.links:
        if link != robot.world and link not in jointed and robot.joints:
            yield Finding(
                LOOK, f"link {link}", "link", "no joint moves it", "name it in robot: joints:, or leave it out"
            )
        elif link != robot.world and link in jointed and not robot.sensors_on(link):
            text = "no sensor is on it: its joints cannot be estimated"
            yield Finding(LOOK, f"link {link}", "link", text, "add one with link:, or join the links beside it")
    for sensor in robot.sensors:
        if not (sensor.gyro or sensor.accel or sensor.mag):
            yield Finding(LOOK, sensor.name, "sensor", "nothing of it is used", "set gyro, accel or mag to true")


def _geometry(configuration: Configuration) -> Iterator[Finding]:
    """Lengths that nobody gave, that nobody has measured yet, or that are in another unit."""
    text = "" if configuration.path is None else read.read_file(configuration.path, "configuration") or ""
    yield from _not_given(configuration, read.read_yaml(text) or {})
    marked = [line.strip() for line in text.splitlines() if MEASURE in line.partition("#")[2]]
    curves = [line for line in marked if line.startswith("curve:")]
    if curves and any(hall.curve == ExponentialCurve() for hall in configuration.robot.hall):  # not calibrated either
        what = "the curve is that of the paper's sensor"
        yield Finding(LOOK, "hall", "calibration", what, "jointest calibrate hall, or put yours there; remove the mark")
    yield from _long(configuration)
    if number := len(marked) - len(curves):
        what = f"{counted(number, 'line')} marked {MEASURE}: values that nobody has measured yet"
        yield Finding(LOOK, "configuration", "geometry", what, "put yours there and remove the mark")


def _not_given(configuration: Configuration, document: Any) -> Iterator[Finding]:
    """Places that are taken for 0 because nobody gave them, where an estimator uses them."""
    pcf = configuration.estimators.get("pcf")
    users = [name for name in configuration.estimators if name.startswith("accel_")]
    users += ["pcf (lever_arms)"] if isinstance(pcf, PcfParams) and pcf.lever_arms else []
    if not users:
        return
    sensors, joints = document.get("sensors") or {}, document["robot"].get("joints") or {}
    places = {
        "position": [name for name, values in sensors.items() if not _has(values, "position")],
        "origin": [
            name
            for name, values in joints.items()
            if not _has(values, "origin") and values["parent"] != configuration.robot.world
        ],
    }
    for key, names in places.items():
        if names:
            what = f"{', '.join(names)}: no {key}: is given, which counts as 0, and {', '.join(users)} uses it"
            yield Finding(LOOK, key, "geometry", what, "measure it, m, in the frame of the link")


def _long(configuration: Configuration) -> Iterator[Finding]:
    """Lengths of a robot as large as a house: those of one that was measured in millimetres."""
    robot = configuration.robot
    places = [(joint.name, "origin", joint.origin) for joint in robot.joints]
    places += [(sensor.name, "position", sensor.position) for sensor in robot.sensors]
    for name, key, place in places:
        if norm(place) > _HOUSE:
            action = "lengths are in m; 250 mm is 0.25"
            yield Finding(LOOK, name, "geometry", f"{key}: is {norm(place):g} m long", action)


def _has(values: Any, key: str) -> bool:
    return isinstance(values, dict) and key in values


def _timing(timing: Timing) -> Iterator[Finding]:
    if timing.reset_jump < timing.max_gap:
        text = f"reset_jump ({timing.reset_jump:g} s) is less than max_gap ({timing.max_gap:g} s): gaps are restarts"
        yield Finding(LOOK, "timing", "timing", text, "make reset_jump the longer one")
    if timing.stale_after < timing.max_gap:
        text = f"stale_after ({timing.stale_after:g} s) is less than max_gap ({timing.max_gap:g} s)"
        yield Finding(
            LOOK, "timing", "timing", f"{text}: joints vanish in gaps that are bridged", "make it the longer one"
        )
