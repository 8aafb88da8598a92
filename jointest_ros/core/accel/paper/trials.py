"""The filters on the paper's model over many trials at a time, for `reproduce` and tests: arrays over trials.

Arrays of sensors enter by their readings alone: channels (trials, T, C) @ PaperModel.reading.T are (trials, T, 8),
whatever C is. So trials of different arrays, numbers of sensors and noise run together: concatenate their readings,
and give their noise an axis of trials. With 2000 trials a step costs 0.3 us (EKF as printed) to 0.7 us a trial.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from jointest_ros.core.accel.paper.euler import correct_euler, predict_euler
from jointest_ros.core.accel.paper.linearise import ARRAYS, Linearise, linearise_ekf
from jointest_ros.core.accel.paper.model import PaperNoise, Values
from jointest_ros.core.accel.paper.trapezoid import (
    correct_trapezoid,
    divided_difference,
    predict_trapezoid,
    start_trapezoid,
)
from jointest_ros.core.frame import FloatArray

PRINTED, DECORRELATED, TRAPEZOID = "printed", "decorrelated", "trapezoid"
BLOCK = 2048  # trials at a time: enough for numpy's overhead to vanish, few enough for the cache


@dataclass(frozen=True, eq=False)
class Trials:
    """What a filter gave.

    Attributes:
        state: (trials, T, 3): w_a, w_b (rad/s), th_ab (rad, continuous).
        variance: (trials, T, 3) of these.
    """

    state: FloatArray
    variance: FloatArray


def run_filter(
    readings: FloatArray,
    noise: PaperNoise,
    period: float,
    start: ArrayLike,
    start_covariance: ArrayLike,
    form: str = TRAPEZOID,
    linearise: Linearise = linearise_ekf,
) -> Trials:
    """Run a filter on readings; sample 0 corrects the start.

    Args:
        readings: (trials, T, 8), see the module text.
        noise: of them; entries are numbers, or (trials).
        period: s.
        start: x0, (3) or (trials, 3), rad/s and rad.
        start_covariance: P0, (3, 3).
        form: `PRINTED` (paper/euler.py, without (20): the paper's results), `DECORRELATED` (with (20), right) or
            `TRAPEZOID` (production, paper/trapezoid.py).
        linearise: `linearise_ekf`, or what `ukf` returns.
    """
    number, length, _ = readings.shape
    starts = np.broadcast_to(np.asarray(start, dtype=float), (number, 3))
    p0 = np.asarray(start_covariance, dtype=float)[np.tril_indices(3)]
    trials = Trials(np.empty((number, length, 3)), np.empty((number, length, 3)))
    run, correlated = {
        PRINTED: (_run_euler, None),
        DECORRELATED: (_run_euler, linearise),
        TRAPEZOID: (_run_trapezoid, linearise),
    }[form]
    for first in range(0, number, BLOCK):
        rows = slice(first, first + BLOCK)
        block = readings[rows]
        x = [np.array(one) for one in starts[rows].T]
        p = [np.full(len(block), one) for one in p0]
        part = Trials(trials.state[rows], trials.variance[rows])
        run(block, _part(noise, rows, number), period, x, p, linearise, correlated, part)
    return trials


def _run_euler(
    readings: FloatArray,
    noise: PaperNoise,
    period: float,
    x: Values,
    p: Values,
    linearise: Linearise,
    correlated: Linearise | None,
    trials: Trials,
) -> None:
    before: Values = None
    for k in range(readings.shape[1]):
        reading = readings[:, k].T.copy()
        if k:
            x, p = predict_euler(x, p, period, before, noise, correlated, ARRAYS)
        x, p, _, _ = correct_euler(x, p, reading, noise, linearise, ARRAYS)
        _store(trials, k, x, p)
        before = reading


def _run_trapezoid(
    readings: FloatArray,
    noise: PaperNoise,
    period: float,
    x: Values,
    p: Values,
    linearise: Linearise,
    _: Linearise | None,
    trials: Trials,
) -> None:
    before: list[FloatArray] = []  # the two newest readings
    for k in range(readings.shape[1]):
        reading = readings[:, k].T.copy()
        if not before:
            x, p = start_trapezoid(x, p, reading, noise)
        else:
            bend = (0.0, 0.0)
            if len(before) == 2:
                one, two = before
                bend = (
                    divided_difference(one[1], two[1], reading[1], period, period),
                    divided_difference(one[5], two[5], reading[5], period, period),
                )
            x, p = predict_trapezoid(x, p, period, reading, noise, bend, 0.0)
        x, p, _white, _root = correct_trapezoid(x, p, period if before else 0.0, reading, noise, linearise, ARRAYS)
        _store(trials, k, x, p)
        before = [*before[-1:], reading]


def _store(trials: Trials, k: int, x: Values, p: Values) -> None:
    for i, entry in enumerate((0, 2, 5)):
        trials.state[:, k, i], trials.variance[:, k, i] = x[i], p[entry]


def _part(noise: PaperNoise, rows: slice, number: int) -> PaperNoise:
    def part(entries: Values) -> Values:
        return tuple(np.broadcast_to(one, number)[rows] if np.ndim(one) else one for one in entries)

    return PaperNoise(part(noise.a), part(noise.b))
