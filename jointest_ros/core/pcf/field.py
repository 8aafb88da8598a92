"""Notices when a magnetometer is disturbed: its norm or its dip is off the reference.

Norm and sine of the dip (field against the accelerometer) are averaged over AVERAGE s, which lets brief accelerations
pass. The reference is configured, or the mean of what was measured at rest, until LEARN s of it are gathered; without
any the sensor counts as sound. A disturbed sensor is sound again when it has been within the tolerances for QUIET s.
"""

from __future__ import annotations

import math
from typing import Any

from jointest_ros.core.frame import Vec3
from jointest_ros.core.pcf.settings import Field
from jointest_ros.core.robot import STANDARD_GRAVITY
from jointest_ros.core.rotation import dot, norm

AVERAGE, LEARN, QUIET = 0.5, 2.0, 0.5  # s
_REST_RATE = 0.1  # rad/s, gyro at rest, a bias included
_REST_ACCEL = 0.5  # m/s^2, by which the accelerometer differs from g at rest
_STATE = ("stamp", "norm", "sine", "reference_norm", "reference_sine", "learnt", "quiet", "disturbed")


class FieldWatch:
    """One magnetometer.

    Attributes:
        reference_norm, reference_sine: tesla, and sine of the dip; NaN while unknown.
    """

    stamp: int | None  # ns, of the newest sample

    def __init__(self, settings: Field) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget the reference too, where it was learnt."""
        configured = self._settings.norm > 0.0
        self.reference_norm = self._settings.norm if configured else math.nan
        self.reference_sine = math.sin(self._settings.dip) if configured else math.nan
        self.learnt = LEARN if configured else 0.0  # s
        self.restart()

    def restart(self) -> None:
        """Start afresh from the next sample; the reference is kept."""
        self.stamp = None
        self.norm = self.sine = math.nan  # averages
        self.quiet = 0.0  # s within the tolerances
        self.disturbed = False

    def sound(self, stamp: int, gyro: Vec3, accel: Vec3, field: Vec3) -> bool:
        """Take a sample, with gyro (rad/s) and accelerometer of the same frame; False: it is not to be used."""
        length, force = norm(field), norm(accel)
        sine = -dot(field, accel) / (length * force) if length * force > 0.0 else 0.0
        elapsed = 0.0 if self.stamp is None else min((stamp - self.stamp) * 1e-9, AVERAGE)
        if self.stamp is None:
            self.norm, self.sine = length, sine
        self.norm += (length - self.norm) * elapsed / AVERAGE
        self.sine += (sine - self.sine) * elapsed / AVERAGE
        self.stamp = stamp
        if self.learnt < LEARN and norm(gyro) < _REST_RATE and abs(force - STANDARD_GRAVITY) < _REST_ACCEL:
            self._learn(length, sine, elapsed)
        within = math.isnan(self.reference_norm) or (
            abs(self.norm - self.reference_norm) <= self._settings.norm_tolerance * self.reference_norm
            and abs(_arcsine(self.sine) - _arcsine(self.reference_sine)) <= self._settings.dip_tolerance
        )
        self.quiet = self.quiet + elapsed if within else 0.0
        self.disturbed = not within or (self.disturbed and self.quiet < QUIET)
        return not self.disturbed

    def _learn(self, length: float, sine: float, elapsed: float) -> None:
        """Mean of all samples at rest."""
        if not self.learnt and not elapsed:
            self.reference_norm, self.reference_sine = length, sine
            return
        self.learnt += elapsed
        share = elapsed / self.learnt if self.learnt else 1.0
        for name, value in (("reference_norm", length), ("reference_sine", sine)):
            before = getattr(self, name)
            setattr(self, name, value if math.isnan(before) else before + share * (value - before))

    def get_state(self) -> dict[str, Any]:
        """All that changes; None for NaN, which JSON does not have."""
        values = {name: getattr(self, name) for name in _STATE}
        return {name: None if value != value else value for name, value in values.items()}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`."""
        for name in _STATE:
            value = state[name]
            setattr(self, name, math.nan if value is None and name != "stamp" else value)


def _arcsine(sine: float) -> float:
    return math.asin(max(-1.0, min(1.0, sine)))
