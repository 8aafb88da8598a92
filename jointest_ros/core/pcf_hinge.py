"""The `hinge` formulation of the PCF: a Kalman filter on one angle, in which nothing can drift about gravity.

State        [q, b]: joint angle (rad) and difference of the two gyro biases along the axis (rad/s).
Input        rate w = j2 . W2 - j1 . W1, W the gyros in their sensor frames, j the joint axis in each.
Process      q+ = q + (w - b) dt, variance (N1^2 + N2^2) dt, N the gyro noise densities;
             b a random walk of `bias_walk`^2 dt.
Measurement  angle = atan2(j2 . (p2 x p1), p1 . p2) - zero, with p1, p2 the parts of the accelerometers perpendicular to
             the axis (parent turned into the child's frame at the zero pose); innovation y = angle - q, wrapped;
             variance R = (s1^2 + s2^2) / (|p1| |p2|), s the accelerometer noise of one sample: it grows by itself as the
             axis comes near gravity, and inside a cone of `gravity_cone` the filter runs on the gyro alone.

Santaera et al. 2015 give Algorithm 2 for the unconstrained pair; the constraint to the axis, the bias state and the
variances follow section 2 of the specification, which also lists the paper's errata.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray, Frame, Recording, Status, Vec3
from jointest_ros.core.pcf_pair import START_VARIANCE, UNKNOWN_VARIANCE, JointOutput
from jointest_ros.core.robot import STANDARD_GRAVITY, Joint, Sensor
from jointest_ros.core.rotation import dot, perpendicular, rotate_inverse

_STATE = ("stamp", "rate", "lever", "q", "b", "p00", "p01", "p11", "zero")


@dataclass(frozen=True)
class HingeNoise:
    """Noise figures and limits of one hinge, in SI (see the module text)."""

    bias_walk: float  # rad/s/sqrt(s)
    bias_std: float  # rad/s
    calibrated_bias_std: float  # rad/s
    gap_rate: float  # rad/s, standard deviation of a rate that nobody measured
    gravity_cone: float  # rad
    max_gap: float  # s
    accel_weight: float
    mag_weight: float


class HingeFilter:
    """One hinge between two inertial sensors. All vectors are in the frames of the sensors."""

    def __init__(self, joint: Joint, parent: Sensor, child: Sensor, noise: HingeNoise) -> None:
        self.joint, self.parent, self.child, self.noise = joint, parent.name, child.name, noise
        u, v = perpendicular(joint.axes[0])
        self._j1, self._u1, self._v1 = (rotate_inverse(parent.mounting, a) for a in (joint.axes[0], u, v))
        self._j2, self._u2, self._v2 = (rotate_inverse(child.mounting, a) for a in (joint.axes[0], u, v))
        self._gyro_density2 = parent.gyro_noise**2 + child.gyro_noise**2
        self._accel_density2 = parent.accel_noise**2 + child.accel_noise**2
        # The lever is g^2 times the squared sine of the angle between axis and gravity.
        self._least_lever = (STANDARD_GRAVITY * math.sin(noise.gravity_cone)) ** 2
        low, high = joint.limits[0] if joint.limits else (-math.pi, math.pi)
        self._middle = 0.5 * (low + high)
        self.zero = 0.0  # rad, what the accelerometers read at the zero pose
        self.innovation = math.nan  # rad, of the latest correction
        self.innovation_variance = math.nan  # rad^2
        self.reset()

    def reset(self) -> None:
        """Forget the angle and the bias; the zero pose is kept."""
        self.q, self.b = 0.0, 0.0
        self.p00, self.p01, self.p11 = UNKNOWN_VARIANCE, 0.0, self.noise.bias_std**2
        self.restart()

    def restart(self) -> None:
        """Start the angle afresh from the next frame; what is known of the bias is kept."""
        self.stamp: int | None = None
        self.rate = 0.0
        self.lever = 0.0  # (m/s^2)^2, smoothed over 1 s: else an accelerating link lets in just the disturbed samples
        self.status = Status.STARTING
        self.p00, self.p01 = UNKNOWN_VARIANCE, 0.0

    # ------------------------------------------------------------- inputs

    def inputs(self, frame: Frame) -> tuple[float, float, float] | None:
        """(rate rad/s, angle rad, lever (m/s^2)^2) of this frame, or None where a sensor is missing."""
        w1, w2 = frame.gyro.get(self.parent), frame.gyro.get(self.child)
        a1, a2 = frame.accel.get(self.parent), frame.accel.get(self.child)
        if w1 is None or w2 is None or a1 is None or a2 is None:
            return None
        j1, j2 = self._j1, self._j2
        rate = j2[0] * w2[0] + j2[1] * w2[1] + j2[2] * w2[2] - j1[0] * w1[0] - j1[1] * w1[1] - j1[2] * w1[2]
        sine, cosine = self._in_plane(a1, a2)
        if self.noise.mag_weight:
            m1, m2 = frame.mag.get(self.parent), frame.mag.get(self.child)
            if m1 is not None and m2 is not None:
                s, c = self._in_plane(m1, m2)
                length = math.sqrt(_square(m1) * _square(m2)) or math.inf
                s, c = s / length, c / length
                scale = self.noise.mag_weight * math.sqrt(_square(a1) * _square(a2))
                sine, cosine = self.noise.accel_weight * sine + scale * s, self.noise.accel_weight * cosine + scale * c
        return rate, math.atan2(sine, cosine), math.sqrt(sine * sine + cosine * cosine)

    def _in_plane(self, a1: Vec3, a2: Vec3) -> tuple[float, float]:
        """|p1| |p2| times sine and cosine of the angle from p2 to p1, the parts of both vectors perpendicular to the axis."""
        u1, v1, u2, v2 = self._u1, self._v1, self._u2, self._v2
        p1u, p1v = u1[0] * a1[0] + u1[1] * a1[1] + u1[2] * a1[2], v1[0] * a1[0] + v1[1] * a1[1] + v1[2] * a1[2]
        p2u, p2v = u2[0] * a2[0] + u2[1] * a2[1] + u2[2] * a2[2], v2[0] * a2[0] + v2[1] * a2[1] + v2[2] * a2[2]
        return p2u * p1v - p2v * p1u, p1u * p2u + p1v * p2v

    def _inputs_batch(self, recording: Recording) -> FloatArray:
        """`inputs` of T frames, (T, 3); NaN where a sensor is missing. Without magnetometers."""
        length = len(recording)
        nothing = np.full((length, 3), np.nan)
        w1, w2 = (recording.gyro.get(s, nothing) for s in (self.parent, self.child))
        a1, a2 = (recording.accel.get(s, nothing) for s in (self.parent, self.child))
        p1u, p1v, p2u, p2v = a1 @ self._u1, a1 @ self._v1, a2 @ self._u2, a2 @ self._v2
        sine, cosine = p2u * p1v - p2v * p1u, p1u * p2u + p1v * p2v
        rate = w2 @ self._j2 - w1 @ self._j1
        return np.column_stack([rate, np.arctan2(sine, cosine), np.hypot(sine, cosine)])

    # ------------------------------------------------------------- steps

    def step(self, stamp: int, period: float, rate: float, angle: float, lever: float) -> None:
        """Predict with the gyro to `stamp`, then correct with the accelerometers."""
        noise = self.noise
        if self.stamp is None:
            self._start(stamp, period, rate, angle, lever)
            return
        elapsed = (stamp - self.stamp) * 1e-9
        self.status = Status.OK
        q, b, p00, p01, p11 = self.q, self.b, self.p00, self.p01, self.p11
        if elapsed > 1.5 * period:  # samples are missing: the gyro covers the last interval only, trapezoid before it
            gap, mean = elapsed - period, 0.5 * (self.rate + rate)
            q += (mean - rate) * gap
            if elapsed > noise.max_gap:
                p00 = min(p00 + (noise.gap_rate * gap) ** 2, UNKNOWN_VARIANCE)
                self.status = Status.GAP
            else:
                p00 += (0.5 * (self.rate - rate) * gap) ** 2
            sample = period
        else:
            sample = elapsed
        q += (rate - b) * elapsed
        p00 += elapsed * (elapsed * p11 - 2.0 * p01 + self._gyro_density2)
        p01 -= elapsed * p11
        p11 += noise.bias_walk * noise.bias_walk * elapsed
        self.lever += (lever - self.lever) * (elapsed if elapsed < 1.0 else 1.0)
        if self.lever > self._least_lever:
            variance = self._accel_density2 / (sample * lever)
            innovation = angle - self.zero - q
            if not -math.pi <= innovation < math.pi:
                innovation = (innovation + math.pi) % (2.0 * math.pi) - math.pi
            total = p00 + variance
            k0, k1 = p00 / total, p01 / total
            q += k0 * innovation
            b += k1 * innovation
            p11 -= k1 * p01
            p01 -= k0 * p01
            p00 -= k0 * p00
            self.innovation, self.innovation_variance = innovation, total
        else:
            self.status |= Status.UNOBSERVABLE
            self.innovation = math.nan
        self.q, self.b, self.p00, self.p01, self.p11 = q, b, p00, p01, p11
        self.rate, self.stamp = rate, stamp

    def _start(self, stamp: int, period: float, rate: float, angle: float, lever: float) -> None:
        """First frame: the angle of the accelerometers, on the branch nearest the middle of the joint's range."""
        self.stamp, self.rate, self.lever, self.status = stamp, rate, lever, Status.OK
        if lever > self._least_lever:
            turn = 2.0 * math.pi
            angle -= self.zero
            self.q = angle + turn * round((self._middle - angle) / turn)
            sample = period if period == period else 0.01
            self.p00, self.p01 = START_VARIANCE + self._accel_density2 / (sample * lever), 0.0
        else:
            self.status = Status.UNOBSERVABLE

    def update(self, frame: Frame) -> JointOutput:
        """One step, or where a sensor is missing an extrapolation that leaves the state alone."""
        inputs = self.inputs(frame)
        if inputs is not None:
            self.step(frame.stamp, frame.period, *inputs)
            return (self.q,), (self.rate - self.b,), (self.p00,), self.status
        if self.stamp is None:
            return (0.0,), (0.0,), (UNKNOWN_VARIANCE,), Status.STARTING | Status.NO_DATA
        elapsed = (frame.stamp - self.stamp) * 1e-9
        if elapsed > self.noise.max_gap:
            variance = min(self.p00 + (self.noise.gap_rate * elapsed) ** 2, UNKNOWN_VARIANCE)
            return (self.q,), (0.0,), (variance,), self.status | Status.NO_DATA | Status.GAP
        velocity = self.rate - self.b
        return (self.q + velocity * elapsed,), (velocity,), (self.p00,), self.status | Status.NO_DATA

    def run(
        self, recording: Recording, stale_after: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64]]:
        """`update` over T frames without magnetometers: (position, velocity, variance, status), each (T,)."""
        length = len(recording)
        inputs = self._inputs_batch(recording)
        missing: Any = ~np.isfinite(inputs).all(axis=1)
        stamps = recording.stamps.tolist()
        period = [math.nan] * length if recording.period is None else recording.period.tolist()
        restarts = set() if recording.reset is None else set(np.flatnonzero(recording.reset).tolist())
        position, velocity, variance = [0.0] * length, [0.0] * length, [0.0] * length
        status = [0] * length
        step = self.step
        for k, (stamp, absent, (rate, angle, lever)) in enumerate(
            zip(stamps, missing.tolist(), inputs.tolist(), strict=True)
        ):
            if k in restarts:
                self.restart()
            if absent:
                (position[k],), (velocity[k],), (variance[k],), flags = self.update(Frame(stamp))
                if self.stamp is None or stamp - self.stamp > stale_after:
                    flags |= Status.STALE
                status[k] = int(flags)
                continue
            step(stamp, period[k], rate, angle, lever)
            position[k], velocity[k], variance[k], status[k] = self.q, rate - self.b, self.p00, self.status.value
        return np.array(position), np.array(velocity), np.array(variance), np.array(status, dtype=np.int64)

    def get_state(self) -> dict[str, Any]:
        """All that changes, as plain numbers."""
        return {name: getattr(self, name) for name in _STATE} | {"status": int(self.status)}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`."""
        for name in _STATE:
            setattr(self, name, state[name])
        self.status = Status(state["status"])

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


def _square(a: Vec3) -> float:
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
