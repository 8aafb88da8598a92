"""The `hinge` formulation of the PCF: a Kalman filter on one angle, in which nothing can drift about gravity.

State        [q, b]: joint angle (rad) and difference of the two gyro biases along the axis (rad/s).
Input        rate w = j2 . W2 - j1 . W1, W the gyros in their sensor frames, j the joint axis in each.
Process      q+ = q + (w - b) dt, variance (N1^2 + N2^2) dt, N the gyro noise densities;
             b a random walk of `bias_walk`^2 dt.
Measurement  angle = atan2(j2 . (p2 x p1), p1 . p2) - zero, with p1, p2 the parts of the accelerometers perpendicular to
             the axis (parent turned into the child's frame at the zero pose); innovation y = angle - q, wrapped;
             variance R = (s1^2 + s2^2) / (|p1| |p2|), s the accelerometer noise of one sample: it grows by itself as
             the axis comes near gravity, and inside a cone of `gravity_cone` the filter runs on the gyro alone.

Santaera et al. 2015 give Algorithm 2 for the unconstrained pair; the constraint to the axis, the bias state and the
variances follow section 2 of the specification, which also lists the paper's errata.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray, Frame, Recording, Status, Vec3
from jointest_ros.core.pcf.imu import UNKNOWN_PERIOD, Gaps
from jointest_ros.core.pcf.pair import START_VARIANCE, UNKNOWN_VARIANCE, JointOutput
from jointest_ros.core.robot import STANDARD_GRAVITY, Joint, Sensor
from jointest_ros.core.rotation import dot, perpendicular, rotate_inverse, wrap

Scalar = TypeVar("Scalar", float, FloatArray)
Sample = tuple[int, float, float, float, float]  # stamp ns, period s, rate rad/s, angle rad, lever (m/s^2)^2

_STATE = ("stamp", "mag_stamp", "rate", "lever", "q", "b", "p00", "p01", "p11", "zero", "status")
_STARTING, _GAP, _UNOBSERVABLE = int(Status.STARTING), int(Status.GAP), int(Status.UNOBSERVABLE)
_NO_DATA, _STALE = int(Status.NO_DATA), int(Status.STALE)
_TURN = 2.0 * math.pi
_LEAST_DENSITY2 = 1e-16  # of noise densities squared, where somebody states that a sensor has none


@dataclass(frozen=True)
class HingeNoise:
    """Noise figures and limits of one hinge, in SI (see the module text)."""

    bias_walk: float  # rad/s/sqrt(s)
    bias_std: float  # rad/s
    calibrated_bias_std: float  # rad/s
    gravity_cone: float  # rad
    accel_weight: float
    mag_weight: float


class HingeFilter:
    """One hinge between two inertial sensors. All vectors are in the frames of the sensors."""

    stamp: int | None  # ns, of the newest frame with both sensors
    mag_stamp: int | None  # ns, of the newest one with both magnetometers

    def __init__(self, joint: Joint, parent: Sensor, child: Sensor, noise: HingeNoise, gaps: Gaps) -> None:
        self.joint, self.parent, self.child, self.noise, self.gaps = joint, parent.name, child.name, noise, gaps
        u, v = perpendicular(joint.axes[0])
        self._j1, self._u1, self._v1 = (rotate_inverse(parent.mounting, a) for a in (joint.axes[0], u, v))
        self._j2, self._u2, self._v2 = (rotate_inverse(child.mounting, a) for a in (joint.axes[0], u, v))
        self._gyro_density2 = max(parent.gyro_noise**2 + child.gyro_noise**2, _LEAST_DENSITY2)
        self._accel_density2 = max(parent.accel_noise**2 + child.accel_noise**2, _LEAST_DENSITY2)
        # The lever is g^2 times the squared sine of the angle between axis and gravity.
        self._least_lever = (STANDARD_GRAVITY * math.sin(noise.gravity_cone)) ** 2
        low, high = joint.limits[0] if joint.limits else (-math.pi, math.pi)
        self._middle = 0.5 * (low + high)
        # rad from the middle; beyond it the angle is on another branch
        self._reach = max(math.pi, 0.5 * (high - low)) if joint.limits else math.inf
        self.zero = 0.0  # rad, what the accelerometers read at the zero pose
        self.innovation = math.nan  # rad, of the latest correction
        self.innovation_variance = math.nan  # rad^2
        self.reset()

    def reset(self) -> None:
        """Forget the angle and the bias; the zero pose is kept."""
        self.q, self.b, self.p11 = 0.0, 0.0, self.noise.bias_std**2
        self.restart()

    def restart(self) -> None:
        """Start the angle afresh from the next frame; what is known of the bias is kept."""
        self.stamp = self.mag_stamp = None
        self.rate = 0.0
        self.lever = 0.0  # (m/s^2)^2, smoothed over 1 s: else an accelerating link lets in just the disturbed samples
        self.status = _STARTING
        self.p00, self.p01 = UNKNOWN_VARIANCE, 0.0

    # ------------------------------------------------------------- inputs

    def inputs(self, frame: Frame) -> tuple[float, float, float] | None:
        """(rate rad/s, angle rad, lever (m/s^2)^2) of this frame, or None where a sensor is missing."""
        w1, w2 = frame.gyro.get(self.parent), frame.gyro.get(self.child)
        a1, a2 = frame.accel.get(self.parent), frame.accel.get(self.child)
        if w1 is None or w2 is None or a1 is None or a2 is None:
            return None
        sine, cosine = self._in_plane(a1, a2)
        if self.noise.mag_weight:
            m1, m2 = frame.mag.get(self.parent), frame.mag.get(self.child)
            if m1 is not None and m2 is not None:
                s, c = self._in_plane(m1, m2)
                scale = self.noise.mag_weight * math.sqrt(dot(a1, a1) * dot(a2, a2))
                scale /= math.sqrt(dot(m1, m1) * dot(m2, m2)) or math.inf
                if frame.period == frame.period:  # slower than the accelerometers: it stands for more time
                    scale *= self.gaps.hold(frame.stamp, self.mag_stamp, frame.period) / frame.period
                self.mag_stamp = frame.stamp
                weight = self.noise.accel_weight
                sine, cosine = weight * sine + scale * s, weight * cosine + scale * c
        return self._rate(w1, w2), math.atan2(sine, cosine), math.sqrt(sine * sine + cosine * cosine)

    def _inputs_batch(self, recording: Recording) -> FloatArray:
        """`inputs` of T frames, (3, T); NaN where a sensor is missing. Without magnetometers."""
        nothing = np.full((len(recording), 3), np.nan)
        columns = [
            tuple(table.get(sensor, nothing).T)
            for table in (recording.gyro, recording.accel)
            for sensor in (self.parent, self.child)
        ]
        w1, w2, a1, a2 = ((x, y, z) for x, y, z in columns)
        sine, cosine = self._in_plane(a1, a2)
        return np.stack([self._rate(w1, w2), np.arctan2(sine, cosine), np.hypot(sine, cosine)])

    def _rate(self, w1: tuple[Scalar, Scalar, Scalar], w2: tuple[Scalar, Scalar, Scalar]) -> Scalar:
        """j2 . W2 - j1 . W1, of one sample or of T samples by components."""
        j1, j2 = self._j1, self._j2
        return j2[0] * w2[0] + j2[1] * w2[1] + j2[2] * w2[2] - j1[0] * w1[0] - j1[1] * w1[1] - j1[2] * w1[2]

    def _in_plane(self, a1: tuple[Scalar, Scalar, Scalar], a2: tuple[Scalar, Scalar, Scalar]) -> tuple[Scalar, Scalar]:
        """|p1| |p2| times sine and cosine of the angle from p2 to p1, the parts of both perpendicular to the axis."""
        u1, v1, u2, v2 = self._u1, self._v1, self._u2, self._v2
        p1u, p1v = u1[0] * a1[0] + u1[1] * a1[1] + u1[2] * a1[2], v1[0] * a1[0] + v1[1] * a1[1] + v1[2] * a1[2]
        p2u, p2v = u2[0] * a2[0] + u2[1] * a2[1] + u2[2] * a2[2], v2[0] * a2[0] + v2[1] * a2[1] + v2[2] * a2[2]
        return p2u * p1v - p2v * p1u, p1u * p2u + p1v * p2v

    # ------------------------------------------------------------- steps

    def steps(self, samples: Iterable[Sample]) -> tuple[list[float], list[float], list[float], list[int]]:
        """Predict with the gyro to each sample, then correct with its accelerometers: (q, rate - b, variance, status).

        One loop for one sample and for many: over many it costs a third, because the state is in local variables.
        """
        noise, gaps = self.noise, self.gaps
        gyro_density2, accel_density2, bias_walk2 = self._gyro_density2, self._accel_density2, noise.bias_walk**2
        least_lever, zero, middle, reach = self._least_lever, self.zero, self._middle, self._reach
        pi = math.pi
        position: list[float] = []
        velocity: list[float] = []
        variance: list[float] = []
        status: list[int] = []
        samples = iter(samples)
        if self.stamp is None and (first := next(samples, None)) is not None:
            self._start(*first)
            position, velocity, variance, status = [self.q], [self.rate - self.b], [self.p00], [self.status]
        before: Any = self.stamp
        rate_before, smooth_lever = self.rate, self.lever
        q, b, p00, p01, p11, flags = self.q, self.b, self.p00, self.p01, self.p11, self.status
        innovation, total = self.innovation, self.innovation_variance
        for stamp, period, rate, angle, lever in samples:
            dt = (stamp - before) * 1e-9
            flags = 0
            if dt <= 1.5 * period:
                sample = dt
            else:  # samples are missing, or the period is not known
                sample = gaps.measured(dt, period)
                if dt > gaps.max_gap:  # nobody knows: held
                    q -= (rate - b) * (dt - sample)
                    p00 = min(p00 + gaps.spread(dt), UNKNOWN_VARIANCE)
                    flags = _GAP
                else:  # the mean of the rates on either side
                    missing = 0.5 * (rate_before - rate) * (dt - sample)
                    q += missing
                    p00 += missing * missing
            q += (rate - b) * dt
            cross = dt * p11
            p00 += dt * (cross - 2.0 * p01 + gyro_density2)
            p01 -= cross
            p11 += bias_walk2 * dt
            smooth_lever += (lever - smooth_lever) * (dt if dt < 1.0 else 1.0)
            if smooth_lever > least_lever and lever > 0.0:
                innovation = angle - zero - q
                if not -pi <= innovation <= pi:
                    innovation = wrap(innovation)
                total = p00 + accel_density2 / (sample * lever)
                k0, k1 = p00 / total, p01 / total
                q += k0 * innovation
                b += k1 * innovation
                p11 -= k1 * p01
                p01 -= k0 * p01
                p00 -= k0 * p00
                if not -reach <= q - middle <= reach:
                    q = middle + wrap(q - middle)
            else:
                flags |= _UNOBSERVABLE
                innovation = math.nan
                if p00 > UNKNOWN_VARIANCE:
                    p00, p01 = UNKNOWN_VARIANCE, 0.0
            before, rate_before = stamp, rate
            position.append(q)
            velocity.append(rate - b)
            variance.append(p00)
            status.append(flags)
        self.stamp, self.rate, self.lever = before, rate_before, smooth_lever
        self.q, self.b, self.p00, self.p01, self.p11, self.status = q, b, p00, p01, p11, flags
        self.innovation, self.innovation_variance = innovation, total
        return position, velocity, variance, status

    def _start(self, stamp: int, period: float, rate: float, angle: float, lever: float) -> None:
        """First frame: the angle of the accelerometers, on the branch nearest the middle of the joint's range."""
        self.stamp, self.rate, self.lever, self.status = stamp, rate, lever, 0
        if lever > self._least_lever:
            self.q = self._middle + wrap(angle - self.zero - self._middle)
            sample = period if period == period else UNKNOWN_PERIOD
            self.p00, self.p01 = START_VARIANCE + self._accel_density2 / (sample * lever), 0.0
        else:
            self.status = _UNOBSERVABLE

    def update(self, frame: Frame) -> JointOutput:
        """One step, or where a sensor is missing an extrapolation that leaves the state alone."""
        inputs = self.inputs(frame)
        if inputs is None:
            q, velocity, variance, status = self._extrapolate(frame.stamp)
            return (q,), (velocity,), (variance,), (status,)
        self.steps(((frame.stamp, frame.period, *inputs),))
        return (self.q,), (self.rate - self.b,), (self.p00,), (self.status,)

    def _extrapolate(self, stamp: int) -> tuple[float, float, float, int]:
        if self.stamp is None:
            return 0.0, 0.0, UNKNOWN_VARIANCE, _STARTING | _NO_DATA | _STALE
        gaps, elapsed = self.gaps, (stamp - self.stamp) * 1e-9
        rate = self.rate - self.b
        q = self.q + rate * min(elapsed, gaps.max_gap)
        variance = min(self.p00 + gaps.spread(elapsed), UNKNOWN_VARIANCE)
        return q, rate if elapsed <= gaps.max_gap else 0.0, variance, self.status | gaps.flags(elapsed)

    def run(self, recording: Recording) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64]]:
        """`update` over T frames without magnetometers: (position, velocity, variance, status), each (T,)."""
        length = len(recording)
        inputs = self._inputs_batch(recording)
        period = np.full(length, np.nan) if recording.period is None else recording.period
        reset = np.zeros(length, dtype=bool) if recording.reset is None else recording.reset
        present: Any = np.isfinite(inputs).all(axis=0)
        changes = np.flatnonzero((present[1:] != present[:-1]) | reset[1:]) + 1
        position: list[float] = []
        velocity: list[float] = []
        variance: list[float] = []
        status: list[int] = []
        for start, stop in itertools.pairwise((0, *changes.tolist(), length)):
            columns = [column[start:stop].tolist() for column in (recording.stamps, period, *inputs)]
            if reset[start:stop].any():
                self.restart()
            rows: Any
            if present[start:stop].all():
                rows = self.steps(zip(*columns, strict=True))
            else:
                rows = zip(*map(self._extrapolate, columns[0]), strict=True)
            for whole, stretch in zip((position, velocity, variance, status), rows, strict=True):
                whole += stretch
        return np.array(position), np.array(velocity), np.array(variance), np.array(status, dtype=np.int64)

    # ------------------------------------------------------------- state

    def get_state(self) -> dict[str, Any]:
        """All that changes, as plain numbers."""
        return {name: getattr(self, name) for name in _STATE}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`."""
        for name in _STATE:
            setattr(self, name, state[name])

    @property
    def sensors(self) -> tuple[str, str]:
        """Names of the two sensors."""
        return self.parent, self.child

    def biases(self) -> dict[str, float]:
        """Bias difference along the axis, child minus parent, rad/s."""
        return {f"{self.joint.name}.gyro": self.b}

    # ------------------------------------------------------------- calibrations

    def set_bias(self, gyro: dict[str, Vec3]) -> None:
        """Gyro biases measured at rest, rad/s by sensor."""
        self.b = dot(self._j2, gyro[self.child]) - dot(self._j1, gyro[self.parent])
        self.p01, self.p11 = 0.0, self.noise.calibrated_bias_std**2

    def set_zero(self, accel: dict[str, Vec3]) -> None:
        """The present pose is the zero pose; mean accelerometers by sensor, m/s^2.

        This equals R_o by TRIAD from the axis (first) and gravity (second). Where the axis is near gravity there is no
        angle to measure: the angle becomes zero, the accelerometers' zero is left alone.
        """
        sine, cosine = self._in_plane(accel[self.parent], accel[self.child])
        if math.hypot(sine, cosine) > self._least_lever:
            self.zero = math.atan2(sine, cosine)
        self.q, self.p00, self.p01 = 0.0, 0.0, 0.0
