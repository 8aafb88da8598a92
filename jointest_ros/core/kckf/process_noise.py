"""Process noise of joint angles and gyro biases: of the data sheet, or the paper's equation (13).

physical   Two neighbouring joints share a gyro, so their noises are correlated: Q_theta = N^2 dt M M^T and
           Q_b = K^2 dt M M^T, M the rows `w_child - w_parent` (N noise density, K bias walk of each gyro), with the
           terms of third and second order in dt by van Loan.
paper      Q13 = [[dt^4/4, dt^3/2], [dt^3/2, dt^2]] deg^2 with the plus sign as printed. The perfect constraint (16)
           leaves of it the part in which the constraint holds: Q13 (x) (I - E^T (I + E E^T)^-1 E), E the axes as
           columns; for n coaxial joints that is I - 11^T / (n + 1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.kckf.linkage import Linkage

PAPER_SCALE = math.radians(1.0) ** 2
Scalar = TypeVar("Scalar", float, FloatArray)


@dataclass(frozen=True)
class ProcessNoise:
    """Noise that enters m angles and their m bias differences (b = bias of the child minus that of the parent).

    Attributes:
        paper: equation (13) instead of the data sheet.
        white: (m, m) rad^2/s, 0 for `paper`.
        walk: (m, m) rad^2/s^3; for `paper` the factor of Q13, rad^2.
        angle_prior, bias_prior: (m, m) correlation of the start values.
    """

    paper: bool
    white: FloatArray
    walk: FloatArray
    angle_prior: FloatArray
    bias_prior: FloatArray

    @classmethod
    def physical(cls, linkage: Linkage) -> ProcessNoise:
        """From the figures of the gyros."""
        rows = linkage.gyro_rows
        density, walk = (
            np.repeat([getattr(gyro, name) ** 2 for gyro in linkage.gyros], 3)
            for name in ("gyro_noise", "gyro_bias_walk")
        )
        return cls(False, rows * density @ rows.T, rows * walk @ rows.T, np.eye(len(rows)), 0.5 * rows @ rows.T)

    @classmethod
    def of_paper(cls, linkage: Linkage) -> ProcessNoise:
        """Equation (13) under the constraint (16)."""
        axes = np.array(linkage.axes).T
        allowed = np.eye(axes.shape[1]) - axes.T @ np.linalg.solve(np.eye(3) + axes @ axes.T, axes)
        return cls(True, np.zeros_like(allowed), PAPER_SCALE * allowed, allowed, allowed)

    def without_constraint(self) -> ProcessNoise:
        """The noise of a filter that knows the joints one by one: nothing is correlated, and (13) is left whole."""
        unit = np.eye(len(self.walk))
        if self.paper:
            return ProcessNoise(True, self.white, PAPER_SCALE * unit, unit, unit)
        return ProcessNoise(False, self.white * unit, self.walk * unit, unit, unit)

    @property
    def independent(self) -> bool:
        """No two coordinates have common noise."""
        return all(np.allclose(m, np.diag(np.diag(m)), atol=1e-12 * np.abs(m).max()) for m in (self.white, self.walk))


def increments(paper: bool, white: Scalar, walk: Scalar, dt: float) -> tuple[Scalar, Scalar, Scalar]:
    """What `dt` s add to the covariance of angles, to that of angles with biases, and to that of biases."""
    if paper:
        return walk * (dt**4 / 4.0), walk * (dt**3 / 2.0), walk * dt**2
    return white * dt + walk * (dt**3 / 3.0), walk * (-(dt**2) / 2.0), walk * dt
