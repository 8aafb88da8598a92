"""Trials of the slider-crank, and the estimators of the accelerometer paper on all of them at once.

The conditions are those of the specification, section 3: sample 0 is an update, errors of the angle are wrapped.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from jointest_ros.core.accel.joint.model import JointModel, ModelNoise
from jointest_ros.core.accel.joint.trials import run_joint_model
from jointest_ros.core.accel.paper.linearise import Linearise, linearise_ekf, ukf
from jointest_ros.core.accel.paper.model import PaperModel, PaperNoise, link_noise, link_reading, relative_vector
from jointest_ros.core.accel.paper.trials import run_filter
from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation.accel_bound import array_information, bound, rms_deg
from jointest_ros.evaluation.measures import rmse_deg
from jointest_ros.sim.slider_crank import PERIOD, CrankMotion

ANALYTICAL, SMOOTHED = "analytical", "smoothed, 25 samples"
PRINTED_EKF, PRINTED_UKF = "EKF as printed, without (20)", "UKF as printed, without (20)"
PAPER_EKF, TRAPEZOID_EKF, TRAPEZOID_UKF = "EKF with (20)", "accel_ekf, model paper", "accel_ukf"
JOINT_EKF, JOINT_SMOOTHER, BOUND = "accel_ekf, model joint", "its smoother", "bound"
FORMS: dict[str, tuple[str, Linearise]] = {
    PRINTED_EKF: ("printed", linearise_ekf),
    PRINTED_UKF: ("printed", ukf()),
    PAPER_EKF: ("decorrelated", linearise_ekf),
    TRAPEZOID_EKF: ("trapezoid", linearise_ekf),
    TRAPEZOID_UKF: ("trapezoid", ukf()),
}
COLORS = {
    ANALYTICAL: "#e69f00",
    SMOOTHED: "#999999",
    PRINTED_EKF: "#d55e00",
    PRINTED_UKF: "#cc79a7",
    JOINT_EKF: "#0072b2",
    BOUND: "#000000",
}  # Okabe and Ito 2008
SETTLED = 100  # samples that do not count, where it is said so
START_VARIANCE = 0.01  # of w_a, w_b, th; rad and s
BLOCK = 512  # trials of a sweep that are in memory together

PlaceT = TypeVar("PlaceT")


@dataclass(frozen=True, eq=False)
class Case:
    """Trials of one motion and placement.

    Attributes:
        sigma: noise of every channel, m/s^2.
        channels: (trials, T, C).
        model: of the paper, for these sensors.
        readings: (trials, T, 8) of that model.
    """

    motion: CrankMotion
    sigma: float
    channels: FloatArray
    model: PaperModel
    readings: FloatArray


def case(motion: CrankMotion, sigma: float, seeds: Iterable[int]) -> Case:
    """One trial for each seed."""
    channels = motion.trials(sigma, seeds)
    model = PaperModel.of(motion.positions_a, motion.positions_b, sigma**2, sigma**2)
    return Case(motion, sigma, channels, model, channels @ model.reading.T)


def near_truth(motion: CrankMotion) -> FloatArray:
    """(3,): the start of all trials where nothing else is said."""
    return np.asarray(motion.state[0] + 0.1 * np.random.default_rng(7).standard_normal(3))


def analytical(readings: FloatArray) -> FloatArray:
    """(trials, T) th_ab of (12), rad, in [-pi, pi]."""
    return np.arctan2(*relative_vector(*(np.moveaxis(readings[..., o : o + 2], -1, 0) for o in (2, 6))))


def centred_mean(angles: FloatArray, window: int = 25) -> FloatArray:
    """(trials, T - window + 1): mean over `window` samples about each that has so many."""
    sums = np.cumsum(np.pad(angles, ((0, 0), (1, 0))), axis=1)
    return np.asarray((sums[:, window:] - sums[:, :-window]) / window)


def filtered(
    readings: FloatArray, noise: PaperNoise, period: float, method: str, start: ArrayLike, variance: float
) -> FloatArray:
    """(trials, T, 3) states by a method of `FORMS`, from `start` with one `variance` of all states."""
    form, linearise = FORMS[method]
    return run_filter(readings, noise, period, start, variance * np.eye(3), form, linearise).state


def paper_filter(one: Case, method: str, start: ArrayLike, variance: float) -> FloatArray:
    """`filtered` for the trials of a case."""
    return filtered(one.readings, one.model.noise, PERIOD, method, start, variance)


def joint_model(one: Case, start: ArrayLike, variance: float = START_VARIANCE, *, smoothed: bool = False) -> FloatArray:
    """(trials, T, 3) states by the joint model, filter or smoother; sensors known to have no biases."""
    model = JointModel(one.motion.positions_a, one.motion.positions_b, ModelNoise(bias=False))
    variances = np.full(3, variance)
    return run_joint_model(model, one.channels, one.sigma**2, PERIOD, start, variances, smoothed=smoothed).state


def wrapped(angle: FloatArray) -> FloatArray:
    """In [-pi, pi)."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def state_errors(states: FloatArray, motion: CrankMotion) -> FloatArray:
    """(trials, T, 3) estimate minus truth, the angle wrapped."""
    error = states - motion.state
    error[..., 2] = wrapped(error[..., 2])
    return error


def settled_rmse(states: FloatArray, motion: CrankMotion) -> FloatArray:
    """(3,) deg/s, deg/s, deg over all trials, from sample `SETTLED` on."""
    return rmse_deg(state_errors(states, motion)[:, SETTLED:], axis=(0, 1))


def bounds(motions: Sequence[CrankMotion], sigma: float, *, smoother: bool = False) -> FloatArray:
    """(placements, 3) deg/s, deg/s, deg: the bound for motions that differ in the placement of the sensors alone."""
    known = np.array([array_information(one.positions_a, one.positions_b, sigma) for one in motions])
    truth = motions[0]
    return rms_deg(bound(truth.state, truth.joint_acceleration, known, PERIOD, smoother=smoother), SETTLED)


def sweep(motions: Sequence[CrankMotion], sigma: float, seeds: Sequence[int]) -> dict[str, FloatArray]:
    """RMSE of the angle, (placements,) deg, by `ANALYTICAL` and `PRINTED_EKF` for motions that differ in the placement.

    Trials of all placements run together: see `blocks`.
    """
    truth, shape = motions[0], (len(motions), len(seeds), -1)
    readings = np.concatenate([case(one, sigma, seeds).readings for one in motions])
    angles = wrapped(analytical(readings) - truth.state[:, 2])[:, SETTLED:].reshape(shape)
    noise = stacked_noise(motions, sigma, len(seeds))
    states = filtered(readings, noise, PERIOD, PRINTED_EKF, near_truth(truth), START_VARIANCE)
    errors = state_errors(states, truth)[:, SETTLED:, 2].reshape(shape)
    return {ANALYTICAL: rmse_deg(angles, axis=(1, 2)), PRINTED_EKF: rmse_deg(errors, axis=(1, 2))}


def blocks(placements: Sequence[PlaceT], trials: int) -> list[tuple[PlaceT, ...]]:
    """As many placements together as `BLOCK` allows with so many trials of each."""
    size = max(1, BLOCK // trials)
    return [tuple(placements[first : first + size]) for first in range(0, len(placements), size)]


def joined(parts: Iterable[dict[str, FloatArray]]) -> dict[str, FloatArray]:
    """What `sweep` gave for one block after the other."""
    parts = list(parts)
    return {method: np.concatenate([part[method] for part in parts]) for method in parts[0]}


def stacked_noise(motions: Sequence[CrankMotion], sigma: float, trials: int) -> PaperNoise:
    """Of the readings of the paper's model, `trials` after each other for every placement."""
    links = []
    for places in ([one.positions_a for one in motions], [one.positions_b for one in motions]):
        noise = np.array([link_noise(link_reading(place), sigma**2) for place in places])
        links.append(np.repeat(noise, trials, axis=0))
    return PaperNoise.of(*links)


def seeds_text(seeds: Sequence[int]) -> str:
    """The condition on simulated trials."""
    return f"{len(seeds)} trials of 10.01 s at 100 Hz, seeds {seeds[0]} to {seeds[-1]}"
