"""How many messages of a topic were used: `counts` are those of `offline.Outcome.inputs`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_USUAL = 0.9  # share that is used when all is well


def unusual(counts: Mapping[str, Any]) -> bool:
    """So few that a user should know."""
    return bool(counts["used"] < _USUAL * counts["messages"])


def used_text(counts: Mapping[str, Any]) -> str:
    """Such as "10 of 12 messages used, 2 late"."""
    refused = "".join(f", {number} {cause}" for cause, number in counts["refused"].items())
    return f"{counts['used']} of {counts['messages']} messages used{refused}"
