"""The exceptions that a user can cause. Each prints as one clear line; the command line turns it into exit code 2."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class JointestError(Exception):
    """Base of every error that bad input or a bad configuration can raise. Always one line of text."""

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(part.strip() for part in message.splitlines()))


class ConfigurationError(JointestError):
    """A parameter or a configuration is wrong: names the parameter, the value and what is allowed."""


class CalibrationError(JointestError):
    """A calibration is refused; the text says what is missing (stillness, motion, data)."""


def counted(number: int, thing: str) -> str:
    """`1 message`, `2 messages`."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def did_you_mean(name: str, names: Iterable[str], otherwise: str = "") -> str:
    """The end of a line about an unknown name: the one of `names` that is like it; `otherwise`: none is."""
    near = difflib.get_close_matches(name, list(names), n=1)
    return f"did you mean '{near[0]}'?" if near else otherwise
