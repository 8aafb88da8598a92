"""An identified joint axis: where it is in both sensors, how well that is known, and what the motion was like."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation.joint_pairs import Pair
from jointest_ros.evaluation.measures import angle_between

UNDETERMINED = math.radians(3.0)  # standard deviation of an axis from which it counts as unknown


@dataclass(frozen=True)
class Axis:
    """The axis of a hinge in one sensor.

    Attributes:
        sensor: its name.
        axis: (3,) unit vector in the sensor's frame.
        covariance: (2, 2) rad^2, of its tilt about `across`; zeros where it was kept.
        across: (2, 3) unit vectors across it.
        configured: (3,) as it was.
        kept: it was taken as configured.
    """

    sensor: str
    axis: FloatArray
    covariance: FloatArray
    across: FloatArray
    configured: FloatArray
    kept: bool

    @property
    def std(self) -> float:
        """Standard deviation in the direction in which it is known worst, rad."""
        return math.sqrt(float(np.linalg.eigvalsh(self.covariance)[-1]))

    @property
    def change(self) -> float:
        """Angle between configured and identified axis, rad."""
        return angle_between(self.axis, self.configured)

    @property
    def determined(self) -> bool:
        """It is known well enough to be used."""
        return self.std < UNDETERMINED


@dataclass(frozen=True)
class AxisFit:
    """An identified hinge and what was measured of its motion; all rates are root mean squares, rad/s.

    Attributes:
        pair: as configured.
        parent, child: the axis in both sensors.
        signed: the sign of one axis relative to the other is known.
        windows: that the fit rests on.
        residual: of z1 - exp(i q) z2, a component; `residual_before`: the same with the configured axes.
        noise: of it, as the sensors' data sheets have it.
        misfit: the part of `residual` that follows the rates.
        joint_rate: about the axis.
        link_rates: of parent and child.
        across_rate: of the parent across the axis.
        time, residual_over_time, residual_before_over_time: (n,) s and rad/s, of the same, for a picture.
    """

    pair: Pair
    parent: Axis
    child: Axis
    signed: bool
    windows: int
    residual: float
    residual_before: float
    noise: float
    misfit: float
    joint_rate: float
    link_rates: tuple[float, float]
    across_rate: float
    time: FloatArray
    residual_over_time: FloatArray
    residual_before_over_time: FloatArray

    @property
    def axes(self) -> tuple[Axis, Axis]:
        """Parent's and child's."""
        return self.parent, self.child

    @property
    def determined(self) -> bool:
        """Both axes are."""
        return self.parent.determined and self.child.determined


def spread(rates: FloatArray) -> float:
    """Of (n, k) rates about their mean, all components together."""
    return math.sqrt(float(np.sum(rates.var(axis=0))))
