"""The joint model on the slider-crank: figures of the specification, section 4, as multiples of the bound.

Mostly 100 trials instead of 200: a ratio scatters by 2 to 3 %.
"""

from __future__ import annotations

import numpy as np
import pytest
from accel_bounds import FILTER, SMOOTHER

from jointest_ros.core.accel.joint.model import JointModel, ModelNoise
from jointest_ros.core.accel.joint.trials import run_joint_model
from jointest_ros.core.accel.paper.trials import Trials
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import STANDARD_GRAVITY
from jointest_ros.sim.slider_crank import PERIOD, SCENARIOS, CrankMotion, motion

TRIALS = 100
BIAS = 20e-3 * STANDARD_GRAVITY  # m/s^2


def estimates(
    true: CrankMotion, channels: FloatArray, sigma: float, bias: bool = False, smoothed: bool = False
) -> Trials:
    """From the local start of section 3."""
    model = JointModel(true.positions_a, true.positions_b, ModelNoise(bias=bias))
    start = true.state[0] + 0.1 * np.random.default_rng(7).standard_normal(3)
    return run_joint_model(model, channels, sigma**2, PERIOD, start, [0.01] * 3, smoothed=smoothed)


def errors(trials: Trials, true: CrankMotion) -> FloatArray:
    """(trials, T, 3) from k = 100 on, the angle wrapped."""
    error = trials.state - true.state
    error[..., 2] = (error[..., 2] + np.pi) % (2 * np.pi) - np.pi
    return error[:, 100:]


def rmse_deg(error: FloatArray) -> FloatArray:
    return np.degrees(np.sqrt(np.mean(np.square(error), axis=(0, 1))))


@pytest.mark.parametrize(("name", "length"), list(FILTER))
def test_best_filter_reaches_the_bound_and_knows_its_error(name: str, length: float) -> None:
    """Item 3."""
    true, sigma = motion(name, length), SCENARIOS[name].sigma
    number = 2 * TRIALS if name == "T2" else TRIALS  # it is slow: few independent errors in a trial
    trials = estimates(true, true.trials(sigma, range(number)), sigma)
    error = errors(trials, true)
    assert (rmse_deg(error) / FILTER[name, length] <= 1.10).all()
    nees = np.mean(np.square(error) / trials.variance[:, 100:], axis=(0, 1))
    assert ((nees > 0.75) & (nees < 1.35)).all()


@pytest.mark.parametrize("name", list(SMOOTHER))
def test_smoother_reaches_its_bound(name: str) -> None:
    """Item 4."""
    true, sigma = motion(name), SCENARIOS[name].sigma
    trials = estimates(true, true.trials(sigma, range(TRIALS)), sigma, smoothed=True)
    assert (rmse_deg(errors(trials, true)) / SMOOTHER[name] <= 1.10).all()


@pytest.mark.parametrize(("name", "allowed"), [("B", 0.8), ("G", 0.4)])
def test_constant_bias_of_every_channel(name: str, allowed: float) -> None:
    """Item 6: median over trials; without bias states 2 deg and more in G, 15 deg and more in B."""
    true, sigma = motion(name), SCENARIOS[name].sigma
    channels = true.trials(sigma, range(40)) + BIAS * np.random.default_rng(40).standard_normal((40, 1, 8))

    def median(bias: bool) -> float:
        error = errors(estimates(true, channels, sigma, bias=bias), true)[..., 2]
        return float(np.median(np.degrees(np.sqrt(np.mean(error**2, axis=1)))))

    assert median(bias=True) <= allowed
    assert median(bias=False) > 4.0 * allowed


@pytest.mark.parametrize("name", ["B", "G"])
def test_mixed_errors_of_the_sensors(name: str) -> None:
    """Item 6: bias, scale, place and orientation wrong at the same time; median over trials."""
    true, sigma, random = motion(name), SCENARIOS[name].sigma, np.random.default_rng(41)
    noise = true.trials(sigma, range(40)) - true.channels

    def wrong(*size: int) -> FloatArray:
        return random.uniform(-1.0, 1.0, size)

    readings = []
    for one in noise:
        moved = 2e-3 * wrong(4, 2)
        places = true.positions_a + moved[:2], true.positions_b + moved[2:]
        turned = motion(name, positions=places).channels.view(complex) * np.exp(1j * np.radians(wrong(4)))
        readings.append(turned.view(float) * (1.0 + 0.01 * wrong(8)) + BIAS * wrong(8) + one)
    error = errors(estimates(true, np.array(readings), sigma, bias=True), true)[..., 2]
    assert np.median(np.degrees(np.sqrt(np.mean(error**2, axis=1)))) <= 2.5


@pytest.mark.parametrize(("name", "allowed"), [("B", 1.08), ("C", 1.08), ("G", 1.08), ("F", 1.15)])
@pytest.mark.parametrize("frames", [False, True], ids=["samples", "frames"])
def test_one_sample_in_twenty_lost(name: str, allowed: float, frames: bool) -> None:
    """Item 7, of single sensors and of whole frames: error over that without losses."""
    true, sigma = motion(name), SCENARIOS[name].sigma
    channels = true.trials(sigma, range(30))
    lost = np.random.default_rng(42).random((30, len(true.time), 1 if frames else 4)) < 0.05
    lost[:, 0] = False
    holes = np.where(np.repeat(lost, 8 if frames else 2, axis=2), np.nan, channels)
    whole, rest = (rmse_deg(errors(estimates(true, z, sigma), true)) for z in (channels, holes))
    assert (rest <= allowed * whole).all()
