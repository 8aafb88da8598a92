"""The equations of a hinge: they hold for one, and their derivatives are right."""

from __future__ import annotations

import numpy as np
import pytest
from finger_windows import means_of, true_axis
from scipy.optimize import least_squares

from jointest_ros.evaluation import hinge_equations as equations
from jointest_ros.evaluation.hinge_equations import Hinge, Scatter, frame_of, hinge_data, tilted
from jointest_ros.sim.finger import simulate

SCATTER = Scatter(1e-3, 0.05)


@pytest.fixture(scope="module")
def problem() -> tuple[equations.HingeData, equations.Frames]:
    """Windows of a noiseless hinge, and its true axes."""
    one = simulate("PC", seed=3, mounting="mounted", rate_hz=500.0, duration_s=25.0, noise=False, bias=False)
    data = hinge_data(means_of(one.recording), "palm", "proximal")
    return data, (frame_of(true_axis(one.robot, "palm", 0)), frame_of(true_axis(one.robot, "proximal", 0)))


def parameters() -> np.ndarray:
    """All known: the arms of the simulated finger, no bias."""
    p = np.zeros(equations.PARAMETERS)
    p[equations.ARM_1], p[equations.ARM_2] = (0.0, -0.05, 0.0), (0.0, 0.02, 0.0)
    return p


def test_they_hold_for_the_true_axes_and_not_for_others(
    problem: tuple[equations.HingeData, equations.Frames],
) -> None:
    data, frames = problem
    true = Hinge(data, frames, parameters(), SCATTER)
    tilt = np.array([0.02, 0.0])
    wrong = Hinge(data, (tilted(frames[0], tilt), frames[1]), parameters(), SCATTER)
    assert np.degrees(SCATTER.gyro * abs(true.across)).max() < 0.1
    assert np.sqrt(np.mean(abs(true.across) ** 2)) < 0.05 * np.sqrt(np.mean(abs(wrong.across) ** 2))
    assert np.sqrt(np.mean(true.along**2)) < 0.2 * np.sqrt(np.mean(wrong.along**2))


def test_derivatives(problem: tuple[equations.HingeData, equations.Frames]) -> None:
    """Near the solution, from axes that are tilted there: q0, in closed form, follows the parameters."""
    whole, frames = problem
    data = whole.part(300)
    assert len(data) <= 300
    start = np.array([0.3, -0.5, 0.2, 0.4])
    frames = tilted(frames[0], start[:2]), tilted(frames[1], start[2:])
    p = least_squares(
        lambda p: Hinge(data, frames, p, SCATTER).residuals(),
        np.zeros(equations.PARAMETERS),
        jac=lambda p: Hinge(data, frames, p, SCATTER).derivatives(),
        x_scale=np.repeat([1.0, 0.01, 0.1, 0.5], [4, 6, 6, 1]),
    ).x
    assert p[:4] == pytest.approx(-start, abs=1e-3)
    derivatives = Hinge(data, frames, p, SCATTER).derivatives()
    step = 1e-6
    for k, way in enumerate(step * np.eye(equations.PARAMETERS)):
        above, below = (Hinge(data, frames, p + sign * way, SCATTER).residuals() for sign in (1.0, -1.0))
        expected = (above - below) / (2.0 * step)
        assert derivatives[:, k] == pytest.approx(expected, abs=1e-3 * abs(expected).max()), k


def test_a_gap_ends_a_stretch() -> None:
    one = simulate("PC", rate_hz=200.0, duration_s=12.0)
    plain = one.recording
    plain.gyro["palm"][900:1000] = np.nan
    data = hinge_data(means_of(plain), "palm", "proximal")
    edges = np.flatnonzero(np.diff(data.stretch))
    assert data.elapsed.max() < equations.STRETCH
    assert np.all(data.elapsed[edges + 1] == 0.0)
    across = np.flatnonzero(np.diff(data.time) > 0.4)
    assert len(across) == 1 and across[0] in edges
