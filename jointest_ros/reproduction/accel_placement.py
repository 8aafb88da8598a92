"""Figs. 6 and 7 of Woods & Vikas: error of the joint angle by mean distance and span of the arrays."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation import jobs
from jointest_ros.evaluation.jobs import HERE, Workers
from jointest_ros.reproduction import accel_trials as trials
from jointest_ros.reproduction.accel_trials import BOUND, JOINT_EKF, PRINTED_EKF
from jointest_ros.reproduction.result import Cell, Options, Report, Result, ResultTable
from jointest_ros.sim.slider_crank import SCENARIOS, CrankMotion, motion, row

SCENARIO = SCENARIOS["P"]
MEAN_A = 0.1  # m, l_a
RATIOS = (0.5, 1.0, 2.0, 5.0)  # l_a / d_a of Fig. 7; that of Fig. 6 is 1
MEANS_B = (0.2, 0.4, 0.6, 0.8, 1.0)  # m, l_b
SPANS_B = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4)  # m, d_b
RUNS = 40
METHODS = (PRINTED_EKF, BOUND)
SHORT = {PRINTED_EKF: "EKF", BOUND: "bound"}

Grid = FloatArray  # (ratios, means, spans) deg


def run(report: Report, options: Options, workers: Workers = HERE) -> Result:
    """All placements of both figures."""
    runs = options.runs or RUNS
    seeds = range(options.seed, options.seed + runs)
    places = [(mean, span, ratio) for ratio in RATIOS for mean in MEANS_B for span in SPANS_B]
    wanted: list[partial[Any]] = [partial(joint_angle, mean, seeds) for mean in MEANS_B]
    wanted += [partial(angles, block, seeds) for block in trials.blocks(places, runs)]
    results = list(jobs.run(wanted, workers, report))
    joint, found = results[: len(MEANS_B)], trials.joined(results[len(MEANS_B) :])
    shape = len(RATIOS), len(MEANS_B), len(SPANS_B)
    grids: dict[str, Grid] = {method: found[method].reshape(shape) for method in METHODS}
    fig6 = {method: grid[RATIOS.index(1.0)] for method, grid in grids.items()}
    return Result(
        conditions=(
            f"Slider-crank of 20 cm and 2 m, {SCENARIOS['B'].description} ({SCENARIO.sigma:.4f} m/s² a sample); two "
            "accelerometers on each link, their middle at l and their distance d; l_a = 10 cm; "
            f"{trials.seeds_text(seeds)}.",
            f"RMSE of θ, deg, over all trials from sample {trials.SETTLED} on; filters start near the truth. EKF: as "
            "printed, without (20). Bound: of Cramér and Rao, for filters.",
        ),
        tables=(
            *(_grid_table(method, fig6[method], joint if method == BOUND else None) for method in METHODS),
            ResultTable(
                "Fig. 7: smallest RMSE of θ, deg, over all l_b and d_b",
                ("l_a / d_a", *METHODS),
                [(f"{r:g}", *(float(grids[m][k].min()) for m in METHODS)) for k, r in enumerate(RATIOS)],
                ".3f",
            ),
        ),
        draw=lambda figure: _draw(figure, grids),
        remarks=(
            "As the paper says, the error of its EKF is a straight line in 1/d_b, and rises with l_b. The latter is "
            "mostly that filter's own doing: at a short span the bound falls with l_b, and accel_ekf with it.",
            "Both confirm (23): a wide span counts most, on both links, and l_a / d_a limits what link b can gain.",
            "The paper's L/2 for the mean position contradicts (23) and its own figures; here the mean is l.",
        ),
        size=(11.0, 7.5),
    )


def placed(mean_b: float, span_b: float, ratio: float = 1.0) -> CrankMotion:
    """The motion, with two accelerometers on each link."""
    return motion(SCENARIO, positions=(row(MEAN_A, MEAN_A / ratio), row(mean_b, span_b)))


def angles(places: Sequence[tuple[float, float, float]], seeds: range) -> dict[str, FloatArray]:
    """(placements,) deg, RMSE or bound of the angle by method; a place is l_b, d_b and l_a / d_a."""
    motions = [placed(*one) for one in places]
    found = trials.sweep(motions, SCENARIO.sigma, seeds)
    return found | {BOUND: trials.bounds(motions, SCENARIO.sigma)[:, 2]}


def joint_angle(mean_b: float, seeds: range) -> float:
    """RMSE of the angle by the joint model with the smallest span on b, deg."""
    one = placed(mean_b, SPANS_B[0])
    case = trials.case(one, SCENARIO.sigma, seeds)
    return float(trials.settled_rmse(trials.joint_model(case, trials.near_truth(one)), one)[2])


def straightness(values: FloatArray) -> float:
    """R^2 of a straight line through errors (spans,) over 1/d_b."""
    return float(np.corrcoef(1.0 / np.array(SPANS_B), values)[0, 1] ** 2)


def _grid_table(method: str, grid: FloatArray, joint: list[float] | None) -> ResultTable:
    columns = ["l_b, m", *(f"d_b {span:g} m" for span in SPANS_B), "R² of a line in 1/d_b"]
    rows: list[tuple[Cell, ...]] = [
        (f"{mean:g}", *map(float, values), straightness(values)) for mean, values in zip(MEANS_B, grid, strict=True)
    ]
    if joint is not None:
        columns.append(f"{JOINT_EKF}, d_b {SPANS_B[0]:g} m")
        rows = [(*cells, value) for cells, value in zip(rows, joint, strict=True)]
    return ResultTable(f"Fig. 6, l_a = d_a = 10 cm: RMSE of θ, deg, {method}", tuple(columns), rows, ".3f")


def _draw(figure: Figure, grids: dict[str, Grid]) -> None:
    panels = figure.subplots(2, 3)
    for line, method in zip(panels, METHODS, strict=True):
        by_span, by_mean, by_ratio = line
        grid, name = grids[method], SHORT[method]
        fig6 = grid[RATIOS.index(1.0)]
        for number, (mean, values) in enumerate(zip(MEANS_B, fig6, strict=True)):
            by_span.plot(1.0 / np.array(SPANS_B), values, "o-", color=f"C{number}", markersize=3.0, label=f"{mean:g} m")
        for number, (span, values) in enumerate(zip(SPANS_B, fig6.T, strict=True)):
            by_mean.plot(MEANS_B, values, "o-", color=f"C{number}", markersize=3.0, label=f"{span:g} m")
        for number, (ratio, values) in enumerate(zip(RATIOS, grid, strict=True)):
            lines = by_ratio.plot(SPANS_B, values.T, "o-", color=f"C{number}", markersize=3.0)
            lines[0].set_label(f"{ratio:g}")
        for axes, text, legend in (
            (by_span, "1/d_b, 1/m (Fig. 6 e, f)", "l_b"),
            (by_mean, "l_b, m (Fig. 6 g, h)", "d_b"),
            (by_ratio, "d_b, m (Fig. 7)", "l_a / d_a"),
        ):
            axes.set(xlabel=text, ylabel=f"{name}: RMSE of θ, deg", ylim=(0.0, None))
            axes.grid(alpha=0.3)
            axes.legend(title=legend, fontsize="small")
