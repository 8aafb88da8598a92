"""Accelerometer arrays beside a joint: do both links agree on the force at the joint, and do their places make sense?

Both arrays give the force at the joint, a_O of equation (9) of Woods & Vikas, each in the axes of its link: two vectors
of the same length. And none of them may see a negative w^2. Readings that are exchanged, turned or reversed break that.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from jointest_ros.core.accel.array import JointArrays, array_matrices
from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation.inspection.agreement import signed_permutations
from jointest_ros.evaluation.inspection.findings import LOOK, OK, WRONG, Finding
from jointest_ros.evaluation.measures import rms

_FEWEST = 100  # windows
_MOST = 1000  # windows that are looked at
_BIAS = 0.4  # m/s^2, of a_O by biases and scales as sensors come
_SHARE = 0.15  # of a_O, that the lengths may differ by
_WRONG = 0.4
_BETTER = 0.3  # of the difference, that a mended array may leave
_ACROSS = 1.0  # m/s^2, by which sensors of a link may differ along the axis


@dataclass(frozen=True)
class ArrayMotion:
    """How well two arrays agree.

    Attributes:
        force: rms of a_O, m/s^2.
        difference: rms of |a_O| of the parent less that of the child, m/s^2.
        squares: mean of w^2 of parent and child, rad^2/s^2.
        along: sensor -> mean of its reading along the axis less that of its link's first sensor, m/s^2.
    """

    force: float
    difference: float
    squares: tuple[float, float]
    along: dict[str, float]

    @property
    def agree(self) -> bool:
        """As well as sensors do that are not calibrated."""
        return self.difference < _BIAS + _SHARE * self.force


def array_readings(arrays: JointArrays, accel: Mapping[str, FloatArray]) -> FloatArray | None:
    """(n, sensors, 3) windows in which all of them gave readings; None where there are too few."""
    if any(sensor.name not in accel for sensor in arrays.sensors):
        return None
    readings = np.stack([accel[sensor.name] for sensor in arrays.sensors], axis=1)
    readings = readings[np.isfinite(readings).all(axis=(1, 2))]
    return readings[:: max(1, len(readings) // _MOST)] if len(readings) >= _FEWEST else None


def array_motion(arrays: JointArrays, readings: FloatArray) -> ArrayMotion:
    """`readings` (n, sensors, 3) in sensor frames, m/s^2, in the order of the arrays' sensors."""
    channels = arrays.channels(readings)
    split = 2 * len(arrays.parent.sensors)
    forces, squares = [], []
    for link, mine in ((arrays.parent, channels[:, :split]), (arrays.child, channels[:, split:])):
        g, f = array_matrices(link.positions)
        forces.append(np.linalg.norm(mine @ f.T, axis=1))
        squares.append(float(np.mean(mine @ g[0])))
    normals = np.cross(arrays.projections[:, 0], arrays.projections[:, 1])  # the axis in each sensor
    along = np.einsum("nsi,si->ns", readings, normals).mean(axis=0)
    firsts = [0] * len(arrays.parent.sensors) + [len(arrays.parent.sensors)] * len(arrays.child.sensors)
    return ArrayMotion(
        rms(np.concatenate(forces)),
        rms(forces[0] - forces[1]),
        (squares[0], squares[1]),
        {s.name: float(along[k] - along[firsts[k]]) for k, s in enumerate(arrays.sensors)},
    )


def array_findings(arrays: JointArrays, readings: FloatArray) -> Iterator[Finding]:
    """What is wrong with the arrays of a joint."""
    joint, motion = arrays.joint.name, array_motion(arrays, readings)
    for sensor, apart in motion.along.items():
        if abs(apart) > _ACROSS:
            text = f"it reads {apart:+.1f} m/s^2 along the axis of {joint} beside the first sensor of its link"
            yield Finding(WRONG, sensor, "mounting", text, "mend mounting: or link:, or is its topic another one's?")
    share = motion.difference / motion.force if motion.force else 0.0
    negative = [
        link
        for link, w2, array in zip(
            (arrays.joint.parent, arrays.joint.child), motion.squares, (arrays.parent, arrays.child), strict=True
        )
        if w2 < -_BIAS / float(np.ptp(array.positions, axis=0).max())
    ]
    if motion.agree and not negative:
        text = f"the arrays of both links agree on the force at the joint (to {share:.0%})"
        yield Finding(OK, joint, "array", text)
        return
    what = f"the arrays of the two links differ by {share:.0%} in the force at the joint"
    if negative:
        what = f"link '{negative[0]}' would turn with a negative square of its rate"
    level = WRONG if negative or share > _WRONG else LOOK
    action = "check position:, origin:, mounting: and link: of its sensors"
    if mended := _mend(arrays, readings, motion):
        level, action = WRONG, f"{mended}; if so, mend it"
    yield Finding(level, joint, "array", what, action)


def _mend(arrays: JointArrays, readings: FloatArray, now: ArrayMotion) -> str:
    """The one mistake that explains it best, if it does: two sensors exchanged, or one turned by a right angle."""
    target = _BETTER * max(now.difference, 1e-9)
    tried: list[tuple[float, str]] = []
    names = [sensor.name for sensor in arrays.sensors]
    turns = [matrix for matrix in signed_permutations()[1:] if np.linalg.det(matrix) > 0.0]  # by right angles

    def consider(changed: FloatArray, text: str) -> None:
        motion = array_motion(arrays, changed)
        along = max(abs(value) for value in motion.along.values())
        if motion.agree and motion.difference < target and min(motion.squares) > -_BIAS and along < _ACROSS:
            tried.append((motion.difference, text))

    for one, two in itertools.combinations(range(len(names)), 2):
        order = list(range(len(names)))
        order[one], order[two] = two, one
        consider(readings[:, order], f"'{names[one]}' and '{names[two]}' look exchanged (topic, link or position)")
    for k, name in enumerate(names):
        for matrix in turns:
            changed = readings.copy()
            changed[:, k] = readings[:, k] @ matrix.T
            consider(changed, f"'{name}' looks turned by a right angle or more (mounting)")
    return min(tried)[1] if tried else ""
