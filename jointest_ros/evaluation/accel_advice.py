"""The error to expect of a joint with accelerometer arrays, and the places of the sensors that make it small.

The expectation is the bound of `accel_bound` in typical motions. The places are those of Woods & Vikas, (23): half of
the sensors at either end of the link; the bound has its minimum there too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointest_ros.core.accel.array import JointArrays, LinkArray, array_matrices, plane
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import Sensor
from jointest_ros.evaluation.accel_bound import INITIAL_VARIANCE, array_information, bound, rms_deg
from jointest_ros.evaluation.accel_motion import Course
from jointest_ros.evaluation.measures import rms

SETTLED_S = 1.0  # before which nothing counts
DRAWS = 50  # of the noise, for the angle of single samples
BIAS_WALK = 1e-4  # m/s^2/sqrt(s): what the bound takes for a constant bias
SPANS = np.linspace(0.1, 1.0, 10)  # of both arrays in the lengths of their links, for the picture

Places = tuple[FloatArray, FloatArray]  # (Na, 2) and (Nb, 2), m from the joint in the plane of motion


@dataclass(frozen=True)
class Expectation:
    """Errors to expect in one motion, root mean square over time.

    Attributes:
        one_sample_deg: angle of (12), each sample by itself.
        angle_deg, rates_dps: bound for filters: of the angle, of parent and child.
        smoothed_deg: bound of the angle for smoothers.
        biased_deg: bound of the angle for filters that have to find constant biases too; None: not asked for.
        observable: at the end more is known of the angle than before the first sample.
    """

    one_sample_deg: float
    angle_deg: float
    rates_dps: tuple[float, float]
    smoothed_deg: float
    biased_deg: float | None
    observable: bool


@dataclass(frozen=True, eq=False)
class Advice:
    """One joint.

    Attributes:
        noise: of the channels in one sample, m/s^2; the largest.
        courses: the motions.
        now: what to expect, by motion.
        lengths: to which sensors can sit on parent and child, m from the joint.
        places: of the sensors at the ends of the links.
        improved_deg: bound of the angle with these, by motion.
    """

    arrays: JointArrays
    noise: float
    courses: Sequence[Course]
    now: list[Expectation]
    lengths: tuple[float, float]
    places: Places
    improved_deg: list[float]

    def positions(self) -> Iterator[tuple[Sensor, tuple[float, ...]]]:
        """(sensor, its new position in the frame of its link, m); what is across the plane of motion stays."""
        moved = np.concatenate(self.places) - self.arrays.positions
        for sensor, step in zip(self.arrays.sensors, moved @ plane(self.arrays.joint.axes[0]), strict=True):
            yield sensor, tuple((np.array(sensor.position) + step).tolist())


def advise(
    arrays: JointArrays, courses: Sequence[Course], bias: float = 0.0, lengths: Mapping[str, float] | None = None
) -> Advice:
    """What to expect of a joint as it is, and with its sensors at the ends of the links.

    Args:
        courses: motions of the joint, of one period.
        bias: standard deviation of the constant biases of the channels, m/s^2; 0: none.
        lengths: of links by name, from the joint, m; a link ends at its farthest sensor unless given.

    Raises:
        ConfigurationError: a sensor without noise.
    """
    covariance = channel_covariance(arrays, 1.0 / courses[0].period)
    parent, child = (
        (lengths or {}).get(name, reach(link))
        for name, link in ((arrays.joint.parent, arrays.parent), (arrays.joint.child, arrays.child))
    )
    ends = at_the_ends(arrays.parent, parent), at_the_ends(arrays.child, child)
    here = arrays.parent.positions, arrays.child.positions
    return Advice(
        arrays,
        math.sqrt(covariance.max()),
        courses,
        [expectation(here, covariance, one, bias) for one in courses],
        (parent, child),
        ends,
        [float(angle_bounds([ends], covariance, one)[0]) for one in courses],
    )


def channel_covariance(arrays: JointArrays, rate_hz: float) -> FloatArray:
    """(C, C) of all channels in one sample, (m/s^2)^2: noise density over the bandwidth of half the rate.

    Raises:
        ConfigurationError: a sensor without noise.
    """
    for sensor in arrays.sensors:
        if not sensor.accel_noise:
            raise ConfigurationError(f"sensor '{sensor.name}': accel_noise_ug is 0; give that of the data sheet")
    return np.diag(np.repeat([sensor.accel_noise**2 * rate_hz / 2.0 for sensor in arrays.sensors], 2))


def expectation(places: Places, covariance: FloatArray, motion: Course, bias: float = 0.0) -> Expectation:
    """What sensors at `places` achieve in one motion.

    Args:
        covariance: of the channels, see `channel_covariance`.
        bias: standard deviation of the constant biases of the channels, m/s^2; 0: none.
    """
    known = motion.state, motion.joint_acceleration, array_information(*places, covariance), motion.period
    first = round(SETTLED_S / motion.period)
    variances = bound(*known)
    w_a, w_b, angle = rms_deg(variances, first).tolist()
    biased = None
    if bias:
        walk = BIAS_WALK * math.sqrt(motion.period)
        biases = array_information(*places, bias), array_information(*places, walk)
        biased = float(rms_deg(bound(*known, biases=biases), first)[2])
    return Expectation(
        _one_sample_deg(places, covariance, motion),
        angle,
        (w_a, w_b),
        float(rms_deg(bound(*known, smoother=True), first)[2]),
        biased,
        bool(variances[-1, 2] < INITIAL_VARIANCE),
    )


def _one_sample_deg(places: Places, covariance: FloatArray, motion: Course) -> float:
    """By drawing: where a_O is small, the error of the angle is no longer in proportion to the noise."""
    generator = np.random.default_rng(0)
    vectors = []
    channels = np.split(np.arange(len(covariance)), [2 * len(places[0])])
    for positions, mine in zip(places, channels, strict=True):
        _, f = array_matrices(positions)
        spread = np.linalg.cholesky(f @ covariance[np.ix_(mine, mine)] @ f.T)
        noise = generator.standard_normal((DRAWS, *motion.joint_acceleration.shape)) @ spread.T
        vectors.append(motion.joint_acceleration + noise)  # in the same axes: the angle between them is the error
    a, b = vectors
    error = np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], (a * b).sum(axis=-1))
    return math.degrees(rms(error))


def angle_bounds(placements: Sequence[Places], covariance: FloatArray, motion: Course) -> FloatArray:
    """(placements,) deg: the bound of the angle for filters."""
    information = np.array([array_information(*places, covariance) for places in placements])
    variances = bound(motion.state, motion.joint_acceleration, information, motion.period)
    return rms_deg(variances, round(SETTLED_S / motion.period))[:, 2]


def bounds_by_span(advice: Advice, motion: Course) -> FloatArray:
    """(spans,) deg: the bound of the angle over `SPANS`, either array in the middle of its link."""
    (a, b), (length_a, length_b) = (advice.arrays.parent, advice.arrays.child), advice.lengths
    near, far = 0.5 * (1.0 - SPANS), 0.5 * (1.0 + SPANS)
    placements = [
        (at_the_ends(a, end * length_a, start * length_a), at_the_ends(b, end * length_b, start * length_b))
        for start, end in zip(near, far, strict=True)
    ]
    return angle_bounds(placements, channel_covariance(advice.arrays, 1.0 / motion.period), motion)


def reach(link: LinkArray) -> float:
    """Distance of the farthest sensor from the joint, m."""
    return float(np.linalg.norm(link.positions, axis=1).max())


def direction(link: LinkArray) -> FloatArray:
    """(2,) unit vector in the plane of motion from the joint towards the farthest sensor."""
    farthest = link.positions[np.argmax(np.linalg.norm(link.positions, axis=1))]
    return np.asarray(farthest / np.linalg.norm(farthest))


def at_the_ends(link: LinkArray, end: float, start: float = 0.0) -> FloatArray:
    """(N, 2) positions: half of the sensors `start` m from the joint, half `end` m, towards the farthest of them, (23).

    Those that are nearest to the joint now stay there; of an odd number one more does.
    """
    towards = direction(link)
    nearest_first = np.argsort(link.positions @ towards, kind="stable")
    distances = np.empty(len(nearest_first))
    distances[nearest_first] = np.where(np.arange(len(distances)) < (len(distances) + 1) // 2, start, end)
    return np.asarray(distances[:, None] * towards)
