"""The KCKF of joints with two or three axes, and of hinges that also use the gyro components off their axis.

As `coupled_filter`, with the biases of all gyros (3 g, link frames) as states: the bias of a relative rate turns
with the joint. The rates th' of linkage_rates.py, at the middle of the interval and of gyros without their biases, are
linearised in gyros and angles (A = d th' / d th):

        | -s2 m2 / c2   (s2 g1 + m3) / c2^2    -g2 / c2   |
    A = |   -m3                 0                  g1     |
        |  m2 / c2     -(g1 + s2 m3) / c2^2   s2 g2 / c2  |

Off-axis rates: those of locked axes are 0 but for noise. When the base moves, they tell the angles of the others. Their
noise is that of the gyros, which also drives the prediction (its cross-covariance is taken into account), and that of
gyros which are misaligned by `alignment`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.kckf.coupled_filter import CoupledFilter
from jointest_ros.core.kckf.linkage import Linkage
from jointest_ros.core.kckf.linkage_rates import JointFrame
from jointest_ros.core.rotation import norm


class ChainMotion:
    """The equations of the module text, linearised for one interval.

    Attributes:
        rates: (m) rad/s, biases subtracted.
        rows: (m, 3 g), rates by gyro components.
        slopes: (m, m), rates by angles.
        residuals, residual_rows, residual_slopes: (r), (r, 3 g), (r, m): of the r locked axes; none unless `off_axis`.
        residual_scale: (r) rate of the parent, at which a misalignment acts, rad/s.
    """

    def __init__(self, linkage: Linkage, off_axis: bool) -> None:
        self._joints: list[tuple[JointFrame, int, int, int]] = []
        n, width = len(linkage.joints), 3 * len(linkage.links)
        active: list[int] = []
        rows, slopes = [], []
        start = 0
        for number, joint in enumerate(linkage.joints):
            parent, child = linkage.ends[start]
            self._joints.append((JointFrame.of(joint.axes), start, parent, child))
            both = [*range(3 * child, 3 * child + 3), *range(3 * parent, 3 * parent + 3)]
            own = range(3 * number, 3 * number + 3)
            rows += [row * width + column for row in own for column in both]
            slopes += [row * 3 * n + column for row in own for column in own]
            active += own[: len(joint.axes)]
            start += len(joint.axes)
        # all three axes of every joint; the locked ones among them
        self._all_rows, self._all_slopes = np.zeros((3 * n, width)), np.zeros((3 * n, 3 * n))
        self._row_places, self._slope_places = np.array(rows), np.array(slopes)
        self._active = np.array(active)
        self._locked = np.setdiff1d(np.arange(3 * n), active) if off_axis else np.empty(0, dtype=np.int64)
        self.residual_rows = np.zeros((len(self._locked), width))
        self.residual_slopes = np.zeros((len(self._locked), len(active)))
        self.residual_scale = np.zeros(len(self._locked))
        links = len(linkage.links)
        self.linearise([(0.0, 0.0, 0.0)] * links, [0.0] * width, [0.0] * len(active), [True] * links)

    def linearise(
        self, gyro: Sequence[Vec3], bias: Sequence[float], angles: Sequence[float], trusted: Sequence[bool]
    ) -> None:
        """At the gyros of g links (rad/s, link frames), their biases (3 g) and the angles (m) of mid-interval.

        Off-axis rates are left out between links that are not both `trusted` (g).
        """
        true = [
            (x - bias[k], y - bias[k + 1], z - bias[k + 2])
            for k, (x, y, z) in zip(range(0, len(bias), 3), gyro, strict=True)
        ]
        rates: list[float] = []
        rows: list[float] = []
        slopes: list[float] = []
        for frame, start, parent, child in self._joints:
            e = frame.sign
            s1, c1, s2, h, s3, c3 = frame.turn(angles, start)
            px, py, pz = frame.components(true[parent])
            wx, wy, wz = frame.components(true[child])
            t, eh = h * s2, e * h
            m2, m3 = c1 * py + s1 * pz, c1 * pz - s1 * py
            g1, g2 = c3 * wx - s3 * wy, s3 * wx + c3 * wy
            rates += (h * g1 + t * m3 - px, g2 - m2, e * (wz - t * g1 - h * m3))
            one = (h * c3, -h * s3, 0.0, -1.0, -t * s1, t * c1)
            two = (s3, c3, 0.0, 0.0, -c1, -s1)
            three = (-e * t * c3, e * t * s3, e, 0.0, eh * s1, -eh * c1)
            rows += frame.vectors(one + two + three)
            slopes += (-t * m2, h * (t * g1 + h * m3), -eh * g2)
            slopes += (-m3, 0.0, e * g1)
            slopes += (eh * m2, -eh * (h * g1 + t * m3), t * g2)
        self._all_rows.put(self._row_places, rows)
        self._all_slopes.put(self._slope_places, slopes)
        if len(self._active) == len(rates):
            self.rates, self.rows, self.slopes = rates, self._all_rows, self._all_slopes
        else:
            self.rates = [rates[k] for k in self._active]
            self.rows = self._all_rows[self._active]
            self.slopes = self._all_slopes[self._active[:, None], self._active]
        locked = self._locked
        if len(locked) and not all(trusted):
            kept = np.array([trusted[parent] and trusted[child] for _, _, parent, child in self._joints])
            locked = locked[kept[locked // 3]]
        self.residuals = np.array(rates)[locked]
        if len(locked):
            self.residual_rows = self._all_rows[locked]
            self.residual_slopes = self._all_slopes[locked[:, None], self._active]
            parents = np.array([norm(true[parent]) for _, _, parent, _ in self._joints])
            self.residual_scale = parents[locked // 3]


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
        self._gyro_noise, self._alignment = gyro_noise, alignment
        super().__init__(*args, **kwargs)
        self._settles = False
        m, both, n = self.m, self.m + self.d, len(self.x)
        self._of_angles = np.zeros((m, n))  # rows of the transition
        self._by_angles, self._by_biases = self._of_angles[:, :m], self._of_angles[:, m:both]
        self._walk = np.zeros(n)  # of every state, per second
        self._walk[m:both] = gyro_walk
        if self._offset_walk is not None:
            self._walk[both:] = self._offset_walk**2
        self._identity, self._no_bias = np.eye(m), np.zeros(m)

    def _biases(self) -> int:
        return len(self._gyro_noise)

    def _bias_prior(self) -> FloatArray:
        return 0.5 * np.eye(self.d)  # so that the difference of two has the variance asked for

    def rate_biases(self) -> FloatArray:
        """(m,) zeros: the rates of `ChainMotion` have none."""
        return self._no_bias

    def _predict_state(self, dt: float, rates: FloatArray) -> None:
        self.x[: self.m] += dt * rates

    def _predict_covariance(self, dt: float, spread: FloatArray | None) -> None:
        m, rows, p = self.m, self.motion.rows, self.covariance
        np.multiply(self.motion.slopes, dt, out=self._by_angles)
        self._by_angles += self._identity
        np.multiply(rows, -dt, out=self._by_biases)
        # only the angles change: their rows of the transition are all that is not identity
        upper = self._of_angles @ p
        angles = upper @ self._of_angles.T
        angles += (rows * (dt * self._gyro_noise)) @ rows.T
        p[:m], p[m:, :m] = upper, upper[:, m:].T
        np.multiply(angles + angles.T, 0.5, out=p[:m, :m])
        p.ravel()[:: len(p) + 1] += dt * self._walk
        self._spread(spread)
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
        total += np.diag((self._alignment * motion.residual_scale) ** 2)
        self._apply(crossed, total, -motion.residuals)
