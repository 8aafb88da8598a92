"""Recordings with a mistake made on purpose, and what `jointest inspect` says of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from jointest_ros.bags.cdr import FLOAT32_MULTIARRAY, IMU, decode_float32_multiarray, decode_imu
from jointest_ros.bags.cdr_encode import ImuEncoder, encode_float32_multiarray
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter

Jointest = Callable[..., Any]


@dataclass(frozen=True)
class Message:
    """One sensor_msgs/Imu, or one message of Hall voltages (in `volts`)."""

    topic: str
    recorded: int
    stamp: int = 0
    frame_id: str = ""
    gyro: Any = None
    accel: Any = None
    volts: Any = None


Change = Callable[[Message, float], Iterator[Message] | Message | None]  # message, s since the start


def rewrite(source: Path, target: Path, change: Change) -> Path:
    """A copy of a recording with each message of a sensor changed, multiplied or left out."""
    with BagReader(source) as reader, BagWriter(target) as writer:
        start, added = reader.start_ns, set()

        def add(topic: str, kind: str) -> None:
            if topic not in added:
                writer.add_topic(topic, kind)
                added.add(topic)

        for topic, time, data in reader.messages():
            kind = reader.topics[topic]
            if kind == IMU:
                stamp, frame_id, gyro, accel = decode_imu(data)
                message = Message(topic, time, stamp, frame_id, np.array(gyro), np.array(accel))
            elif kind == FLOAT32_MULTIARRAY:
                message = Message(topic, time, volts=np.array(decode_float32_multiarray(data)[0]))
            else:
                add(topic, kind)
                writer.write(topic, time, data)
                continue
            changed = change(message, (time - start) * 1e-9)
            for one in () if changed is None else (changed,) if isinstance(changed, Message) else changed:
                add(one.topic, kind)
                if kind == IMU:
                    encoded = _encoder(one.frame_id).encode(one.stamp, tuple(one.gyro), tuple(one.accel))
                else:
                    encoded = encode_float32_multiarray(one.volts.tolist())
                writer.write(one.topic, one.recorded, encoded)
    return target


@lru_cache
def _encoder(frame_id: str) -> ImuEncoder:
    return ImuEncoder(frame_id)


def only(sensor: str, change: Callable[[Message, float], Any]) -> Change:
    """The change for the messages of one sensor; the others stay."""
    return lambda message, time: change(message, time) if message.topic == f"/imu/{sensor}" else message


def readings(sensor: str, gyro: Any = 1.0, accel: Any = 1.0) -> Change:
    """Readings of one sensor, or all ("*"), multiplied by a factor for each axis, or by a matrix."""

    def times(factor: Any, value: Any) -> Any:
        factor = np.asarray(factor)
        return factor @ value if factor.ndim == 2 else factor * value

    def change(message: Message, _time: float) -> Message:
        if message.volts is not None or (sensor != "*" and message.topic != f"/imu/{sensor}"):
            return message
        return replace(message, gyro=times(gyro, message.gyro), accel=times(accel, message.accel))

    return change


def exchanged(one: str, two: str) -> Change:
    """Two sensors publish on each other's topic."""
    names = {f"/imu/{one}": two, f"/imu/{two}": one}

    def change(message: Message, _time: float) -> Message:
        if message.topic not in names:
            return message
        other = names[message.topic]
        return replace(message, topic=f"/imu/{other}", frame_id=other)

    return change


def inspected(jointest: Jointest, folder: Path, *arguments: object) -> tuple[int, list[dict[str, str]]]:
    """Exit code and findings."""
    file = folder / "inspected.json"
    result = jointest("inspect", *arguments, "--json", file)
    assert result.err == ""
    return result.code, json.loads(file.read_text(encoding="utf-8"))["findings"]


def not_ok(findings: list[dict[str, str]]) -> list[tuple[str, str, str]]:
    """(level, subject, kind) of all that is not well."""
    return [(f["level"], f["subject"], f["kind"]) for f in findings if f["level"] != "ok"]
