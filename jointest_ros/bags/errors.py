"""What can go wrong with recordings and with the bytes of messages. Each prints as one line."""

from __future__ import annotations

from jointest_ros.core.errors import JointestError


class BagError(JointestError):
    """A recording cannot be found, read, understood or written. Always one line of text."""

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(part.strip() for part in message.splitlines()))


class CdrError(BagError):
    """Bytes that are not a well-formed message of the expected type."""


class UnknownEncoding(CdrError):
    """Bytes in another encoding than CDR little endian: a general deserialiser may still understand them."""
