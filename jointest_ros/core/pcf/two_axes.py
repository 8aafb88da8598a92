"""What the geometry of a joint of two axes says of the rotation about gravity, which accelerometers do not show.

With T the rotation from the zero pose, both axes in the child's sensor: T j2 keeps its angle to j1, as it turns about
j1 alone. A turn of T by d about gravity g, as the child has it, changes that:

    c = j1 . T j2 - j1 . j2,    dc/dd = s = g . (j2 x T^T j1)

so d is seen where both axes are across gravity (a hip of somebody who stands), and not where gravity lies in their
plane. There -c s g is the least-squares correction. The constraint is that of Laidig, Lehmann, Begin, Seel 2017
("Magnetometer-free realtime inertial motion tracking by exploitation of kinematic constraints in 2-DoF joints"), used
here as a third direction of Algorithm 2.
"""

from __future__ import annotations

import math

from jointest_ros.core.frame import Quat, Vec3
from jointest_ros.core.pcf.attitude import STILL, angle_about
from jointest_ros.core.rotation import about, cross, dot, multiply, norm, rotate, rotate_inverse, unit, wrap

LEAST = 0.25  # s^2 (30 deg): below it an error of the axes by 1 deg would become one of more than 2 deg
_LEAST_LENGTH2 = 0.03  # (10 deg): what is across an axis tells the angle about it from here on


class TwoAxes:
    """The module text for one joint, from R12 (child sensor to parent sensor)."""

    def __init__(self, axes: tuple[Vec3, ...], at_zero: Quat, middles: tuple[float, ...]) -> None:
        """`axes` in the child's sensor, `at_zero` R12 at the zero pose, `middles` of the ranges, rad."""
        self._first, self._second = axes
        self._in_parent = rotate(at_zero, self._first)
        self._cosine = dot(*axes)
        self._middles = middles

    def correction(self, r12: Quat, accel: Vec3) -> tuple[Vec3, float]:
        """(-c s g rad, s^2), g by the child's accelerometer; zeros below `LEAST`."""
        first, second, length = rotate_inverse(r12, self._in_parent), self._second, norm(accel)
        s = dot(accel, cross(second, first)) / length if length > 0.0 else 0.0
        if s * s < LEAST:
            return STILL, 0.0
        k = (self._cosine - dot(first, second)) * s / length
        return (k * accel[0], k * accel[1], k * accel[2]), s * s

    def from_gravity(self, a1: Vec3, a2: Vec3) -> Quat | None:
        """T that turns the child's gravity a2 into a1, the parent's at the zero pose; None where that tells too little.

        j1 . a1 = j1 . exp(j2 q2) a2 has two solutions: the one nearer to the middles of the ranges is taken.
        """
        j1, j2, cosine = self._first, self._second, self._cosine
        if norm(a1) * norm(a2) == 0.0:
            return None
        a1, a2 = unit(a1), unit(a2)
        above, along = dot(j1, a1), dot(j2, a2)
        p, q = dot(j1, a2) - along * cosine, dot(j1, cross(j2, a2))
        reach2 = p * p + q * q
        if 1.0 - above * above < _LEAST_LENGTH2 or reach2 < _LEAST_LENGTH2:
            return None
        middle = math.atan2(q, p)
        side = math.acos(max(-1.0, min(1.0, (above - along * cosine) / math.sqrt(reach2))))
        nearest, least = None, math.inf
        for two in (middle - side, middle + side):
            turned = about(j2, two)
            one = angle_about(j1, rotate(turned, a2), a1)
            far = sum(wrap(angle - middle) ** 2 for angle, middle in zip((one, two), self._middles, strict=True))
            if far < least:
                nearest, least = multiply(about(j1, one), turned), far
        return nearest
