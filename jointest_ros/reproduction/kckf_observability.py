"""Section 3.3 of Yumbla et al. 2023: rank of the observability matrix (21) of the KCKF and of the standard KF."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.kckf.paper_reference import measurement, observability_rank, pair_rows, transition
from jointest_ros.evaluation.jobs import HERE, Workers
from jointest_ros.reproduction.result import Cell, Options, Report, Result, ResultTable

JOINTS = range(2, 9)
SHOWN = 4  # the paper's number of joints
DT = 0.01
AXES = 3
KCKF, STANDARD_KF, HINGES = "KCKF (19)", "standard KF (8)", "KCKF, hinge Halls only"


def measurements(n: int) -> dict[str, FloatArray]:
    """C of each filter for n joints."""
    hinges = [AXES * joint + joint % 2 for joint in range(n) for _ in range(2)]  # x, y, x, y, ... and two sensors each
    return {
        KCKF: measurement(n, pair_rows(n)),
        STANDARD_KF: measurement(n, pair_rows(n), constrained=False),
        HINGES: measurement(n, hinges),
    }


def run(report: Report, options: Options, workers: Workers = HERE) -> Result:
    """Ranks for all of `JOINTS`; nothing is drawn at random."""
    ranks: dict[str, list[int]] = {KCKF: [], STANDARD_KF: [], HINGES: []}
    for done, n in enumerate(JOINTS):
        report(done, len(JOINTS))
        for name, c in measurements(n).items():
            ranks[name].append(observability_rank(transition(n, DT), c))
    states = [6 * n + 6 for n in JOINTS]
    rows: list[tuple[Cell, ...]] = [
        (n, size, size, ranks[KCKF][k], size - 6, ranks[STANDARD_KF][k], 2 * n + 6, ranks[HINGES][k])
        for k, (n, size) in enumerate(zip(JOINTS, states, strict=True))
    ]
    columns = (
        "n",
        "states",
        "KCKF: paper",
        "KCKF: ours",
        "KF: paper",
        "KF: ours",
        "hinges: 2n+6",
        "hinges: ours",
    )
    hidden: list[tuple[Cell, ...]] = [
        (name, ", ".join(unobservable(SHOWN, c)) or "none") for name, c in measurements(SHOWN).items()
    ]
    return Result(
        conditions=(
            f"Matrices (8), (11), (19) as printed, 6n+6 states, sample time {DT:g} s; nothing is simulated.",
            "Hinge Halls only: two sensors on each hinge, hinges about x and y in turn, and the constraint (17).",
        ),
        tables=(
            ResultTable("rank of (21)", columns, rows),
            ResultTable(f"states that cannot be observed, n = {SHOWN}", ("filter", "states"), hidden),
        ),
        draw=lambda figure: _draw(figure, ranks, states),
        remarks=(
            "The paper's full rank takes Hall sensors that give three angles a joint, (5). A hinge's sensor gives "
            "one: the locked axes must be left out of the filter (axes: x), as kckf does.",
        ),
        size=(7.0, 5.0),
    )


def unobservable(n: int, c: FloatArray) -> list[str]:
    """The states, as three-vectors or components of them, that a measurement of their own would add to (21)."""
    a = transition(n, DT)
    rank = observability_rank(a, c)
    unit = np.eye(len(a))
    names: list[str] = []
    blocks = [f"θ{k}" for k in range(1, n + 1)] + ["φ"] + [f"b{k}" for k in range(1, n + 1)] + ["bφ"]
    for number, block in enumerate(blocks):
        hidden = [
            letter
            for axis, letter in enumerate("xyz")
            if observability_rank(a, np.vstack([c, unit[AXES * number + axis]])) > rank
        ]
        if hidden:
            names.append(block if len(hidden) == AXES else f"{block}{''.join(hidden)}")
    return names


def _draw(figure: Figure, ranks: dict[str, list[int]], states: list[int]) -> None:
    axes = figure.subplots()
    axes.plot(JOINTS, states, "k--", label="number of states N = 6n + 6")
    for (name, row), marker, color in zip(ranks.items(), "osv", ("#0072b2", "#d55e00", "#009e73"), strict=True):
        axes.plot(JOINTS, row, marker, color=color, label=name, markersize=8)
    axes.set_xlabel("joints n")
    axes.set_ylabel("rank of the observability matrix (21)")
    axes.set_title("Observable states of the paper's filters")
    axes.grid(alpha=0.3)
    axes.legend()
