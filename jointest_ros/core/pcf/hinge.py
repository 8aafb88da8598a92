"""The `hinge` formulation of the PCF: a Kalman filter on one angle, in which nothing can drift about gravity.

State        [q, b]: joint angle (rad) and difference of the two gyro biases along the axis (rad/s).
Input        rate w of hinge_inputs.py.
Process      q+ = q + (w - b) dt, variance (N1^2 + N2^2) dt, N the gyro noise densities;
             b a random walk of `bias.walk`^2 dt.
Measurement  angle of hinge_inputs.py, less that of the zero pose; innovation y = angle - q, wrapped; variance
             R = (s1^2 + s2^2) / lever, s the accelerometer noise of one sample: it grows by itself as the axis comes
             near gravity, and inside a cone of `gravity_cone` the filter runs on the gyro alone.

Santaera et al. 2015 give Algorithm 2 for the unconstrained pair; the constraint to the axis, the bias state and the
variances follow section 2 of the specification, which also lists the paper's errata.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray, Frame, Recording, Status, Vec3
from jointest_ros.core.pcf.angle_variance import UNKNOWN_VARIANCE
from jointest_ros.core.pcf.hinge_inputs import HingeInputs
from jointest_ros.core.pcf.imu import UNKNOWN_PERIOD, Gaps
from jointest_ros.core.pcf.pair import START_VARIANCE, JointOutput
from jointest_ros.core.pcf.settings import HingeNoise
from jointest_ros.core.robot import STANDARD_GRAVITY, Joint, Sensor
from jointest_ros.core.rotation import wrap
from jointest_ros.core.saturated_gyros import SaturatedGyros

Row = tuple[float, float, float, float]  # dt s, rate rad/s, angle rad, its variance rad^2 (infinite: none)
Columns = tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64]]  # position, velocity, variance, status, (T,)

_STATE = ("stamp", "rate", "lever", "q", "b", "p00", "p01", "p11", "zero", "strayed", "status")
_STARTING, _GAP, _UNOBSERVABLE = int(Status.STARTING), int(Status.GAP), int(Status.UNOBSERVABLE)
_NO_DATA, _STALE, _DISTURBED = int(Status.NO_DATA), int(Status.STALE), int(Status.DISTURBED)
# A filter that is sure of a wrong angle, after a fault, takes many seconds to return: where the accelerometers
# contradict it by so much in the mean, the angle is as good as unknown; nor does such an innovation tell of the bias.
# Accelerations of links contradict by less, and in turns: the means of real recordings stay below 2.5 deg. An IMU that
# slips is noticed before (pair_checks.py). Magnetometers may be wrong for long.
_ASTRAY = math.radians(15.0)  # rad, of the mean over 1 s
_LEAST_DENSITY2 = 1e-16  # of noise densities squared, where somebody states that a sensor has none
_BLOCK = 2048  # rows: their Python floats stay in the cache, and the sums over less than 700 s in `_noises` finite


class HingeFilter:
    """One hinge between two inertial sensors."""

    stamp: int | None  # ns, of the newest frame with both sensors

    def __init__(self, joint: Joint, parent: Sensor, child: Sensor, noise: HingeNoise, gaps: Gaps) -> None:
        self.joint, self.parent, self.child, self.noise, self.gaps = joint, parent.name, child.name, noise, gaps
        self.inputs = HingeInputs(joint, parent, child, noise, gaps)
        self._saturation = SaturatedGyros((parent, child), gaps.gap_rate)
        self._gyro_density2 = max(parent.gyro_noise**2 + child.gyro_noise**2, _LEAST_DENSITY2)
        self._accel_density2 = max(parent.accel_noise**2 + child.accel_noise**2, _LEAST_DENSITY2)
        # The lever is g^2 times the squared sine of the angle between axis and gravity.
        self._astray = math.inf if noise.mag_weight else _ASTRAY
        self._least_lever = (STANDARD_GRAVITY * math.sin(noise.gravity_cone)) ** 2
        low, high = joint.limits[0] if joint.limits else (-math.pi, math.pi)
        self._middle = 0.5 * (low + high)
        # rad from the middle; beyond it the angle is on another branch
        self._reach = max(math.pi, 0.5 * (high - low)) if joint.limits else math.inf
        self._bias_walk2 = noise.bias.walk**2
        self.zero = 0.0  # rad, what the accelerometers read at the zero pose
        self.innovation = math.nan  # rad, of the latest correction
        self.innovation_variance = math.nan  # rad^2
        self.reset()

    def reset(self) -> None:
        """Forget the angle and the bias; the zero pose is kept."""
        self.q, self.b, self.p11 = 0.0, 0.0, self.noise.bias.std**2
        self.inputs.reset()
        self.restart()

    def restart(self) -> None:
        """Start the angle afresh from the next frame; what is known of the bias is kept."""
        self.stamp = None
        self.rate = 0.0
        self.strayed = 0.0  # rad, mean innovation of late
        self.lever = 0.0  # (m/s^2)^2, smoothed over 1 s: else an accelerating link lets in just the disturbed samples
        self.status = _STARTING
        self.p00, self.p01 = UNKNOWN_VARIANCE, 0.0
        self._saturation.time = 0.0
        self.inputs.restart()

    # ------------------------------------------------------------- steps

    def filter(self, rows: Iterable[Row]) -> tuple[list[float], list[float], list[float]]:
        """Predict with the gyro to each sample, then correct with its angle: (q, b, variance of q) of each.

        One loop for one sample and for many: the state is in local variables, which is what makes many cheap.
        """
        gyro_density2, bias_walk2 = self._gyro_density2, self._bias_walk2
        lowest, highest = self._middle - self._reach, self._middle + self._reach
        half_turn, less_half_turn, infinite, astray = math.pi, -math.pi, math.inf, self._astray
        q, b, p00, p01, p11 = self.q, self.b, self.p00, self.p01, self.p11
        innovation, total, strayed = self.innovation, self.innovation_variance, self.strayed
        angles: list[float] = []
        biases: list[float] = []
        variances: list[float] = []
        for dt, rate, angle, noise2 in rows:
            before = p01
            p01 -= dt * p11
            p00 += dt * (gyro_density2 - before - p01)
            p11 += bias_walk2 * dt
            q += (rate - b) * dt
            if noise2 < infinite:
                innovation = angle - q
                if not less_half_turn <= innovation <= half_turn:
                    innovation = wrap(innovation)
                strayed += (innovation - strayed) * (dt if dt < 1.0 else 1.0)
                if not -astray <= strayed <= astray:
                    p00, p01, strayed = p00 + strayed * strayed, 0.0, 0.0
                total = p00 + noise2
                k1, kept = p01 / total, noise2 / total
                q += p00 / total * innovation
                if -astray <= innovation <= astray:
                    b += k1 * innovation
                    p11 -= k1 * p01
                p01 *= kept
                p00 *= kept
                if not lowest <= q <= highest:
                    q = self._middle + wrap(q - self._middle)
            else:
                innovation = math.nan
                if p00 > UNKNOWN_VARIANCE:
                    p00, p01 = UNKNOWN_VARIANCE, 0.0
            angles.append(q)
            biases.append(b)
            variances.append(p00)
        self.q, self.b, self.p00, self.p01, self.p11 = q, b, p00, p01, p11
        self.innovation, self.innovation_variance, self.strayed = innovation, total, strayed
        return angles, biases, variances

    def step(self, stamp: int, period: float, rate: float, angle: float, lever: float, saturated: bool = False) -> None:
        """One sample, whatever came before it; `saturated`: a gyro is."""
        if self.stamp is None:
            self._start(period, angle, lever)
        else:
            dt = (stamp - self.stamp) * 1e-9
            sample, self.status = (dt, 0) if dt <= 1.5 * period else self._bridge(dt, period, rate)
            if saturated:
                self.p00 = min(self.p00 + self._saturation.spread(dt), UNKNOWN_VARIANCE)
            else:
                self._saturation.time = 0.0
            self.lever += (lever - self.lever) * min(dt, 1.0)
            noise2 = math.inf
            if self.lever > self._least_lever and lever > 0.0:
                noise2 = self._accel_density2 / (sample * lever)
            else:
                self.status |= _UNOBSERVABLE
            self.filter(((dt, rate, angle - self.zero, noise2),))
        if saturated:
            self.status |= _DISTURBED
        self.stamp, self.rate = stamp, rate

    def _start(self, period: float, angle: float, lever: float) -> None:
        """First frame: the angle of the accelerometers, on the branch nearest the middle of the joint's range."""
        self.lever, self.status = lever, 0
        if lever > self._least_lever:
            self.q = self._middle + wrap(angle - self.zero - self._middle)
            sample = period if period == period else UNKNOWN_PERIOD
            self.p00, self.p01 = START_VARIANCE + self._accel_density2 / (sample * lever), 0.0
        else:
            self.status = _UNOBSERVABLE

    def _bridge(self, dt: float, period: float, rate: float) -> tuple[float, int]:
        """Samples are missing, or the period is not known: (s that the newest sample covers, flags)."""
        sample = self.gaps.measured(dt, period)
        if dt > self.gaps.max_gap:  # nobody knows: held
            self.q -= (rate - self.b) * (dt - sample)
            self.p00 = min(self.p00 + self.gaps.spread(dt), UNKNOWN_VARIANCE)
            return sample, _GAP
        missing = 0.5 * (self.rate - rate) * (dt - sample)  # the mean of the rates on either side
        self.q += missing
        self.p00 += missing * missing
        return sample, 0

    def update(self, frame: Frame) -> JointOutput:
        """One step, or where a sensor is missing an extrapolation that leaves the state alone."""
        elapsed = math.nan if self.stamp is None else (frame.stamp - self.stamp) * 1e-9
        inputs = self.inputs.read(frame, elapsed if elapsed <= self.gaps.max_gap else math.nan)
        if inputs is None:
            q, velocity, variance, status = self._extrapolate(frame.stamp)
            return (q,), (velocity,), (variance,), (status,)
        saturated = bool(self._saturation) and self._saturation.any(frame.gyro)
        self.step(frame.stamp, frame.period, *inputs, saturated)
        if self.inputs.disturbed:
            self.status |= _DISTURBED
        return (self.q,), (self.rate - self.b,), (self.p00,), (self.status,)

    def _extrapolate(self, stamp: int) -> tuple[float, float, float, int]:
        if self.stamp is None:
            return 0.0, 0.0, UNKNOWN_VARIANCE, _STARTING | _NO_DATA | _STALE
        gaps, elapsed = self.gaps, (stamp - self.stamp) * 1e-9
        rate = self.rate - self.b
        q = self.q + rate * min(elapsed, gaps.max_gap)
        variance = min(self.p00 + gaps.spread(elapsed), UNKNOWN_VARIANCE)
        return q, rate if elapsed <= gaps.max_gap else 0.0, variance, self.status | gaps.flags(elapsed)

    # ------------------------------------------------------------- many samples

    def run(self, recording: Recording) -> Columns:
        """`update` over T frames, without magnetometers and `accel_time`."""
        length = len(recording)
        columns = (np.empty(length), np.empty(length), np.empty(length), np.empty(length, dtype=np.int64))
        present = self.inputs.present(recording)
        reset = np.zeros(length, dtype=bool) if recording.reset is None else recording.reset
        changes = np.flatnonzero((present[1:] != present[:-1]) | reset[1:]) + 1
        for start, stop in itertools.pairwise((0, *changes.tolist(), length)):
            if reset[start]:
                self.restart()
            stretch = recording.part(start, stop)
            if present[start]:
                found = self._run_present(stretch)
            else:
                rows = map(self._extrapolate, stretch.stamps.tolist())
                q, velocity, variance, status = map(np.array, zip(*rows, strict=True))
                found = q, velocity, variance, status
            for whole, part in zip(columns, found, strict=True):
                whole[start:stop] = part
        return columns

    def _run_present(self, recording: Recording) -> Columns:
        """Stretches of regular samples by arrays, the others one by one."""
        length, stamps = len(recording), recording.stamps
        period = np.full(length, np.nan) if recording.period is None else recording.period
        elapsed = np.diff(stamps, prepend=stamps[0] if self.stamp is None else self.stamp) * 1e-9
        regular = (elapsed <= 1.5 * period) & (elapsed < 0.25)
        if self.stamp is None:
            regular[0] = False
        saturated = self._saturation.rows(recording.gyro, length)
        regular &= ~saturated
        rate, angle, lever = self.inputs.read_batch(recording, self.stamp)
        position, variance = np.empty(length), np.empty(length)
        bias, status = np.empty(length), np.empty(length, dtype=np.int64)
        row = 0
        for odd in (*np.flatnonzero(~regular).tolist(), length):
            if row < odd:
                self._saturation.time = 0.0
            while row < odd:
                stop = min(row + _BLOCK, odd)
                part = slice(row, stop)
                noise2, status[part] = self._noises(elapsed[part], lever[part])
                rows = zip(
                    elapsed[part].tolist(),
                    rate[part].tolist(),
                    (angle[part] - self.zero).tolist(),
                    noise2.tolist(),
                    strict=True,
                )
                position[part], bias[part], variance[part] = self.filter(rows)
                self.stamp, self.rate, self.status = int(stamps[stop - 1]), float(rate[stop - 1]), int(status[stop - 1])
                row = stop
            if odd < length:
                sample = float(period[odd]), float(rate[odd]), float(angle[odd]), float(lever[odd])
                self.step(int(stamps[odd]), *sample, bool(saturated[odd]))
                position[odd], bias[odd], variance[odd], status[odd] = self.q, self.b, self.p00, self.status
                row = odd + 1
        return position, rate - bias, variance, status

    def _noises(self, elapsed: FloatArray, lever: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Variances of the angles and flags of regular samples; takes them into the average of the lever."""
        decay = np.cumsum(np.log1p(-elapsed))  # of what was there before
        smooth = np.exp(decay) * (self.lever + np.cumsum(lever * elapsed * np.exp(-decay)))
        self.lever = float(smooth[-1])
        with np.errstate(divide="ignore"):
            noise2 = self._accel_density2 / (elapsed * lever)
        noise2[smooth <= self._least_lever] = np.inf
        return noise2, np.where(np.isinf(noise2), _UNOBSERVABLE, 0)

    # ------------------------------------------------------------- state

    def get_state(self) -> dict[str, Any]:
        """All that changes, as plain numbers and lists."""
        state = {name: getattr(self, name) for name in _STATE}
        return state | {"inputs": self.inputs.get_state(), "saturated": self._saturation.time}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`."""
        for name in _STATE:
            setattr(self, name, state[name])
        self.inputs.set_state(state["inputs"])
        self._saturation.time = state["saturated"]

    @property
    def sensors(self) -> tuple[str, str]:
        """Names of the two sensors."""
        return self.parent, self.child

    def biases(self) -> dict[str, float]:
        """Bias difference along the axis, child minus parent, rad/s."""
        return {f"{self.joint.name}.gyro": self.b}

    # ------------------------------------------------------------- calibrations

    @property
    def zero_pose(self) -> tuple[float, ...]:
        """What the accelerometers read at the zero pose, rad."""
        return (self.zero,)

    def take_zero_pose(self, numbers: tuple[float, ...]) -> None:
        """Before the first frame: `zero_pose` of an earlier run."""
        (self.zero,) = numbers

    def set_bias(self, gyro: dict[str, Vec3], deviation: float) -> None:
        """Gyro biases measured at rest, rad/s by sensor, and the standard deviation of their difference."""
        self.b = self.inputs.set_bias(gyro)
        self.p01, self.p11 = 0.0, deviation**2

    def set_zero(self, accel: dict[str, Vec3]) -> None:
        """The present pose is the zero pose; mean accelerometers by sensor, m/s^2.

        This equals R_o by TRIAD from the axis (first) and gravity (second). Where the axis is near gravity there is no
        angle to measure: the angle becomes zero, the accelerometers' zero is left alone.
        """
        angle, lever = self.inputs.angle_of(accel)
        if lever > self._least_lever:
            self.zero = angle
        self.q, self.p00, self.p01 = 0.0, 0.0, 0.0
