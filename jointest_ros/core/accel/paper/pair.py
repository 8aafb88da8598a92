"""The filter of one joint on the paper's model, online: trapezoid, bank of starts, missing sensors.

A sensor that is missing leaves its link to the others as long as two of them are apart. Else, and where a whole frame
is missing, nothing is known of the input: the output is carried on, its variance grows by what the jerk may have done,
and the state waits. The next sample closes the gap by the trapezoid between its ends, with the variance of what that
may have missed of an acceleration with white snap. After a gap longer than `max_gap` the signs of the angular
velocities are open again, and where the force at the joint has been too weak for long the angle is: the filter starts
afresh with the next samples that tell the angle. A filter that contradicts its samples for a while may have gone
astray: a fresh start then runs beside it, until the more likely one has won.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from jointest_ros.core.accel.array import JointArrays
from jointest_ros.core.accel.pair_filter import UNKNOWN, UNOBSERVABLE, first_branch
from jointest_ros.core.accel.paper.linearise import FLOATS, Linearise
from jointest_ros.core.accel.paper.model import PaperNoise
from jointest_ros.core.accel.paper.trapezoid import (
    correct_trapezoid,
    divided_difference,
    predict_trapezoid,
    start_trapezoid,
)
from jointest_ros.core.accel.reader import Reader
from jointest_ros.core.accel.start import LOST, evidence, hypotheses, survivors
from jointest_ros.core.frame import FloatArray, Status

SNAP = 1e5  # rad^2/s^7, density of the white snap of a link
JERK = 1e3  # rad/s^3, standard deviation of what is not known of a link's jerk while samples are missing
_ASTRAY = 8.0  # mean square of the normalised innovations, 1 when all is well
_AVERAGED = 0.25  # s
_PATIENCE = 1.0  # s between fresh starts beside the filter
_UNEVEN = 2.0  # steps that differ more are bridged without the end correction: it would amplify the noise

# X and P (see paper/trapezoid.py), cumulative log likelihood, whitened innovations of the newest sample
Hypothesis = tuple[list[float], list[float], float, Sequence[float]]
_NONE = (math.nan,) * 4
_STARTING, _UNOBSERVABLE = int(Status.STARTING), int(Status.UNOBSERVABLE)


class PaperPair:
    """A `PairFilter`.

    Args:
        linearise: `linearise_ekf` or what `ukf` returns.
        max_gap: s, after which the filter starts afresh.
    """

    def __init__(self, arrays: JointArrays, linearise: Linearise, max_gap: float) -> None:
        self._joint, self._linearise, self._max_gap = arrays.joint, linearise, max_gap
        self._reader = Reader(arrays)
        limits = arrays.joint.limits
        low, high = limits[0] if limits else (-math.inf, math.inf)
        self._middle = -0.5 * (low + high) if limits else 0.0
        self._reach = max(math.pi, 0.5 * (high - low))  # rad from the middle; beyond it the angle is on another branch
        self.restart()

    def restart(self) -> None:
        """Before the first sample."""
        self.angle, self.rates, self.variance = 0.0, (0.0, 0.0), UNKNOWN
        self.status = _STARTING
        self._bank: list[Hypothesis] = []
        self._elapsed = 0.0  # s since the newest sample
        self._inputs: list[tuple[float, float]] = []  # alpha of both links, the two newest samples, the older first
        self._spacing = 0.0  # s between these
        self._innovations: Sequence[float] = _NONE
        self._told = 0.0  # 1/rad^2, see `evidence`
        self._strain = 1.0  # mean square of the normalised innovations of late
        self._patience = 0.0  # s, before the next fresh start beside the filter

    def step(self, dt: float, channels: FloatArray, variances: FloatArray) -> bool:
        """Predict over `dt` s, then correct; see `PairFilter`."""
        self._elapsed += dt
        read = self._reader.read(channels, variances)
        if read is None:
            self._carry_on()
            return False
        reading, noise = read
        dt, self._elapsed = self._elapsed, 0.0
        bank = self._advance(dt, reading, noise) if self._bank and dt <= self._max_gap else []
        if len(bank) > 1:
            states, spreads = [one[0] for one in bank], [(p[0], p[2], p[5]) for _, p, _, _ in bank]
            bank = [bank[one] for one in survivors([one[2] for one in bank], states, spreads)]
        if not bank or bank[0][1][5] > LOST:
            dt, bank = 0.0, self._start(reading, noise)
        elif self._astray(dt, bank):
            bank = bank + [(x, p, bank[0][2], white) for x, p, _, white in self._start(reading, noise)]
        self._bank = bank
        self._inputs = [*(self._inputs[-1:] if dt else []), (reading[1], reading[5])]
        self._spacing = dt
        if not bank:
            self.rates, self.variance, self._innovations = (0.0, 0.0), UNKNOWN, _NONE
            self.status = (self.status & _STARTING) | _UNOBSERVABLE
            return True
        x, p, _, self._innovations = bank[0]
        if not -self._reach <= x[2] - self._middle <= self._reach:
            x[2] = first_branch(x[2], self._joint)
        self.rates, self.angle, self.variance = (x[0], x[1]), x[2], min(p[5], UNKNOWN)
        self.status = _UNOBSERVABLE if p[5] > UNOBSERVABLE else 0
        return True

    def _start(self, reading: list[float], noise: PaperNoise) -> list[Hypothesis]:
        """The four hypotheses, made of the sample: it does not correct them again. None where it tells no angle."""
        bank: list[Hypothesis] = []
        starts = hypotheses(reading, noise)
        self._told, enough = evidence(self._told, starts[0][1][2])
        if not enough:
            return bank
        self._told, self._strain, self._patience = 0.0, 1.0, _PATIENCE
        left = None if self.status & _STARTING else self.angle
        for (w_a, w_b, th), (var_a, var_b, var_th) in starts:
            state = w_a, w_b, first_branch(th, self._joint, left)
            x, p = start_trapezoid(state, (var_a, 0.0, var_b, 0.0, 0.0, var_th), reading, noise)
            bank.append((x, p, 0.0, _NONE))
        return bank

    def _advance(self, dt: float, reading: list[float], noise: PaperNoise) -> list[Hypothesis]:
        """All hypotheses `dt` s later; one whose numbers have left all bounds is dropped."""
        bend = self._bend(dt, reading)
        spread2 = SNAP * dt**5 / 120.0
        bank: list[Hypothesis] = []
        for x, p, log, _ in self._bank:
            try:
                before, covariance = predict_trapezoid(x, p, dt, reading, noise, bend, spread2)
                after = correct_trapezoid(before, covariance, dt, reading, noise, self._linearise, FLOATS)
                v0, v1, v2, v3 = after.whitened
                log -= 0.5 * (v0 * v0 + v1 * v1 + v2 * v2 + v3 * v3) + math.log(after.root_determinant)
            except (ValueError, ZeroDivisionError, OverflowError):
                continue
            if math.isfinite(log):
                bank.append((after.x, after.p, log, after.whitened))
        return bank

    def _astray(self, dt: float, bank: list[Hypothesis]) -> bool:
        """The innovations have been too large for a while, and there is but one hypothesis."""
        strain = 0.25 * sum(one * one for one in bank[0][3])
        self._strain += (strain - self._strain) * min(dt / _AVERAGED, 1.0)
        self._patience = max(self._patience - dt, 0.0)
        return self._strain > _ASTRAY and not self._patience and len(bank) == 1

    def _bend(self, dt: float, reading: list[float]) -> tuple[float, float]:
        """Second differences of the inputs for `predict_trapezoid`; 0 where steps are too uneven or too few."""
        if len(self._inputs) < 2 or dt > _UNEVEN * self._spacing:
            return 0.0, 0.0
        (a0, b0), (a1, b1) = self._inputs
        return (
            divided_difference(a0, a1, reading[1], self._spacing, dt),
            divided_difference(b0, b1, reading[5], self._spacing, dt),
        )

    def _carry_on(self) -> None:
        """The output without a sample: on with the newest accelerations, for `max_gap` at most."""
        self._innovations = _NONE
        if not self._bank:
            return
        x, p, _, _ = self._bank[0]
        t = min(self._elapsed, self._max_gap)
        relative = x[0] - x[1] + 0.5 * t * (x[3] - x[4])
        self.angle = x[2] + t * relative
        self.rates = (x[0] + t * x[3], x[1] + t * x[4]) if self._elapsed <= self._max_gap else (0.0, 0.0)
        spread = p[5] + 2.0 * t * (p[3] - p[4]) + t * t * (p[0] - 2.0 * p[1] + p[2]) + 2.0 * (JERK * t**3 / 6.0) ** 2
        self.variance = min(spread, UNKNOWN) if self._elapsed <= self._max_gap else UNKNOWN

    def innovations(self) -> Sequence[float]:
        """Of the newest sample, made independent: the sum of their squares is its normalised innovation squared."""
        return self._innovations

    def biases(self) -> Sequence[float]:
        """None: the model has no biases."""
        return ()

    def get_state(self) -> dict[str, Any]:
        """All that changes."""
        return {
            "output": [self.angle, *self.rates, self.variance, self.status],
            "bank": [[list(x), list(p), log, list(white)] for x, p, log, white in self._bank],
            "elapsed": self._elapsed,
            "inputs": [list(pair) for pair in self._inputs],
            "spacing": self._spacing,
            "innovations": list(self._innovations),
            "watch": [self._told, self._strain, self._patience],
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`."""
        self.angle, w_a, w_b, self.variance, self.status = state["output"]
        self.rates = (w_a, w_b)
        self._bank = [(list(x), list(p), log, tuple(white)) for x, p, log, white in state["bank"]]
        self._elapsed, self._spacing = state["elapsed"], state["spacing"]
        self._inputs = [(a, b) for a, b in state["inputs"]]
        self._innovations = tuple(state["innovations"])
        self._told, self._strain, self._patience = state["watch"]
