"""The joints between the sensors of a recording: axes, mountings, signs, zero, what the motion shows of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointest_ros.core.accel.array import joint_arrays
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import FloatArray, Vec3, vec3
from jointest_ros.core.robot import Robot
from jointest_ros.core.rotation import rotate
from jointest_ros.evaluation.inertial_windows import StillPhase, WindowMeans
from jointest_ros.evaluation.inspection import against_truth, arrays, bodies, hall, hinge_gravity, hinges, two_axes
from jointest_ros.evaluation.inspection.findings import LOOK, OK, WRONG, Finding
from jointest_ros.evaluation.inspection.grid import Phase, rate_time, rows_of
from jointest_ros.evaluation.inspection.hinge_motion import HingeMotion, hinge_motion
from jointest_ros.evaluation.inspection.sensors import SensorReport
from jointest_ros.evaluation.joint_pairs import Pair, hinge_pairs
from jointest_ros.evaluation.measures import angle_between
from jointest_ros.evaluation.mounting_fit import reading
from jointest_ros.evaluation.truth import Truth

_APART = math.radians(20.0)  # of the verticals of two sensors in the zero pose
_TILTED = math.radians(45.0)


@dataclass
class JointReport:
    """One hinge.

    Attributes:
        motion: as configured.
        off_deg: by how much the identified axis is off in parent and child, NaN where it is not known.
        zero_deg: what it reads in the still start, NaN without.
    """

    name: str
    motion: HingeMotion
    off_deg: tuple[float, float]
    zero_deg: float


def with_still(means: WindowMeans, reports: Mapping[str, SensorReport], phases: list[Phase]) -> WindowMeans:
    """The means with the phases in which all sensors stood still."""
    still = []
    for start, end in phases:
        gyro, accel = (
            {n: _mean(getattr(r.si, key)[rows_of(r.si, (start, end))]) for n, r in reports.items()}
            for key in ("gyro", "accel")
        )
        still.append(StillPhase(start, end, gyro, accel))
    return replace(means, still=still)


def _mean(rows: FloatArray) -> Vec3:
    return vec3(rows.mean(axis=0))


def biases(reports: Mapping[str, SensorReport]) -> dict[str, FloatArray]:
    """Of the gyros that were at rest, (3,) rad/s."""
    return {name: report.rest.gyro_bias for name, report in reports.items() if report.rest is not None}


class Joints:
    """Judges the joints whose sensors are sound.

    Args:
        usable: the sound sensors.
        means: with their still phases.
        start: the still start, None where there is none.
        takes_zero: its pose becomes the zero pose.
        cone: rad, from the vertical, in which an axis tells nothing.

    Attributes:
        unjudged: hinge -> its sensors that are not sound.
    """

    def __init__(
        self,
        robot: Robot,
        usable: Mapping[str, SensorReport],
        means: WindowMeans,
        start: Phase | None,
        takes_zero: bool,
        cone: float,
        truth: Truth,
    ) -> None:
        self._robot, self._usable, self._means, self._start = robot, usable, means, start
        self._takes_zero, self._cone, self._truth = takes_zero, cone, truth
        self._biases = biases(usable)
        self.unjudged: dict[str, list[str]] = {}
        try:
            pairs, _ = hinge_pairs(robot)
        except ConfigurationError:  # no hinge between IMUs
            pairs = []
        self._motions: dict[str, HingeMotion] = {}
        self._brief: list[str] = []  # hinges whose sensors gave too little together
        for pair in pairs:
            if lacking := [sensor.name for sensor in pair.sensors if sensor.name not in usable]:
                self.unjudged[pair.joint.name] = lacking
            elif (motion := hinge_motion(means, pair, self._biases)) is not None:
                self._motions[pair.joint.name] = motion
            else:
                self._brief.append(pair.joint.name)
        self._pairs = {name: motion.pair for name, motion in self._motions.items()}
        self._fits = {name: hinges.identify(means, pair) for name, pair in self._pairs.items()}
        middles = [rate_time(report.si, means.length) for report in usable.values()]
        self._when = means.first, means.length, float(np.median(middles)) if middles else 0.0

    def reports(self) -> list[JointReport]:
        """Figures of the hinges."""
        reports = []
        for name, motion in self._motions.items():
            fit = self._fits[name]
            off = (math.nan, math.nan)
            if fit is not None and motion.moves:
                one, two = (math.degrees(axis.change) if axis.determined else math.nan for axis in fit.axes)
                off = one, two
            reports.append(JointReport(name, motion, off, math.degrees(self._zero(motion.pair))))
        return reports

    def findings(self) -> Iterator[Finding]:
        """All that there is to say."""
        one_body = list(bodies.one_body_findings(self._robot, self._means, self._gyros()))
        yield from one_body
        swap = None if one_body else self._exchanged()
        if swap is not None:
            text = f"'{swap[0]}' and '{swap[1]}' are exchanged: that explains the motion of all joints"
            yield Finding(WRONG, swap[0], "exchanged", text, "exchange their topic:, frame_id: or link:")
        doubtful = {*(swap or ()), *(finding.subject for finding in one_body)}
        sound = {}
        cleared = hinges.cleared(self._motions, self._fits)
        suspects = hinges.reversed_twice(self._motions, self._fits)
        mounted: set[str] = set()
        for name, motion in self._motions.items():
            if any(sensor.name in doubtful for sensor in motion.pair.sensors):
                continue
            mine = list(hinges.axis_findings(motion, self._fits[name], cleared, suspects))
            yield from (finding for finding in mine if finding.subject not in mounted)
            mounted |= {finding.subject for finding in mine if finding.kind == "mounting"}
            yield from hinge_gravity.gravity_finding(motion, self._cone)
            if all(finding.level != WRONG for finding in mine):
                sound[name] = motion
                yield from self._gravity(motion, all(finding.level == OK for finding in mine))
        if self._truth.position:
            yield from against_truth.truth_findings(sound, self._truth, *self._when, self._takes_zero)
        means = replace(self._means, gyro={name: self._means.gyro[name] for name in self._gyros()})
        yield from two_axes.two_axis_findings(self._robot, means, self._biases)
        if self._takes_zero and self._start is not None:
            for pair in two_axes.pairs(self._robot, means.given):
                yield from self._zero_findings(pair, self._start)
        yield from self._upright()
        yield from self._others()
        yield from self._left_out()

    def _gyros(self) -> list[str]:
        return [name for name, report in self._usable.items() if report.gyro]

    def _exchanged(self) -> tuple[str, str] | None:
        """Two sensors that are taken for each other."""

        def others(one: str, two: str) -> dict[str, HingeMotion] | None:
            found = {}
            for name, pair in self._pairs.items():
                motion = hinge_motion(self._means, hinges.exchanged(pair, one, two), self._biases)
                if motion is None:
                    return None
                found[name] = motion
            return found

        if any(hinges.suspicious(motion, self._fits[name]) for name, motion in self._motions.items()):
            return hinges.swapped(self._means, list(self._pairs.values()), self._motions, self._biases)
        if self._truth.position:
            return against_truth.exchanged_by_truth(self._motions, others, self._truth, *self._when)
        return None

    def _gravity(self, motion: HingeMotion, fits: bool) -> Iterator[Finding]:
        """Tilt, limits, zero. Where the axis does not fit (False), the tilt says it once more."""
        if fits or not motion.moves:
            yield from hinge_gravity.tilt_finding(motion)
        zero = self._zero(motion.pair)
        if motion.moves:
            yield from hinge_gravity.limits_finding(motion, zero if self._takes_zero and not math.isnan(zero) else 0.0)
        if self._takes_zero and self._start is not None:
            yield from self._zero_findings(motion.pair, self._start)

    def _at_rest(self, pair: Pair, start: Phase) -> tuple[Vec3, Vec3]:
        """Accelerometers of parent and child in the still start, sensor frames."""
        one, two = (self._usable[sensor.name].si for sensor in pair.sensors)
        return _mean(one.accel[rows_of(one, start)]), _mean(two.accel[rows_of(two, start)])

    def _zero(self, pair: Pair) -> float:
        """What a joint reads in the still start, rad; NaN: nothing."""
        angle = None if self._start is None else reading(pair, *self._at_rest(pair, self._start))
        return math.nan if angle is None else angle

    def _zero_findings(self, pair: Pair, start: Phase) -> Iterator[Finding]:
        """In the zero pose the link frames coincide, so both sensors must see the vertical in the same direction."""
        up, child_up = (
            np.array(rotate(sensor.mounting, accel))
            for sensor, accel in zip(pair.sensors, self._at_rest(pair, start), strict=True)
        )
        apart = angle_between(up, child_up)
        if apart > _APART:
            one, two = (sensor.name for sensor in pair.sensors)
            where = "in the pose that becomes zero"
            text = f"'{one}' and '{two}' see the vertical {math.degrees(apart):.0f} deg apart {where}"
            action = (
                "a mounting is turned (jointest calibrate zero turns it about the axis), or that is not the zero pose"
            )
            yield Finding(LOOK, pair.joint.name, "zero", text, action)

    def _upright(self) -> Iterator[Finding]:
        """The first links of a robot with a world link: z is up in the zero pose."""
        for joint in self._robot.joints:
            if not self._robot.world or joint.parent != self._robot.world or self._start is None:
                continue
            for sensor in self._robot.sensors_on(joint.child):
                if sensor.name not in self._usable or not sensor.accel:
                    continue
                own = self._usable[sensor.name].si
                x, y, z = rotate(sensor.mounting, _mean(own.accel[rows_of(own, self._start)]))
                tilt = math.degrees(math.atan2(math.hypot(x, y), z))
                if tilt > math.degrees(_TILTED):
                    text = f"link '{joint.child}' is tilted by {tilt:.0f} deg at the start, by '{sensor.name}'"
                    action = "if it stood upright there, mend mounting:; the angles from the world are as wrong"
                    yield Finding(LOOK, joint.name, "zero", text, action)

    def _left_out(self) -> Iterator[Finding]:
        """Joints of which nothing is said above."""
        for name in self._brief:
            text = "its sensors gave too little at the same time: not judged"
            yield Finding(LOOK, name, "unjudged", text, "record for longer")
        for joint in self._robot.joints:
            if len(joint.axes) > 2 and joint.parent != self._robot.world:
                text = "a joint of three axes can turn in any way: no motion contradicts its axes and mountings"
                yield Finding(LOOK, joint.name, "unjudged", text, "compare its angles in poses that you know")

    def _others(self) -> Iterator[Finding]:
        """Gyros without accelerometers, and accelerometers without gyros."""
        usable, robot = self._usable, self._robot
        gyros = tuple(s for s in robot.sensors if s.gyro and not s.accel and s.name in usable)
        yield from hall.gyro_findings(replace(robot, sensors=gyros), self._means, self._biases)
        alone = tuple(s for s in robot.sensors if s.accel and not s.gyro and s.name in usable)
        try:
            found = joint_arrays(replace(robot, sensors=alone))
        except ConfigurationError:
            return
        for one in found:
            readings = arrays.array_readings(one, self._means.accel)
            if readings is not None:
                yield from arrays.array_findings(one, readings)
