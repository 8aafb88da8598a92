"""The filters of Yumbla et al. 2023 as they stand in the paper, in dense matrices: to hold ours against.

States and notation as in `jointest_ros.core.kckf.paper_reference`. Any unit of angle will do, but (13) means degrees.
Only the sign of (12) is corrected, which is an obvious slip.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.kckf.paper_reference import measurement, transition


def input_matrix(n: int, dt: float, axes: int = 3, printed: bool = False) -> FloatArray:
    """B, equation (12). `printed`: with the sign of its last block as printed, which contradicts (10)."""
    rows = np.zeros((2 * (n + 1), n + 1))
    for joint in range(n):
        rows[joint, joint : joint + 2] = (-dt, dt)
    rows[n, 0], rows[n, n] = -dt, -dt if printed else dt
    return np.asarray(np.kron(rows, np.eye(axes)))


def process_noise(n: int, dt: float, axes: int = 3, cross_sign: float = 1.0) -> FloatArray:
    """Q, equation (13), deg^2. `cross_sign` -1 is the sign that belongs to (11); with (16) it is not stable."""
    cross = cross_sign * dt**3 / 2.0
    return np.asarray(np.kron([[dt**4 / 4.0, cross], [cross, dt**2]], np.eye(axes * (n + 1))))


class PaperFilter:
    """(3)-(20) with dense matrices; without `constrained` the paper's standard Kalman filter.

    Attributes:
        x: (2 axes (n + 1)) state; covariance: of it.
        innovation, innovation_covariance: of the newest correction, the constraint last.

    Args:
        rows: the angle state that each Hall reading measures, see `measurement`.
        sigma: standard deviation of a Hall angle.
        start: standard deviations of angles and biases at the start.
        cross_sign: see `process_noise`.
    """

    def __init__(
        self,
        n: int,
        rows: Sequence[int],
        axes: int = 3,
        constrained: bool = True,
        sigma: float = 3.2,
        start: tuple[float, float] = (10.0, 1.0),
        cross_sign: float = 1.0,
    ) -> None:
        self.n, self.axes, self.cross_sign = n, axes, cross_sign
        self.c = measurement(n, rows, axes, constrained)
        self.r = np.diag([sigma**2] * len(rows) + [0.0] * (len(self.c) - len(rows)))
        self.x = np.zeros(2 * axes * (n + 1))
        self.covariance = np.diag(np.repeat(np.square(start), axes * (n + 1)))

    def predict(self, dt: float, gyro: FloatArray) -> None:
        """`dt` s with the rates (n + 1, axes) of all links."""
        a = transition(self.n, dt, self.axes)
        self.x = a @ self.x + input_matrix(self.n, dt, self.axes) @ np.ravel(gyro)
        self.covariance = a @ self.covariance @ a.T + process_noise(self.n, dt, self.axes, self.cross_sign)

    def correct(self, angles: FloatArray) -> None:
        """Hall angles in the order of `rows`."""
        y = np.append(angles, np.zeros(len(self.c) - len(angles)))
        self.innovation = y - self.c @ self.x
        crossed = self.covariance @ self.c.T
        self.innovation_covariance = self.c @ crossed + self.r
        gain = np.linalg.solve(self.innovation_covariance, crossed.T).T
        self.x = self.x + gain @ self.innovation
        self.covariance = self.covariance - gain @ crossed.T

    @property
    def angles(self) -> FloatArray:
        """(n, axes) of the joints."""
        return self.x[: self.axes * self.n].reshape(self.n, self.axes)

    @property
    def torso(self) -> FloatArray:
        """(axes) phi."""
        return self.x[self.axes * self.n : self.axes * (self.n + 1)]
