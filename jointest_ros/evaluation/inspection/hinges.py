"""A hinge between two inertial sensors: does the recording show the axis, the mountings and the signs as configured?"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import STANDARD_GRAVITY, Sensor
from jointest_ros.core.rotation import perpendicular, rotate_inverse
from jointest_ros.evaluation.axis_calibration import fit_axes
from jointest_ros.evaluation.axis_fit import Axis, AxisFit
from jointest_ros.evaluation.hinge_equations import (
    BIAS_1,
    BIAS_2,
    PARAMETERS,
    Frames,
    Hinge,
    HingeData,
    Scatter,
    hinge_data,
)
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.inspection.findings import LOOK, OK, WRONG, Finding
from jointest_ros.evaluation.joint_pairs import Pair

STILL = math.radians(2.0)  # rad/s rms of a joint: less is no motion
_SCATTER = Scatter(math.radians(1.0), 0.5)  # what is left over where all is well, coarsely
_FEWEST = 100  # windows
SLIGHT = math.radians(5.0)  # of an axis: worth a word
FAR = math.radians(15.0)  # of an axis: the angles are wrong
_SIGMAS = 3.0
_NO_HINGE = 0.25  # share of the joint's rate in what no axis explains
_REVERSED = math.radians(160.0)
_MUCH_LESS = 0.1  # of the squares that are left over
_QUIET = 0.05  # of g, by which the norm of an accelerometer may differ where it tells the vertical
_FEW_QUIET = 25  # windows


@dataclass(frozen=True)
class HingeMotion:
    """What a recording holds of one hinge as it is configured.

    Attributes:
        angle: (n,) rad, of the windows in `data`, by mountings, gyros and gravity; within half a turn of the middle of
            the limits, or of the mean.
        rate: (n,) rad/s about the axis, child less parent.
        joint_rate, across_rate: rms of the motion about the axis, and of what the axis does not explain, rad/s.
        gravity: (n,) rad, angle between axis and vertical, 0 to pi / 2.
        tilt: median of the elevation of the axis by the child's accelerometer less that by the parent's, rad; NaN:
            never quiet enough.
    """

    pair: Pair
    data: HingeData
    angle: FloatArray
    rate: FloatArray
    joint_rate: float
    across_rate: float
    gravity: FloatArray
    tilt: float

    @property
    def moves(self) -> bool:
        """Enough to judge it."""
        return self.joint_rate > STILL


def hinge_motion(means: WindowMeans, pair: Pair, biases: Mapping[str, FloatArray]) -> HingeMotion | None:
    """The motion of a hinge as configured; None where its sensors gave too little together.

    Args:
        biases: of the gyros, (3,) rad/s, where they are known.
    """
    data = hinge_data(means, pair.parent.name, pair.child.name)
    if len(data) < _FEWEST:
        return None
    parameters = np.zeros(PARAMETERS)
    nothing = np.zeros(3)
    parameters[BIAS_1], parameters[BIAS_2] = (biases.get(sensor.name, nothing) for sensor in pair.sensors)
    frames = _frames(pair)
    hinge = Hinge(data, frames, parameters, _SCATTER)
    rates = [w - parameters[b] for w, b in zip(data.gyro, (BIAS_1, BIAS_2), strict=True)]
    rate = rates[1] @ frames[1][2] - rates[0] @ frames[0][2]
    across = _SCATTER.gyro * math.sqrt(float(np.mean(abs(hinge.across) ** 2)))
    ups = [a @ frame[2] / STANDARD_GRAVITY for a, frame in zip(data.accel, frames, strict=True)]
    norms = [np.linalg.norm(a, axis=1) / STANDARD_GRAVITY for a in data.accel]
    quiet = np.logical_and(*(abs(norm - 1.0) < _QUIET for norm in norms))
    slanted = [np.arcsin(np.clip(up, -1.0, 1.0)) for up in ups]
    tilt = float(np.median((slanted[1] - slanted[0])[quiet])) if quiet.sum() >= _FEW_QUIET else math.nan
    return HingeMotion(
        pair,
        data,
        _wrapped(hinge.turn, pair),
        rate,
        float(rate.std()),
        across,
        np.arccos(np.clip(abs(ups[0] / norms[0]), 0.0, 1.0)),
        tilt,
    )


def _wrapped(turn: NDArray[np.complex128], pair: Pair) -> FloatArray:
    middle = float(np.angle(turn.mean()))
    if pair.joint.limits is not None:
        middle = 0.5 * sum(pair.joint.limits[0])
    return np.asarray(middle + np.angle(turn * np.exp(-1j * middle)))


def _frames(pair: Pair) -> Frames:
    """Rows u, v, axis of the links, which coincide at the zero pose, in either sensor: so phases are joint angles."""
    axis = pair.joint.axes[0]
    rows = (*perpendicular(axis), axis)
    one, two = (np.array([rotate_inverse(sensor.mounting, row) for row in rows]) for sensor in pair.sensors)
    return one, two


# ---------------------------------------------------------------- axes


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
        axis.sensor: np.array(_to_link(sensor, axis.axis))
        for axis, sensor in zip(fit.axes, pair.sensors, strict=True)
        if axis.determined
    }
    configured = _text(pair.axis)
    if len(in_link) == 2:
        one, two = in_link.values()
        if _between(one, two) < 0.5 * max(
            off.values()
        ):  # both see the same one: the axis, or both mountings, are wrong
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


def _to_link(sensor: Sensor, vector: FloatArray) -> tuple[float, float, float]:
    x, y, z, w = sensor.mounting
    return rotate_inverse((-x, -y, -z, w), (float(vector[0]), float(vector[1]), float(vector[2])))


def _between(one: FloatArray, two: FloatArray) -> float:
    return math.atan2(float(np.linalg.norm(np.cross(one, two))), float(one @ two))


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
