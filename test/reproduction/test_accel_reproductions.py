"""Figures of the accelerometer paper that are computed anew: specification accel_array.md, section 4, items 8 to 10."""

from __future__ import annotations

import numpy as np
import pytest

from jointest_ros.reproduction import accel_count, accel_placement, accel_table2, accel_table3
from jointest_ros.reproduction import accel_trials as trials
from jointest_ros.reproduction.accel_trials import ANALYTICAL, BOUND, JOINT_EKF, PRINTED_EKF, SMOOTHED
from jointest_ros.sim.slider_crank import SCENARIOS, motion


@pytest.mark.parametrize(
    ("scenario", "length", "expected"),
    [("T2", 0.3, 9.05), ("T2", 0.2, 13.7), ("T2", 0.1, 29.7), ("B", 0.3, 2.74), ("G", 0.3, 0.367)],
)
def test_the_analytical_angle_without_whole_turns(scenario: str, length: float, expected: float) -> None:
    one = trials.case(motion(scenario, length), SCENARIOS[scenario].sigma, range(40))
    errors = trials.wrapped(trials.analytical(one.readings) - one.motion.state[:, 2])
    assert trials.rmse_deg(errors[:, trials.SETTLED :], axis=(0, 1)) == pytest.approx(expected, rel=0.03)


@pytest.fixture(scope="module")
def table2() -> accel_table2.Distributions:
    """1000 trials of every entry but the UKF's."""
    found = {}
    for length in accel_table2.LENGTHS_CM:
        one = trials.case(motion("T2", length / 100.0), SCENARIOS["T2"].sigma, range(1000))
        values = accel_table2.distributions(one, methods=(PRINTED_EKF,))
        found |= {(*key, length): errors for key, errors in values.items()}
    return found


@pytest.mark.parametrize(
    ("state", "method", "expected"),
    [
        ("θ", ANALYTICAL, (8.87, 13.4, 40.2)),
        ("θ", SMOOTHED, (1.77, 2.69, 9.88)),
        ("θ", PRINTED_EKF, (0.97, 1.49, 3.41)),
        ("ω_a", PRINTED_EKF, (0.64, 0.95, 1.96)),
        ("ω_b", PRINTED_EKF, (0.96, 1.44, 2.98)),
    ],
)
def test_table_2_lies_in_our_distributions(
    table2: accel_table2.Distributions, state: str, method: str, expected: tuple[float, ...]
) -> None:
    printed = accel_table2.PAPER[state, method]
    for length, entry, median in zip(accel_table2.LENGTHS_CM, printed, expected, strict=True):
        low, middle, high = np.percentile(table2[state, method, length], accel_table2.BAND)
        assert low <= entry <= high
        assert middle == pytest.approx(median, rel=0.05)


def test_our_filter_is_near_the_bound_where_the_printed_one_is_not() -> None:
    one = trials.case(motion("T2"), SCENARIOS["T2"].sigma, range(40))
    limit = trials.bounds([one.motion], one.sigma)[0]
    np.testing.assert_allclose(limit, (0.530, 0.829, 0.858), rtol=0.005)
    best, printed = (accel_table2.settled(one, method) / limit for method in (JOINT_EKF, PRINTED_EKF))
    assert (best < 1.15).all()  # 40 trials scatter by 5 %
    assert (best < printed).all()


def test_more_accelerometers_gain_a_third_and_two_groups_at_the_ends_more() -> None:
    found = accel_count.angles([(2, 2), (10, 10), accel_count.ENDS], range(60))
    gain = {method: 100.0 * (1.0 - values[1] / values[0]) for method, values in found.items()}
    assert gain[PRINTED_EKF] == pytest.approx(31.0, abs=3.0)
    assert gain[ANALYTICAL] == pytest.approx(35.0, abs=1.5)
    assert gain[BOUND] == pytest.approx(38.0, abs=0.5)
    assert 1.0 - found[BOUND][2] / found[BOUND][1] == pytest.approx(0.27, abs=0.01)


def test_the_error_of_the_papers_filter_is_linear_in_one_over_the_span_and_grows_with_the_distance() -> None:
    placements = [(mean, span) for mean in (0.2, 0.4) for span in accel_placement.SPANS_B]
    motions = [accel_placement.placed(*one) for one in placements]
    found = trials.sweep(motions, accel_placement.SCENARIO.sigma, range(20))
    near, far = found[PRINTED_EKF].reshape(2, -1)
    assert accel_placement.straightness(near) >= 0.99
    assert accel_placement.straightness(far) >= 0.99
    assert (far > near).all()


def test_the_error_of_the_best_filter_falls_with_the_distance() -> None:
    means = 0.2, 0.6, 1.0
    limits = trials.bounds([accel_placement.placed(mean, 0.1) for mean in means], accel_placement.SCENARIO.sigma)
    np.testing.assert_allclose(limits[:, 2], (0.64, 0.61, 0.56), atol=0.006)
    ours = [accel_placement.joint_angle(mean, range(20)) for mean in means]
    np.testing.assert_allclose(ours, limits[:, 2], rtol=0.1)
    assert ours[0] > ours[1] > ours[2]


def test_a_sweep_gives_what_each_placement_gives_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trials, "BLOCK", 11)
    places = [(2, number) for number in (2, 3, 5)]
    sigma, seeds = accel_count.SCENARIO.sigma, range(5)
    blocks = trials.blocks(places, len(seeds))
    assert blocks == [((2, 2), (2, 3)), ((2, 5),)]
    together = trials.joined(accel_count.angles(block, seeds) for block in blocks)
    motions = [accel_count.placed(one) for one in places]
    for number, one in enumerate(motions):
        case = trials.case(one, sigma, seeds)
        states = trials.paper_filter(case, PRINTED_EKF, trials.near_truth(one), trials.START_VARIANCE)
        alone = trials.settled_rmse(states, one)[2]
        assert together[PRINTED_EKF][number] == pytest.approx(alone, rel=1e-9)


def test_table_3_calibration_and_places_cost_more_than_noise() -> None:
    noise, rest = "noise and range of the data sheet alone", accel_table3.ALL
    settings = [(cause, "slow_periodic", "bno055") for cause in (noise, rest)]
    found = accel_table3.errors(settings, range(1), 10.0)
    for method in (SMOOTHED, PRINTED_EKF):
        low, high = (found[(*setting, method)].max() for setting in settings)
        assert low < 0.3 < high < 6.0
    assert set(found) == {(*setting, method) for setting in settings for method in accel_table3.METHODS}
