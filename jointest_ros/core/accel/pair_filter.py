"""What an estimator on accelerometer arrays needs of the filter of one joint: the interface of the paper's filters, of
the joint model and of the analytical angle.

Filters count as the paper does: th_ab = th_a - th_b, a the parent, b the child. The estimator turns the sign.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import Joint

UNKNOWN = math.pi**2 / 3.0  # rad^2, variance of an angle of which nothing is known
UNOBSERVABLE = 0.25  # rad^2, a larger variance says that the force at the joint is too weak to tell the angle


def first_branch(angle: float, joint: Joint, left: float | None = None) -> float:
    """th_ab with which a filter starts, of all `angle` + 2 pi n: within pi of the middle of the joint's limits.

    A continuous joint goes on from where the filter had to leave it, if it had.
    """
    middle = 0.0 if joint.limits is None else -0.5 * sum(joint.limits[0])
    if joint.continuous and left is not None:
        middle = left
    return middle - math.remainder(middle - angle, math.tau)


class PairFilter(Protocol):
    """Filter of one joint with C channels.

    Attributes:
        angle: th_ab, rad, continuous; the start is by `first_branch`.
        rates: w_a and w_b, rad/s.
        variance: of the angle, rad^2.
        status: STARTING and UNOBSERVABLE where they hold; the estimator adds missing sensors and gaps.
    """

    angle: float
    rates: tuple[float, float]
    variance: float
    status: int

    def step(self, dt: float, channels: FloatArray, variances: FloatArray) -> bool:
        """Predict over `dt` s (0 at the first frame; longer than the period where frames were lost), then correct.

        Args:
            dt: s since the frame before.
            channels: (C) m/s^2, in the order of `JointArrays.channels`; NaN: missing or not to be trusted.
            variances: (C) noise of the channels, (m/s^2)^2 a sample; the same object as long as nothing changes.

        Returns:
            False: the channels were too few to correct anything; it was a prediction only.
        """
        ...

    def restart(self) -> None:
        """Start the motion afresh from the next sample; what is known of biases is kept."""
        ...

    def innovations(self) -> Sequence[float]:
        """(C) of the newest step over their standard deviations; NaN: not used."""
        ...

    def biases(self) -> Sequence[float]:
        """(C) of the channels, m/s^2; empty where none are estimated."""
        ...

    def get_state(self) -> Any:
        """All that changes, as plain numbers, lists and dicts."""
        ...

    def set_state(self, state: Any) -> None:
        """Continue identically from `get_state`."""
        ...
