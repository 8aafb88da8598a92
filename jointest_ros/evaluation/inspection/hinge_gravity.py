"""What gravity tells of a hinge: where its axis is, whether it can be observed, whether it stays within its limits."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from jointest_ros.core.pcf.pair_checks import TILT_LIMIT
from jointest_ros.evaluation.inspection.findings import LOOK, WRONG, Finding
from jointest_ros.evaluation.inspection.hinge_motion import HingeMotion
from jointest_ros.evaluation.inspection.hinges import FAR, deg


def tilt_finding(motion: HingeMotion) -> Iterator[Finding]:
    """Do both accelerometers see the axis at the same elevation?"""
    if abs(motion.tilt) > TILT_LIMIT:
        one, two = (sensor.name for sensor in motion.pair.sensors)
        text = f"'{two}' sees the axis {deg(abs(motion.tilt))} {'higher' if motion.tilt > 0 else 'lower'} than '{one}'"
        level = WRONG if abs(motion.tilt) > FAR else LOOK
        action = f"a mounting is off ('{one}' or '{two}'), or an accelerometer: jointest calibrate axis, accel"
        yield Finding(level, motion.pair.joint.name, "tilt", text, action)


def gravity_finding(motion: HingeMotion, cone: float) -> Iterator[Finding]:
    """Is the joint observable: its axis not near the vertical?

    Args:
        cone: rad, `gravity_cone_deg` of pcf.
    """
    share = float(np.mean(motion.gravity < cone))
    if share > 0.1:
        text = f"its axis is within {deg(cone)} of vertical for {share:.0%} of the time: there the angle is gyro alone"
        action = "hold the robot so that the axis lies flatter, at least now and then; the angle drifts meanwhile"
        yield Finding(LOOK, motion.pair.joint.name, "observability", text, action)


def limits_finding(motion: HingeMotion, zero: float) -> Iterator[Finding]:
    """Do the angles stay within the configured limits?

    Args:
        zero: rad, that is subtracted: what the joint reads in the pose that becomes its zero pose.
    """
    joint = motion.pair.joint
    if joint.limits is None or joint.continuous:
        return
    (low, high), beyond = joint.limits[0], math.radians(10.0)
    middle = 0.5 * (low + high)
    angle = np.asarray(middle + np.angle(np.exp(1j * (motion.angle - zero - middle))))
    outside = float(np.mean((angle < low - beyond) | (angle > high + beyond)))
    if outside < 0.02:
        return
    first, last = np.degrees(np.quantile(angle, [0.01, 0.99]))
    allowed = f"{math.degrees(low):.0f} to {math.degrees(high):.0f}"
    text = f"it moves from {first:.0f} to {last:.0f} deg, limits_deg are {allowed}"
    inside_reversed = float(np.mean((-angle >= low - beyond) & (-angle <= high + beyond)))
    if inside_reversed > 0.98:
        action = "its positive direction is the other one (axis:), its sensors are exchanged, or the limits are"
        yield Finding(WRONG, joint.name, "limits", f"{text}: reversed", action)
        return
    action = "is its zero right (jointest calibrate zero)? Mounting, axis and limits_deg?"
    yield Finding(WRONG if outside > 0.5 else LOOK, joint.name, "limits", text, action)
