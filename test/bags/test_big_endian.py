"""A recording whose messages are all CDR big endian gives the same ground truth and Hall voltages as any other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from jointest_ros import config
from jointest_ros.bags.ground_truth import TruthReader
from jointest_ros.bags.hall_readings import read_hall
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.typestore import typestore
from jointest_ros.bags.writer import BagWriter
from jointest_ros.evaluation.truth import Truth

PROJECT = Path(__file__).resolve().parents[2]


def as_big_endian(source: Path, target: Path, imus: bool = True) -> Path:
    """A copy; without its IMUs (False) voltages are taken by their record times."""
    with BagReader(source) as reader, BagWriter(target) as writer:
        kept = {topic: kind for topic, kind in reader.topics.items() if imus or "Imu" not in kind}
        for topic, kind in kept.items():
            writer.add_topic(topic, kind)
        for topic, time, data in reader.messages(tuple(kept)):
            message = typestore().deserialize_cdr(data, kept[topic])
            big = bytes(typestore().serialize_cdr(message, kept[topic], little_endian=False))
            assert big[:2] == b"\x00\x00"
            writer.write(topic, time, big)
    return target


def read_truth(bag: Path) -> tuple[Truth, int]:
    with BagReader(bag) as reader:
        collected = TruthReader(reader, "")
        for topic, time, data in reader.messages(tuple(collected.handlers)):
            collected.handlers[topic](data, time)
    return collected.truth(), collected.refused


def test_ground_truth(tmp_path: Path) -> None:
    source = PROJECT / "bags" / "finger"
    (expected, _), (truth, refused) = read_truth(source), read_truth(as_big_endian(source, tmp_path / "big"))
    assert refused == 0 and len(truth.stamps) > 100
    assert (truth.stamps == expected.stamps).all()
    assert truth.position.keys() == expected.position.keys() and truth.orientation.keys() == expected.orientation.keys()
    for name, angles in expected.position.items():
        np.testing.assert_array_equal(truth.position[name], angles)
    for name, (_, quaternions) in expected.orientation.items():
        np.testing.assert_array_equal(truth.orientation[name][1], quaternions)


def test_hall_voltages_without_imus(tmp_path: Path) -> None:
    source, loaded = PROJECT / "bags" / "exoshell", config.load(PROJECT / "config" / "exoshell.yaml")
    robot = replace(loaded.robot, sensors=())
    with BagReader(source) as reader:
        expected = read_hall(reader, robot, loaded.timing)
    with BagReader(as_big_endian(source, tmp_path / "big", imus=False)) as reader:
        found = read_hall(reader, robot, loaded.timing)
    assert len(found.volts) > 100
    np.testing.assert_array_equal(found.stamps, expected.stamps)
    np.testing.assert_array_equal(found.volts, expected.volts)
