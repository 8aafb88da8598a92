"""A joint of two axes between two inertial sensors: do gravity and gyros say the same of it?

With the axes j1 in the parent and j2 in the child, both see gravity turned by the joint: u = R1(q1) R2(q2) v. Since the
first axis keeps its component, j1.u = j1.R2(q2) v, which is one equation for q2 with two solutions; q1 follows. Then
all of the motion between the links must be about the two axes: (R1 R2 w_child - w_parent).(j1 x R1 j2) = 0. Neither a
heading nor an integral is needed. A mounting that is turned about its axis, or that reverses it, is an offset or the
sign of an angle, which the zero pose tells.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import STANDARD_GRAVITY, Robot
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.inspection.agreement import signed_permutations
from jointest_ros.evaluation.inspection.bodies import turn_as_one
from jointest_ros.evaluation.inspection.findings import LOOK, OK, WRONG, Finding
from jointest_ros.evaluation.inspection.hinge_motion import STILL
from jointest_ros.evaluation.joint_pairs import Pair, imu_on
from jointest_ros.evaluation.measures import rms

_QUIET = 0.05  # of g, by which the norm of an accelerometer may differ where it tells the vertical
_FEWEST, _MOST = 100, 3000  # windows
_DEFINED = 0.3  # sine, of the vertical to an axis and of the angle to where the two solutions meet: less tells little
_AGREES = 0.12  # share of the rate that may be about neither axis: of mountings that are some degrees off
_SLIGHT = 0.1  # share of the rate that about one axis is no motion: what verticals off by some degrees feign
_BETTER = 0.3  # of what is left over as configured, which another mounting must stay below


@dataclass(frozen=True)
class _Windows:
    """Quiet windows in link frames by the mountings: (n, 3) unit verticals and rates, of parent and child."""

    up: FloatArray
    rate: FloatArray
    child_up: FloatArray
    child_rate: FloatArray


def two_axis_findings(robot: Robot, means: WindowMeans, biases: Mapping[str, FloatArray]) -> Iterator[Finding]:
    """What there is to say of the joints of two axes with sound IMUs on either side.

    Args:
        means: of the sound sensors; `biases`: of their gyros where they are known, (3,) rad/s.
    """
    for pair in pairs(robot, means.given):
        if len(pair.joint.axes) == 2:
            yield from _findings(pair, means, biases)


def pairs(robot: Robot, sensors: Collection[str]) -> Iterator[Pair]:
    """The joints of two and three axes with an IMU of `sensors` on either side."""
    for joint in robot.joints:
        parent, child = imu_on(robot, joint.parent), imu_on(robot, joint.child)
        if len(joint.axes) > 1 and parent and child and {parent.name, child.name} <= set(sensors):
            yield Pair(joint, parent, child)


def _findings(pair: Pair, means: WindowMeans, biases: Mapping[str, FloatArray]) -> Iterator[Finding]:
    name, (one, two) = pair.joint.name, (sensor.name for sensor in pair.sensors)
    if turn_as_one(means.gyro[one], means.gyro[two], 5.0 * STILL, STILL):
        action = "bend this joint; if you did: are both sensors on one link, or is one topic that of another sensor?"
        yield Finding(LOOK, name, "motion", f"'{one}' and '{two}' turn as one", action)
        return
    windows = _quiet(pair, means, biases)
    own = _left_over(windows, pair)
    if own is None:
        text = "it is never quiet enough, or its axes are vertical: axes and mountings are not judged"
        yield Finding(LOOK, name, "unjudged", text, "move it slowly in another recording, its axes slanted")
        return
    if own.total < STILL:
        yield Finding(LOOK, name, "motion", "it hardly moves", "bend it about both axes in another recording")
        return
    share = own.over / own.total
    if share > _AGREES:
        yield _disagreement(pair, windows, share)
        return
    least = max(STILL, _SLIGHT * own.total)
    for coordinate, rate in zip(pair.joint.coordinates, own.rates, strict=True):
        if rate < least:
            text = f"it hardly moves about this axis ({math.degrees(rate):.1f} deg/s rms): it is not judged"
            yield Finding(LOOK, coordinate, "motion", text, "bend it about both axes in another recording")
    if min(own.rates) >= least:
        text = f"all but {share:.0%} of the motion is about its two axes, by gravity and gyros"
        yield Finding(OK, name, "axis", text)


@dataclass(frozen=True)
class _LeftOver:
    """rms, rad/s: about neither axis, of the whole motion between the links, about each axis."""

    over: float
    total: float
    rates: tuple[float, float]


def _quiet(pair: Pair, means: WindowMeans, biases: Mapping[str, FloatArray]) -> _Windows:
    rows: list[FloatArray] = []
    quiet = np.ones(len(means.start), dtype=bool)
    for sensor in pair.sensors:
        accel, gyro = means.accel[sensor.name], means.gyro[sensor.name] - biases.get(sensor.name, np.zeros(3))
        norm = np.linalg.norm(accel, axis=1)
        quiet &= np.isfinite(gyro).all(axis=1) & (abs(norm / STANDARD_GRAVITY - 1.0) < _QUIET)
        turn = Rotation.from_quat(sensor.mounting)
        whole = np.isfinite(norm)
        up = np.full_like(accel, np.nan)
        up[whole] = turn.apply(accel[whole]) / norm[whole, None]
        rows += [up, gyro @ turn.as_matrix().T]
    every = max(1, int(quiet.sum()) // _MOST)
    up, rate, child_up, child_rate = (table[quiet][::every] for table in rows)
    return _Windows(up, rate, child_up, child_rate)


def _left_over(windows: _Windows, pair: Pair) -> _LeftOver | None:
    """Of both solutions, a window has the one that leaves less; None where too few windows say anything."""
    first, second = (np.array(axis) for axis in pair.joint.axes)
    u, v = windows.up, windows.child_up
    along = float(first @ second)
    cosine = v @ first - along * (v @ second)
    sine = np.cross(second, v) @ first
    level = u @ first - along * (v @ second)
    size = np.hypot(cosine, sine)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.clip(np.nan_to_num(level / size), -1.0, 1.0)
    clear = (size > _DEFINED) & (np.linalg.norm(np.cross(u, first), axis=1) > _DEFINED)
    if clear.sum() < _FEWEST:
        return None
    best, rates, whole = np.full(len(u), np.inf), np.zeros((len(u), 2)), np.zeros(len(u))
    for sign in (1.0, -1.0):
        turn2 = Rotation.from_rotvec((np.arctan2(sine, cosine) + sign * np.arccos(ratio))[:, None] * second)
        seen = turn2.apply(v)
        flat, target = seen - np.outer(seen @ first, first), u - np.outer(u @ first, first)
        angle = np.arctan2(np.cross(flat, target) @ first, np.sum(flat * target, axis=1))
        turn1 = Rotation.from_rotvec(angle[:, None] * first)
        moved = (turn1 * turn2).apply(windows.child_rate) - windows.rate
        other = turn1.apply(second)
        normal = np.cross(first, other)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        over = abs(np.sum(moved * normal, axis=1))
        less = over < best
        about = np.column_stack([moved @ first, np.sum(moved * other, axis=1)])
        gram = np.linalg.inv(np.array([[1.0, along], [along, 1.0]]))
        best[less], rates[less] = over[less], (about @ gram.T)[less]
        whole[less] = np.linalg.norm(moved, axis=1)[less]
    usable = clear & (abs(level) < math.sqrt(1.0 - _DEFINED**2) * size)  # not where both solutions meet
    fewer = usable if usable.sum() >= _FEWEST else clear
    one, two = (rms(rates[fewer, k]) for k in range(2))
    return _LeftOver(rms(best[fewer]), rms(whole[fewer]), (one, two))


def _disagreement(pair: Pair, windows: _Windows, share: float) -> Finding:
    """Which mistake explains it: the sensors exchanged, or one of them mounted with other axes."""
    one, two = (sensor.name for sensor in pair.sensors)
    text = f"gravity and gyros do not agree that it has these two axes: {share:.0%} of the motion is about neither"
    best = _BETTER * share
    found: tuple[str, str, str] | None = None
    other = _exchanged(pair, windows)
    if (left := _share(other, pair)) < best:
        best, found = left, (pair.joint.name, "exchanged", f"'{one}' and '{two}' are exchanged")
    for matrix in signed_permutations():
        if np.linalg.det(matrix) < 0.0:
            continue
        for sensor, turned in (
            (one, _Windows(windows.up @ matrix.T, windows.rate @ matrix.T, windows.child_up, windows.child_rate)),
            (two, _Windows(windows.up, windows.rate, windows.child_up @ matrix.T, windows.child_rate @ matrix.T)),
        ):
            if (left := _share(turned, pair)) < 0.8 * best:  # another one must be better, not only as good
                axis = Rotation.from_matrix(matrix).as_rotvec()
                what = f"it is mounted turned by {math.degrees(np.linalg.norm(axis)):.0f} deg"
                best, found = left, (sensor, "mounting", f"{what} about {_axis(axis)} of its link, or likewise")
    action = "mend mounting:, axes: or topic:; mountings up to 45 deg off: jointest calibrate axis"
    if found is None:
        return Finding(LOOK, pair.joint.name, "axis", text, action)
    subject, kind, reason = found
    of = "" if subject == pair.joint.name else f"{pair.joint.name}: "
    return Finding(WRONG, subject, kind, f"{of}{text}; {reason}: that leaves {best:.0%}", action)


def _axis(vector: FloatArray) -> str:
    return f"[{', '.join(f'{round(float(part), 2) + 0.0:g}' for part in vector / np.linalg.norm(vector))}]"


def _exchanged(pair: Pair, windows: _Windows) -> _Windows:
    """The readings of either sensor taken with the mounting of the other."""
    one, two = (Rotation.from_quat(sensor.mounting) for sensor in pair.sensors)
    to_parent, to_child = (one * two.inv()).as_matrix(), (two * one.inv()).as_matrix()
    return _Windows(
        windows.child_up @ to_parent.T,
        windows.child_rate @ to_parent.T,
        windows.up @ to_child.T,
        windows.rate @ to_child.T,
    )


def _share(windows: _Windows, pair: Pair) -> float:
    found = _left_over(windows, pair)
    return math.inf if found is None or not found.total else found.over / found.total
