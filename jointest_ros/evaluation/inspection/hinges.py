"""A hinge between two inertial sensors: does the recording show the axis, the mountings and the signs as configured?"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.frame import FloatArray, vec3
from jointest_ros.core.rotation import rotate
from jointest_ros.evaluation.axis_calibration import fit_axes
from jointest_ros.evaluation.axis_fit import Axis, AxisFit
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.inspection.findings import LOOK, OK, WRONG, Finding
from jointest_ros.evaluation.inspection.hinge_motion import STILL, HingeMotion, hinge_motion
from jointest_ros.evaluation.joint_pairs import Pair
from jointest_ros.evaluation.measures import angle_between

SLIGHT = math.radians(5.0)  # of an axis: worth a word
FAR = math.radians(15.0)  # of an axis: the angles are wrong
_SIGMAS = 3.0
_NO_HINGE = 0.25  # share of the joint's rate in what no axis explains
_REVERSED = math.radians(160.0)
_MUCH_LESS = 0.1  # of the squares that are left over


def identify(means: WindowMeans, pair: Pair) -> AxisFit | None:
    """The axis of the hinge in both sensors by the motion; None where they gave too little together."""
    try:
        return fit_axes(means, pair)
    except CalibrationError:
        return None


def suspicious(motion: HingeMotion, fit: AxisFit | None) -> bool:
    """The motion is not as configured."""
    return motion.moves and fit is not None and (_loose(fit) or any(_off(axis) > SLIGHT for axis in fit.axes))


def _off(axis: Axis) -> float:
    """By how much an identified axis is certainly off, rad; 0 where it is not known."""
    return max(0.0, axis.change - _SIGMAS * axis.std) if axis.determined else 0.0


def _loose(fit: AxisFit) -> bool:
    return fit.misfit > _NO_HINGE * fit.joint_rate


def cleared(motions: Mapping[str, HingeMotion], fits: Mapping[str, AxisFit | None]) -> set[str]:
    """The sensors of hinges whose axis is as configured."""
    sound = set()
    for name, fit in fits.items():
        if fit is not None and motions[name].moves and fit.determined and not suspicious(motions[name], fit):
            sound |= {axis.sensor for axis in fit.axes}
    return sound


def reversed_twice(motions: Mapping[str, HingeMotion], fits: Mapping[str, AxisFit | None]) -> set[str]:
    """The sensors that two hinges or more see the other way round: one mistake explains both."""
    seen = Counter(
        axis.sensor
        for name, fit in fits.items()
        if fit is not None and motions[name].moves and not _loose(fit)
        if any(_off(one) > _REVERSED for one in fit.axes)
        for axis in fit.axes
    )
    return {sensor for sensor, times in seen.items() if times > 1}


def axis_findings(
    motion: HingeMotion, fit: AxisFit | None, cleared: Collection[str], suspects: Collection[str]
) -> Iterator[Finding]:
    """Whether the axis is where it is configured.

    Args:
        cleared: sensors that are as configured by another hinge.
        suspects: sensors of several hinges whose axis points the other way.
    """
    pair, name = motion.pair, motion.pair.joint.name
    one, two = (sensor.name for sensor in pair.sensors)
    if not motion.moves:
        text = f"it hardly moves ({_dps(motion.joint_rate)} rms): axis, signs and mountings are not judged"
        if fit is not None and min(fit.link_rates) > 5.0 * STILL:
            text = f"'{one}' and '{two}' turn as one ({_dps(motion.joint_rate)} rms between them)"
            action = (
                "bend this joint; if you did: are both sensors on one link, or is one topic that of another sensor?"
            )
            yield Finding(LOOK, name, "motion", text, action)
        else:
            yield Finding(LOOK, name, "motion", text, "bend it through its whole range in another recording")
        return
    if fit is None:
        return
    if _loose(fit):
        text = (
            f"the motion between '{one}' and '{two}' is not about one axis: {_dps(fit.misfit)} of "
            f"{_dps(fit.joint_rate)} rms remain with the best axis"
        )
        action = "are these the sensors on either side (link:, topic:, frame_id:)? Has one of them come loose?"
        yield Finding(WRONG, name, "hinge", text, action)
        return
    off = {axis.sensor: _off(axis) for axis in fit.axes if axis.determined}
    if not off:
        yield Finding(LOOK, name, "axis", "the motion does not show the axis", "move it further, and for longer")
        return
    if max(off.values()) <= SLIGHT:
        within = ", ".join(f"'{a.sensor}' {math.degrees(a.change):.1f}" for a in fit.axes if a.determined)
        yield Finding(OK, name, "axis", f"the axis is as configured (deg off, in {within})")
        return
    yield _axis_finding(fit, pair, off, cleared, suspects)


def _axis_finding(
    fit: AxisFit, pair: Pair, off: Mapping[str, float], cleared: Collection[str], suspects: Collection[str]
) -> Finding:
    name = pair.joint.name
    level = WRONG if max(off.values()) > FAR else LOOK
    in_link = {
        axis.sensor: np.array(rotate(sensor.mounting, vec3(axis.axis)))
        for axis, sensor in zip(fit.axes, pair.sensors, strict=True)
        if axis.determined
    }
    configured = _text(pair.axis)
    if len(in_link) == 2:
        one, two = in_link.values()
        # both see the same one: the axis, or both mountings, are wrong
        if angle_between(one, two) < 0.5 * max(off.values()):
            mean = one + two
            text = f"it turns about {_text(mean / np.linalg.norm(mean))} in both links, not about {configured}"
            action = "mend axis:, or check whether both mountings are turned alike; jointest calibrate axis"
            return Finding(level, name, "axis", text, action)
        odd = max(off, key=lambda sensor: off[sensor])
        other = next(sensor for sensor in off if sensor != odd)
        if off[odd] > _REVERSED and (odd in cleared or (other in suspects and odd not in suspects)):
            odd = other  # of two opposite axes, the motion does not tell which is right
            return _mounting(level, odd, name, math.pi, -in_link[odd], configured)
        return _mounting(level, odd, name, off[odd], in_link[odd], configured)
    ((sensor, axis),) = in_link.items()
    text = f"it turns about {_text(axis)} as '{sensor}' is mounted, not about {configured} ({deg(off[sensor])} off)"
    action = f"mend axis:, or mounting: of '{sensor}'; which one, a recording shows in which the parent turns too"
    return Finding(level, name, "axis", text, action)


def _mounting(level: str, sensor: str, joint: str, off: float, axis: FloatArray, configured: str) -> Finding:
    if off > _REVERSED:
        what = f"the axis of {joint} points the other way than as configured: it is mounted the other way round"
    else:
        what = f"the axis of {joint} is {_text(axis)} as it is mounted, not {configured}: turned by {deg(off)}"
    return Finding(level, sensor, "mounting", what, "mend mounting:, or let jointest calibrate axis find it")


def swapped(
    means: WindowMeans, pairs: Sequence[Pair], motions: Mapping[str, HingeMotion], biases: Mapping[str, FloatArray]
) -> tuple[str, str] | None:
    """The two sensors that, exchanged, explain the motion of all hinges as configured; None: no two do."""
    now = _left_over(motions.values())
    best: tuple[float, tuple[str, str]] | None = None
    for one, two in itertools.combinations(dict.fromkeys(s.name for pair in pairs for s in pair.sensors), 2):
        others = [hinge_motion(means, exchanged(pair, one, two), biases) for pair in pairs]
        left = _left_over(others)
        if left < _MUCH_LESS * now and (best is None or left < best[0]):
            best = left, (one, two)
    if best is None:
        return None
    for pair in (exchanged(pair, *best[1]) for pair in pairs):
        motion = hinge_motion(means, pair, biases)
        if motion is None or suspicious(motion, identify(means, pair)):
            return None
    return best[1]


def _left_over(motions: Iterable[HingeMotion | None]) -> float:
    """Sum of the squares of what the axes do not explain."""
    return sum(math.inf if m is None else m.across_rate**2 * len(m.data) for m in motions)


def exchanged(pair: Pair, one: str, two: str) -> Pair:
    """The pair with the readings of two sensors taken for each other; places and mountings stay."""
    other = {one: two, two: one}
    parent, child = (replace(s, name=other.get(s.name, s.name)) for s in pair.sensors)
    return replace(pair, parent=parent, child=child)


# ---------------------------------------------------------------- texts


def _text(axis: FloatArray) -> str:
    """As it is written in a configuration: a letter where it is near one."""
    largest = int(np.argmax(abs(axis)))
    if abs(axis[largest]) > math.cos(math.radians(3.0)):
        return f"{'-' if axis[largest] < 0 else ''}{'xyz'[largest]}"
    return f"[{', '.join(f'{round(float(component), 2) + 0.0:g}' for component in axis)}]"


def _dps(rate: float) -> str:
    return f"{math.degrees(rate):.1f} deg/s"


def deg(angle: float) -> str:
    """An angle in rad, for a text."""
    return f"{math.degrees(angle):.0f} deg"
