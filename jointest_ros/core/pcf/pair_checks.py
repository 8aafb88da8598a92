"""Do the IMUs of a chain of hinges agree? Finds one that has slipped, or is mounted otherwise than configured.

For a pair of IMUs with one hinge between them, or two parallel ones (a redundant pair: IMU 1 to 3 gives q1 + q2):

residual   angle between the IMUs by their accelerometers, less that of the filters, which trust the gyros for seconds;
           low-passed, so that what accelerates the links averages out
tilt       elevation of the axis by the child's accelerometer less that by the parent's; low-passed
turned     residual + what the accelerometers have moved the filters' angle by, against the gyros, in the last seconds;
           its largest value where the residual was too large: an IMU was turned about the axis by so much

A redundant pair needs no filter of its own: with parallel axes its rates and its gravity angles are the sums of those
of the two pairs, and so is the filter that they drive. That it repeats them is what tells which IMU slipped: the middle
one shows in both pairs, with opposite signs, and not in their sum. What no check can show is a slip about the axis that
the gyro sees too: it looks as a motion of the joint does, and takes the next zero pose along.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from jointest_ros.core.frame import Frame
from jointest_ros.core.pcf.hinge import HingeFilter
from jointest_ros.core.robot import STANDARD_GRAVITY, Robot
from jointest_ros.core.rotation import dot, rotate_inverse, wrap

STEP = 19_000_000  # ns: every 20 ms is enough, and costs a tenth of a microsecond a sample at 1 kHz
SETTLING = 5_000_000_000  # ns after a start or a gap, until the filter trusts its gyros
RESIDUAL_TIME = 2.0  # s
MEMORY = 20.0  # s
TILT_TIME = 5.0  # s
# Real hinges with an uncalibrated MPU6050, moving at up to 170 deg/s, reach 2 deg.
RESIDUAL_LIMIT = math.radians(3.5)
TILT_LIMIT = math.radians(5.0)
# An IMU that slips by 45 deg in simulation adds up to 56; a reversed gyro to 230, one in deg/s to thousands.
CONTRADICTION_LIMIT = math.radians(90.0)
CONTRADICTION = (
    "gyro and accelerometer contradict each other: units (deg/s?), reversed axes or mountings; "
    "record a minute and run jointest inspect"
)
_PARALLEL = 0.999  # cosine


@dataclass(frozen=True, slots=True)
class PairCheck:
    """What the module text says of one pair; angles in rad, about the axis of the last joint.

    Attributes:
        sensors: the two IMUs.
        joints: the hinges between them: two, where the pair is redundant.
        turned: 0 while the residual has never been too large since the latest zero pose.
    """

    sensors: tuple[str, str]
    joints: tuple[str, ...]
    residual: float
    tilt: float
    turned: float

    @property
    def agrees(self) -> bool:
        """Neither slipped nor tilted."""
        return not self.turned and abs(self.tilt) <= TILT_LIMIT


class _Hinge:
    """The running means of one hinge."""

    def __init__(self, robot: Robot, hinge: HingeFilter) -> None:
        self.hinge = hinge
        self.axis1, self.axis2 = (
            rotate_inverse(robot.sensor(name).mounting, hinge.joint.axes[0]) for name in hinge.sensors
        )
        self.restart()

    def restart(self) -> None:
        self.stamp: int | None = None
        self.settled = 0  # ns
        self.q = self.velocity = self.tilt = 0.0
        self.residual = self.moved = 0.0

    def update(self, frame: Frame) -> None:
        hinge, stamp = self.hinge, frame.stamp
        if hinge.stamp != stamp:  # a sensor is missing
            return
        q, velocity = hinge.q, hinge.rate - hinge.b
        elapsed = math.inf if self.stamp is None else (stamp - self.stamp) * 1e-9
        if elapsed > hinge.gaps.max_gap:
            self.settled = stamp + SETTLING
            self.residual = self.moved = 0.0
        elif stamp >= self.settled:
            innovation = hinge.innovation if hinge.innovation == hinge.innovation else 0.0
            self.residual += (innovation - self.residual) * elapsed / RESIDUAL_TIME
            self.moved += wrap(q - self.q) - 0.5 * (velocity + self.velocity) * elapsed - self.moved * elapsed / MEMORY
            one, two = hinge.inputs.accels
            tilt = (dot(self.axis2, two) - dot(self.axis1, one)) / STANDARD_GRAVITY
            self.tilt += (tilt - self.tilt) * elapsed / TILT_TIME
        self.stamp, self.q, self.velocity = stamp, q, velocity


@dataclass(slots=True)
class _Pair:
    """Hinges between two IMUs with the sense of their axes, and the largest turn."""

    sensors: tuple[str, str]
    hinges: tuple[tuple[float, _Hinge], ...]
    turned: float = 0.0

    def update(self) -> None:
        residual = sum(sign * one.residual for sign, one in self.hinges)
        if abs(residual) > RESIDUAL_LIMIT:
            turned = residual + sum(sign * one.moved for sign, one in self.hinges)
            self.turned = max(self.turned, turned, key=abs)

    def check(self) -> PairCheck:
        joints = tuple(one.hinge.joint.name for _, one in self.hinges)
        residual, tilt = (sum(sign * getattr(one, name) for sign, one in self.hinges) for name in ("residual", "tilt"))
        return PairCheck(self.sensors, joints, residual, tilt, self.turned)


class PairChecks:
    """Watches the hinges of an estimator, but for those on the world link."""

    def __init__(self, robot: Robot, hinges: Sequence[HingeFilter]) -> None:
        self._hinges = [_Hinge(robot, hinge) for hinge in hinges if hinge.joint.parent != robot.world]
        self._pairs = [_Pair((one.hinge.parent, one.hinge.child), ((1.0, one),)) for one in self._hinges]
        for one in self._hinges:
            for two in self._hinges:
                along = dot(one.hinge.joint.axes[0], two.hinge.joint.axes[0])
                if one.hinge.joint.child == two.hinge.joint.parent and abs(along) > _PARALLEL:
                    sense = math.copysign(1.0, along)
                    self._pairs.append(_Pair((one.hinge.parent, two.hinge.child), ((sense, one), (1.0, two))))
        self._next = -(2**63)

    def update(self, frame: Frame) -> None:
        """Look at the filters after their step."""
        if frame.reset:
            self.reset()
        if frame.stamp < self._next:
            return
        self._next = frame.stamp + STEP
        for one in self._hinges:
            one.update(frame)
        for pair in self._pairs:
            pair.update()

    def reset(self) -> None:
        """Begin anew, because the filters do."""
        self._next = -(2**63)
        for one in self._hinges:
            one.restart()
        self.clear()

    def clear(self) -> None:
        """Forget what had turned: a zero pose was taken."""
        for one in self._hinges:
            one.residual = one.moved = 0.0
        for pair in self._pairs:
            pair.turned = 0.0

    def checks(self) -> list[PairCheck]:
        """The present state of all pairs: those with one hinge, then the redundant ones."""
        return [pair.check() for pair in self._pairs]


def odd_ones(checks: Sequence[PairCheck]) -> list[str]:
    """The IMUs that explain every pair that does not agree, and are in none that does if there are such."""
    wrong = [set(check.sensors) for check in checks if not check.agrees]
    if not wrong:
        return []
    common = set.intersection(*wrong)
    trusted = {sensor for check in checks if check.agrees for sensor in check.sensors}
    return sorted(common - trusted or common)


def contradicts(checks: Sequence[PairCheck]) -> bool:
    """The gyros were corrected by more than a slip can explain."""
    return any(abs(check.turned) > CONTRADICTION_LIMIT for check in checks)


def verdict(checks: Sequence[PairCheck]) -> str:
    """One line about what does not agree, or ""."""
    wrong = [check for check in checks if not check.agrees]
    if not wrong:
        return ""
    names = " or ".join(odd_ones(checks)) or ", ".join("-".join(check.sensors) for check in wrong)
    if contradicts(wrong):
        return f"IMU {names}: {CONTRADICTION}"
    turned = math.degrees(max(abs(check.turned) for check in wrong))
    tilt = math.degrees(max((abs(check.tilt) for check in wrong if abs(check.tilt) > TILT_LIMIT), default=0.0))
    texts = []
    if turned:
        causes = "slipped? take the zero pose anew; fast links without lever_arms look so too"
        texts.append(f"turned by {turned:.1f} deg about the joint's axis ({causes})")
    if tilt:
        texts.append(f"the joint's axis is {tilt:.1f} deg off (mounting, axis or accelerometer calibration wrong?)")
    return f"IMU {names}: {'; '.join(texts)}"
