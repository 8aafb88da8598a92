"""What a step of every estimator costs, by `update` and by arrays, beside the peers that are installed."""

from __future__ import annotations

from jointest_ros.benchmark import peers
from jointest_ros.benchmark.case import Case, Rigs
from jointest_ros.benchmark.chain import RATE_HZ, X, Y, Z, hinges
from jointest_ros.benchmark.cost import REFERENCE, Cost, Task, measure, reference
from jointest_ros.benchmark.part import Options, PartResult
from jointest_ros.reproduction.result import Cell, Report, ResultTable

ROUNDS, SIZE = 15, 500
QUICK_ROUNDS, QUICK_SIZE = 5, 40

_PAIR = Case("pcf hinge, a pair", "pcf", hinges(1), {"formulation": "hinge"}, budget_us=5.0)
_BALLS = [(X, Y, Z)] * 4
CASES = (
    Case("gyro, 4 hinges", "gyro", hinges(4)),
    Case("hall, 4 hinges", "hall", hinges(4)),
    Case("kf, 4 hinges", "kf", hinges(4)),
    Case("kckf additive, 4 hinges", "kckf", hinges(4), {"kinematics": "additive"}, budget_us=25.0),
    Case("kckf composed, 4 hinges", "kckf", hinges(4), {"kinematics": "composed"}, budget_us=25.0),
    Case("kckf composed, 4 three-axis", "kckf", _BALLS, {"kinematics": "composed"}, budget_us=100.0),
    _PAIR,
    Case("pcf lever_arms, a pair", "pcf", hinges(1), {"formulation": "hinge", "lever_arms": True}),
    Case("pcf relative, a pair", "pcf", hinges(1), {"formulation": "relative"}, budget_us=5.0),
    Case("pcf absolute, a pair", "pcf", hinges(1), {"formulation": "absolute"}),
    Case("accel_analytical", "accel_analytical", [(X,)], accelerometers=True),
    Case("accel_ekf, paper's model", "accel_ekf", [(X,)], {"model": "paper"}, True, budget_us=40.0),
    Case("accel_ekf, joint model, 8 biases", "accel_ekf", [(X,)], {"model": "joint"}, True, budget_us=120.0),
    Case("accel_ukf", "accel_ukf", [(X,)], accelerometers=True),
)
_COLUMNS = (
    "step",
    "sensors",
    "joints",
    "update_us",
    "spread_us",
    "budget_us",
    "ratio",
    "us_per_joint",
    "arrays_us",
    "arrays_spread_us",
    "arrays_ratio",
)


def run(options: Options, report: Report) -> PartResult:
    """The part `steps`."""
    rounds, size = (QUICK_ROUNDS, QUICK_SIZE) if options.quick else (ROUNDS, SIZE)
    rigs = Rigs(rounds, size)
    tasks: dict[tuple[str, str], Task] = {(REFERENCE, "update"): reference}
    shapes: dict[str, tuple[int | None, int | None, float | None]] = {}  # sensors, joints, budget
    for case in CASES:
        rig = rigs.of(case)
        by_frames, by_arrays = case.make(rig.robot), case.make(rig.robot)
        tasks[case.label, "update"] = rig.updates(by_frames)
        tasks[case.label, "arrays"] = rig.arrays(by_arrays)
        shapes[case.label] = len(rig.robot.sensors), len(by_frames.joints), case.budget_us
    _, *parts = rigs.of(_PAIR).parts
    sensor = next(iter(parts[0].gyro))
    for peer in peers.installed([p.gyro[sensor] for p in parts], [p.accel[sensor] for p in parts], RATE_HZ):
        tasks[peer.name, "update"] = peer.update
        if peer.arrays is not None:
            tasks[peer.name, "arrays"] = peer.arrays
        shapes[peer.name] = 1, None, None
    shapes[REFERENCE] = None, None, None
    costs = measure(tasks, rounds, report)
    rows = [_row(label, *shape, costs) for label, shape in shapes.items()]
    conditions = (
        f"CPU time of a frame, us: median of {rounds} rounds of {size} frames at {RATE_HZ:g} Hz, taken in turns by "
        "all; spread: half of the range of the middle half of the rounds",
        f"ratio: to the {REFERENCE} (a quaternion turned and normalised), which tells of the machine alone",
        "joints: angles estimated; update: one Frame after another; arrays: run on a Recording",
        f"peers: of one IMU, called as their documentation does; not installed: {', '.join(peers.absent()) or 'none'}",
        "pcf: the whole estimator, with its look for rest; a pair of many costs less, see the part joints",
        "filterpy EKF: its bare predict and update, with 3 states and 4 measurements as in the paper's accel_ekf",
    )
    return PartResult((ResultTable("cost of a step", _COLUMNS, rows, ".4g"),), conditions)


def _row(
    label: str, sensors: int | None, joints: int | None, budget: float | None, costs: dict[tuple[str, str], Cost]
) -> tuple[Cell, ...]:
    unit = costs[REFERENCE, "update"].us
    update, arrays = costs[label, "update"], costs.get((label, "arrays"))
    by_arrays = (arrays.us, arrays.spread_us, arrays.us / unit) if arrays else (None, None, None)
    per_joint = update.us / joints if joints else None
    return (label, sensors, joints, update.us, update.spread_us, budget, update.us / unit, per_joint, *by_arrays)
