"""The filter of the KCKF in float32 beside float64, frame by frame over an hour at 1 kHz: 3.6 million steps each."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.kckf.coupled_filter import CoupledFilter
from jointest_ros.core.kckf.kckf import KckfParams
from jointest_ros.core.kckf.linkage import serial_linkage
from jointest_ros.evaluation.jobs import HERE, Workers
from jointest_ros.evaluation.measures import rmse_deg
from jointest_ros.reproduction.kckf_steady import LinkageInputs
from jointest_ros.reproduction.result import Cell, Options, Report, Result, ResultTable
from jointest_ros.sim import exoshell
from jointest_ros.sim.simulated import read_options

SCENARIO = "drift"
RATE_HZ, DURATION_S = 1000.0, 3600.0
CHUNK_S = 10.0
LOOK_EVERY = 100  # steps
ALLOWED = 0.01  # the specification: float32 within 1 % of float64
PARAMS = KckfParams(hall_noise="constant", kinematics="additive")


class Precision:
    """The filter in one precision, looked at every `LOOK_EVERY` steps.

    Attributes:
        variances: rows (2 m,), rad^2 and rad^2/s^2.
        torso: estimates of phi, deg.
        asymmetry: largest |P - P^T| so far, relative to the largest element of P.
        least: smallest eigenvalue so far of P as a matrix of correlations; negative infinity: P was not finite.
        still: steps after which one more left P as it was, bit by bit; None: none did.
    """

    def __init__(self, inputs: LinkageInputs, dtype: type) -> None:
        noise = PARAMS.process_noise(inputs.linkage)
        start = (math.radians(PARAMS.initial_angle_deg), math.radians(PARAMS.initial_bias_dps), 0.0)
        self._filter = CoupledFilter(inputs.hall, inputs.coordinate, noise, start, PARAMS.hall_sigma, dtype=dtype)
        self._dtype = dtype
        self._used = np.ones(len(inputs.coordinate), dtype=bool)
        self._steps = 0
        self.variances: list[FloatArray] = []
        self.torso: list[float] = []
        self.asymmetry, self.least = 0.0, math.inf
        self.still: int | None = None

    def run(self, rates: FloatArray, angles: FloatArray) -> None:
        """The next frames: (T, m) rad/s and (T, h) rad."""
        dt = 1.0 / RATE_HZ
        for rate, angle in zip(rates.astype(self._dtype), angles.astype(self._dtype), strict=True):
            look = self._steps % LOOK_EVERY == 0
            before = self._filter.covariance.copy() if look else None
            self._filter.step(dt if self._steps else 0.0, rate, angle, self._used)
            self._steps += 1
            if before is not None:
                self._look(before)

    def _look(self, before: FloatArray) -> None:
        p = self._filter.covariance.astype(np.float64)
        variances = p.diagonal()
        self.variances.append(variances)
        self.torso.append(math.degrees(self._filter.x[: self._filter.m].sum()))
        if not (np.isfinite(p).all() and (variances > 0.0).all()):
            self.least = -math.inf
            return
        if self.still is None and np.array_equal(p, before):
            self.still = self._steps
        self.asymmetry = max(self.asymmetry, float(np.abs(p - p.T).max() / np.abs(p).max()))
        root = np.sqrt(variances)
        self.least = min(self.least, float(np.linalg.eigvalsh(p / np.outer(root, root))[0]))


def run(report: Report, options: Options, workers: Workers = HERE) -> Result:
    """Both precisions on the same hour."""
    duration = options.duration_s or DURATION_S
    robot = exoshell.exoshell(SCENARIO)
    inputs = LinkageInputs(robot, serial_linkage(robot))
    double, single = Precision(inputs, np.float64), Precision(inputs, np.float32)
    truth: list[FloatArray] = []
    chosen = {"scenario": SCENARIO, "rate_hz": RATE_HZ, "duration_s": duration, "seed": options.seed}
    steps, total = 0, round(RATE_HZ * duration)
    for part in exoshell.stretches(read_options(exoshell.ExoshellOptions, chosen), CHUNK_S):
        rates, angles = inputs.of(part.recording)
        for precision in (double, single):
            precision.run(rates, angles)
        truth.append(np.degrees(part.truth_torso[::LOOK_EVERY, 0]))
        steps += len(rates)
        report(steps, total)
    errors: list[FloatArray] = [np.array(precision.torso) - np.concatenate(truth) for precision in (double, single)]
    variances = [np.array(precision.variances) for precision in (double, single)]
    relative = np.abs(variances[1] / variances[0] - 1.0).max(axis=1)

    late = [rmse_deg(np.radians(error[len(error) // 2 :]), axis=0) for error in errors]
    rows: list[tuple[Cell, ...]] = [
        ("steps", None, total, total),
        ("P stands still after, s", None, _seconds(double), _seconds(single)),
        ("largest |P - Pᵀ| / |P|", "about 0", double.asymmetry, single.asymmetry),
        ("smallest eigenvalue of P as correlations", "> 0", double.least, single.least),
        ("rms error of the torso, second half, deg", None, *map(float, late)),
        ("largest relative difference of a variance", f"<= {ALLOWED:g}", None, float(relative.max())),
        ("largest difference of the torso, deg", None, None, float(np.abs(errors[1] - errors[0]).max())),
    ]
    time = np.arange(len(relative), dtype=float) * (LOOK_EVERY / RATE_HZ)
    return Result(
        conditions=(
            f"Scenario drift at {RATE_HZ:g} Hz, {duration:g} s, seed {options.seed}: four joints about one axis, "
            "which share their gyros: 8 states.",
            "The filter class of kckf itself, frame by frame, P and x in the precision of the column, noise of the "
            "data sheets, Hall angles with 3.2 deg of noise (as here, where the sensors are linear, noise in volts).",
            f"P is looked at every {LOOK_EVERY} steps. Once a step leaves it as it was, so does every later one, and "
            "the filter keeps its gain (float64: once a step changes it by less than 1e-13).",
        ),
        tables=(ResultTable("float32 beside float64", ("figure", "expected", "float64", "float32"), rows, ".3g"),),
        draw=lambda figure: _draw(figure, time, relative, errors),
        remarks=(
            "Not in the paper. Its own form, with the torso as a state and (16), is what the reduced filter replaces.",
        ),
        size=(9.0, 6.0),
    )


def _seconds(precision: Precision) -> float | None:
    return None if precision.still is None else precision.still / RATE_HZ


def _draw(figure: Figure, time: FloatArray, relative: FloatArray, errors: list[FloatArray]) -> None:
    top, bottom = figure.subplots(2, 1, sharex=True)
    minutes = time / 60.0
    top.semilogy(
        minutes, np.maximum(relative, 1e-9), color="#0072b2", label="largest relative difference of a variance"
    )
    top.axhline(ALLOWED, color="k", linestyle="--", label="allowed")
    top.set_ylabel("float32 / float64 - 1")
    top.legend()
    difference = np.abs(errors[1] - errors[0])
    bottom.semilogy(
        minutes, np.maximum(np.abs(errors[0]), 1e-9), ".", markersize=1, color="#999999", label="error, float64"
    )
    bottom.semilogy(
        minutes, np.maximum(difference, 1e-9), ".", markersize=1, color="#d55e00", label="float32 against float64"
    )
    bottom.set_ylabel("torso angle, deg")
    bottom.set_xlabel("time, min")
    bottom.legend(markerscale=8)
    for axes in (top, bottom):
        axes.grid(alpha=0.3)
        axes.set_xlim(0.0, minutes[-1])
    top.set_title("The KCKF at 1 kHz in single and double precision (simulated)")
