"""Offline runs tell of an IMU that slipped, as the diagnostics of a node do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from scipy.spatial.transform import Rotation

from jointest_ros.bags import offline, synthetic
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.timing import Timing
from jointest_ros.sim.finger import simulate


@pytest.mark.parametrize("angle_deg", [0.0, 12.0])
def test_a_slip_is_a_warning(angle_deg: float, tmp_path: Path) -> None:
    recorded = simulate("still", rate_hz=100.0, duration_s=15.0)
    accel = recorded.recording.accel["distal"].copy()
    accel[900:] = Rotation.from_euler("x", angle_deg, degrees=True).apply(accel[900:])
    recording = replace(recorded.recording, accel={**recorded.recording.accel, "distal": accel})
    with BagWriter(tmp_path / "bag") as writer:
        for topic, msgtype in synthetic.topics(recorded.robot).items():
            writer.add_topic(f"/{topic}", msgtype)
        for stamp, topic, data in synthetic.messages([replace(recorded, recording=recording)]):
            writer.write(f"/{topic}", stamp, data)
    estimators = {"pcf": Pcf(recorded.robot, PcfParams(zero_at_start=True))}
    with BagReader(tmp_path / "bag") as reader:
        outcome = offline.run(reader, Intake(recorded.robot, Timing()), estimators, lambda name, estimates: None)
    expected = [f"{tmp_path}/bag: pcf: IMU distal: turned by "] if angle_deg else []
    assert [text[: len(start)] for text, start in zip(outcome.warnings, expected, strict=True)] == expected
