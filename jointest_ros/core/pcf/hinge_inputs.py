"""What the two IMUs of a hinge say of it: its rate, its angle by the accelerometers, and how well that angle shows.

rate    j2 . W2 - j1 . W1, W the gyros in their sensor frames, j the joint axis in each.
angle   atan2(j2 . (p2 x p1), p1 . p2), p1, p2 the parts of the accelerometers perpendicular to the axis (parent turned
        into the child's frame at the zero pose).
lever   |p1| |p2|: g^2 times the squared sine of the angle between axis and gravity, at rest.

With `lever_arms` the accelerometers are moved to the joint first (lever_arm.py).
Magnetometers add their own p1, p2 to sine and cosine, scaled to the length of the accelerometers.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray, Frame, Recording, Vec3
from jointest_ros.core.pcf.attitude import STILL
from jointest_ros.core.pcf.average import AccelAverage
from jointest_ros.core.pcf.field import FieldWatch
from jointest_ros.core.pcf.imu import Gaps
from jointest_ros.core.pcf.lever_arm import Components, Scalar, arms, at_joint, change
from jointest_ros.core.pcf.settings import HingeNoise
from jointest_ros.core.robot import Joint, Sensor
from jointest_ros.core.rotation import dot, perpendicular, rotate_inverse


class HingeInputs:
    """The readings of one hinge. All vectors are in the frames of the sensors."""

    mag_stamp: int | None  # ns, of the newest frame with both magnetometers
    accels: tuple[Vec3, Vec3]  # m/s^2, of the newest frame, at the joint and averaged as configured
    before: tuple[Vec3, Vec3] | None  # rad/s, gyros of the frame before; only with `lever_arms`

    def __init__(self, joint: Joint, parent: Sensor, child: Sensor, noise: HingeNoise, gaps: Gaps) -> None:
        self.parent, self.child, self._noise, self._gaps = parent.name, child.name, noise, gaps
        u, v = perpendicular(joint.axes[0])
        self._j1, self._u1, self._v1 = (rotate_inverse(parent.mounting, a) for a in (joint.axes[0], u, v))
        self._j2, self._u2, self._v2 = (rotate_inverse(child.mounting, a) for a in (joint.axes[0], u, v))
        self._arm1, self._arm2 = arms(joint, parent, child)
        self._watches = FieldWatch(noise.smoothing.field), FieldWatch(noise.smoothing.field)
        self._averages = AccelAverage(noise.smoothing.accel_time), AccelAverage(noise.smoothing.accel_time)
        self._biases: tuple[Vec3, Vec3] | None = None  # rad/s, as measured at rest
        self.restart()

    def restart(self) -> None:
        """Start afresh from the next frame; references of the magnetic field are kept."""
        self.mag_stamp = self.before = None
        self.disturbed = False
        for one in (*self._watches, *self._averages):
            one.restart()

    def reset(self) -> None:
        """Forget the references and the biases too."""
        self._biases = None
        self.restart()
        for watch in self._watches:
            watch.reset()

    def read(self, frame: Frame, elapsed: float) -> tuple[float, float, float] | None:
        """(rate rad/s, angle rad, lever (m/s^2)^2), or None where a sensor is missing.

        `elapsed` s since the frame before with both sensors; NaN: there was none, or a gap.
        """
        w1, w2 = frame.gyro.get(self.parent), frame.gyro.get(self.child)
        a1, a2 = frame.accel.get(self.parent), frame.accel.get(self.child)
        if w1 is None or w2 is None or a1 is None or a2 is None:
            return None
        noise = self._noise
        if noise.smoothing.lever_arms:
            t1 = t2 = STILL
            if self.before is not None and elapsed <= 1.5 * frame.period:
                t1, t2 = (change(b, w, elapsed) for b, w in zip(self.before, (w1, w2), strict=True))
            a1, a2 = at_joint(a1, w1, t1, self._arm1), at_joint(a2, w2, t2, self._arm2)
            self.before = w1, w2
        if noise.smoothing.accel_time and self._biases is not None:
            a1, a2 = (
                average.add((w[0] - b[0], w[1] - b[1], w[2] - b[2]), accel, elapsed)
                for average, w, b, accel in zip(self._averages, (w1, w2), self._biases, (a1, a2), strict=True)
            )
        self.accels = a1, a2
        sine, cosine = self._in_plane(a1, a2)
        if noise.mag_weight:
            sine, cosine = self._with_field(frame, sine, cosine, (w1, w2), (a1, a2))
        return self._rate(w1, w2), math.atan2(sine, cosine), math.sqrt(sine * sine + cosine * cosine)

    def _with_field(
        self, frame: Frame, sine: float, cosine: float, gyros: tuple[Vec3, Vec3], accels: tuple[Vec3, Vec3]
    ) -> tuple[float, float]:
        m1, m2 = frame.mag.get(self.parent), frame.mag.get(self.child)
        if m1 is None or m2 is None:
            return sine, cosine
        rows = zip(self._watches, gyros, accels, (m1, m2), strict=True)
        if not all([watch.sound(frame.stamp, *row) for watch, *row in rows]):
            self.disturbed = True
            return sine, cosine
        self.disturbed = False
        (a1, a2), noise = accels, self._noise
        s, c = self._in_plane(m1, m2)
        scale = noise.mag_weight * math.sqrt(dot(a1, a1) * dot(a2, a2))
        scale /= math.sqrt(dot(m1, m1) * dot(m2, m2)) or math.inf
        if frame.period == frame.period:  # slower than the accelerometers: it stands for more time
            scale *= self._gaps.hold(frame.stamp, self.mag_stamp, frame.period) / frame.period
        self.mag_stamp = frame.stamp
        return noise.accel_weight * sine + scale * s, noise.accel_weight * cosine + scale * c

    def present(self, recording: Recording) -> Any:
        """(T,) mask of the frames with both sensors."""
        total = np.zeros(len(recording))
        for table in (recording.gyro, recording.accel):
            for sensor in (self.parent, self.child):
                if sensor not in table:
                    return np.zeros(len(recording), dtype=bool)
                for column in table[sensor].T:
                    total = total + column
        return np.isfinite(total)

    def read_batch(self, recording: Recording, stamp: int | None) -> tuple[FloatArray, FloatArray, FloatArray]:
        """`read` of T frames with both sensors, without magnetometers and averages; `stamp` of the frame before, ns."""
        w1, w2 = _components(recording.gyro[self.parent]), _components(recording.gyro[self.child])
        a1, a2 = _components(recording.accel[self.parent]), _components(recording.accel[self.child])
        if self._noise.smoothing.lever_arms:
            stamps = recording.stamps
            elapsed = np.diff(stamps, prepend=stamps[0] if stamp is None else stamp) * 1e-9
            period = np.full(len(stamps), np.nan) if recording.period is None else recording.period
            regular = (elapsed > 0.0) & (elapsed <= 1.5 * period) & (elapsed <= self._gaps.max_gap)
            elapsed[~regular] = np.inf  # the change is not known, and is left out
            b1, b2 = self.before or (_row(w1, 0), _row(w2, 0))
            a1 = at_joint(a1, w1, _changes(b1, w1, elapsed), self._arm1)
            a2 = at_joint(a2, w2, _changes(b2, w2, elapsed), self._arm2)
            self.before = _row(w1, -1), _row(w2, -1)
        sine, cosine = self._in_plane(a1, a2)
        return self._rate(w1, w2), np.arctan2(sine, cosine), np.sqrt(sine * sine + cosine * cosine)

    def _rate(self, w1: Components[Scalar], w2: Components[Scalar]) -> Scalar:
        """j2 . W2 - j1 . W1, of one sample or of T samples by components."""
        j1, j2 = self._j1, self._j2
        return j2[0] * w2[0] + j2[1] * w2[1] + j2[2] * w2[2] - j1[0] * w1[0] - j1[1] * w1[1] - j1[2] * w1[2]

    def _in_plane(self, a1: Components[Scalar], a2: Components[Scalar]) -> tuple[Scalar, Scalar]:
        """|p1| |p2| times sine and cosine of the angle from p2 to p1, the parts of both perpendicular to the axis."""
        u1, v1, u2, v2 = self._u1, self._v1, self._u2, self._v2
        p1u, p1v = u1[0] * a1[0] + u1[1] * a1[1] + u1[2] * a1[2], v1[0] * a1[0] + v1[1] * a1[1] + v1[2] * a1[2]
        p2u, p2v = u2[0] * a2[0] + u2[1] * a2[1] + u2[2] * a2[2], v2[0] * a2[0] + v2[1] * a2[1] + v2[2] * a2[2]
        return p2u * p1v - p2v * p1u, p1u * p2u + p1v * p2v

    # ------------------------------------------------------------- zero pose and bias

    def angle_of(self, accel: dict[str, Vec3]) -> tuple[float, float]:
        """(angle rad, lever) of mean accelerometers by sensor, at rest."""
        sine, cosine = self._in_plane(accel[self.parent], accel[self.child])
        return math.atan2(sine, cosine), math.hypot(sine, cosine)

    def set_bias(self, gyro: dict[str, Vec3]) -> float:
        """Gyro biases measured at rest, rad/s by sensor; returns what they make of the rate."""
        self._biases = gyro[self.parent], gyro[self.child]
        return self._rate(*self._biases)

    # ------------------------------------------------------------- state

    def get_state(self) -> dict[str, Any]:
        """All that changes, as plain numbers and lists."""
        return {
            "mag_stamp": self.mag_stamp,
            "disturbed": self.disturbed,
            "before": None if self.before is None else [list(rate) for rate in self.before],
            "biases": None if self._biases is None else [list(bias) for bias in self._biases],
            "watches": [watch.get_state() for watch in self._watches],
            "averages": [average.get_state() for average in self._averages],
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`."""
        self.mag_stamp, self.disturbed = state["mag_stamp"], state["disturbed"]
        self.before, self._biases = _two_vectors(state["before"]), _two_vectors(state["biases"])
        for watch, saved in zip(self._watches, state["watches"], strict=True):
            watch.set_state(saved)
        for average, saved in zip(self._averages, state["averages"], strict=True):
            average.set_state(saved)


def _two_vectors(saved: Any) -> tuple[Vec3, Vec3] | None:
    return None if saved is None else (tuple(saved[0]), tuple(saved[1]))


def _components(table: FloatArray) -> Components[FloatArray]:
    x, y, z = table.T
    return x, y, z


def _row(columns: Components[FloatArray], row: int) -> Vec3:
    x, y, z = columns
    return float(x[row]), float(y[row]), float(z[row])


def _changes(before: Vec3, now: Components[FloatArray], elapsed: FloatArray) -> Components[FloatArray]:
    x, y, z = (np.diff(column, prepend=first) / elapsed for column, first in zip(now, before, strict=True))
    return x, y, z
