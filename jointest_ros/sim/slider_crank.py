"""The slider-crank of Woods & Vikas (Appendix III) with the scenarios of its specification, section 3.

Crank a of length L_a turns about a fixed pivot by th_a(t); b of length L_b joins it at O and slides with its other end:
sin th_b = -(L_a / L_b) sin th_a. Both links bear accelerometers in a row along x, at distances from O; as in the
paper, those of a are counted outward beyond O. States are [w_a, w_b, th_ab], th_ab = th_a - th_b.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from jointest_ros.core.accel.array import lever
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import STANDARD_GRAVITY
from jointest_ros.sim.imu import GRAVITY
from jointest_ros.sim.motion import Signal, constant, raised_cosine, sine

PERIOD = 0.01  # s
SAMPLES = 1001
DATA_SHEET_SIGMA = 400e-6 * STANDARD_GRAVITY * math.sqrt(50.0)  # m/s^2 a sample: 400 ug/sqrt(Hz), 50 Hz of bandwidth
TABLE_SIGMA = 0.0143  # m/s^2 a sample, with which Table II of the paper is consistent


@dataclass(frozen=True)
class CrankScenario:
    """One motion of the crank with its sensors' noise.

    Attributes:
        angle: times (T,) s -> th_a, rad.
        sigma: standard deviation of every channel, m/s^2.
        gravity: the plane of motion is vertical; th_a counts from horizontal.
        lengths: L_a, L_b, m; None: L and 2 L of a chosen L.
        spans: (l_a, d_a), (l_b, d_b): mean distance of the two sensors of a link from O and the distance between them,
            m; None: L / 2 for all.
    """

    description: str
    angle: Callable[[FloatArray], Signal]
    sigma: float = DATA_SHEET_SIGMA
    gravity: bool = False
    lengths: tuple[float, float] | None = None
    spans: tuple[tuple[float, float], tuple[float, float]] | None = None


def _swing(amplitude: float, frequency_hz: float) -> Callable[[FloatArray], Signal]:
    return lambda time: sine(time, frequency_hz) * amplitude


def _turn(time: FloatArray) -> Signal:
    rate = constant(time, math.pi)
    return Signal(math.pi * time, rate.value, rate.rate)


SCENARIOS: dict[str, CrankScenario] = {
    "T2": CrankScenario("as Table II: 90 deg at 0.1 Hz", _swing(math.pi / 2.0, 0.1), TABLE_SIGMA),
    "B": CrankScenario("90 deg at 0.25 Hz, noise of a data sheet", _swing(math.pi / 2.0, 0.25)),
    "C": CrankScenario("full rotation at 0.5 Hz", _turn),
    "D": CrankScenario("from rest, 103 deg at 0.2 Hz", lambda time: raised_cosine(time, 0.2) * 1.8),
    "G": CrankScenario("as B in a vertical plane", _swing(math.pi / 2.0, 0.25), gravity=True),
    "F": CrankScenario("29 deg at 2 Hz", _swing(0.5, 2.0)),
    "P": CrankScenario(
        "as B, with the placement of Figs. 6 and 7",
        _swing(math.pi / 2.0, 0.25),
        lengths=(0.2, 2.0),
        spans=((0.1, 0.1), (1.0, 0.1)),
    ),
}


@dataclass(frozen=True, eq=False)
class CrankMotion:
    """The truth at T instants.

    Attributes:
        time: (T,) s.
        state: (T, 3): w_a, w_b (rad/s), th_ab (rad).
        angular_acceleration: (T, 2) of a and b, rad/s^2.
        joint_acceleration: (T, 2) specific force at O in the axes of a, m/s^2.
        positions_a, positions_b: (N, 2) of the accelerometers from O, m.
        channels: (T, 2 (Na + Nb)) what they read without error, m/s^2, in the order of `core.accel.array`.
    """

    time: FloatArray
    state: FloatArray
    angular_acceleration: FloatArray
    joint_acceleration: FloatArray
    positions_a: FloatArray
    positions_b: FloatArray
    channels: FloatArray

    def trials(self, sigma: float, seeds: Iterable[int]) -> FloatArray:
        """(trials, T, channels) readings with white noise of `sigma` (m/s^2), one trial for each seed."""
        noise = [np.random.default_rng(seed).standard_normal(self.channels.shape) for seed in seeds]
        return np.asarray(self.channels + sigma * np.array(noise))


def row(mean: float, span: float, number: int = 2) -> FloatArray:
    """(number, 2) positions of accelerometers evenly from mean - span / 2 to mean + span / 2 along x, m."""
    along = mean + span * np.linspace(-0.5, 0.5, number)
    return np.column_stack([along, np.zeros(number)])


def motion(
    scenario: str | CrankScenario,
    length: float = 0.3,
    *,
    positions: tuple[ArrayLike, ArrayLike] | None = None,
    first: int = 0,
    samples: int = SAMPLES,
    period: float = PERIOD,
) -> CrankMotion:
    """The motion of a scenario.

    Args:
        scenario: a key of `SCENARIOS`, or one of your own.
        length: L, m, for scenarios without lengths.
        positions: of the accelerometers of a and b, (Na, 2) and (Nb, 2), m; the scenario's unless given.
        first, samples, period: number of the first sample (0 is at time 0), T, and s.
    """
    chosen = SCENARIOS[scenario] if isinstance(scenario, str) else scenario
    length_a, length_b = chosen.lengths or (length, 2.0 * length)
    spans = chosen.spans or ((length / 2.0, length / 2.0),) * 2
    places = [np.array(p, dtype=np.float64) for p in positions or [row(*span) for span in spans]]
    time: FloatArray = period * np.arange(first, first + samples, dtype=np.float64)
    a = chosen.angle(time)
    ratio = length_a / length_b
    angle_b = np.arcsin(-ratio * np.sin(a.value))
    rate_b = -ratio * np.cos(a.value) / np.cos(angle_b) * a.rate
    curved = np.sin(a.value) * (a.rate**2 - rate_b**2) - np.cos(a.value) * a.acceleration
    acceleration_b = ratio * curved / np.cos(angle_b)
    y_a, y_b = np.stack([a.rate**2, a.acceleration], axis=-1), np.stack([rate_b**2, acceleration_b], axis=-1)

    at_joint = y_a @ lever([length_a, 0.0]).T
    if chosen.gravity:
        at_joint = at_joint + GRAVITY * np.column_stack([np.sin(a.value), np.cos(a.value)])
    angle = a.value - angle_b
    c, s = np.cos(angle), np.sin(angle)
    seen_by_b = np.column_stack([c * at_joint[:, 0] - s * at_joint[:, 1], s * at_joint[:, 0] + c * at_joint[:, 1]])
    readings = [
        origin[:, None, :] + np.einsum("nij,tj->tni", lever(place), y)
        for origin, place, y in zip((at_joint, seen_by_b), places, (y_a, y_b), strict=True)
    ]
    return CrankMotion(
        time,
        np.column_stack([a.rate, rate_b, angle]),
        np.column_stack([a.acceleration, acceleration_b]),
        at_joint,
        places[0],
        places[1],
        np.concatenate([r.reshape(samples, -1) for r in readings], axis=1),
    )
