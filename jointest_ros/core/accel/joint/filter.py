"""The filter of one joint on the joint model, online: start by hypotheses, missing and faulty sensors, recovery.

It starts when a sample tells the angle: from |w| and the angle of that sample with the four pairs of signs of w. While
several hypotheses are left, their mean by likelihood is put out, with its variance. When a gap, or a long time without
force at the joint, has left the angle or the signs unknown, the output is held and the next telling sample starts
afresh. What was learned of the biases is kept.

A sample that contradicts the prediction is tried without each of the sensors: where that resolves it, the sensor is
left out of this sample. Where nothing does for a while the filter may have gone astray (a wrong sign, a fault that came
slowly): a fresh start then runs beside it until one of them has won.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jointest_ros.core.accel.array import JointArrays
from jointest_ros.core.accel.joint.model import (
    ANGLE,
    MOTION,
    Correction,
    JointModel,
    ModelNoise,
    Weighting,
    channel_innovations,
)
from jointest_ros.core.accel.joint.smoother import Snapshot
from jointest_ros.core.accel.joint.start import JointStart
from jointest_ros.core.accel.pair_filter import UNKNOWN, UNOBSERVABLE, first_branch
from jointest_ros.core.accel.start import LOST, survivors
from jointest_ros.core.frame import FloatArray, Status
from jointest_ros.core.learned import ACCEL_DRIFT, Bias

# Strain: mean square of the normalised innovations, 1 when all is well, more in movements faster than the model expects
_CONTRADICTION = 8.0  # times the usual strain, of a sample that cannot be true
_JUDGES = 4  # sensors, of which one may be left out
_RESOLVED = 4.0  # strain of what is left without the faulty sensor,
_MUCH_LESS = 0.05  # or its share of what it was
_ASTRAY = 10.0  # usual strain of a filter that may follow something else; but wrong scales and places give as much
_AVERAGED = 0.25  # s
_PATIENCE = 1.0, 8.0  # s between fresh starts beside the filter, doubled after each: the first and the longest
_ADVANTAGE = 10.0  # log likelihood by which the filter is ahead of a fresh start, so that its output is not disturbed
_PATTERNS = 64  # of missing sensors whose weighting is kept
_STARTING, _UNOBSERVABLE, _DISTURBED = int(Status.STARTING), int(Status.UNOBSERVABLE), int(Status.DISTURBED)


class JointFilter:
    """See `PairFilter`, which it is, and the module text.

    Args:
        max_gap: s without data, after which the signs of the angular velocities are open again.
    """

    _x: FloatArray | None  # (n), or (hypotheses, n); the most likely first
    _p: FloatArray | None
    _log_likelihoods: list[float]  # of the hypotheses
    _parents: list[int]  # of the hypotheses in the step before; -1: started in this one
    _left: float | None  # rad, where the angle was when the motion was given up

    def __init__(self, arrays: JointArrays, noise: ModelNoise, max_gap: float) -> None:
        self._joint, self._max_gap = arrays.joint, max_gap
        self.model = JointModel(arrays.parent.positions, arrays.child.positions, noise)
        self._start = JointStart(arrays)
        self._forget_biases()
        self._kept: tuple[FloatArray, FloatArray] | None = None  # biases and covariance of before a sensor froze
        self._variances: FloatArray | None = None
        self._weightings: dict[bytes, Weighting] = {}
        self._x = self._p = None
        self.restart()

    def restart(self) -> None:
        """See `PairFilter`."""
        self._leave()
        self._take_kept()
        self.angle, self.rates, self.variance = 0.0, (0.0, 0.0), UNKNOWN
        self.status = _STARTING
        self._left = None
        self._newest: tuple[Correction, Weighting] | None = None

    def start_from(self, biases: Sequence[Bias]) -> None:
        """Before the first sample: biases (C) of an earlier run, as a prior (learned.py)."""
        values, deviations = np.array(biases).reshape(-1, 2).T
        variances = deviations**2 + ACCEL_DRIFT**2
        usual = self.model.noise.bias_std**2
        values[variances >= usual] = 0.0
        self._bias, self._bias_covariance = values, np.diag(np.minimum(variances, usual))

    def bias_deviations(self) -> list[float]:
        """(C) standard deviations of the biases, m/s^2."""
        p = self._p
        covariance = self._bias_covariance if p is None else (p if p.ndim == 2 else p[0])[MOTION:, MOTION:]
        return np.sqrt(covariance.diagonal()).tolist()

    def keep_biases(self) -> None:
        """A sensor is frozen: what is learned of biases while its link has too few sensors may be motion."""
        if self._kept is None:
            x, p = self._most_likely()
            self._kept = self._bias, self._bias_covariance
            if x is not None and p is not None:
                self._kept = x[MOTION:].copy(), p[MOTION:, MOTION:].copy()

    def take_back_biases(self) -> None:
        """The sensor is back: start the motion afresh from the next sample, with the biases of before."""
        if self._kept is not None:
            self._left = self.angle
            self._leave()
            self._take_kept()

    def _take_kept(self) -> None:
        if self._kept is not None:
            (self._bias, self._bias_covariance), self._kept = self._kept, None

    def _most_likely(self) -> tuple[FloatArray | None, FloatArray | None]:
        if self._x is None or self._p is None or self._x.ndim == 1:
            return self._x, self._p
        return self._x[0], self._p[0]

    def _leave(self) -> None:
        """Give up the motion; keep the biases of the most likely hypothesis."""
        x, p = self._most_likely()
        if x is not None and p is not None:
            self._bias, self._bias_covariance = x[MOTION:].copy(), p[MOTION:, MOTION:].copy()
        self._x = self._p = None
        self._log_likelihoods, self._parents = [], []
        self._start.clear()
        self._silent = 0.0  # s since the newest correction
        self._strain = 1.0  # of late
        self._patience, self._since_challenge = _PATIENCE[0], _PATIENCE[0]

    def _forget_biases(self) -> None:
        biases = self.model.size - MOTION
        self._bias, self._bias_covariance = np.zeros(biases), np.eye(biases) * self.model.noise.bias_std**2

    # ------------------------------------------------------------- steps

    def step(self, dt: float, channels: FloatArray, variances: FloatArray) -> bool:
        """See `PairFilter`."""
        if variances is not self._variances:
            self._variances = variances
            self._weightings.clear()
        readings = channels.view(complex)
        missing = np.isnan(readings)
        present = len(missing) - np.count_nonzero(missing)
        self._newest = None
        fault = 0
        if self._x is not None:
            self._predict(dt)
        if self._x is None:
            self._bias_covariance += np.eye(len(self._bias)) * (self.model.noise.bias_walk**2 * dt)
            self._begin(channels)
        if present > 1 and self._x is not None:
            if present < len(missing):
                readings = np.where(missing, 0.0, readings)
            fault = self._correct_safely(dt, channels, readings, missing)
            self._silent = 0.0
        self._publish(fault)
        return bool(present > 1)

    def _correct_safely(self, dt: float, channels: FloatArray, readings: Any, missing: Any) -> int:
        """Correct; readings beyond all reason, with which numbers cannot be computed, cost what was known."""
        assert self._x is not None
        fault = 0
        try:
            if self._x.ndim > 1:
                self._correct_hypotheses(readings, missing)
            else:
                fault = self._correct(dt, readings, missing)
                if self._strain > _ASTRAY:
                    self._challenge(dt, channels)
            if np.isfinite(self._x).all():
                return fault
        except np.linalg.LinAlgError:
            pass
        self._leave()
        self._forget_biases()
        self._newest = None
        return _DISTURBED

    def _predict(self, dt: float) -> None:
        assert self._x is not None and self._p is not None
        if dt > 0.0:
            self._x, self._p = self.model.predict(self._x, self._p, dt)
        self._parents = list(range(len(self._x))) if self._x.ndim > 1 else [0]
        self._silent += dt
        if self._silent > self._max_gap or self._p[..., ANGLE, ANGLE].min() > LOST:
            self._left = self.angle
            self._leave()

    def _weighting(self, missing: Any) -> Weighting:
        pattern = missing.tobytes()
        weighting = self._weightings.get(pattern)
        if weighting is None:
            assert self._variances is not None
            if len(self._weightings) >= _PATTERNS:
                self._weightings.clear()
            weighting = self._weightings[pattern] = self.model.weighting(self._variances[::2], missing)
        return weighting

    def _correct(self, dt: float, readings: Any, missing: Any) -> int:
        """Correct the one hypothesis, without a sensor that contradicts all others; the status if there is one."""
        before = self._x, self._p
        assert before[0] is not None and before[1] is not None
        weighting = self._weighting(missing)
        x, p, found = self.model.correct(before[0], before[1], readings, weighting)
        strain = _strain(found, missing)
        fault = _DISTURBED if self._strain > _ASTRAY else 0
        present = np.flatnonzero(~missing)
        if strain > _CONTRADICTION * max(self._strain, 1.0) and len(present) >= _JUDGES:
            fault = _DISTURBED
            strains = []
            for sensor in present:
                without = missing.copy()
                without[sensor] = True
                others = self._weighting(without)
                result = self.model.correct(before[0], before[1], np.where(without, 0.0, readings), others)
                strains.append((_strain(result[2], without), result, others))
            least, (x_others, p_others, found_others), others = min(strains, key=lambda one: one[0])
            if least < max(_RESOLVED, _MUCH_LESS * strain):
                strain, x, p, found, weighting = least, x_others, p_others, found_others, others
        self._strain += (strain - self._strain) * min(dt / _AVERAGED, 1.0)
        self._x, self._p, self._newest = x, p, (found, weighting)
        return fault

    def _correct_hypotheses(self, readings: Any, missing: Any) -> None:
        """Correct them all, drop those that have lost or become equal to another, the most likely first."""
        assert self._x is not None and self._p is not None
        weighting = self._weighting(missing)
        stacked = np.broadcast_to(readings, (len(self._x), len(readings)))
        x, p, found = self.model.correct(self._x, self._p, stacked, weighting)
        gained = found.log_likelihood().tolist()
        log_likelihoods = [a + b for a, b in zip(self._log_likelihoods, gained, strict=True)]
        kept = survivors(log_likelihoods, x[:, :3].tolist(), np.diagonal(p, axis1=1, axis2=2)[:, :3].tolist())
        best = kept[0]
        self._x, self._p = (x[kept], p[kept]) if len(kept) > 1 else (x[best], p[best])
        self._log_likelihoods = [log_likelihoods[one] for one in kept]
        self._parents = [self._parents[one] for one in kept]
        self._newest = Correction(found.innovation[best], found.covariance[best], found.turn[best]), weighting

    def _begin(self, channels: FloatArray) -> None:
        """Start if this sample tells the angle."""
        assert self._variances is not None
        offer = self._start.offer(channels, self._variances, self._bias, self._bias_covariance)
        if offer is None:
            return
        states, variances = offer
        states[:, ANGLE] = first_branch(states[0, ANGLE], self._joint, self._left)
        self._x, self._p = self.model.prior(states, variances)
        self._x[:, MOTION:], self._p[:, MOTION:, MOTION:] = self._bias, self._bias_covariance
        self._log_likelihoods, self._parents = [0.0] * len(states), [-1] * len(states)

    def _challenge(self, dt: float, channels: FloatArray) -> None:
        """Put a fresh start, which knows nothing of the biases, beside the filter."""
        assert self._x is not None and self._p is not None
        self._since_challenge += dt
        if self._since_challenge < self._patience:
            return
        x, p = self._x, self._p
        self._forget_biases()
        self._left = self.angle
        self._begin(channels)
        if self._x is not x:
            self._x, self._p = np.concatenate([x[None], self._x]), np.concatenate([p[None], self._p])
            self._log_likelihoods.insert(0, _ADVANTAGE)
            self._parents.insert(0, 0)
            self._since_challenge, self._strain = 0.0, 1.0
            self._patience = min(2.0 * self._patience, _PATIENCE[1])

    def _publish(self, fault: int) -> None:
        """Output of the filter, or the mean of the hypotheses by likelihood."""
        x, p = self._x, self._p
        if x is None or p is None:
            self.rates, self.variance = (0.0, 0.0), UNKNOWN
            self.status = (self.status & _STARTING) | _UNOBSERVABLE | fault
            return
        if x.ndim == 1:
            w_a, w_b, angle = x[:3].tolist()
            variance = p.item(ANGLE, ANGLE)
        else:
            weights = np.exp(np.array(self._log_likelihoods) - self._log_likelihoods[0])
            weights /= weights.sum()
            w_a, w_b, angle = (weights @ x[:, :3]).tolist()
            variance = float(weights @ (p[:, ANGLE, ANGLE] + (x[:, ANGLE] - angle) ** 2))
        self.angle, self.rates, self.variance = angle, (w_a, w_b), min(variance, UNKNOWN)
        self.status = fault | (_UNOBSERVABLE if variance > UNOBSERVABLE else 0)

    # ------------------------------------------------------------- what else is known

    def innovations(self) -> Sequence[float]:
        """See `PairFilter`: of the most likely hypothesis, before the correction, without what a_O explains."""
        if self._newest is None:
            return [math.nan] * (2 * self.model.sensors)
        return channel_innovations(*self._newest).tolist()

    def biases(self) -> Sequence[float]:
        """See `PairFilter`: of the most likely hypothesis."""
        if self._x is None:
            return self._bias.tolist()
        return (self._x if self._x.ndim == 1 else self._x[0])[MOTION:].tolist()

    def snapshot(self, dt: float) -> Snapshot | None:
        """For the smoother, after a step of `dt` s; None: no estimate."""
        if self._x is None or self._p is None:
            return None
        n = self.model.size
        return Snapshot(dt, self._x.reshape(-1, n), self._p.reshape(-1, n, n), tuple(self._parents))

    def get_state(self) -> Any:
        """See `PairFilter`."""
        return {
            "x": None if self._x is None else self._x.tolist(),
            "p": None if self._p is None else self._p.tolist(),
            "log_likelihoods": list(self._log_likelihoods),
            "bias": self._bias.tolist(),
            "bias_covariance": self._bias_covariance.tolist(),
            "kept": None if self._kept is None else [one.tolist() for one in self._kept],
            "told": self._start.told,
            "left": self._left,
            "times": [self._silent, self._strain, self._patience, self._since_challenge],
            "output": [self.angle, *self.rates, self.variance, self.status],
        }

    def set_state(self, state: Any) -> None:
        """See `PairFilter`."""
        self._x = None if state["x"] is None else np.array(state["x"])
        self._p = None if state["p"] is None else np.array(state["p"])
        self._log_likelihoods = list(state["log_likelihoods"])
        self._bias = np.array(state["bias"])
        self._bias_covariance = np.array(state["bias_covariance"]).reshape(len(self._bias), len(self._bias))
        kept, self._kept = state["kept"], None
        if kept is not None:
            self._kept = np.array(kept[0]), np.array(kept[1]).reshape(len(self._bias), len(self._bias))
        self._start.clear()
        self._start.told, self._left = state["told"], state["left"]
        self._silent, self._strain, self._patience, self._since_challenge = state["times"]
        self.angle, w_a, w_b, self.variance, self.status = state["output"]
        self.rates = w_a, w_b
        self._parents = []
        self._newest = None


def _strain(found: Correction, missing: Any) -> float:
    """Mean square of the normalised innovations: about 1 when all is well."""
    normalised = found.innovation**2 / np.diagonal(found.covariance)
    present = len(missing) - np.count_nonzero(missing)
    return float(normalised.sum()) / (2 * (present - 1)) if present > 1 else 0.0
