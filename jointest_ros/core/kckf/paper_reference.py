"""The model of Yumbla et al. 2023 as it stands in the paper, and its observability; `kckf` is what to use.

n joints, n + 1 links. `axes` = 3 is the paper's form of 6n + 6 states, each block of which is I_3; `axes` = 1 is one of
the three equal filters of 2n + 2 states into which it falls. State (7): theta_1 .. theta_n, phi, b_1 .. b_n, b_phi.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jointest_ros.core.frame import FloatArray


def transition(n: int, dt: float, axes: int = 3) -> FloatArray:
    """A, equation (11)."""
    identity = np.eye(axes * (n + 1))
    return np.asarray(np.block([[identity, -dt * identity], [np.zeros_like(identity), identity]]))


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
