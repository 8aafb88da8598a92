"""The exceptions that a user can cause. Each prints as one clear line; the command line turns it into exit code 2."""


class JointestError(Exception):
    """Base of every error that bad input or a bad configuration can raise. Always one line of text."""

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(part.strip() for part in message.splitlines()))


class ConfigurationError(JointestError):
    """A parameter or a configuration is wrong: names the parameter, the value and what is allowed."""


class CalibrationError(JointestError):
    """A calibration is refused; the text says what is missing (stillness, motion, data)."""
