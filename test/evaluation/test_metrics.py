"""The figures of `jointest evaluate`, against numbers made by hand and by plain numpy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import Series, Status
from jointest_ros.core.torso import TorsoChain
from jointest_ros.evaluation.metrics import errors, has_figures, inclination_deg, joint_error, summarize
from jointest_ros.evaluation.truth import Truth

MS = 1_000_000
JOINTS = ("one", "two")


def series(
    stamps: np.ndarray,
    position: np.ndarray,
    status: np.ndarray | int = 0,
    orientation: dict[str, np.ndarray] | None = None,
) -> Series:
    """Estimates with a velocity of 1 rad/s."""
    shape = position.shape
    return Series(
        stamps, position, np.ones(shape), np.zeros(shape), np.zeros(shape, dtype=np.int64) + status,
        orientation=orientation or {},
    )  # fmt: skip


def at(count: int, period_ms: float = 10.0, start_ms: float = 0.0) -> np.ndarray:
    return np.round((start_ms + np.arange(count) * period_ms) * MS).astype(np.int64)


def truth_of(stamps: np.ndarray, *positions: np.ndarray) -> Truth:
    return Truth(stamps, dict(zip(JOINTS, positions, strict=False)), {"two": np.zeros(len(stamps))})


def test_figures_by_hand() -> None:
    """Errors of 3, -4 and 1 deg out of four truth samples."""
    figures = summarize(np.array([3.0, -4.0, 1.0]), 4)
    assert figures == {
        "rmse_deg": pytest.approx(math.sqrt(26.0 / 3.0)),
        "bias_deg": pytest.approx(0.0),
        "std_deg": pytest.approx(math.sqrt(26.0 / 3.0)),
        "max_abs_deg": 4.0,
        "samples": 3,
        "coverage": 0.75,
    }


def test_figures_without_a_sample() -> None:
    nothing = {"rmse_deg": None, "bias_deg": None, "std_deg": None, "max_abs_deg": None, "samples": 0, "coverage": 0.0}
    assert summarize(np.empty(0), 5) == nothing
    assert summarize(np.empty(0), 0) == nothing


def test_errors_of_joints_and_velocities() -> None:
    """Nothing is fitted or removed: an offset stays, in rmse and in bias."""
    generator = np.random.default_rng(1)
    position = generator.normal(size=(50, 2))
    truth = truth_of(at(50), position[:, 0] - math.radians(2.0), position[:, 1] + generator.normal(size=50))
    table = errors(series(at(50), position), JOINTS, truth)
    assert table["joints"]["one"] == {
        "rmse_deg": pytest.approx(2.0),
        "bias_deg": pytest.approx(2.0),
        "std_deg": pytest.approx(0.0, abs=1e-12),
        "max_abs_deg": pytest.approx(2.0),
        "samples": 50,
        "coverage": 1.0,
    }
    difference = np.degrees(position[:, 1] - truth.position["two"])
    two = table["joints"]["two"]
    assert two["rmse_deg"] == pytest.approx(np.sqrt((difference**2).mean()))
    assert two["bias_deg"] == pytest.approx(difference.mean())
    assert two["std_deg"] == pytest.approx(difference.std())
    assert two["rmse_deg"] ** 2 == pytest.approx(two["bias_deg"] ** 2 + two["std_deg"] ** 2)
    assert two["max_abs_deg"] == pytest.approx(abs(difference).max())
    assert list(table["velocities"]) == ["two"]  # the truth says nothing of the velocity of the other
    assert table["velocities"]["two"]["rmse_deg"] == pytest.approx(math.degrees(1.0))
    assert (table["torso"], table["orientation"], table["nis"], table["nees"]) == ({}, {}, None, None)
    assert has_figures(table)


def test_what_counts_as_covered() -> None:
    """Estimates at half the rate of the truth cover half of it."""
    truth = truth_of(at(100), np.zeros(100))
    half = errors(series(at(50, 20.0), np.zeros((50, 1))), ("one",), truth)["joints"]["one"]
    assert (half["samples"], half["coverage"]) == (50, 0.5)
    late = errors(series(at(60, 10.0, 400.0), np.zeros((60, 1))), ("one",), truth)["joints"]["one"]
    assert (late["samples"], late["coverage"]) == (60, 0.6)
    none = errors(series(at(10, 10.0, 5000.0), np.zeros((10, 1))), ("one",), truth)
    assert (none["joints"]["one"]["samples"], none["joints"]["one"]["rmse_deg"]) == (0, None)
    assert not has_figures(none)


def test_skip_counts_from_the_first_truth_sample() -> None:
    error = np.where(np.arange(100) < 30, 1.0, 0.01)
    truth = truth_of(at(100, 10.0, 7000.0), np.zeros(100))
    estimates = series(at(100, 10.0, 7000.0), error[:, None])
    figures = errors(estimates, ("one",), truth, 0.3)["joints"]["one"]
    assert (figures["samples"], figures["coverage"]) == (70, 1.0)
    assert figures["rmse_deg"] == pytest.approx(math.degrees(0.01))
    assert errors(estimates, ("one",), truth, 0.29)["joints"]["one"]["samples"] == 71
    for beyond in (1.0, 1e300):
        assert errors(estimates, ("one",), truth, beyond)["joints"] == {}


@pytest.mark.parametrize("flag", [Status.STARTING, Status.STALE, Status.STALE | Status.NO_DATA])
def test_what_is_not_published_is_not_judged(flag: Status) -> None:
    status = np.zeros((100, 2), dtype=np.int64)
    status[:40, 0] = int(flag)
    position = np.where(status > 0, 99.0, 0.0)
    table = errors(series(at(100), position, status), JOINTS, truth_of(at(100), np.zeros(100), np.zeros(100)))
    assert table["joints"]["one"]["max_abs_deg"] == 0.0
    assert (table["joints"]["one"]["coverage"], table["joints"]["two"]["coverage"]) == (0.6, 1.0)


@pytest.mark.parametrize("flag", [Status.NO_DATA, Status.GAP, Status.UNOBSERVABLE, Status.DISTURBED])
def test_what_is_published_with_a_warning_is_judged(flag: Status) -> None:
    table = errors(series(at(10), np.zeros((10, 1)), int(flag)), ("one",), truth_of(at(10), np.zeros(10)))
    assert table["joints"]["one"]["coverage"] == 1.0


def test_an_estimate_that_is_no_number_counts_as_missing() -> None:
    position = np.zeros((10, 1))
    position[3:5] = (math.nan,), (math.inf,)
    table = errors(series(at(10), position), ("one",), truth_of(at(10), np.zeros(10)))
    assert (table["joints"]["one"]["rmse_deg"], table["joints"]["one"]["coverage"]) == (0.0, 0.8)


def test_a_truth_that_knows_a_joint_at_times_only() -> None:
    """Two sources of truth on one topic, each with a joint of its own, take turns."""
    known = np.arange(20) % 2 == 0
    truth = truth_of(at(20), np.where(known, 0.1, math.nan), np.where(known, math.nan, 0.2))
    table = errors(series(at(20), np.zeros((20, 2))), JOINTS, truth)["joints"]
    assert [table[joint]["samples"] for joint in JOINTS] == [10, 10]
    assert [table[joint]["coverage"] for joint in JOINTS] == [1.0, 1.0]
    assert table["two"]["bias_deg"] == pytest.approx(math.degrees(-0.2))


def test_a_joint_without_any_truth_is_left_out() -> None:
    table = errors(series(at(9), np.zeros((9, 2))), JOINTS, truth_of(at(9), np.zeros(9), np.full(9, math.nan)))
    assert list(table["joints"]) == ["one"]


def test_only_continuous_joints_are_wrapped() -> None:
    position = np.radians([[179.0, 179.0]])
    truth = truth_of(at(1), np.radians([-179.0]), np.radians([-179.0]))
    table = errors(series(at(1), position), JOINTS, truth, continuous={"two"})["joints"]
    assert table["one"]["rmse_deg"] == pytest.approx(358.0)
    assert table["two"]["bias_deg"] == pytest.approx(-2.0)


def test_rows_and_stamps_of_what_was_matched() -> None:
    status = np.zeros((6, 1), dtype=np.int64)
    status[0] = int(Status.STARTING)
    error = joint_error(
        series(at(6, 10.0, 2.0), np.arange(6.0)[:, None], status), 0, truth_of(at(5), np.zeros(5)), "one"
    )
    assert error is not None
    assert error.rows.tolist() == [1, 2, 3, 4]
    assert error.stamps.tolist() == at(4, 10.0, 10.0).tolist()
    assert error.degrees == pytest.approx(np.degrees([1.0, 2.0, 3.0, 4.0]))
    assert error.expected == 5


def test_nees_is_the_mean_square_of_the_error_over_its_reported_deviation() -> None:
    generator = np.random.default_rng(2)
    sigma = np.tile([0.1, 0.4], (500, 1))
    sigma[:250] = 0.0  # nothing is reported: left out
    estimates = series(at(500), sigma * generator.normal(size=(500, 2)))
    estimates.variance[:] = sigma**2
    truth = truth_of(at(500), np.zeros(500), np.zeros(500))
    expected = np.mean((estimates.position[250:] / sigma[250:]) ** 2)
    assert errors(estimates, JOINTS, truth)["nees"] == pytest.approx(expected)
    assert expected == pytest.approx(1.0, abs=0.2)
    estimates.variance[:] *= 4.0
    assert errors(estimates, JOINTS, truth)["nees"] == pytest.approx(expected / 4.0)
    assert errors(series(at(500), np.zeros((500, 2))), JOINTS, truth)["nees"] is None


# -------------------------------------------------------------------- torso

CHAIN = TorsoChain("base", JOINTS, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), composed=True)


def with_torso(position: np.ndarray, turn: Rotation, status: np.ndarray | int = 0) -> Series:
    """Estimates whose torso is the true one of `position`, then turned by `turn`."""
    torso = Rotation.from_euler("XY", position) * turn
    estimates = series(at(len(position)), position, status)
    estimates.torso, estimates.torso_orientation = torso.as_rotvec(), torso.as_quat()
    return estimates


def test_torso_errors_are_those_of_the_last_link_in_the_first() -> None:
    position = np.random.default_rng(4).uniform(-0.5, 0.5, size=(40, 2))
    truth = truth_of(at(40), *position.T)
    turn = Rotation.from_rotvec([0.0, 0.0, math.radians(3.0)])
    table = errors(with_torso(position, turn), JOINTS, truth, 0.1, chain=CHAIN)["torso"]
    assert list(table) == ["x", "y", "z", "geodesic"]
    assert table["geodesic"]["rmse_deg"] == pytest.approx(3.0)
    assert (table["geodesic"]["samples"], table["geodesic"]["coverage"]) == (30, 1.0)
    true = Rotation.from_euler("XY", position)
    difference = np.degrees((true * turn).as_rotvec() - true.as_rotvec())[10:]
    for column, name in enumerate("xyz"):
        assert table[name]["rmse_deg"] == pytest.approx(np.sqrt(np.mean(difference[:, column] ** 2)))
        assert table[name]["bias_deg"] == pytest.approx(difference[:, column].mean())
    exact = errors(with_torso(position, Rotation.identity()), JOINTS, truth, chain=CHAIN)["torso"]
    assert exact["geodesic"]["max_abs_deg"] == pytest.approx(0.0, abs=1e-5)


def test_additive_torso_errors_are_sums_of_angles() -> None:
    chain = TorsoChain("base", JOINTS, ((1.0, 0.0, 0.0), (1.0, 0.0, 0.0)), composed=False)
    position = np.full((5, 2), 0.2)
    estimates = series(at(5), position)
    estimates.torso = np.tile([0.5, 0.0, 0.0], (5, 1))
    estimates.torso_orientation = Rotation.from_rotvec(estimates.torso).as_quat()
    table = errors(estimates, JOINTS, truth_of(at(5), *position.T), chain=chain)["torso"]
    assert table["x"]["bias_deg"] == pytest.approx(math.degrees(0.1))
    assert table["geodesic"]["rmse_deg"] == pytest.approx(math.degrees(0.1))


def test_the_torso_needs_the_truth_and_an_estimate_of_every_joint() -> None:
    position = np.zeros((20, 2))
    status = np.zeros((20, 2), dtype=np.int64)
    status[:5, 1] = int(Status.STALE)
    second = np.where(np.arange(20) < 8, math.nan, 0.0)
    table = errors(
        with_torso(position, Rotation.identity(), status), JOINTS, truth_of(at(20), np.zeros(20), second), chain=CHAIN
    )["torso"]
    assert (table["x"]["samples"], table["x"]["coverage"]) == (12, 1.0)
    table = errors(
        with_torso(position, Rotation.identity(), status), JOINTS, truth_of(at(20), *position.T), chain=CHAIN
    )["torso"]
    assert (table["x"]["samples"], table["x"]["coverage"]) == (15, 0.75)
    assert errors(series(at(20), position), JOINTS, truth_of(at(20), *position.T), chain=CHAIN)["torso"] == {}
    one = with_torso(position, Rotation.identity())
    assert errors(one, JOINTS, truth_of(at(20), np.zeros(20)), chain=CHAIN)["torso"] == {}


# -------------------------------------------------------------------- inclination


def test_inclination_is_the_angle_between_the_verticals() -> None:
    tilt = Rotation.from_euler("x", 12.0, degrees=True)
    truth = Rotation.random(20, random_state=3)
    assert inclination_deg((tilt * truth).as_quat(), truth.as_quat()) == pytest.approx(np.full(20, 12.0))
    # independent: heading, any turn about the vertical
    turned = Rotation.from_rotvec(np.outer(np.linspace(-3.0, 3.0, 20), [0.0, 0.0, 1.0])) * truth
    assert inclination_deg(turned.as_quat(), truth.as_quat()) == pytest.approx(np.zeros(20), abs=1e-6)
    # independent of the sign of the quaternion, and exact for upside down and for tiny angles
    assert inclination_deg(-truth.as_quat(), truth.as_quat()) == pytest.approx(np.zeros(20), abs=1e-6)
    for degrees in (180.0, 90.0, 1e-6):
        tilt = Rotation.from_euler("y", degrees, degrees=True)
        assert inclination_deg((tilt * truth).as_quat(), truth.as_quat()) == pytest.approx(np.full(20, degrees))


def test_inclination_errors_of_sensors() -> None:
    up, tilted = [0.0, 0.0, 0.0, 1.0], Rotation.from_euler("x", 3.0, degrees=True).as_quat().tolist()
    estimates = np.array([up, up, [math.nan] * 4, up])
    truth = Truth(orientation={"imu": (at(4), np.array([tilted] * 4)), "other": (at(4), np.array([up] * 4))})
    table = errors(series(at(4), np.empty((4, 0)), orientation={"imu": estimates}), (), truth, 0.01)
    assert table["joints"] == {}
    assert table["orientation"] == {
        "imu": {
            "inclination": {
                "rmse_deg": pytest.approx(3.0),
                "bias_deg": pytest.approx(3.0),
                "std_deg": pytest.approx(0.0, abs=1e-6),
                "max_abs_deg": pytest.approx(3.0),
                "samples": 2,
                "coverage": pytest.approx(2 / 3),
            }
        }
    }
    assert has_figures(table)


def test_an_orientation_that_never_matches() -> None:
    up = np.array([[0.0, 0.0, 0.0, 1.0]] * 3)
    truth = Truth(orientation={"imu": (at(3), up), "silent": (at(0), up[:0])})
    orientation = {"imu": up, "silent": up}
    table = errors(series(at(3, 10.0, 900.0), np.empty((3, 0)), orientation=orientation), (), truth)
    assert [table["orientation"][name]["inclination"]["samples"] for name in ("imu", "silent")] == [0, 0]
    assert not has_figures(table)
