"""The filters of Yumbla et al. 2023 as they stand in the paper, for tests and `reproduce`; `kckf` is what to use.

n joints, n + 1 links. `axes` = 3 is the paper's form of 6n + 6 states, each block of which is I_3; `axes` = 1 is one of
the three equal filters of 2n + 2 states into which it falls. State (7): theta_1 .. theta_n, phi, b_1 .. b_n, b_phi.
Any unit of angle will do, but (13) means degrees. Only the sign of (12) is corrected, which is an obvious slip.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jointest_ros.core.frame import FloatArray


def transition(n: int, dt: float, axes: int = 3) -> FloatArray:
    """A, equation (11)."""
    identity = np.eye(axes * (n + 1))
    return np.asarray(np.block([[identity, -dt * identity], [np.zeros_like(identity), identity]]))


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


def measurement(n: int, rows: Sequence[int], axes: int = 3, constrained: bool = True) -> FloatArray:
    """C: one row for each reading of the angle states `rows`, and (19), (17) where `constrained`.

    The paper's (8) is rows = 0, 1, 2, 0, 1, 2, 3, 4, 5, ...: two sensors of three angles for each joint.
    """
    states = 2 * axes * (n + 1)
    hall = np.zeros((len(rows), states))
    hall[range(len(rows)), list(rows)] = 1.0
    if not constrained:
        return hall
    constraint = np.kron(np.append(np.append(np.ones(n), -1.0), np.zeros(n + 1)), np.eye(axes))
    return np.vstack([hall, constraint])


def pair_rows(n: int, axes: int = 3) -> list[int]:
    """`rows` of `measurement` for the paper's (8)."""
    return [axes * joint + axis for joint in range(n) for _ in range(2) for axis in range(axes)]


def observability_rank(a: FloatArray, c: FloatArray) -> int:
    """Rank of (21)."""
    blocks = [c]
    for _ in range(len(a) - 1):
        blocks.append(blocks[-1] @ a)
    return int(np.linalg.matrix_rank(np.vstack(blocks)))


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
