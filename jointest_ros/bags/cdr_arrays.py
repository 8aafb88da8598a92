"""Many messages of one publisher at once out of their CDR bytes: the same checks and numbers as `cdr`, as arrays.

What such messages do not share (length, frame id, layout) or what makes one of them malformed gives None: they are then
decoded one by one, which tells what is wrong with which.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointest_ros.bags.cdr import (
    CDR_LE,
    IMU_LAYOUTS,
    NANOSECONDS,
    Dims,
    decode_float32_multiarray,
    decode_imu,
    float32_multiarray_head,
)
from jointest_ros.bags.errors import CdrError
from jointest_ros.core.frame import FloatArray

_FRAME_ID = 12  # offset of its length
_Fields = dict[str, tuple[str, int]]  # name -> numpy type, offset


def decode_imus(messages: Sequence[bytes]) -> tuple[NDArray[np.int64], str, FloatArray, FloatArray] | None:
    """`cdr.decode_imu` of n messages, at least one, all of one frame id: stamps (n,), frame id, gyro, accel (n, 3)."""
    first = messages[0]
    try:
        frame_id = decode_imu(first)[1]
    except CdrError:
        return None
    layout = IMU_LAYOUTS[first[_FRAME_ID : _FRAME_ID + 4]]
    size = 4 + int.from_bytes(first[_FRAME_ID : _FRAME_ID + 4], "little")
    rows = _rows(
        messages,
        {
            "identifier": ("<u2", 0),
            "sec": ("<i4", 4),
            "nanosec": ("<u4", 8),
            "frame_id": (f"({size},)u1", _FRAME_ID),
            "gyro": ("(3,)<f8", layout.size - 2 * 96),  # each is followed by a covariance: 12 doubles
            "accel": ("(3,)<f8", layout.size - 96),
        },
    )
    if (
        rows is None
        or (rows["identifier"] != CDR_LE).any()
        or (rows["nanosec"] >= NANOSECONDS).any()
        or (rows["frame_id"] != rows["frame_id"][0]).any()
    ):
        return None
    stamps = rows["sec"].astype(np.int64) * NANOSECONDS + rows["nanosec"]
    return stamps, frame_id, np.array(rows["gyro"], dtype=float), np.array(rows["accel"], dtype=float)


def decode_float32_multiarrays(messages: Sequence[bytes]) -> tuple[FloatArray, Dims] | None:
    """`cdr.decode_float32_multiarray` of n messages, at least one, all of one layout: values (n, width), dimensions."""
    first = messages[0]
    try:
        values, dims = decode_float32_multiarray(first)
    except CdrError:
        return None
    head = float32_multiarray_head(first)
    if head is None or not values:
        return None
    fields = {
        "identifier": ("<u2", 0),
        "head": (f"({len(head)},)u1", 4),
        "values": (f"({len(values)},)<f4", 4 + len(head)),
    }
    rows = _rows(messages, fields)
    if rows is None or (rows["identifier"] != CDR_LE).any() or (rows["head"] != rows["head"][0]).any():
        return None
    return rows["values"].astype(float), dims


def _rows(messages: Sequence[bytes], fields: _Fields) -> NDArray[Any] | None:
    """The fields of messages of one length; None where they have several."""
    size = len(messages[0])
    if set(map(len, messages)) != {size}:
        return None
    kind = np.dtype(
        {
            "names": list(fields),
            "formats": [form for form, _ in fields.values()],
            "offsets": [offset for _, offset in fields.values()],
            "itemsize": size,
        }
    )
    return np.frombuffer(b"".join(messages), dtype=kind)
