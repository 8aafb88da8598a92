"""Accelerometers whose samples are sound and still wrong: the diagnostics and the log say so, the estimates go on."""

from __future__ import annotations

from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from ros_bench import Bench, values
from without_ros import Message, assert_same, estimate, shown, simulated

from jointest_ros.bags.cdr import decode_imu
from jointest_ros.bags.cdr_encode import ImuEncoder
from jointest_ros.nodes import diagnostics

GOOD = simulated(scenario="PC", rate_hz=100.0, duration_s=4.0, zero_pose_s=1.5, seed=2)
VICTIM = "imu/middle"


def changed(data: bytes, factor: float, limit: float = 1e9) -> bytes:
    """The message with another acceleration."""
    stamp, frame_id, gyro, accel = decode_imu(data)
    x, y, z = (min(limit, max(-limit, factor * value)) for value in accel)
    return ImuEncoder(frame_id).encode(stamp, gyro, (x, y, z))


def test_units_and_saturation_are_in_the_diagnostics(
    bench: Bench, finger_config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(diagnostics, "PERIOD", 0.1)
    path = tmp_path / "robot.yaml"
    text = finger_config.read_text(encoding="utf-8")
    path.write_text(text.replace("distal: {", "distal: {accel_range_g: 1, "), encoding="utf-8")
    sent: list[Message] = []
    for topic, data in GOOD:
        new = changed(data, 1.0 / 9.81) if topic == VICTIM else data
        sent.append((topic, changed(data, 1.0, 9.80665) if topic == "imu/distal" else new))
    expected = estimate(sent, path)
    states = bench.listen()
    node = bench.estimator(path)
    reports, logs = bench.diagnostics(node), bench.log(node)
    names = {name: f"input {bench.namespace}/imu/{name}" for name in ("palm", "middle", "distal")}
    bench.send(node, sent[:1000])
    report = reports.until(lambda report: "in g" in report[names["middle"]].message)
    assert report[names["middle"]].level == DiagnosticStatus.WARN
    assert report[names["middle"]].message == "middle reads 1.00 at rest: is it in g instead of m/s^2?"
    for joint in ("finger_pip", "finger_dip"):  # on either side of it: not gravity, not the noise model
        text = report[f"joint {joint}"].message
        assert text.endswith("middle reads 1.00 at rest: is it in g instead of m/s^2?")
        assert not any(word in text for word in ("axis near gravity", "suspended", "noise model"))
    assert "middle reads" not in report["joint finger_mcp"].message
    (warning,) = bench.until(lambda: [log.msg for log in logs if "in g" in log.msg], "a warning")
    assert warning == f"{bench.namespace}/{VICTIM}: middle reads 1.00 at rest: is it in g instead of m/s^2?"

    bench.send(node, sent[1000:])
    report = reports.until(lambda report: values(report[names["palm"]])["messages"] == "400")
    assert values(report[names["palm"]])["saturated: palm"] == "0"
    counted = int(values(report[names["distal"]])["saturated: distal"])
    limit = 0.99 * 9.80665
    assert counted == sum(max(map(abs, decode_imu(data)[3])) >= limit for topic, data in sent if topic == "imu/distal")
    assert counted > 100
    bench.until(lambda: len(states) >= shown(expected[0]), "the joint states")
    assert_same(states, expected)


def test_saturation_is_told_while_it_lasts(
    bench: Bench, finger_config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(diagnostics, "PERIOD", 0.1)
    path = tmp_path / "robot.yaml"
    text = finger_config.read_text(encoding="utf-8")
    path.write_text(text.replace("distal: {", "distal: {accel_range_g: 2, "), encoding="utf-8")
    node = bench.estimator(path)
    reports = bench.diagnostics(node)
    name = f"input {bench.namespace}/imu/distal"
    bench.send(node, [(t, changed(data, 3.0, 19.6)) if t == "imu/distal" else (t, data) for t, data in GOOD[:400]])
    report = reports.until(lambda report: "saturated" in report[name].message)
    assert report[name].level == DiagnosticStatus.WARN
    assert report[name].message.endswith(" samples saturated at the full scale of 2 g")
    bench.send(node, GOOD[400:800])
    report = reports.until(lambda report: values(report[name])["messages"] == "200")
    assert values(report[name])["saturated: distal"] == "100"
    reports.until(lambda report: "saturated" not in report[name].message)
