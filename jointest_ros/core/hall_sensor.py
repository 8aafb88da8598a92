"""Hall sensors on joints: the curve from voltage to angle, its inverse, its slope and where it ends.

Yumbla et al. 2023, equation (1): theta_h(V) = .07 exp(2.87 V) - 2.22e5 exp(-8.43 V) deg. It rises over its whole range.
At negative angles it is flat in V, that is, imprecise; the mirrored second sensor of a pair covers them.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import FloatArray

_TABLE_STEP = 2e-3  # V: the Hermite polynomials between the nodes are exact to 1e-9 of the angle
_LEAST_SLOPE = 1e-3  # rad/V: a spline may be level in a point
_TABLE_ABOVE = 1.0  # V above the range: angles that the joint reaches after the sensor has saturated


@dataclass(frozen=True)
class ExponentialCurve:
    """theta_h(V) = a exp(b V) - c exp(-d V), equation (1).

    Attributes:
        a_deg, c_deg: deg, neither negative, not both 0.
        b, d: 1/V, positive.
    """

    a_deg: float = 0.07
    b: float = 2.87
    c_deg: float = 2.22e5
    d: float = 8.43

    def __post_init__(self) -> None:
        values = (self.a_deg, self.b, self.c_deg, self.d)
        sound = all(math.isfinite(v) for v in values) and min(values) >= 0.0 and self.b > 0.0 and self.d > 0.0
        if not sound or not self.a_deg + self.c_deg:
            raise ConfigurationError(
                f"hall curve (a, b, c, d): {values} is not allowed; a, c: 0 or more, not both 0; b, d: positive"
            )

    def angle(self, volts: FloatArray) -> FloatArray:
        """theta_h, rad, of voltages of any shape."""
        return np.radians(self.a_deg * np.exp(self.b * volts) - self.c_deg * np.exp(-self.d * volts))

    def slope(self, volts: FloatArray) -> FloatArray:
        """d theta_h / dV, rad/V, positive."""
        return np.radians(self.a_deg * self.b * np.exp(self.b * volts) + self.c_deg * self.d * np.exp(-self.d * volts))


@dataclass(frozen=True)
class SplineCurve:
    """Monotone cubic through measured points (Fritsch and Carlson 1980), straight beyond the first and the last.

    Attributes:
        volts: at least two, rising.
        angles_deg: theta_h at them, rising.
    """

    volts: tuple[float, ...]
    angles_deg: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.volts) != len(self.angles_deg) or len(self.volts) < 2:
            raise ConfigurationError(
                f"hall curve: {len(self.volts)} volts, {len(self.angles_deg)} angles_deg; give equally many, at least 2"
            )
        for what, row in (("volts", self.volts), ("angles_deg", self.angles_deg)):
            if not all(low < high for low, high in itertools.pairwise(row)):
                raise ConfigurationError(f"hall curve.{what}: {row} is not allowed; the values must rise")

    def angle(self, volts: FloatArray) -> FloatArray:
        """theta_h, rad, of voltages of any shape."""
        inside = np.clip(volts, self.volts[0], self.volts[-1])
        return np.asarray(_spline(self)(inside) + self.slope(volts) * (volts - inside))

    def slope(self, volts: FloatArray) -> FloatArray:
        """d theta_h / dV, rad/V."""
        return np.asarray(_spline(self)(np.clip(volts, self.volts[0], self.volts[-1]), 1))


@lru_cache(maxsize=256)
def _spline(curve: SplineCurve) -> Any:
    from scipy.interpolate import PchipInterpolator  # slow to import, and few have splines

    return PchipInterpolator(curve.volts, np.radians(curve.angles_deg))


Curve = ExponentialCurve | SplineCurve


@dataclass(frozen=True)
class HallSensor:
    """One Hall sensor. The defaults are the paper's curve on a DRV5053 behind a 12 bit converter of 3.3 V.

    It reads V = V(theta_h) + offset + noise, where theta_h is the joint angle, or its negative when `mirrored`.

    Attributes:
        joint: coordinate that it measures, a name out of `Robot.coordinates`.
        curve: from voltage to angle.
        mirrored: it sits on the other side of the joint.
        offset: known error of the voltage, V: subtracted.
        noise: standard deviation of a reading, V (34.5 mV: the paper's 3.2 deg over its range of motion).
        hall_range: lowest and highest voltage that the sensor can put out, V.
        resolution: one digit of the converter, V; 0 for none.

    Raises:
        ConfigurationError: a value that is not allowed.
    """

    joint: str
    curve: Curve = ExponentialCurve()
    mirrored: bool = False
    offset: float = 0.0
    noise: float = 0.0345
    hall_range: tuple[float, float] = (0.2, 1.8)
    resolution: float = 3.3 / 4096

    def __post_init__(self) -> None:
        where = f"hall sensor of '{self.joint}'"
        if not (math.isfinite(self.noise) and self.noise > 0.0):
            raise ConfigurationError(f"{where}.noise: {self.noise!r} is not allowed; give a positive number of volts")
        if not (math.isfinite(self.resolution) and self.resolution >= 0.0):
            raise ConfigurationError(f"{where}.resolution: {self.resolution!r} is not allowed; give 0 V or more")
        if not math.isfinite(self.offset):
            raise ConfigurationError(f"{where}.offset: {self.offset!r} is not allowed; give a number of volts")
        low, high = self.hall_range
        if not (-100.0 <= low < high <= 100.0 and high - low > 2.0 * self.gate_margin):
            raise ConfigurationError(
                f"{where}.hall_range: {self.hall_range!r} is not allowed; give [lowest, highest] V, wider than noise"
            )

    @property
    def variance(self) -> float:
        """Variance of a reading with its rounding, V^2."""
        return self.noise**2 + self.resolution**2 / 12.0

    @property
    def gate_margin(self) -> float:
        """A reading within this of an end of the range may have been clipped, V."""
        return 2.0 * self.resolution + self.noise

    @property
    def sign(self) -> float:
        """d theta_h / d theta: 1, or -1 when mirrored."""
        return -1.0 if self.mirrored else 1.0

    def angle(self, volts: FloatArray) -> FloatArray:
        """Joint angle, rad, that readings (any shape, V) stand for."""
        return self.sign * self.curve.angle(np.asarray(volts, dtype=float) - self.offset)

    def slope(self, volts: FloatArray) -> FloatArray:
        """d angle / dV, rad/V, at readings of any shape, V."""
        return self.sign * self.curve.slope(np.asarray(volts, dtype=float) - self.offset)

    def voltage(self, angle: FloatArray) -> FloatArray:
        """Reading without noise and without limits, V, at joint angles of any shape, rad."""
        return self.table.voltages(self.sign * np.asarray(angle, dtype=float))[0] + self.offset

    def usable(self, volts: FloatArray) -> NDArray[np.bool_]:
        """Which readings (any shape, V) are certainly not clipped; false for NaN."""
        low, high = self.hall_range
        volts = np.asarray(volts)
        return (volts > low + self.gate_margin) & (volts < high - self.gate_margin)

    @property
    def table(self) -> VoltageTable:
        """Both directions of the curve for single numbers."""
        return _table(self.curve, *self.hall_range)


class VoltageTable:
    """The curve and its inverse as cubic Hermite polynomials between nodes: fast for single numbers, any curve.

    Angles are theta_h, that is, before the sensor's sign, and voltages before its offset. Straight beyond the nodes.
    """

    def __init__(self, curve: Curve, low: float, high: float) -> None:
        volts = np.arange(low, high + _TABLE_ABOVE, _TABLE_STEP)
        angles, slopes = curve.angle(volts), np.maximum(curve.slope(volts), _LEAST_SLOPE)
        self._angle_nodes, self._inverse = _hermite(angles, volts, 1.0 / slopes)
        self._volt_nodes, self._forward = _hermite(volts, angles, slopes)
        self._angle_list: list[float] = self._angle_nodes.tolist()
        self._inverse_rows: list[tuple[float, ...]] = [tuple(row) for row in self._inverse.T.tolist()]
        self._volt_list: list[float] = self._volt_nodes.tolist()
        self._forward_rows: list[tuple[float, ...]] = [tuple(row) for row in self._forward.T.tolist()]

    def angle(self, volts: float) -> float:
        """theta_h, rad."""
        x0, c0, c1, c2, c3 = self._forward_rows[bisect_right(self._volt_list, volts)]
        x = volts - x0
        return c0 + x * (c1 + x * (c2 + x * c3))

    def voltage(self, angle: float) -> tuple[float, float]:
        """(V, dV / d theta_h in V/rad)."""
        x0, c0, c1, c2, c3 = self._inverse_rows[bisect_right(self._angle_list, angle)]
        x = angle - x0
        return c0 + x * (c1 + x * (c2 + x * c3)), c1 + x * (2.0 * c2 + 3.0 * x * c3)

    def angles(self, volts: FloatArray) -> FloatArray:
        """`angle` of voltages of any shape."""
        x0, c0, c1, c2, c3 = self._forward[:, self._volt_nodes.searchsorted(volts, "right")]
        x = volts - x0
        return np.asarray(c0 + x * (c1 + x * (c2 + x * c3)))

    def voltages(self, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`voltage` of angles of any shape."""
        x0, c0, c1, c2, c3 = self._inverse[:, self._angle_nodes.searchsorted(angles, "right")]
        x = angles - x0
        return c0 + x * (c1 + x * (c2 + x * c3)), c1 + x * (2.0 * c2 + 3.0 * x * c3)


@lru_cache(maxsize=256)
def _table(curve: Curve, low: float, high: float) -> VoltageTable:
    return VoltageTable(curve, low, high)


def _hermite(x: FloatArray, y: FloatArray, slope: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Nodes (n,), and (5, n + 1) x0 and coefficients of y in powers of x - x0; column k is for x before node k."""
    step, rise = np.diff(x), np.diff(y) / np.diff(x)
    quadratic = (3.0 * rise - 2.0 * slope[:-1] - slope[1:]) / step
    cubic = (slope[:-1] + slope[1:] - 2.0 * rise) / step**2
    inside = np.column_stack([x[:-1], y[:-1], slope[:-1], quadratic, cubic])
    before, after = ([[x[k], y[k], slope[k], 0.0, 0.0]] for k in (0, -1))
    return x, np.ascontiguousarray(np.vstack([before, inside, after]).T)
