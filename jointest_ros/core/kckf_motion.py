"""The KCKF of joints with two or three axes, and of hinges that also use the gyro components off their axis.

As `kckf_coupled`, with the biases of all gyros (3 g, link frames) as states, because the bias of a relative rate turns
with the joint. In the names of linkage_rates.py, for each joint at the middle of the interval:

rate      theta_i' = d_i . (w_child - b_child - R^T (w_parent - b_parent))
slope     d theta_i' / d theta_j = d_i . t_j,  t_j = c_j x (R^T w_parent + sum_{l < j} theta_l' c_l)
off axis  0 = p . (w_child - b_child - R^T (w_parent - b_parent)) for every p perpendicular to all c_i: when the base
          moves, these rates tell the angle; slope p . t_j. Their noise is that of the gyros, which also drives the
          prediction (its cross-covariance is taken into account), and of gyros that are misaligned by `alignment`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.kckf_coupled import CoupledFilter
from jointest_ros.core.linkage import Linkage
from jointest_ros.core.linkage_rates import Columns, joint_frame, relative_rate
from jointest_ros.core.rotation import cross, dot, norm, perpendicular, rotate, unit

Rows = list[list[float]]


class ChainMotion:
    """The equations of the module text, linearised for one interval.

    Attributes:
        rates: (m) rad/s, before biases are subtracted.
        rows: (m, 3 g), rates by gyro components.
        slopes: (m, m), rates by angles.
        residuals, residual_rows, residual_slopes, residual_scale: (r), (r, 3 g), (r, m), (r): of the off-axis rates, and
            the rate of the parent at which a misalignment acts, rad/s.
    """

    def __init__(self, linkage: Linkage, off_axis: bool) -> None:
        self._off_axis = off_axis
        self._joints: list[tuple[Columns, int, int, int]] = []
        start = 0
        for joint in linkage.joints:
            self._joints.append((joint.axes, start, *linkage.ends[start]))
            start += len(joint.axes)
        residuals = sum(3 - len(joint.axes) for joint in linkage.joints) if off_axis else 0
        self.rates = [0.0] * start
        self.rows = np.zeros((start, 3 * len(linkage.links)))
        self.slopes = np.zeros((start, start))
        self.residuals = np.zeros(residuals)
        self.residual_rows = np.zeros((residuals, self.rows.shape[1]))
        self.residual_slopes = np.zeros((residuals, start))
        self.residual_scale = np.zeros(residuals)

    def linearise(self, gyro: Sequence[Vec3], bias: Sequence[float], angles: Sequence[float]) -> None:
        """At the gyros of g links (rad/s, link frames), their biases (3 g) and the angles (m) of mid-interval."""
        row = 0
        for axes, start, parent, child in self._joints:
            k, p, c = len(axes), 3 * parent, 3 * child
            rotation, columns, duals = joint_frame(axes, angles[start : start + k])
            inner, outer = gyro[parent], gyro[child]
            b, e = bias[p : p + 3], bias[c : c + 3]
            relative = relative_rate(rotation, inner, outer)
            carried = (inner[0] - b[0], inner[1] - b[1], inner[2] - b[2])
            x, y, z = relative_rate(rotation, carried, (outer[0] - e[0], outer[1] - e[1], outer[2] - e[2]))
            corrected = (x, y, z)
            # R^T w_parent of the corrected rates
            x, y, z = outer[0] - e[0] - x, outer[1] - e[1] - y, outer[2] - e[2] - z
            levers: list[Vec3] = []
            for column, dual in zip(columns, duals, strict=True):
                levers.append(cross(column, (x, y, z)))
                rate = dot(dual, corrected)
                x, y, z = x + rate * column[0], y + rate * column[1], z + rate * column[2]
            part = slice(start, start + k)
            self.rates[part] = [dot(dual, relative) for dual in duals]
            self.rows[part, c : c + 3] = duals
            self.rows[part, p : p + 3] = [_negative(rotate(rotation, dual)) for dual in duals]
            if k > 1:
                self.slopes[part, part] = [[dot(dual, lever) for lever in levers] for dual in duals]
            if self._off_axis:
                for normal in _normals(columns):
                    self.residuals[row] = dot(normal, relative)
                    self.residual_rows[row, c : c + 3] = normal
                    self.residual_rows[row, p : p + 3] = _negative(rotate(rotation, normal))
                    self.residual_slopes[row, part] = [dot(normal, lever) for lever in levers]
                    self.residual_scale[row] = norm(carried)
                    row += 1


def _negative(a: Vec3) -> Vec3:
    return (-a[0], -a[1], -a[2])


def _normals(columns: Columns) -> tuple[Vec3, ...]:
    if len(columns) == 1:
        return perpendicular(columns[0])
    return (unit(cross(columns[0], columns[1])),) if len(columns) == 2 else ()


class MotionFilter(CoupledFilter):
    """The filter of the module text. Set `motion` for the interval, then `step` with its rates.

    Args (beyond those of `CoupledFilter`):
        motion: equations of the chain.
        gyro_noise, gyro_walk: (3 g,) squares of density (rad^2/s) and bias walk (rad^2/s^3) of every gyro component.
        alignment: standard deviation of a misalignment between neighbouring gyros, rad.
    """

    def __init__(
        self,
        *args: Any,
        motion: ChainMotion,
        gyro_noise: FloatArray,
        gyro_walk: FloatArray,
        alignment: float,
        **kwargs: Any,
    ) -> None:
        self.motion = motion
        self._gyro_noise, self._gyro_walk, self._alignment = gyro_noise, gyro_walk, alignment
        super().__init__(*args, **kwargs)
        self._settles = False

    def _biases(self) -> int:
        return len(self._gyro_noise)

    def _bias_prior(self) -> FloatArray:
        return 0.5 * np.eye(self.d)  # so that the difference of two has the variance asked for

    def rate_biases(self) -> FloatArray:
        """(m,) biases of the joint rates in the present posture, rad/s."""
        return np.asarray(self.motion.rows @ self.x[self.m : self.m + self.d])

    def _predict_state(self, dt: float, rates: FloatArray) -> None:
        self.x[: self.m] += dt * (rates - self.rate_biases())

    def _predict_covariance(self, dt: float, spread: FloatArray | None) -> None:
        m, both = self.m, self.m + self.d
        rows, p = self.motion.rows, self.covariance
        step = np.concatenate([dt * self.motion.slopes, -dt * rows], axis=1)
        step[range(m), range(m)] += 1.0
        moved = step @ p[:both]
        p[:m, m:] = moved[:, m:]
        p[m:, :m] = moved[:, m:].T
        p[:m, :m] = moved[:, :both] @ step.T + (rows * (dt * self._gyro_noise)) @ rows.T
        p[range(m, both), range(m, both)] += dt * self._gyro_walk
        self._add_offset_walk(p, dt)
        self._finish_prediction(spread)
        if len(self.motion.residuals):
            self._correct_off_axis(dt)

    def _correct_off_axis(self, dt: float) -> None:
        motion, m, both = self.motion, self.m, self.m + self.d
        noise = self._gyro_noise / dt
        by_state = np.concatenate([motion.residual_slopes, -motion.residual_rows], axis=1)
        # the same gyro noise n: -dt n in the angles, n in the residuals
        crossed = self.covariance[:, :both] @ by_state.T
        common = dt * (motion.rows * noise) @ motion.residual_rows.T
        total = by_state @ crossed[:both] + (motion.residual_rows * noise) @ motion.residual_rows.T
        crossed[:m] += common
        by_noise = by_state[:, :m] @ common
        total += by_noise + by_noise.T
        innovation = motion.residual_rows @ self.x[m:both] - motion.residuals
        self._apply(crossed, total, (self._alignment * motion.residual_scale) ** 2, innovation)
