"""What can go wrong with recordings and with the bytes of messages. Each prints as one line."""

from __future__ import annotations

from jointest_ros.core.errors import JointestError


class BagError(JointestError):
    """A recording cannot be found, read, understood or written."""


class CdrError(BagError):
    """Bytes that are not a well-formed message of the expected type."""


class UnknownEncoding(CdrError):
    """Bytes in another encoding than CDR little endian: a general deserialiser may still understand them."""
