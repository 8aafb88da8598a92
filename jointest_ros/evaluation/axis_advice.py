"""What to do where a hinge's axis could not be identified, or not well."""

from __future__ import annotations

import math
from collections.abc import Iterator

from jointest_ros.evaluation.axis_fit import AxisFit

_STILL = math.radians(2.0)  # rad/s, rms: a joint or a link that moves less hardly moves
_NO_HINGE = 0.2  # share of the joint's rate in the misfit
_SLIGHT = 0.01  # share of the rates in the misfit, worth a word
_UNCERTAIN = math.radians(0.5)
_FAR = math.radians(45.0)


def refusal(fit: AxisFit) -> str:
    """Why the axes of this fit must not be used, and what to do; empty where they may."""
    unknown = [axis.sensor for axis in fit.axes if not axis.determined]
    parent = fit.parent.sensor
    stray = fit.misfit > _NO_HINGE * fit.joint_rate
    if not unknown:
        if stray and len(fit.pair.joint.axes) > 1:
            return _strays(fit, "two axes")
        if fit.signed:
            return ""
        one, two = (axis.sensor for axis in fit.axes)
        return (
            f"the motion does not show whether the axis in '{two}' points the same way as that in '{one}': "
            f"turn '{one}' about several directions while the joint moves"
        )
    where = " and ".join(f"'{name}'" for name in unknown)
    what = f"its axis in {where} is undetermined: "
    if fit.joint_rate < _STILL:
        return f"{what}the joint hardly moved ({_dps(fit.joint_rate)}); bend it while '{parent}' turns too"
    if stray:
        return what + _strays(fit, "one axis" if len(fit.pair.joint.axes) == 1 else "two axes")
    kept = f", or keep its mounting as configured: --keep {parent}" if unknown == [parent] else ""
    if fit.link_rates[0] < _STILL or fit.across_rate < _STILL:
        return (
            f"{what}'{parent}' hardly turned across it ({_dps(fit.across_rate)}); "
            f"turn it about several directions while the joint moves{kept}"
        )
    return f"{what}move joint and '{parent}' longer and further, about several directions{kept}"


def _strays(fit: AxisFit, axes: str) -> str:
    parent, child = (axis.sensor for axis in fit.axes)
    return (
        f"the motion is not about {axes} (residual {_dps(fit.residual)}); "
        f"are '{parent}' and '{child}' the sensors on either side?"
    )


def advice(fit: AxisFit) -> Iterator[str]:
    """What makes usable axes doubtful, one line each."""
    rate = max(fit.link_rates)
    if fit.misfit > _SLIGHT * rate:
        yield (
            f"a residual of {_dps(fit.misfit)} follows the motion ({fit.misfit / rate:.1%} of the rates): scale and "
            "cross-axis errors of the gyros, play, or an axis that wanders"
        )
    for axis in fit.axes:
        if axis.std > _UNCERTAIN:
            yield (
                f"the axis in '{axis.sensor}' is known to ± {math.degrees(axis.std):.1f} deg only; "
                "move longer and further, about several directions"
            )
        if axis.change > _FAR:
            yield (
                f"the axis in '{axis.sensor}' is {math.degrees(axis.change):.0f} deg from the configured one; "
                "check that the joint reads positive the way round that you mean"
            )


def _dps(rate: float) -> str:
    return f"{math.degrees(rate):.2f} deg/s rms"
