"""Figures to reach: section 5 of the specification, items 3 to 6, 8 and 9. Angles in degrees."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointest_ros.core.frame import FloatArray, Recording
from jointest_ros.core.kckf.coupled_filter import CoupledFilter
from jointest_ros.core.kckf.gyro import Gyro
from jointest_ros.core.kckf.hall import Hall, HallParams
from jointest_ros.core.kckf.hall_bank import HallBank
from jointest_ros.core.kckf.kckf import PAPER, Kckf, KckfParams
from jointest_ros.core.kckf.kf import Kf
from jointest_ros.core.kckf.linkage import serial_linkage
from jointest_ros.core.kckf.process_noise import ProcessNoise
from jointest_ros.sim import exoshell

ADDITIVE = KckfParams(kinematics="additive")
OFFSET = KckfParams(kinematics="additive", hall_offset=True)
BOUND = np.array([0.0395, 0.0368, 0.0310, 0.0336])  # of the scenario `clipped`


def rms(error: FloatArray, axis: int = 0) -> FloatArray:
    return np.asarray(np.sqrt((error**2).mean(axis=axis)))


def fixed_input(file: Path) -> tuple[Recording, FloatArray, FloatArray]:
    """A recording of the shared data, true joints (T, 4) and additive torso (T, 2), deg.

    Gyro row k covers the interval from stamp k to stamp k + 1: it belongs to frame k + 1; frame 0 has none.
    """
    with np.load(file) as data:
        length = len(data["t"])
        gyro = np.vstack([np.full((1, 5, 3), np.nan), np.radians(data["gyro"])])
        recording = Recording(
            (np.arange(length) * round(float(data["ts"]) * 1e9)).astype(np.int64),
            {name: gyro[:, k] for k, name in enumerate(exoshell.GYROS)},
            {},
            hall=data["hall_V"].reshape(length, 8),
            period=np.full(length, float(data["ts"])),
        )
        return recording, data["theta"], data["phi"]


@pytest.fixture(scope="module")
def bench(shared_data: Path) -> tuple[Recording, FloatArray, FloatArray]:
    return fixed_input(shared_data / "exoshell" / "bench.npz")


@pytest.fixture(scope="module")
def table_1(shared_data: Path) -> tuple[Recording, FloatArray, FloatArray]:
    return fixed_input(shared_data / "exoshell" / "table1_like.npz")


def errors(
    estimator: Kckf | Kf | Gyro | Hall, data: tuple[Recording, FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    recording, joints, torso = data
    series = estimator.run(recording)
    assert series.torso is not None
    return rms(np.degrees(series.position) - joints), rms(np.degrees(series.torso[:, :2]) - torso)


# ------------------------------------------------------------- 3: Monte Carlo


RUNS, GROUPS = (
    200,
    5,
)  # in groups: many runs share one covariance, too many would wake the threads of the linear algebra


def monte_carlo(noise: ProcessNoise) -> dict[str, FloatArray]:
    """60 s of `RUNS` runs, scored in the second half: the constant Hall noise makes the gain the same for all of them.

    One axis, four joints, gyro noise and bias walk as in the scenario; the motion itself cancels out of the errors of a
    linear filter.
    """
    robot = exoshell.exoshell("monte-carlo")
    hall, coordinate = HallBank(robot.hall), np.repeat(np.arange(4), 2)
    start = (np.radians(10.0), np.radians(1.0), 0.0)
    used = np.ones(8, dtype=bool)
    rng = np.random.default_rng(3)
    dt, steps, runs = 0.01, 6000, RUNS // GROUPS
    squares, variances, nis, nees = [], [], [], []
    for _ in range(GROUPS):
        filter_ = CoupledFilter(hall, coordinate, noise, start, exoshell.SIGMA)
        filter_.x = np.zeros((runs, 8))
        walk = exoshell.GYRO_BIAS_WALK * np.sqrt(dt) * rng.standard_normal((steps, runs, 5))
        walk[0] = np.radians(rng.uniform(-1.0, 1.0, (runs, 5)))
        bias = np.cumsum(walk, axis=0)
        rates = np.diff(bias + exoshell.GYRO_NOISE / np.sqrt(dt) * rng.standard_normal(bias.shape), axis=2)
        readings = exoshell.SIGMA * rng.standard_normal((steps, runs, 8))
        for k in range(steps):
            filter_.step(dt if k else 0.0, rates[k], readings[k], used)
            if k < steps // 2:
                continue
            nis.append((filter_.innovations**2).sum(axis=1).mean())
            if k % 20 == 0:
                p = filter_.covariance
                error = filter_.x - np.hstack([np.zeros((runs, 4)), np.diff(bias[k], axis=1)])
                whole = np.column_stack([error[:, :4], error[:, :4].sum(axis=1)])
                squares.append((whole**2).mean(axis=0))
                variances.append(np.append(p.diagonal()[:4], p[:4, :4].sum()))
                nees.append(np.einsum("ri,ij,rj->r", error, np.linalg.inv(p), error).mean())
    return {
        "rmse": np.degrees(np.sqrt(np.mean(squares, axis=0))),
        "bound": np.degrees(np.sqrt(np.mean(variances, axis=0))),
        "nis": np.mean(nis),
        "nees": np.mean(nees),
    }


@pytest.fixture(scope="module")
def matched() -> dict[str, FloatArray]:
    return monte_carlo(ProcessNoise.physical(serial_linkage(exoshell.exoshell("monte-carlo"))))


def test_matched_noise_is_consistent(matched: dict[str, FloatArray]) -> None:
    ratio = matched["rmse"] / matched["bound"]
    assert ((ratio[:4] > 0.93) & (ratio[:4] < 1.07)).all()
    assert 0.90 < ratio[4] < 1.10
    assert matched["nis"] == pytest.approx(8.0, rel=0.005)
    assert matched["nees"] == pytest.approx(8.0, rel=0.05)


def test_the_price_of_the_paper_s_process_noise(matched: dict[str, FloatArray]) -> None:
    found = monte_carlo(ProcessNoise.of_paper(serial_linkage(exoshell.exoshell("monte-carlo"))))
    assert found["rmse"][:4] == pytest.approx(0.18, rel=0.05)
    assert found["rmse"][4] == pytest.approx(0.31, rel=0.05)
    assert (found["rmse"] / matched["bound"]).mean() == pytest.approx(2.05, rel=0.05)


# ------------------------------------------------------------- 4: bench


def test_bench_by_the_paper(bench: tuple[Recording, FloatArray, FloatArray]) -> None:
    joints, torso = errors(Kckf(exoshell.exoshell("bench"), PAPER), bench)
    assert joints == pytest.approx([0.279, 0.189, 0.176, 0.190], rel=0.02)
    assert torso == pytest.approx([0.284, 0.242], rel=0.02)


@pytest.mark.parametrize("params", [ADDITIVE, OFFSET])
def test_bench_by_default_is_better(bench: tuple[Recording, FloatArray, FloatArray], params: KckfParams) -> None:
    joints, torso = errors(Kckf(exoshell.exoshell("bench"), params), bench)
    assert (joints <= [0.279, 0.189, 0.176, 0.190]).all()
    assert (torso <= [0.284, 0.242]).all()


def test_bench_without_the_constraint(bench: tuple[Recording, FloatArray, FloatArray]) -> None:
    _, torso = errors(Kf(exoshell.exoshell("bench"), Kf.Params(kinematics="additive")), bench)
    assert torso == pytest.approx([19.72, 33.13], abs=0.01)


# ------------------------------------------------------------- 5: like Table 1


def test_table_1_by_the_paper(table_1: tuple[Recording, FloatArray, FloatArray]) -> None:
    robot = exoshell.exoshell("table1")
    joints, _ = errors(Kckf(robot, PAPER), table_1)
    assert ((joints[[0, 1, 3]] > 5.0) & (joints[[0, 1, 3]] < 6.5)).all()
    assert joints[2] == pytest.approx(3.4, abs=0.1)
    single = [errors(Hall(robot, HallParams(sensor=k, kinematics="additive")), table_1)[0] for k in (1, 2)]
    assert single[0] == pytest.approx([20.96, 14.74, 6.62, 12.13], rel=0.01)  # Table 1 itself
    assert single[1] == pytest.approx([14.33, 10.06, 6.04, 7.44], rel=0.01)


@pytest.mark.parametrize("noise", [None, 0.020, 0.0345])
def test_table_1_with_voltages_taken_for_what_they_are(
    table_1: tuple[Recording, FloatArray, FloatArray], noise: float | None
) -> None:
    """Whether the filter knows the true noise of each sensor or only the data sheet's."""
    robot = exoshell.exoshell("table1")
    if noise is not None:
        robot = replace(robot, hall=tuple(replace(sensor, noise=noise) for sensor in robot.hall))
    joints, _ = errors(Kckf(robot, ADDITIVE), table_1)
    assert (joints <= 1.4).all()
    joints, torso = errors(Kckf(robot, OFFSET), table_1)
    assert (joints <= 0.15).all()
    assert (torso <= 0.2).all()


# ------------------------------------------------------------- 6: clipped and offset sensors


def test_clipped_sensors() -> None:
    squares, nees = [], []
    for seed in range(40):
        made = exoshell.simulate("clipped", seed=seed)
        series = Kckf(made.robot, ADDITIVE).run(made.recording)
        error = (series.position - made.truth_position)[2000:]
        squares.append((np.degrees(error) ** 2).mean(axis=0))
        nees.append((error**2 / series.variance[2000:]).mean(axis=0))
    assert (rms(np.sqrt(squares)) <= 1.15 * BOUND).all()
    assert ((np.mean(nees, axis=0) > 0.8) & (np.mean(nees, axis=0) < 1.25)).all()


def test_offset_sensors() -> None:
    squares = []
    for seed in range(4):
        made = exoshell.simulate("offset", seed=seed)
        series = Kckf(made.robot, OFFSET).run(made.recording)
        squares.append((np.degrees(series.position - made.truth_position)[2000:] ** 2).mean(axis=0))
    assert (rms(np.sqrt(squares)) <= 0.05).all()


# ------------------------------------------------------------- 8, 9: an hour


def held(
    seconds: float, rate_hz: float, hall_errors: FloatArray, dtype: type = np.float64
) -> tuple[CoupledFilter, FloatArray]:
    """The filter after `seconds` in the posture of the scenario `drift`, default noise, and its torso errors."""
    robot = exoshell.exoshell("drift")
    linkage = serial_linkage(robot)
    start = (np.radians(10.0), np.radians(1.0), 0.0)
    noise = ProcessNoise.physical(linkage)
    filter_ = CoupledFilter(HallBank(robot.hall), np.repeat(np.arange(4), 2), noise, start, exoshell.SIGMA, dtype=dtype)
    rng = np.random.default_rng(5)
    dt, steps = 1.0 / rate_hz, round(seconds * rate_hz)
    biases = np.radians([0.10, -0.06, 0.12, -0.02, 0.2528])
    posture = np.radians([20.0, -12.0, 8.0, 15.0])
    used, torso = np.ones(8, dtype=bool), np.empty(steps)
    for first in range(0, steps, 10_000):
        count = min(10_000, steps - first)
        gyro = biases + exoshell.GYRO_NOISE / np.sqrt(dt) * rng.standard_normal((count, 5))
        readings = np.repeat(posture + np.radians(hall_errors), 2) + exoshell.SIGMA * rng.standard_normal((count, 8))
        for k, (rates, angles) in enumerate(zip(np.diff(gyro, axis=1), readings, strict=True), start=first):
            filter_.step(dt if k else 0.0, rates, angles, used)
            torso[k] = filter_.x[:4].sum()
    return filter_, np.degrees(torso - posture.sum())


def test_an_hour_without_constraint_drifts_550_degrees() -> None:
    made = exoshell.simulate("drift", duration_s=3600.0, rate_hz=10.0)
    series = Kf(made.robot, Kf.Params(kinematics="additive")).run(made.recording)
    assert series.torso is not None
    assert np.degrees(series.torso - made.truth_torso)[-1, 0] == pytest.approx(550.0, abs=3.0)


def test_an_hour_with_the_constraint_does_not_drift() -> None:
    _, torso = held(3600.0, 100.0, np.zeros(4))
    assert np.abs(torso[6000:]).max() <= 1.3
    hours = np.arange(len(torso)) / 360_000
    assert abs(np.polyfit(hours[6000:], torso[6000:], 1)[0]) < 0.15


def test_calibration_errors_of_the_hall_sensors_add_up_in_the_torso() -> None:
    _, torso = held(300.0, 100.0, np.array([4.0, -2.0, 3.0, 2.0]))
    assert torso[6000:].mean() == pytest.approx(7.0, abs=0.1)


def test_covariance_stays_sound_at_1_khz_in_both_precisions() -> None:
    double, _ = held(20.0, 1000.0, np.zeros(4))
    single, _ = held(20.0, 1000.0, np.zeros(4), np.float32)
    for filter_ in (double, single):
        p = filter_.covariance
        assert (p == p.T).all()
        assert np.linalg.eigvalsh(p.astype(float)).min() > 0.0
    assert single.covariance.dtype == np.float32
    assert np.sqrt(single.covariance.diagonal()) == pytest.approx(np.sqrt(double.covariance.diagonal()), rel=0.01)
