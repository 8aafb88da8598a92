"""All that a recording holds for an inspection: its topics, and every inertial sensor, the Hall voltages, the truth."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointest_ros.bags.cdr import (
    FLOAT32_MULTIARRAY,
    IMU,
    MAGNETIC_FIELD,
    decode_float32_multiarray,
    decode_imu,
    decode_magnetic_field,
)
from jointest_ros.bags.errors import BagError, CdrError
from jointest_ros.bags.ground_truth import TruthReader
from jointest_ros.bags.intake import HALL_TOPIC
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.typestore import decoded, typestore
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.progress import Progress, no_progress
from jointest_ros.evaluation.inspection.stream import Stream
from jointest_ros.evaluation.truth import Truth

_ENOUGH = 500  # messages of a topic that show all of its frame ids
_REPORT = 4096  # messages between reports of progress


@dataclass
class Survey:
    """What a recording holds.

    Attributes:
        topics: message type and number of messages by topic.
        span: record times of the first and of the last message, ns.
        streams: one for each topic of sensor_msgs/Imu and frame id on it.
        fields: the same of sensor_msgs/MagneticField; the field is in `accel`, tesla.
        hall: record times (N,) ns and voltages by number of them (N, h); the most frequent number. None without any.
        truth: ground truth.
        undecodable: messages by topic that are not of their type.
        damage: why the recording could not be read to its end; empty when it could.
    """

    topics: dict[str, tuple[str, int]]
    span: tuple[int, int]
    streams: list[Stream] = field(default_factory=list)
    fields: list[Stream] = field(default_factory=list)
    hall: tuple[NDArray[np.int64], FloatArray] | None = None
    truth: Truth = field(default_factory=Truth)
    undecodable: dict[str, int] = field(default_factory=dict)
    damage: str = ""

    @property
    def duration(self) -> float:
        """From the first to the last message, s."""
        return (self.span[1] - self.span[0]) * 1e-9


class _Rows:
    """The messages of one topic with one frame id."""

    def __init__(self) -> None:
        self.stamps, self.recorded = array("q"), array("q")
        self.gyro, self.accel = array("d"), array("d")
        self.has_orientation = False

    def stream(self, topic: str, frame_id: str) -> Stream:
        stamps, recorded = (np.frombuffer(a, dtype=np.int64) for a in (self.stamps, self.recorded))
        accel = np.frombuffer(self.accel).reshape(-1, 3)
        gyro = np.frombuffer(self.gyro).reshape(-1, 3) if self.gyro else np.full_like(accel, np.nan)
        return Stream(topic, frame_id, stamps, recorded, gyro, accel, self.has_orientation)


def survey(reader: BagReader, namespace: str = "", progress: Progress = no_progress) -> Survey:
    """Read an open recording once; memory grows with its inertial messages, 64 bytes each."""
    found = Survey(
        {topic: (kind, reader.counts[topic]) for topic, kind in reader.topics.items()},
        (reader.start_ns, reader.start_ns + round(reader.duration_s * 1e9)),
        damage=reader.damage,
    )
    imus: dict[tuple[str, str], _Rows] = {}
    mags: dict[tuple[str, str], _Rows] = {}
    hall: dict[int, tuple[array[int], array[float]]] = {}
    truth = TruthReader(reader, namespace)
    handlers: dict[str, Callable[[bytes, int], None]] = dict(truth.handlers)
    for topic, kind in reader.topics.items():
        if kind == IMU:
            handlers[topic] = partial(_imu, imus, topic)
        elif kind == MAGNETIC_FIELD:
            handlers[topic] = partial(_mag, mags, topic)
    hall_topic = reader.resolve(HALL_TOPIC, namespace)
    if hall_topic is not None and reader.topics[hall_topic] == FLOAT32_MULTIARRAY:
        handlers[hall_topic] = partial(_hall, hall)
    total = sum(reader.counts[topic] for topic in handlers)
    try:
        for done, (topic, time, data) in enumerate(reader.messages(tuple(handlers)) if handlers else ()):
            try:
                handlers[topic](data, time)
            except CdrError:
                found.undecodable[topic] = found.undecodable.get(topic, 0) + 1
            if done % _REPORT == 0:
                progress(done, total)
    except BagError as error:
        found.damage = str(error)
    found.streams = [rows.stream(*key) for key, rows in sorted(imus.items())]
    found.fields = [rows.stream(*key) for key, rows in sorted(mags.items())]
    if hall:
        width, (times, values) = max(hall.items(), key=lambda item: len(item[1][0]))
        found.hall = np.frombuffer(times, dtype=np.int64), np.frombuffer(values).reshape(-1, width)
    found.truth = truth.truth()
    return found


def imu_sources(reader: BagReader, progress: Progress = no_progress) -> dict[str, list[str]]:
    """Frame ids on each topic of sensor_msgs/Imu, by the first messages of an open recording."""
    topics = [topic for topic, kind in reader.topics.items() if kind == IMU and reader.counts[topic]]
    found: dict[str, dict[str, int]] = {topic: {} for topic in topics}
    lacking = dict.fromkeys(topics, _ENOUGH)
    with suppress(BagError):  # a damaged one: what came before will do
        for topic, _, data in reader.messages(topics) if topics else ():
            if topic not in lacking:
                continue
            with suppress(CdrError):
                found[topic].setdefault(decode_imu(data)[1], 0)
            lacking[topic] -= 1
            if not lacking[topic]:
                del lacking[topic]
                progress(len(topics) - len(lacking), len(topics))
            if not lacking:
                break
    return {topic: list(ids) for topic, ids in found.items() if ids}


def _imu(table: dict[tuple[str, str], _Rows], topic: str, data: bytes, time: int) -> None:
    stamp, frame_id, gyro, accel = decoded(decode_imu, data, IMU)
    rows = table.get((topic, frame_id))
    if rows is None:
        rows = table[topic, frame_id] = _Rows()
        rows.has_orientation = _has_orientation(data)
    rows.stamps.append(stamp)
    rows.recorded.append(time)
    rows.gyro.extend(gyro)
    rows.accel.extend(accel)


def _has_orientation(data: bytes) -> bool:
    """A sensor_msgs/Imu says by a covariance that begins with -1 that it has none; many drivers send zeros instead."""
    try:
        message: Any = typestore().deserialize_cdr(data, IMU)
    except Exception:  # its generated code raises whatever damaged bytes make it trip over
        return False
    q = message.orientation
    return bool(message.orientation_covariance[0] >= 0.0 and 0.9 < abs(q.x) + abs(q.y) + abs(q.z) + abs(q.w) < 2.1)


def _mag(table: dict[tuple[str, str], _Rows], topic: str, data: bytes, time: int) -> None:
    stamp, frame_id, value = decoded(decode_magnetic_field, data, MAGNETIC_FIELD)
    rows = table.setdefault((topic, frame_id), _Rows())
    rows.stamps.append(stamp)
    rows.recorded.append(time)
    rows.accel.extend(value)


def _hall(table: dict[int, tuple[array[int], array[float]]], data: bytes, time: int) -> None:
    volts = decoded(decode_float32_multiarray, data, FLOAT32_MULTIARRAY)[0]
    if not volts:
        return
    times, values = table.setdefault(len(volts), (array("q"), array("d")))
    times.append(time)
    values.extend(volts)
