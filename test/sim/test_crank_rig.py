"""The slider-crank as a recording: its channels are those of the scenarios."""

from __future__ import annotations

import numpy as np
import pytest
from planar import table

from jointest_ros.core.accel.array import joint_arrays
from jointest_ros.sim import crank_rig
from jointest_ros.sim.crank_rig import CrankOptions, simulate
from jointest_ros.sim.simulated import SimulatedRobot, SimulationError
from jointest_ros.sim.slider_crank import SCENARIOS, motion


def channels(simulated: SimulatedRobot) -> np.ndarray:
    (arrays,) = joint_arrays(simulated.robot)
    return arrays.channels(np.stack([simulated.recording.accel[s.name] for s in arrays.sensors], axis=1))


@pytest.mark.parametrize("length", [0.3, 0.1])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_recording_is_a_trial_of_the_specification(scenario: str, length: float) -> None:
    true = motion(scenario, length)
    sigma = SCENARIOS[scenario].sigma
    recorded = simulate(scenario, length=length, seed=5)
    (trial,) = true.trials(sigma, [5])
    np.testing.assert_array_equal(channels(recorded), trial)
    (arrays,) = joint_arrays(recorded.robot)
    np.testing.assert_allclose(arrays.parent.positions, true.positions_a, atol=1e-12)
    np.testing.assert_allclose(arrays.child.positions, true.positions_b, atol=1e-12)
    np.testing.assert_array_equal(recorded.truth_position[:, 0], -true.state[:, 2])
    np.testing.assert_array_equal(recorded.truth_velocity[:, 0], true.state[:, 1] - true.state[:, 0])
    for sensor in recorded.robot.sensors:  # what an estimator makes of the density at 100 Hz
        assert sensor.accel_noise * np.sqrt(50.0) == pytest.approx(sigma)


@pytest.mark.parametrize(("scenario", "upward"), [("B", 9.81), ("G", 0.0)])
def test_gravity_is_in_the_plane_of_motion_or_across_it(scenario: str, upward: float) -> None:
    recorded = simulate(scenario, noise=0.0)
    for reading in recorded.recording.accel.values():
        np.testing.assert_array_equal(reading[:, 2], upward)


def test_noise() -> None:
    true = motion("B", samples=4000, period=1e-3)
    for factor in (0.0, 1.0, 3.0):
        recorded = simulate("B", rate_hz=1000.0, duration_s=4.0, noise=factor)
        error = channels(recorded) - true.channels
        expected = factor * SCENARIOS["B"].sigma * np.sqrt(10.0)  # the same density over ten times the bandwidth
        assert error.std() == pytest.approx(expected, rel=0.02)
        across = np.array([reading[:, 2] - 9.81 for reading in recorded.recording.accel.values()])
        assert across.std() == pytest.approx(expected, rel=0.03)
        assert all(sensor.accel_noise > 0.0 for sensor in recorded.robot.sensors)


@pytest.mark.parametrize("rate_hz", [100.0, 333.0])
def test_stretches_join_to_the_whole(rate_hz: float) -> None:
    options = {"rate_hz": rate_hz, "duration_s": 7.0, "seed": 2}
    whole, pieces = simulate("C", **options), list(crank_rig.stretches(CrankOptions(scenario="C", **options), 1.7))
    assert len(pieces) == 5
    assert np.array_equal(np.concatenate([p.recording.stamps for p in pieces]), whole.recording.stamps)
    np.testing.assert_allclose(np.vstack([table(piece) for piece in pieces]), table(whole), atol=1e-12)


def test_a_full_rotation_is_a_continuous_joint() -> None:
    recorded = simulate("C")
    assert recorded.robot.joints[0].continuous
    assert np.ptp(recorded.truth_position) > 4.0 * np.pi


@pytest.mark.parametrize(
    ("options", "named", "allowed"),
    [
        ({"scenario": "A"}, "'A'", "T2, B, C, D, G, F, P"),
        ({"length": 0.0}, "length: 0.0", "0.02 to 10 m"),
        ({"noise": -1.0}, "noise: -1.0", "0 to 100"),
        ({"rate_hz": 10.0}, "rate_hz: 10.0", "100 to 1000 Hz"),
    ],
)
def test_bad_input(options: dict[str, object], named: str, allowed: str) -> None:
    with pytest.raises(SimulationError) as caught:
        simulate(**options)
    assert named in str(caught.value) and allowed in str(caught.value)
