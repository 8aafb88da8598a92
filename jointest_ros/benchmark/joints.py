"""How the cost of a step grows with the number of joints."""

from __future__ import annotations

from collections.abc import Iterator

from jointest_ros.benchmark.case import Case, Rigs
from jointest_ros.benchmark.chain import RATE_HZ, X, Y, Z, hinges
from jointest_ros.benchmark.cost import Task, measure
from jointest_ros.benchmark.part import Options, PartResult
from jointest_ros.reproduction.result import Cell, Report, ResultTable

COUNTS = (2, 4, 8, 16, 32)
MOST_THREE_AXIS = 16  # 48 angles and 51 biases in one filter: beyond any robot
ROUNDS, SIZE = 7, 100
QUICK_COUNTS, QUICK_ROUNDS, QUICK_SIZE = (2, 8), 2, 10

_COLUMNS = ("estimator", "joints", "angles", "update_us", "spread_us", "us_per_joint", "growth")


def _cases(count: int) -> Iterator[Case]:
    """Of `count` joints."""
    yield Case("pcf hinge", "pcf", hinges(count), {"formulation": "hinge"})
    yield Case("pcf relative", "pcf", hinges(count), {"formulation": "relative"})
    yield Case("kckf additive, hinges", "kckf", hinges(count), {"kinematics": "additive"})
    yield Case("kckf composed, hinges", "kckf", hinges(count), {"kinematics": "composed"})
    if count <= MOST_THREE_AXIS:
        yield Case("kckf composed, three-axis", "kckf", [(X, Y, Z)] * count, {"kinematics": "composed"})
    yield Case("accel_ekf, paper's model", "accel_ekf", [(X,)] * count, {"model": "paper"}, True)
    yield Case("accel_ekf, joint model", "accel_ekf", [(X,)] * count, {"model": "joint"}, True)


def run(options: Options, report: Report) -> PartResult:
    """The part `joints`."""
    counts, rounds, size = (QUICK_COUNTS, QUICK_ROUNDS, QUICK_SIZE) if options.quick else (COUNTS, ROUNDS, SIZE)
    rigs = Rigs(rounds, size)
    tasks: dict[tuple[str, int], Task] = {}
    angles: dict[tuple[str, int], int] = {}
    for count in counts:
        for case in _cases(count):
            rig = rigs.of(case)
            estimator = case.make(rig.robot)
            angles[case.label, count] = len(estimator.joints)
            tasks[case.label, count] = rig.updates(estimator)
    costs = measure(tasks, rounds, report)
    rows: list[tuple[Cell, ...]] = []
    labels = [label for label, count in costs if count == counts[0]]
    for (label, count), cost in sorted(costs.items(), key=lambda item: labels.index(item[0][0])):
        per_joint, first = cost.us / count, costs[label, counts[0]].us / counts[0]
        rows.append((label, count, angles[label, count], cost.us, cost.spread_us, per_joint, per_joint / first))
    conditions = (
        f"CPU time of a frame by update, us: median of {rounds} rounds of {size} frames at {RATE_HZ:g} Hz, taken in "
        "turns; spread: half of the range of the middle half of the rounds",
        f"growth: cost per joint over that of {counts[0]} joints; 1 where twice the joints cost twice as much",
        "joints in series; kckf with three-axis joints has all angles and biases in one filter: 99 states of 16 joints",
    )
    return PartResult((ResultTable("cost of a step by joints", _COLUMNS, rows, ".4g"),), conditions)
