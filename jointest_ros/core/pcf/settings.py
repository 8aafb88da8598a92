"""What the filters of one joint share, in SI; `PcfParams` has the same in the units of a user."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Field:
    """When a magnetometer counts as disturbed."""

    norm_tolerance: float  # share of the reference
    dip_tolerance: float  # rad
    norm: float = 0.0  # tesla, reference; 0: learnt at rest
    dip: float = 0.0  # rad below horizontal, reference


@dataclass(frozen=True)
class Smoothing:
    """What is done with samples before a filter gets them."""

    accel_time: float  # s, over which accelerometers are averaged; 0: not at all
    field: Field
    lever_arms: bool = False  # accelerations by the turning of the links are removed


NO_SMOOTHING = Smoothing(0.0, Field(math.inf, math.inf))


@dataclass(frozen=True)
class BiasNoise:
    """The difference of the gyro biases of two sensors, along an axis."""

    std: float  # rad/s, before it is calibrated
    walk: float  # rad/s/sqrt(s)


@dataclass(frozen=True)
class HingeNoise:
    """Noise figures and limits of one hinge (see hinge.py)."""

    bias: BiasNoise
    gravity_cone: float  # rad
    accel_weight: float
    mag_weight: float
    smoothing: Smoothing
