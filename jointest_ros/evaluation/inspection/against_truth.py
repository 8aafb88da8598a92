"""The motion of joints by their sensors beside the ground truth of a recording: sign, unit, order, time, zero."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation.inspection.findings import LOOK, OK, WRONG, Finding
from jointest_ros.evaluation.inspection.hinge_motion import HingeMotion
from jointest_ros.evaluation.truth import Truth

_LIKE = 0.8  # correlation from which two rates are the same motion
_UNLIKE = 0.5
_EXCHANGED = 0.9
_SLOPES = (0.7, 1.4)  # rate over that of the truth
_FEWEST = 100  # windows
_LATEST = 0.3  # s, that is looked for
_SIGNIFICANT_LAG = 0.004  # s
_ZERO = math.radians(10.0)


@dataclass(frozen=True)
class Comparison:
    """A joint beside the truth.

    Attributes:
        correlation: of the rates, with the truth moved by `lag`.
        slope: rate by the sensors over that of the truth.
        lag: by how much the stamps of the sensors are later than those of the truth, s.
        offset: median of the angle by the sensors less that of the truth, rad.
    """

    correlation: float
    slope: float
    lag: float
    offset: float


def compare(
    motion: HingeMotion, truth: Truth, coordinate: str, first: int, length: float, middle: float
) -> Comparison | None:
    """Compare one joint with one of the truth; None where they have too little in common.

    Args:
        first: stamp of time 0 of the motion, ns.
        length: of its windows, s; `middle`: of their rates, see `rate_time`.
    """
    position = truth.position.get(coordinate)
    if position is None:
        return None
    time, known = (truth.stamps - first) * 1e-9, np.isfinite(position)
    time, position = time[known], np.unwrap(position[known])
    if len(time) < _FEWEST:
        return None
    times = motion.data.time + middle
    common = (times - length > time[0] + _LATEST) & (times + length < time[-1] - _LATEST)
    if common.sum() < _FEWEST:
        return None
    times, rate, angle = times[common], motion.rate[common], motion.angle[common]

    def true_rate(lag: float) -> FloatArray:
        after, before = (np.interp(times - lag + part * length, time, position) for part in (0.5, -0.5))
        return np.asarray((after - before) / length)

    def correlation(lag: float) -> float:
        other = true_rate(lag)
        if other.std() < 1e-6 or rate.std() < 1e-6:
            return 0.0
        return float(np.corrcoef(rate, other)[0, 1])

    lags = np.arange(-_LATEST, _LATEST + 1e-9, 0.5 * length)
    rows = np.array([correlation(lag) for lag in lags])
    best = int(np.argmax(abs(rows)))
    lag = float(lags[best])
    if 0 < best < len(lags) - 1:  # the top of the parabola through three points
        a, b, c = abs(rows[best - 1 : best + 2])
        if (bend := a - 2.0 * b + c) < 0.0:
            lag += float(0.5 * (a - c) / bend * 0.5 * length)
    other = true_rate(lag)
    slope = float(rate @ other) / float(other @ other) if other.any() else 0.0
    offset = angle - np.interp(times - lag, time, position)
    turn = np.median(np.exp(1j * offset).real) + 1j * np.median(np.exp(1j * offset).imag)
    return Comparison(correlation(lag), slope, lag, float(np.angle(turn)))


def truth_findings(
    motions: Mapping[str, HingeMotion], truth: Truth, first: int, length: float, middle: float, takes_zero: bool
) -> Iterator[Finding]:
    """What the truth tells of the joints.

    Args:
        motions: by joint.
        first, length, middle: see `compare`.
        takes_zero: the pose of the still start becomes the zero pose, so that an offset does no harm.
    """
    tables = {
        name: {other: compare(motion, truth, other, first, length, middle) for other in truth.position}
        for name, motion in motions.items()
        if motion.moves and truth.position
    }
    lags = []
    for name, row in tables.items():
        own = row.get(name)
        if own is None:
            continue
        if abs(own.correlation) < _UNLIKE:
            like = [other for other, one in row.items() if one is not None and abs(one.correlation) > _LIKE]
            hint = f"; it moves as '{like[0]}' does" if like else ""
            text = f"its motion is not that of the ground truth (correlation {own.correlation:.2f}){hint}"
            action = "are its sensors on the right links (topic:, link:)? Has the truth the names of the configuration?"
            yield Finding(WRONG, name, "truth", text, action)
        elif own.correlation < 0.0:
            text = "it moves the other way round than the ground truth"
            yield Finding(WRONG, name, "truth", text, "reverse axis:, exchange its sensors, or mend the truth")
        elif not _SLOPES[0] < own.slope < _SLOPES[1]:
            text = f"it turns {own.slope:.2f} times as fast as the ground truth"
            action = "the unit of the truth, the full scale of the gyros, or other sensors than those beside it?"
            yield Finding(WRONG, name, "truth", text, action)
        else:
            lags += [own.lag] if own.correlation > 0.95 else []
            yield from _offset(name, own, takes_zero)
    if lags and abs(lag := float(np.median(lags))) > max(_SIGNIFICANT_LAG, 0.1 * length):
        text = f"the sensors run {abs(lag) * 1e3:.0f} ms {'behind' if lag > 0 else 'ahead of'} the ground truth"
        action = (
            f"delay_ms: {max(lag, 0.0) * 1e3:.0f} more, if it is the low-pass filter of the sensors"
            if lag > 0
            else "the truth is late; errors grow with the rate"
        )
        yield Finding(LOOK, "ground truth", "delay", text, action)


def exchanged_by_truth(
    motions: Mapping[str, HingeMotion],
    others: Callable[[str, str], Mapping[str, HingeMotion] | None],
    truth: Truth,
    first: int,
    length: float,
    middle: float,
) -> tuple[str, str] | None:
    """The two sensors that, exchanged, make all joints move as the truth does, where they do not now.

    Args:
        motions: by joint, as configured; `others`: the same with two sensors exchanged.
        first, length, middle: see `compare`.
    """

    def fit(now: Mapping[str, HingeMotion]) -> float:
        """The worst joint: 1 where it moves as the truth does."""
        likeness = 1.0
        for name, motion in now.items():
            one = compare(motion, truth, name, first, length, middle)
            if one is not None:
                likeness = min(likeness, one.correlation if _SLOPES[0] < one.slope < _SLOPES[1] else 0.0)
        return likeness

    if not motions or fit(motions) > _UNLIKE:
        return None
    names = dict.fromkeys(sensor.name for motion in motions.values() for sensor in motion.pair.sensors)
    for one, two in itertools.combinations(names, 2):
        changed = others(one, two)
        if changed is not None and fit(changed) > _EXCHANGED:
            return one, two
    return None


def _offset(name: str, own: Comparison, takes_zero: bool) -> Iterator[Finding]:
    agree = f"it moves as the ground truth does (correlation {own.correlation:.3f}, {own.slope:.3f} times as fast)"
    yield Finding(OK, name, "truth", agree)
    if abs(own.offset) > _ZERO and not takes_zero:
        text = f"it reads {math.degrees(own.offset):.0f} deg more than the ground truth"
        action = "the truth's zero is another one, or a mounting is turned about the axis: jointest calibrate zero"
        yield Finding(LOOK, name, "zero", text, action)
