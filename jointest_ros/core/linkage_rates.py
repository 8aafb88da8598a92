"""Joint rates from link gyros: differences for hinges, kinematics for joints of more axes.

Errata of Yumbla et al. 2023, (2), (9), (10): theta' = w_child - R^T w_parent, R = rotation child to parent. For a hinge
the component along its axis needs no R; for a joint of two or three axes it does. With `composed=False` R is left out,
as the paper does.

A joint R = exp(th_1 a_1) .. exp(th_k a_k) turns at sum th_i' c_i in the child's frame, c_i the axis a_i carried there by
the later turns. d_i is the dual basis of c_i: th_i' = d_i . (w_child - R^T w_parent).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from jointest_ros.core.frame import FloatArray, Quat, Recording, Vec3
from jointest_ros.core.linkage import Linkage
from jointest_ros.core.robot import Sensor
from jointest_ros.core.rotation import IDENTITY, cross, dot, multiply, rotate, rotate_inverse

NAN = math.nan
MISSING: Vec3 = (NAN, NAN, NAN)
_LEAST_DETERMINANT = 0.02  # of the columns c: closer to gimbal lock the rates are damped

Columns = Sequence[Vec3]


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
            whole = np.isfinite(rates).all(axis=1)
            tables[name] = [(x, y, z) for x, y, z in np.where(whole[:, None], rates, NAN).tolist()]
        return [self.of_frame(dict(zip(tables, row, strict=True))) for row in zip(*tables.values(), strict=True)]


def turn(axis: Vec3, angle: float) -> Quat:
    """exp(angle axis) for a unit axis."""
    s = math.sin(0.5 * angle)
    return (axis[0] * s, axis[1] * s, axis[2] * s, math.cos(0.5 * angle))


def joint_frame(axes: Columns, angles: Sequence[float]) -> tuple[Quat, list[Vec3], list[Vec3]]:
    """Rotation child to parent, the columns c and their dual basis d (both in the child's frame) of one joint."""
    rotation = turn(axes[-1], angles[-1])
    columns = [axes[-1]]
    for axis, angle in zip(axes[-2::-1], angles[-2::-1], strict=True):
        columns.insert(0, rotate_inverse(rotation, axis))
        rotation = multiply(turn(axis, angle), rotation)
    return rotation, columns, _dual(columns)


def _dual(c: Columns) -> list[Vec3]:
    if len(c) == 1:
        return [c[0]]
    if len(c) == 2:
        cosine = dot(c[0], c[1])
        scale = 1.0 / (1.0 - cosine * cosine)
        return [_combined(scale, c[0], -scale * cosine, c[1]), _combined(scale, c[1], -scale * cosine, c[0])]
    first = cross(c[1], c[2])
    determinant = dot(c[0], first)
    if abs(determinant) < _LEAST_DETERMINANT:
        determinant = math.copysign(_LEAST_DETERMINANT, determinant)
    scale = 1.0 / determinant
    return [(v[0] * scale, v[1] * scale, v[2] * scale) for v in (first, cross(c[2], c[0]), cross(c[0], c[1]))]


def _combined(a: float, v: Vec3, b: float, w: Vec3) -> Vec3:
    return (a * v[0] + b * w[0], a * v[1] + b * w[1], a * v[2] + b * w[2])


def relative_rate(rotation: Quat, parent: Vec3, child: Vec3) -> Vec3:
    """w_child - R^T w_parent, child's frame, rad/s."""
    x, y, z = rotate_inverse(rotation, parent)
    return (child[0] - x, child[1] - y, child[2] - z)


class ComposedRates:
    """Rates of all coordinates from the gyros of the links and the present angles."""

    def __init__(self, linkage: Linkage) -> None:
        self._joints: list[tuple[Columns, slice, int, int]] = []
        start = 0
        for joint in linkage.joints:
            self._joints.append((joint.axes, slice(start, start + len(joint.axes)), *linkage.ends[start]))
            start += len(joint.axes)

    def __call__(self, link_rates: Sequence[Vec3], angles: Sequence[float]) -> list[float]:
        """(m) rad/s; NaN where a gyro is missing."""
        rates: list[float] = []
        for axes, part, parent, child in self._joints:
            rotation, _, dual = joint_frame(axes, angles[part])
            relative = relative_rate(rotation, link_rates[parent], link_rates[child])
            rates += [dot(d, relative) for d in dual]
        return rates
