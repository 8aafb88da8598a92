"""Accelerometers computed on a motion: the spline gives it back, the readings are those of its positions."""

from __future__ import annotations

import numpy as np
import pytest
from planar import COARSE, LOST, along, specific_force, table

from jointest_ros.core.frame import FloatArray
from jointest_ros.sim import pendulum
from jointest_ros.sim.pendulum import PendulumOptions

PERIOD = 1e-3
TIME = PERIOD * np.arange(6001)
OMEGA = np.array([7.0, 11.0])
EXACT = {"sensor": "ideal", "calibration": "exact"}


def angles(derivative: int = 0) -> FloatArray:
    """(T, 2): swings about hanging down, as large and as fast as those of the real pendulum, or a derivative."""
    phase = TIME[:, None] * OMEGA + 0.5 * np.pi * derivative
    return np.array([0.9, 1.3]) * OMEGA**derivative * np.sin(phase) + (np.pi if derivative == 0 else 0.0)


def test_the_spline_gives_motion_and_derivatives() -> None:
    noise = 5e-5 * np.random.default_rng(1).standard_normal((len(TIME), 2))  # rad, as the encoders have it
    motion = pendulum.smooth(angles() + noise, PERIOD)
    for derivative, tolerance in ((0, 2e-5), (1, 4e-3), (2, 1.2)):
        error = motion(TIME, derivative) - angles(derivative)
        assert error[50:-50].std() < tolerance


@pytest.mark.parametrize("rate_hz", [1000.0, 250.0])
def test_readings_are_those_of_differentiated_positions(rate_hz: float) -> None:
    motion = pendulum.smooth(angles(), PERIOD)
    (recorded,) = pendulum.stretches(motion, 6.0, PendulumOptions(rate_hz=rate_hz, **EXACT))
    assert len(recorded.recording) == 6 * rate_hz + 1
    fine = np.arange(0.0, 6.0, 1e-3)
    # angles from the vertical, counted as they are seen from z; along() counts from horizontal
    first, second = (motion(fine)[:, arm] + 0.5 * np.pi for arm in range(2))
    elbow = pendulum.LENGTHS[0] * along(first)
    every = round(1000.0 / rate_hz)
    rows = np.arange(LOST * COARSE, len(fine) - LOST * COARSE)
    for sensor in recorded.robot.sensors:
        angle, origin = (first, np.zeros_like(elbow)) if sensor.link == "arm_1" else (second, elbow)
        expected = specific_force(origin + sensor.position[0] * along(angle), angle, 1e-3)[rows % every == 0]
        reading = recorded.recording.accel[sensor.name][rows[rows % every == 0] // every]
        np.testing.assert_allclose(reading[:, :2], expected, atol=2e-3)
        np.testing.assert_allclose(reading[:, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(recorded.truth_position[:, 0], np.diff(angles())[::every, 0], atol=1e-5)
    np.testing.assert_allclose(recorded.truth_velocity[50:-50, 0], np.diff(angles(1))[::every][50:-50, 0], atol=1e-3)


def test_hanging_still_it_reads_gravity_along_the_arms() -> None:
    motion = pendulum.smooth(np.full((3001, 2), np.pi), PERIOD)
    (recorded,) = pendulum.stretches(motion, 3.0, PendulumOptions(**EXACT))
    for reading in recorded.recording.accel.values():
        np.testing.assert_allclose(reading, np.tile([-9.81, 0.0, 0.0], (3001, 1)), atol=1e-5)


def test_stretches_and_seeds() -> None:
    motion = pendulum.smooth(np.tile(angles(), (5, 1))[:25001], PERIOD)
    pieces = list(pendulum.stretches(motion, 25.0, PendulumOptions(seed=3)))
    assert [len(piece.recording) for piece in pieces] == [10000, 10000, 5001]
    assert np.array_equal(np.diff(np.concatenate([p.recording.stamps for p in pieces])), np.full(25000, 10**6))
    again, other = (next(pendulum.stretches(motion, 25.0, PendulumOptions(seed=seed))) for seed in (3, 4))
    assert np.array_equal(table(again), table(pieces[0]))
    assert not np.allclose(table(other), table(pieces[0]))
