"""Figures to reach by the paper's filters: section 4 of the specification, item 2, and of 8 to 10 what is theirs.

A ratio is the error over the Cramer-Rao bound that section 3 of the specification prints (deg/s, deg/s, deg).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from accel_bounds import FILTER
from accel_printed import Printed

from jointest_ros.core.accel.paper.linearise import Linearise, linearise_ekf, ukf
from jointest_ros.core.accel.paper.model import PaperModel, PaperNoise, link_noise, link_reading, relative_vector
from jointest_ros.core.accel.paper.trials import DECORRELATED, PRINTED, TRAPEZOID, run_filter
from jointest_ros.core.frame import FloatArray
from jointest_ros.sim import slider_crank
from jointest_ros.sim.slider_crank import SCENARIOS, CrankMotion, row

TRIALS = 100


def wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def rms_deg(error: FloatArray, axis: int | tuple[int, ...] = (0, 1)) -> FloatArray:
    return np.asarray(np.degrees(np.sqrt((error**2).mean(axis=axis))))


def near_truth(motion: CrankMotion) -> FloatArray:
    return np.asarray(motion.state[0] + 0.1 * np.random.default_rng(7).standard_normal(3))


class Scenario:
    """Trials of a scenario as readings."""

    def __init__(self, name: str, length: float = 0.3, trials: int = TRIALS) -> None:
        self.key, self.sigma = (name, length), SCENARIOS[name].sigma
        self.motion = slider_crank.motion(name, length)
        self.channels = self.motion.trials(self.sigma, range(trials))
        self.model = PaperModel.of(self.motion.positions_a, self.motion.positions_b, self.sigma**2, self.sigma**2)
        self.readings = self.channels @ self.model.reading.T

    def error(self, state: FloatArray) -> FloatArray:
        error = state - self.motion.state
        error[..., 2] = wrapped(error[..., 2])
        return error[:, 100:]

    def ratios(self, form: str, linearise: Linearise = linearise_ekf) -> tuple[FloatArray, FloatArray]:
        """(error over bound, normalised estimation error squared) of each state."""
        start, p0 = near_truth(self.motion), 0.01 * np.eye(3)
        run = run_filter(self.readings, self.model.noise, slider_crank.PERIOD, start, p0, form, linearise)
        error = self.error(run.state)
        return rms_deg(error) / FILTER[self.key], (error**2 / run.variance[:, 100:]).mean(axis=(0, 1))


@pytest.fixture(scope="module")
def table_2() -> dict[float, Scenario]:
    return {length: Scenario("T2", length) for length in (0.3, 0.2, 0.1)}


# ------------------------------------------------------------- 2: errata


@pytest.mark.parametrize(
    ("length", "allowed"), [(0.3, (1.40, 1.25, 1.30)), (0.2, (1.40, 1.25, 1.30)), (0.1, (1.45, 1.25, 1.45))]
)
def test_paper_ekf_without_decorrelation(
    table_2: dict[float, Scenario], length: float, allowed: tuple[float, float, float]
) -> None:
    ratios, _ = table_2[length].ratios(PRINTED)
    assert (ratios <= np.array(allowed) * 1.03).all()  # 3 %: what 100 trials scatter


@pytest.mark.parametrize("length", [0.3, 0.2, 0.1])
def test_decorrelation_helps(table_2: dict[float, Scenario], length: float) -> None:
    without, _ = table_2[length].ratios(PRINTED)
    ratios, _ = table_2[length].ratios(DECORRELATED)
    assert ratios[0] <= 1.10
    assert ratios[0] <= 0.85 * without[0]


def test_one_sign_mended_alone_is_noticed(table_2: dict[float, Scenario]) -> None:
    """(10) and (20) with only one of their two wrong signs mended: nobody shall bring that in unseen."""
    one = table_2[0.3]
    starts = np.tile(near_truth(one.motion), (TRIALS, 1))
    places, q = (one.motion.positions_a, one.motion.positions_b), one.sigma**2 * np.eye(8)
    half = Printed(*places, q, decorrelated=True, sign=-1.0).ekf(one.channels, starts, 0.01 * np.eye(3))[0]
    assert rms_deg(one.error(half))[0] / FILTER[one.key][0] >= 1.8


# ------------------------------------------------------------- production form


@pytest.mark.parametrize("name", ["B", "C", "D", "G", "F"])
def test_trapezoid_reaches_the_bound(name: str) -> None:
    ratios, nees = Scenario(name, trials=50).ratios(TRAPEZOID)
    assert (ratios <= 1.10).all()
    assert ((nees > 0.75) & (nees < 1.35)).all()


def test_euler_lags_in_a_fast_motion() -> None:
    """Why production does without it: section 1, item 3."""
    assert (Scenario("F", trials=10).ratios(DECORRELATED)[0] > 12.0).all()


@pytest.mark.parametrize(("length", "allowed"), [(0.3, 1.12), (0.2, 1.17), (0.1, 1.40)])
def test_trapezoid_where_the_force_at_the_joint_is_weak(
    table_2: dict[float, Scenario], length: float, allowed: float
) -> None:
    """o_b stands in H with its noise: what the joint model has ahead of this one."""
    assert (table_2[length].ratios(TRAPEZOID)[0] <= allowed).all()


@pytest.mark.parametrize("form", [PRINTED, DECORRELATED, TRAPEZOID])
@pytest.mark.parametrize("name", ["T2", "B", "G"])
def test_ukf_equals_ekf(name: str, form: str) -> None:
    one = Scenario(name, trials=50)
    ekf, unscented = one.ratios(form)[0], one.ratios(form, ukf())[0]
    assert unscented == pytest.approx(ekf, rel=0.03)


# ------------------------------------------------------------- 8: analytical


@pytest.mark.parametrize(
    ("name", "length", "expected"),
    [("T2", 0.3, 9.05), ("T2", 0.2, 13.7), ("T2", 0.1, 29.7), ("B", 0.3, 2.74), ("G", 0.3, 0.367)],
)
def test_analytical_angle(name: str, length: float, expected: float) -> None:
    one = Scenario(name, length)
    assert rms_deg(wrapped(analytical(one.readings) - one.motion.state[:, 2])[:, 100:]) == pytest.approx(
        expected, rel=0.03
    )


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_analytical_angle_is_exact_without_noise(name: str) -> None:
    motion = slider_crank.motion(name)
    model = PaperModel.of(motion.positions_a, motion.positions_b, 1.0, 1.0)
    error = wrapped(analytical(motion.channels @ model.reading.T) - motion.state[:, 2])
    strong = np.linalg.norm(motion.joint_acceleration, axis=1) > 1e-3
    assert np.abs(error[strong]).max() < 1e-9


def analytical(readings: FloatArray) -> FloatArray:
    rows = np.moveaxis(readings, -1, 0)
    return np.arctan2(*relative_vector(rows[2:4], rows[6:8]))


# ------------------------------------------------------------- 9: placement


def sweep(
    scenario: str | slider_crank.CrankScenario, places: list[tuple[FloatArray, FloatArray]], form: str, trials: int
) -> tuple[FloatArray, FloatArray]:
    """RMSE of the angle (filter, analytical), deg, for placements of the sensors; motion and noise of B."""
    sigma = SCENARIOS["B"].sigma
    motions = [slider_crank.motion(scenario, positions=one) for one in places]
    models = [PaperModel.of(*one, sigma**2, sigma**2) for one in places]
    readings = np.concatenate(
        [one.trials(sigma, range(trials)) @ model.reading.T for one, model in zip(motions, models, strict=True)]
    )
    links = [
        np.repeat([link_noise(link_reading(one[link]), sigma**2) for one in places], trials, axis=0) for link in (0, 1)
    ]
    start, truth = near_truth(motions[0]), motions[0].state
    run = run_filter(readings, PaperNoise.of(*links), slider_crank.PERIOD, start, 0.01 * np.eye(3), form)
    errors = run.state[..., 2] - truth[:, 2], analytical(readings) - truth[:, 2]
    filtered, raw = (rms_deg(wrapped(e)[:, 100:].reshape(len(places), -1), axis=1) for e in errors)
    return filtered, raw


FIG_5 = replace(SCENARIOS["B"], lengths=(0.2, 0.25))


def ends(mean: float, span: float, each: int) -> FloatArray:
    return np.concatenate([row(mean - span / 2, 0.0, each), row(mean + span / 2, 0.0, each)])


def test_more_sensors_gain_a_third() -> None:
    places = [row(0.1, 0.1), row(0.1, 0.1, 10), ends(0.1, 0.1, 5)]
    two, ten, at_ends = range(3)
    printed, raw = sweep(FIG_5, [(one, one) for one in places], PRINTED, 200)
    best, _ = sweep(FIG_5, [(one, one) for one in places], TRAPEZOID, 200)
    assert 1 - printed[ten] / printed[two] == pytest.approx(0.31, abs=0.04)
    assert 1 - raw[ten] / raw[two] == pytest.approx(0.35, abs=0.03)
    assert 1 - best[ten] / best[two] == pytest.approx(0.38, abs=0.03)  # as the bound
    assert 1 - best[at_ends] / best[ten] == pytest.approx(0.27, abs=0.03)


def test_error_of_the_paper_s_filter_over_placement() -> None:
    spans = np.array([0.05, 0.075, 0.1, 0.15, 0.2])
    means = (0.2, 0.4)
    places = [(row(0.1, 0.1), row(mean, span)) for mean in means for span in spans]
    found = sweep("P", places, PRINTED, 40)[0].reshape(len(means), len(spans))
    for errors in found:
        assert np.corrcoef(1.0 / spans, errors)[0, 1] ** 2 >= 0.99
    assert (found[1] > found[0]).all()


# ------------------------------------------------------------- 10: Table II

PAPER_TABLE_2 = {0.3: (9.04, 0.71, 0.69, 0.97), 0.2: (13.69, 1.79, 1.10, 1.55), 0.1: (41.42, 3.12, 2.21, 3.11)}
MEDIANS = {0.3: (8.87, 0.97, 0.64, 0.96), 0.2: (13.4, 1.49, 0.95, 1.44), 0.1: (40.2, 3.41, 1.96, 2.98)}


@pytest.mark.parametrize("length", [0.3, 0.2, 0.1])
def test_table_2_lies_in_our_band(length: float) -> None:
    """Analytical (its wraps counted as errors, as in the paper) and EKF th, w_a, w_b."""
    one = Scenario("T2", length, 1000)
    run = run_filter(one.readings, one.model.noise, slider_crank.PERIOD, one.motion.state[0], np.eye(3), PRINTED)
    raw = rms_deg(analytical(one.readings) - one.motion.state[:, 2], axis=1)
    w_a, w_b, angle = rms_deg(run.state - one.motion.state, axis=1).T
    for ours, paper, median in zip((raw, angle, w_a, w_b), PAPER_TABLE_2[length], MEDIANS[length], strict=True):
        low, middle, high = np.percentile(ours, [5, 50, 95])
        assert low <= paper <= high
        assert middle == pytest.approx(median, rel=0.04)
