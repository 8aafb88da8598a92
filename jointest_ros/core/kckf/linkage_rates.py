"""Joint rates from link gyros: differences for hinges, kinematics for joints of more axes.

Errata of Yumbla et al. 2023, (2), (9), (10): theta' = w_child - R^T w_parent, R = rotation child to parent. For a hinge
the component along its axis needs no R; for a joint of two or three axes it does. With `composed=False` R is left out,
as the paper does.

A joint of three perpendicular axes, taken as x, y, z: R = Rx(th1) Ry(th2) Rz(th3), with the parent's rate p, the
child's w, m = Rx^T p and g = Rz w:

    th1' = (g1 + s2 m3) / c2 - p1,    th2' = g2 - m2,    th3' = w3 - (s2 g1 + m3) / c2

A joint of fewer axes is one whose other angles are 0; their rates are 0, and what the gyros say of them is noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointest_ros.core.frame import FloatArray, Recording, Vec3
from jointest_ros.core.kckf.linkage import Linkage
from jointest_ros.core.robot import Sensor
from jointest_ros.core.rotation import IDENTITY, cross, dot, perpendicular, rotate, rotate_inverse

NAN = math.nan
MISSING: Vec3 = (NAN, NAN, NAN)
_LEAST_COSINE = 0.02  # of the second angle: closer to gimbal lock the rates are damped
_XYZ = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class GyroDifferences:
    """Rates of all coordinates as differences of gyro components: exact for hinges, additive for other joints."""

    def __init__(self, linkage: Linkage) -> None:
        self._rows = []
        for axis, (parent, child) in zip(linkage.axes, linkage.ends, strict=True):
            inner, outer = linkage.gyros[parent], linkage.gyros[child]
            in_sensors = rotate_inverse(outer.mounting, axis), rotate_inverse(inner.mounting, axis)
            self._rows.append((outer.name, in_sensors[0], inner.name, in_sensors[1]))

    def of_frame(self, gyro: Mapping[str, Vec3]) -> list[float]:
        """(m) rad/s from the gyros of a frame (rad/s, sensor frames); NaN where one is missing."""
        rates = []
        for outer, (ox, oy, oz), inner, (ix, iy, iz) in self._rows:
            w, v = gyro.get(outer, MISSING), gyro.get(inner, MISSING)
            rates.append(ox * w[0] + oy * w[1] + oz * w[2] - (ix * v[0] + iy * v[1] + iz * v[2]))
        return rates

    def of_recording(self, recording: Recording) -> FloatArray:
        """(T, m), `of_frame` of every row."""
        nothing = np.full((len(recording), 3), NAN)
        columns = []
        for outer, o, inner, i in self._rows:
            w, v = recording.gyro.get(outer, nothing).T, recording.gyro.get(inner, nothing).T
            columns.append(o[0] * w[0] + o[1] * w[1] + o[2] * w[2] - (i[0] * v[0] + i[1] * v[1] + i[2] * v[2]))
        return np.column_stack(columns)


class LinkRates:
    """Gyros turned into the frames of their links."""

    def __init__(self, gyros: Sequence[Sensor]) -> None:
        self._gyros = [(gyro.name, None if gyro.mounting == IDENTITY else gyro.mounting) for gyro in gyros]

    def of_frame(self, gyro: Mapping[str, Vec3]) -> list[Vec3]:
        """(g) vectors, rad/s; NaN where one is missing."""
        rates = []
        for name, mounting in self._gyros:
            rate = gyro.get(name, MISSING)
            rates.append(rate if mounting is None else rotate(mounting, rate))
        return rates

    def of_recording(self, recording: Recording) -> list[list[Vec3]]:
        """(T) lists, `of_frame` of every row."""
        tables = {}
        for name, _ in self._gyros:
            rates = recording.gyro.get(name)
            if rates is None:
                rates = np.full((len(recording), 3), NAN)
            whole = np.isfinite(rates).all(axis=1, keepdims=True)
            tables[name] = [(x, y, z) for x, y, z in np.where(whole, rates, NAN).tolist()]
        return [self.of_frame(dict(zip(tables, row, strict=True))) for row in zip(*tables.values(), strict=True)]


@dataclass(frozen=True)
class JointFrame:
    """Right-handed basis of a joint whose axes are perpendicular, completed to three; the added ones are locked.

    Attributes:
        axes: how many axes the joint has; the rest is locked at 0.
        basis: three unit vectors, or None for x, y, z.
        sign: -1 where the third axis of the joint is the negative of the basis.
    """

    axes: int
    basis: tuple[Vec3, Vec3, Vec3] | None
    sign: float

    @classmethod
    def of(cls, axes: Sequence[Vec3]) -> JointFrame:
        """For one to three perpendicular unit vectors."""
        first = axes[0]
        second = axes[1] if len(axes) > 1 else perpendicular(first)[0]
        third = cross(first, second)
        sign = -1.0 if len(axes) == 3 and dot(third, axes[2]) < 0.0 else 1.0
        basis = (first, second, third)
        return cls(len(axes), None if basis == _XYZ else basis, sign)

    def components(self, a: Vec3) -> Vec3:
        """Of a vector given in link axes."""
        return a if self.basis is None else (dot(self.basis[0], a), dot(self.basis[1], a), dot(self.basis[2], a))

    def turn(self, angles: Sequence[float], start: int) -> tuple[float, float, float, float, float, float]:
        """s1, c1, s2, 1 / c2, s3, c3 of the module text; its angles begin at `start`, those it does not have are 0."""
        th1 = angles[start]
        th2 = angles[start + 1] if self.axes > 1 else 0.0
        th3 = self.sign * angles[start + 2] if self.axes > 2 else 0.0
        return math.sin(th1), math.cos(th1), math.sin(th2), _secant(th2), math.sin(th3), math.cos(th3)

    def vectors(self, components: Sequence[float]) -> Sequence[float]:
        """In link axes, of the components of one vector after the other."""
        if self.basis is None:
            return components
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = self.basis
        turned: list[float] = []
        for k in range(0, len(components), 3):
            x, y, z = components[k : k + 3]
            turned += (ax * x + bx * y + cx * z, ay * x + by * y + cy * z, az * x + bz * y + cz * z)
        return turned


class ComposedRates:
    """Rates of all coordinates from the gyros of the links and the present angles: the equations of the module text."""

    def __init__(self, linkage: Linkage) -> None:
        self._joints = []
        start = 0
        for joint in linkage.joints:
            self._joints.append((JointFrame.of(joint.axes), start, *linkage.ends[start]))
            start += len(joint.axes)

    def __call__(self, link_rates: Sequence[Vec3], angles: Sequence[float]) -> list[float]:
        """(m) rad/s; NaN where a gyro is missing."""
        rates: list[float] = []
        for frame, start, parent, child in self._joints:
            s1, c1, s2, h, s3, c3 = frame.turn(angles, start)
            px, py, pz = frame.components(link_rates[parent])
            wx, wy, wz = frame.components(link_rates[child])
            m3, g1 = c1 * pz - s1 * py, c3 * wx - s3 * wy
            whole = (
                h * (g1 + s2 * m3) - px,
                s3 * wx + c3 * wy - c1 * py - s1 * pz,
                frame.sign * (wz - h * (s2 * g1 + m3)),
            )
            rates += whole[: frame.axes]
        return rates


def _secant(angle: float) -> float:
    """1 / cos, limited near gimbal lock."""
    cosine = math.cos(angle)
    return 1.0 / (cosine if abs(cosine) > _LEAST_COSINE else math.copysign(_LEAST_COSINE, cosine))
