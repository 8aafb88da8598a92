"""Fig. 5 of Woods & Vikas: error of the joint angle by the number of accelerometers on either link."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation import jobs
from jointest_ros.evaluation.jobs import HERE, Workers
from jointest_ros.reproduction import accel_trials as trials
from jointest_ros.reproduction.accel_trials import ANALYTICAL, BOUND, COLORS, JOINT_EKF, PRINTED_EKF
from jointest_ros.reproduction.result import Cell, Options, Report, Result, ResultTable
from jointest_ros.sim.slider_crank import SCENARIOS, CrankMotion, motion, row

# As in the paper: L_a = 20 cm, L_b = 25 cm, the middle of every array and its span 10 cm.
SCENARIO = dataclasses.replace(SCENARIOS["B"], lengths=(0.2, 0.25))
MIDDLE = SPAN = 0.1
NUMBERS = tuple(range(2, 11))
RUNS = 60
FIXED = 5  # N_a of Fig. 5 (a)
METHODS = (ANALYTICAL, PRINTED_EKF, BOUND)

Places = tuple[int, int]  # accelerometers in a row on link a and b
ENDS: Places = (0, 0)


def run(report: Report, options: Options, workers: Workers = HERE) -> Result:
    """All pairs of numbers, then ten accelerometers at the ends of the arrays beside ten in a row."""
    runs = options.runs or RUNS
    seeds = range(options.seed, options.seed + runs)
    pairs = [(a, b) for a in NUMBERS for b in NUMBERS]
    alike = [*((number, number) for number in NUMBERS), ENDS]
    wanted: list[partial[Any]] = [partial(joint_angle, places, seeds) for places in alike]
    wanted += [partial(angles, block, seeds) for block in trials.blocks([*pairs, ENDS], runs)]
    results = list(jobs.run(wanted, workers, report))
    joint, found = results[: len(alike)], trials.joined(results[len(alike) :])
    tables = {method: values[:-1].reshape(len(NUMBERS), -1) for method, values in found.items()}
    last = {method: float(values[-1]) for method, values in found.items()} | {JOINT_EKF: joint[-1]}
    same = {method: np.diag(values) for method, values in tables.items()} | {JOINT_EKF: np.array(joint[:-1])}
    shown = (*METHODS, JOINT_EKF)
    return Result(
        conditions=(
            f"Slider-crank of 20 and 25 cm, {SCENARIO.description} ({SCENARIO.sigma:.4f} m/s² a sample); N "
            f"accelerometers in a row from {MIDDLE - SPAN / 2:g} to {MIDDLE + SPAN / 2:g} m from the joint on either "
            f"link; {trials.seeds_text(seeds)}.",
            f"RMSE of θ over all trials from sample {trials.SETTLED} on; filters start near the truth. Bound: that of "
            "Cramér and Rao, for filters.",
        ),
        tables=(
            ResultTable(
                "the same number N on both links: RMSE of θ, deg",
                ("N", *shown),
                [
                    *((number, *(float(same[m][k]) for m in shown)) for k, number in enumerate(NUMBERS)),
                    ("2 to 10: less by, %", *(_less(same[m][0], same[m][-1]) for m in shown)),
                    ("5 + 5 at the ends", *(last[m] for m in shown)),
                    ("than 10 in a row: less by, %", *(_less(same[m][-1], last[m]) for m in shown)),
                ],
                ".3f",
            ),
            ResultTable(
                f"Fig. 5 (a), {FIXED} accelerometers on link a: RMSE of θ, deg",
                ("N on link b", *METHODS),
                [_row(number, tables, NUMBERS.index(FIXED), k) for k, number in enumerate(NUMBERS)],
                ".3f",
            ),
        ),
        draw=lambda figure: _draw(figure, tables),
        remarks=(
            "The paper finds that filters benefit minimally from more than two accelerometers. They gain as the bound "
            "does, nearly as much as the analytical angle; a single trial a point scatters by a third, and hides it.",
            "More accelerometers help less than two groups at the ends of the arrays.",
        ),
        size=(12.0, 4.2),
    )


def placed(places: Places) -> CrankMotion:
    """The motion, with so many accelerometers in a row on either link; `ENDS`: ten on each, half of them at an end."""
    if places == ENDS:
        return motion(SCENARIO, positions=(at_ends(NUMBERS[-1]),) * 2)
    a, b = (row(MIDDLE, SPAN, number) for number in places)
    return motion(SCENARIO, positions=(a, b))


def at_ends(number: int) -> FloatArray:
    """(number, 2): half of them at either end of the array."""
    ends = row(MIDDLE, SPAN)
    return np.repeat(ends, (number // 2, number - number // 2), axis=0)


def angles(places: Sequence[Places], seeds: range) -> dict[str, FloatArray]:
    """(placements,) deg, RMSE or bound of the angle by method."""
    motions = [placed(one) for one in places]
    found = trials.sweep(motions, SCENARIO.sigma, seeds)
    return found | {BOUND: trials.bounds(motions, SCENARIO.sigma)[:, 2]}


def joint_angle(places: Places, seeds: range) -> float:
    """RMSE of the angle by the joint model, deg."""
    one = placed(places)
    case = trials.case(one, SCENARIO.sigma, seeds)
    return float(trials.settled_rmse(trials.joint_model(case, trials.near_truth(one)), one)[2])


def _less(before: float, after: float) -> float:
    return float(100.0 * (1.0 - after / before))


def _row(number: int, tables: dict[str, FloatArray], a: int, b: int) -> tuple[Cell, ...]:
    return number, *(float(tables[method][a, b]) for method in METHODS)


def _draw(figure: Figure, tables: dict[str, FloatArray]) -> None:
    for axes, method in zip(figure.subplots(1, len(METHODS)), METHODS, strict=True):
        for number, line in zip(NUMBERS, tables[method], strict=True):
            shade = 0.25 + 0.75 * (number - NUMBERS[0]) / (NUMBERS[-1] - NUMBERS[0])
            label = f"{number} on link a" if number in (NUMBERS[0], FIXED, NUMBERS[-1]) else None
            axes.plot(NUMBERS, line, "o-", color=COLORS[method], alpha=shade, markersize=3.0, label=label)
        axes.set(title=method, xlabel="accelerometers on link b", ylabel="RMSE of θ, deg", ylim=(0.0, None))
        axes.grid(alpha=0.3)
        axes.legend(frameon=False)
