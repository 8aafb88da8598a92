"""Gyros on links and Hall sensors on joints: order, sign and curve of the voltages, axes and signs of the gyros."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import rotate_inverse
from jointest_ros.evaluation.inertial_windows import WindowMeans
from jointest_ros.evaluation.inspection.findings import LOOK, OK, WRONG, Finding
from jointest_ros.evaluation.inspection.hinge_motion import STILL
from jointest_ros.evaluation.measures import rms

_STEP = 0.2  # s, over which turns are compared
_FEWEST = 20  # steps
_LIKE = 0.8  # correlation of the same motion
_UNLIKE = 0.4
_MOVED = 3.0  # standard deviations of a step by noise alone
_USABLE = 0.3  # share of the readings within the range


@dataclass(frozen=True)
class Turns:
    """How far the joints turn from step to step by their gyros, rad: coordinate -> (n,); the steps begin at `start`."""

    start: NDArray[np.int64]
    by_gyro: dict[str, FloatArray]


def joint_turns(robot: Robot, means: WindowMeans, biases: Mapping[str, FloatArray]) -> Turns:
    """The turns of the hinges with a gyro on either side."""
    windows = max(1, round(_STEP / means.length))
    number = len(means.start) // windows
    turns = {}
    for joint, pair in _gyro_hinges(robot, means):
        rate = np.zeros(len(means.start))
        for sensor, sign in zip(pair, (-1.0, 1.0), strict=True):
            axis = np.array(rotate_inverse(sensor.mounting, joint.axes[0]))
            rate += sign * (means.gyro[sensor.name] - biases.get(sensor.name, np.zeros(3))) @ axis
        turns[joint.name] = rate[: number * windows].reshape(number, windows).sum(axis=1) * means.length
    return Turns(means.start[: number * windows : windows], turns)


def _gyro_hinges(robot: Robot, means: WindowMeans) -> Iterator[tuple[Joint, tuple[Sensor, Sensor]]]:
    """The hinges with the first gyro on either side, where both gave something."""
    for joint in robot.joints:
        one, two = (next((s for s in robot.sensors_on(link) if s.gyro), None) for link in (joint.parent, joint.child))
        if len(joint.axes) == 1 and one and two and one.name in means.gyro and two.name in means.gyro:
            yield joint, (one, two)


def hall_findings(robot: Robot, stamps: NDArray[np.int64], volts: FloatArray, turns: Turns) -> Iterator[Finding]:
    """What is wrong with the voltages.

    Args:
        stamps: (N,) ns, rising, on the clock of the gyros.
        volts: (N, h) in the order of the configuration.
    """
    fine = []
    for number, hall in enumerate(robot.hall):
        name, reading = f"hall[{number}]", volts[:, number]
        present = np.isfinite(reading)
        if not present.any():  # a place without a sensor
            continue
        usable = hall.usable(reading)
        share = float(usable[present].mean())
        low, high = float(np.nanmin(reading)), float(np.nanmax(reading))
        if share < _USABLE:
            text = (
                f"only {share:.0%} of its readings ({low:.2f} to {high:.2f} V) are within hall_range {hall.hall_range}"
            )
            level = WRONG if share < 0.02 else LOOK
            yield Finding(level, name, "range", text, "volts? hall_range? The magnet, or no sensor there (NaN)?")
            if share < 0.02:
                continue
        spread = math.sqrt(hall.variance) * float(np.median(abs(hall.slope(reading[usable])))) if usable.any() else 0.0
        like = _correlations(stamps, hall.angle(reading), usable, spread, turns)
        own = like.get(hall.joint)
        if own is None:
            continue
        others = {joint: r for joint, r in like.items() if joint != hall.joint and abs(r) > _LIKE}
        if own < -_LIKE:
            text = f"its angle goes against the gyros of {hall.joint} (correlation {own:.2f})"
            yield Finding(WRONG, name, "sign", text, "mirrored: is the other way round, or axis: of the joint")
        elif abs(own) < _UNLIKE and others:
            joint = max(others, key=lambda j: abs(others[j]))
            text = f"it follows {joint} (correlation {others[joint]:.2f}), not {hall.joint} ({own:.2f})"
            yield Finding(WRONG, name, "order", text, "the voltages are in another order than hall:")
        elif own < _UNLIKE:
            text = f"its angle does not follow the gyros of {hall.joint} (correlation {own:.2f})"
            yield Finding(LOOK, name, "order", text, "curve, order of the voltages, or gyros on other links?")
        else:
            fine.append(own)
    if fine:
        yield Finding(
            OK, "hall", "hall", f"{len(fine)} sensors follow the gyros of their joints (r {min(fine):.2f} or more)"
        )


def _correlations(
    stamps: NDArray[np.int64], angle: FloatArray, usable: NDArray[np.bool_], spread: float, turns: Turns
) -> dict[str, float]:
    """Of the steps of an angle with those of every joint that moves, by joint.

    Args:
        spread: standard deviation of an angle, rad: of joints that hardly move more, nothing can be said.
    """
    rows = np.searchsorted(stamps, np.append(turns.start, turns.start[-1:] + round(_STEP * 1e9)))
    rows = np.clip(rows, 0, len(stamps) - 1)
    good = np.append(0, np.cumsum(usable))
    begin, end = rows[:-1], rows[1:]
    whole = (end > begin) & (good[end] - good[begin] >= 0.9 * (end - begin))
    readings = max(1, round(float(np.median(end - begin)) / 2.0))
    smooth = _smoothed(np.where(usable, angle, 0.0), usable, readings)
    least = max(STILL * _STEP, _MOVED * spread * math.sqrt(2.0 / readings))
    steps = smooth[end] - smooth[begin]
    found = {}
    for joint, turn in turns.by_gyro.items():
        kept = whole & np.isfinite(turn) & np.isfinite(steps)
        if kept.sum() >= _FEWEST and turn[kept].std() > least and steps[kept].std() > 0.0:
            found[joint] = float(np.corrcoef(turn[kept], steps[kept])[0, 1])
    return found


def _smoothed(values: FloatArray, usable: NDArray[np.bool_], length: int) -> FloatArray:
    """Means over `length` usable readings about each."""
    kernel = np.ones(length)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.convolve(values, kernel, "same") / np.convolve(usable.astype(float), kernel, "same"))


def gyro_findings(robot: Robot, means: WindowMeans, biases: Mapping[str, FloatArray]) -> Iterator[Finding]:
    """Hinges between gyros alone: what turns across the axis must be as long on both sides."""
    for joint, pair in _gyro_hinges(robot, means):
        lengths, rates = [], []
        for sensor in pair:
            axis = np.array(rotate_inverse(sensor.mounting, joint.axes[0]))
            rate = means.gyro[sensor.name] - biases.get(sensor.name, np.zeros(3))
            rates.append(rate @ axis)
            lengths.append(np.linalg.norm(rate - rates[-1][:, None] * axis, axis=1))
        whole = np.isfinite(lengths).all(axis=0)
        one, two = (length[whole] for length in lengths)
        if whole.sum() < _FEWEST:
            continue
        moved = float((rates[1] - rates[0])[whole].std())
        if moved < STILL:
            text = f"it hardly moves ({math.degrees(moved):.1f} deg/s rms): axis, signs and mountings are not judged"
            yield Finding(LOOK, joint.name, "motion", text, "bend it through its whole range in another recording")
            continue
        left = rms(one - two)
        whole_rate = math.sqrt(float(np.mean(one**2 + two**2))) + moved
        if left > 0.25 * whole_rate and left > 2.0 * STILL:
            names = " and ".join(f"'{sensor.name}'" for sensor in pair)
            text = f"the rates across its axis differ by {math.degrees(left):.0f} deg/s rms between {names}"
            yield Finding(WRONG, joint.name, "axis", text, "axis:, mounting: or link: of these sensors is another one")
        else:
            text = f"its gyros agree across the axis (to {math.degrees(left):.1f} deg/s)"
            yield Finding(OK, joint.name, "axis", text)
