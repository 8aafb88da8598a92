"""What an inspection says: one finding each, with what to do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

OK, LOOK, WRONG = "ok", "look", "wrong"
LEVELS = (WRONG, LOOK, OK)  # the worst first


@dataclass(frozen=True)
class Finding:
    """One finding.

    Attributes:
        level: `OK`, `LOOK` (may be as it should be: look at it) or `WRONG` (estimates will be, too).
        subject: the topic, sensor, joint or key that it is about.
        kind: what was judged, one word that stays the same: "units", "polarity", "axis", ...
        text: what was found.
        action: what to do; empty where all is well.
    """

    level: str
    subject: str
    kind: str
    text: str
    action: str = ""


@dataclass(frozen=True)
class Advice:
    """A setting that suits the recording better.

    Attributes:
        key: path of the key in the configuration.
        value: that it should have, as it is written there.
        reason: what was measured.
    """

    key: str
    value: str
    reason: str


def worst(findings: Iterable[Finding]) -> str:
    """The worst level among them."""
    levels = {finding.level for finding in findings}
    return next((level for level in LEVELS if level in levels), OK)


def at(seconds: float) -> str:
    """A time in a recording."""
    return f"{seconds:.1f} s"
