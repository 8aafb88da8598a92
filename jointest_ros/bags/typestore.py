"""The message definitions that `rosbags` brings along, and what only its general deserialiser can read."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TypeVar

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from jointest_ros.bags.errors import CdrError, UnknownEncoding

DecodedT = TypeVar("DecodedT")


@cache
def typestore() -> Typestore:
    """The message definitions of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def as_little_endian(data: bytes, msgtype: str) -> bytes:
    """The same message as CDR little endian, for the decoders of `cdr` that raised `UnknownEncoding`.

    It knows CDR big endian. It is 20 times slower than decoding; such bags are rare.

    Raises:
        CdrError: the bytes are malformed, or in an encoding that is not known here either.
    """
    try:
        message = typestore().deserialize_cdr(data, msgtype)
        return bytes(typestore().serialize_cdr(message, msgtype, little_endian=True))
    except Exception as error:  # its generated code raises whatever damaged bytes make it trip over
        raise CdrError(f"{msgtype}: {error}") from None


def decoded(decode: Callable[[bytes], DecodedT], data: bytes, msgtype: str) -> DecodedT:
    """What a decoder of `cdr` makes of a message, also in an encoding that only the general deserialiser knows.

    Raises:
        CdrError: see `as_little_endian`.
    """
    try:
        return decode(data)
    except UnknownEncoding:
        return decode(as_little_endian(data, msgtype))
