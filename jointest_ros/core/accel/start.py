"""The start of the filters: four hypotheses that differ in the signs of the angular velocities.

Accelerometers tell w^2, never the sign of w, until the links have moved on. A filter that starts at w = 0 starts on a
saddle, where noise decides. So filters start from |w| = sqrt(z) with all four pairs of signs and from the analytical
angle (12); the most likely one is put out, and those that cannot win any more are dropped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from jointest_ros.core.accel.paper.model import PaperNoise, relative_noise, relative_vector

SIGNS = ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0))
LARGEST_ANGLE_VARIANCE = 1.0  # rad^2, where the force at the joint says nothing
_TELLING = 0.25  # rad^2, a sample whose angle has a larger variance tells nothing
_ENOUGH = 44.0  # 1/rad^2, sum of 1 / variance over telling samples in a row: noise alone does not reach that
LOST = 0.5  # rad^2, variance of the angle from which on a filter, linear in small errors, means nothing
_BEHIND = 20.0  # in log likelihood: has lost
_SAME = 0.1  # standard deviations: two hypotheses have become one


def hypotheses(
    reading: Sequence[float], noise: PaperNoise
) -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    """([w_a, w_b, th], their variances) of each hypothesis, rad and rad/s, from the first sample.

    Args:
        reading: as of `PaperModel`, with the noise of it.
    """
    speeds, variances = [], []
    for z, sigma in ((reading[0], math.sqrt(noise.a[0])), (reading[4], math.sqrt(noise.b[0]))):
        least = 0.5 * math.sqrt(sigma)  # rad/s, below which z is noise
        speeds.append(max(math.sqrt(max(z, 0.0)), least))
        variances.append((0.5 * sigma / speeds[-1]) ** 2)
    o_a, o_b = reading[2:4], reading[6:8]
    sine, cosine = relative_vector(o_a, o_b)
    angle, length2 = math.atan2(sine, cosine), sine * sine + cosine * cosine
    spread = relative_noise(o_a, o_b, noise) / length2 if length2 else math.inf
    spread = min(spread, LARGEST_ANGLE_VARIANCE)
    return [((a * speeds[0], b * speeds[1], angle), (variances[0], variances[1], spread)) for a, b in SIGNS]


def evidence(told: float, variance: float) -> tuple[float, bool]:
    """What the latest samples in a row have told of the angle, 1/rad^2, and whether a filter may start with this one.

    Args:
        told: before this sample.
        variance: of the angle of this sample, rad^2.
    """
    told = told + 1.0 / variance if variance < _TELLING else 0.0
    return told, told >= _ENOUGH


def survivors(
    log_likelihoods: Sequence[float], states: Sequence[Sequence[float]], variances: Sequence[Sequence[float]]
) -> list[int]:
    """Which hypotheses to keep, the most likely first.

    Args:
        log_likelihoods: cumulative.
        states, variances: [w_a, w_b, th] of each, further entries are ignored.
    """
    order = sorted(range(len(log_likelihoods)), key=lambda one: -log_likelihoods[one])
    kept: list[int] = []
    for one in order:
        if log_likelihoods[one] < log_likelihoods[order[0]] - _BEHIND:
            break
        if not any(_same(states[one], states[other], variances[other]) for other in kept):
            kept.append(one)
    return kept


def _same(one: Sequence[float], other: Sequence[float], variances: Sequence[float]) -> bool:
    return all((a - b) ** 2 <= _SAME**2 * v for a, b, v in zip(one[:3], other[:3], variances[:3], strict=True))
