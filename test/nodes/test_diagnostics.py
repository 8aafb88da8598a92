"""Who reads /diagnostics can tell a bad sensor from a bad filter, and what is missing until the robot is ready."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_bench import Bench, Report, queue, values
from sensor_msgs.msg import Imu
from std_msgs.msg import String
from without_ros import Message, simulated

from jointest_ros.bags.cdr import decode_imu
from jointest_ros.bags.cdr_encode import ImuEncoder
from jointest_ros.nodes import diagnostics
from jointest_ros.nodes.arrival import arrivals

CONFIGS = Path(__file__).resolve().parents[2] / "config"
FINGER = simulated(scenario="PC", rate_hz=100.0, duration_s=4.0, zero_pose_s=1.5, seed=2)
SHELL = simulated("exoshell", scenario="bench", rate_hz=100.0, duration_s=4.0, seed=2)
VICTIM = "imu/middle"


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports come often, so that no test waits for them."""
    monkeypatch.setattr(diagnostics, "PERIOD", 0.3)


def inputs_of(report: Report) -> dict[str, DiagnosticStatus]:
    """The statuses of the inputs by topic."""
    return {what.removeprefix("input "): status for what, status in report.items() if what.startswith("input ")}


def replaced(data: bytes, shift_ms: int = 0, gyro: Any = None) -> bytes:
    """The message with another stamp and other rates."""
    stamp, frame_id, old, accel = decode_imu(data)
    return ImuEncoder(frame_id).encode(stamp + shift_ms * 1_000_000, gyro or old, accel)


# ----------------------------------------------------------------- figures


def test_what_is_told_of_each_sensor(bench: Bench, finger_config: Path) -> None:
    """Lost samples, older stamps and NaN are counted at the sensor that has them."""
    node = bench.estimator(finger_config)
    reports = bench.diagnostics(node)
    sent: list[Message] = []
    for number, (topic, data) in enumerate(FINGER):
        frame = number // 4
        if topic == VICTIM and frame in (150, 200, 250):
            continue
        sent.append((topic, data))
        if topic == VICTIM and frame in (160, 170):
            sent.append((topic, replaced(data, shift_ms=-20)))
        if topic == VICTIM and frame == 180:
            sent.append((topic, replaced(data, shift_ms=5, gyro=(math.nan, 0.0, 0.0))))
    bench.send(node, sent)
    report = reports.until(lambda report: values(report[f"input {bench.namespace}/imu/distal"])["used"] == "400")
    found = {topic.split("/")[-1]: values(status) for topic, status in inputs_of(report).items()}
    keys = ("gaps", "out of order", "not finite", "frozen")
    assert [found["middle"][key] for key in keys] == ["3", "2", "1", "no"]
    assert [found["distal"][key] for key in keys] == ["0", "0", "0", "no"]
    assert 0.0 <= float(found["distal"]["age of the last message (s)"]) < 60.0
    report = reports.next()
    assert values(report[f"input {bench.namespace}/{VICTIM}"])["rate (Hz)"] == "0.0"


def test_sensors_on_one_topic_are_told_apart(bench: Bench, finger_config: Path, tmp_path: Path) -> None:
    text = finger_config.read_text(encoding="utf-8")
    names = ("palm", "proximal", "middle", "distal")
    for name in names:
        text = text.replace(f"  {name}: {{position", f"  {name}: {{topic: imu/all, frame_id: {name}, position")
    path = tmp_path / "shared.yaml"
    path.write_text(text, encoding="utf-8")
    node = bench.estimator(path)
    reports = bench.diagnostics(node)
    bench.send(node, [("imu/all", data) for topic, data in FINGER if topic != VICTIM])
    report = reports.until(lambda report: values(report["estimator"])["estimates"] != "0")
    told = values(report[f"input {bench.namespace}/imu/all"])
    assert {key for key in told if key.startswith("rate")} == {f"rate (Hz): {name}" for name in names}
    assert told["rate (Hz): middle"] == "0.0"
    assert float(told["rate (Hz): palm"]) > 0.0


@pytest.mark.parametrize(("lost", "level"), [((0, 1, 3, 7), DiagnosticStatus.WARN), ((0,), DiagnosticStatus.OK)])
def test_a_sensor_that_loses_many_samples(
    bench: Bench, finger_config: Path, lost: tuple[int, ...], level: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four of ten are told, one of ten is not; of the others nothing."""
    monkeypatch.setattr(diagnostics, "PERIOD", 1e3)  # one report of all, when it is asked for
    node = bench.estimator(finger_config)
    reports = bench.diagnostics(node)
    for begin in (0, 4 * 100):
        part = list(enumerate(FINGER))[begin : begin + 4 * 100]
        bench.send(node, [one for number, one in part if not (begin and one[0] == VICTIM and number // 4 % 10 in lost)])
        node._diagnostics.publish()
        report = reports.next()
    found = {topic.split("/")[-1]: status for topic, status in inputs_of(report).items()}
    assert found["middle"].level == level
    assert ("40% of the samples of middle are missing" in found["middle"].message) == (level == DiagnosticStatus.WARN)
    assert all(found[name].level == DiagnosticStatus.OK for name in ("palm", "proximal", "distal"))


def test_stamps_that_jump_are_in_the_log(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config)
    log = bench.log(node)
    for jumps in range(3):
        bench.send(node, FINGER)
        if jumps:
            words = f"the stamps of the inputs jumped ({jumps} time{'s' * (jumps > 1)} so far)"
            bench.until(partial(_logged, log, words), words)


def _logged(log: list[Log], words: str) -> bool:
    return any(words in one.msg for one in log)


def test_what_is_told_of_the_estimator(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config)
    reports = bench.diagnostics(node)
    bench.send(node, FINGER)
    report = reports.until(lambda report: values(report["estimator"])["estimates"] == "400")
    told = values(report["estimator"])
    assert (told["partial frames"], told["gaps"], told["resets"]) == ("0", "0", "0")
    p50, p99, longest = (float(told[f"latency {what} (ms)"]) for what in ("p50", "p99", "max"))
    assert 0.0 < p50 <= p99 <= longest < 1e3
    assert float(told["rate (Hz)"]) > 0.0
    assert told["calibration file"] == "none"
    assert told["warm start"] == "no"
    assert values(reports.next()["estimator"])["latency p50 (ms)"] == ""  # nothing since


def test_latency_is_that_of_the_newest_input(
    bench: Bench, finger_config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also when the executor takes a message late: what counts is when it hands it over."""
    node = bench.estimator(finger_config)
    reports = bench.diagnostics(node)
    clock = {"now": 0}

    def ticking() -> int:
        clock["now"] += 1_000_000
        return clock["now"]

    with monkeypatch.context() as patch:
        patch.setattr("jointest_ros.nodes.arrival.time.monotonic_ns", ticking)
        arrivals.done()
        for topic, data in FINGER[: 4 * 10]:
            node._receive(node.intake.handlers[topic], node._diagnostics._inputs[topic], data)
    assert list(node._diagnostics.latencies) == [1_000_000] * 10
    report = reports.next()
    assert values(report["estimator"])["latency max (ms)"] == "1.000"


def test_stillness_of_joints(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config)
    reports = bench.diagnostics(node)
    assert "still" not in values(reports.next()["joint finger_mcp"])
    bench.send(node, FINGER[:500])
    report = reports.until(lambda report: values(report["estimator"])["estimates"] == "125")
    assert values(report["joint finger_mcp"])["still"] == "yes"
    bench.send(node, FINGER[500:])
    report = reports.until(lambda report: values(report["estimator"])["estimates"] == "400")
    assert values(report["joint finger_mcp"])["still"] == "no"


# ----------------------------------------------------------------- ready


def test_ready_once_calibrated(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config, still_start=0.0)
    reports = bench.diagnostics(node)
    status = reports.next()["estimator"]
    assert status.level == DiagnosticStatus.WARN
    assert f"look at the inputs {bench.namespace}/imu/palm" in status.message

    bench.send(node, FINGER[:500])
    report = reports.until(lambda report: values(report["estimator"])["estimates"] == "125")
    assert {status.level for status in inputs_of(report).values()} == {DiagnosticStatus.OK}
    status = report["estimator"]
    assert status.level == DiagnosticStatus.WARN
    assert values(status)["ready"] == "no"
    assert status.message == (
        "not ready: not calibrated: gyro bias of palm, proximal, middle, distal unknown; "
        "call ~/calibrate_gyro_bias at rest"
    )

    assert bench.trigger(node, "calibrate_gyro_bias") == (True, "done")
    bench.send(node, FINGER[500:])
    report = reports.until(lambda report: values(report["estimator"])["estimates"] == "400")
    assert report["estimator"].level == DiagnosticStatus.OK
    assert values(report["estimator"])["ready"] == "yes"
    assert report["estimator"].message.startswith("ready, ")


def test_a_silent_sensor_keeps_it_from_being_ready(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config)
    reports = bench.diagnostics(node)
    bench.send(node, FINGER)
    reports.until(lambda report: report["estimator"].level == DiagnosticStatus.OK)
    bench.send(node, [(t, replaced(d, 5000)) for t, d in FINGER if t != VICTIM])
    report = reports.until(lambda report: "stale" in report["joint finger_pip"].message)
    assert f"look at the inputs {bench.namespace}/{VICTIM}" in report["estimator"].message
    assert "stale: finger_pip, finger_dip" in report["estimator"].message
    assert report[f"input {bench.namespace}/{VICTIM}"].level == DiagnosticStatus.STALE


# ----------------------------------------------------------------- a bad sensor, or a bad filter


def shell(tmp_path: Path, old: str = "", new: str = "") -> Path:
    """The configuration of the exoshell with something changed."""
    text = (CONFIGS / "exoshell.yaml").read_text(encoding="utf-8").replace("calibration_file:", "# ")
    assert old in text
    path = tmp_path / "shell.yaml"
    path.write_text(text.replace(old, new, 1) if old else text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["kf", "kckf"])
def test_sound_inputs_and_a_wrong_axis(name: str, bench: Bench, tmp_path: Path) -> None:
    wrong = shell(tmp_path, "child: link_3, axis: y", "child: link_3, axis: -y")
    node = bench.estimator(wrong, name)
    reports, logs = bench.diagnostics(node), bench.log(node)
    bench.send(node, SHELL)
    report = reports.until(lambda report: "innovations" in report["estimator"].message)
    assert {status.level for status in inputs_of(report).values()} == {DiagnosticStatus.OK}
    assert report["estimator"].level == DiagnosticStatus.WARN
    assert report["estimator"].message.startswith("inputs sound, innovations of joint_2 ")
    assert report["estimator"].message.endswith(
        " times larger than the noise model: check axes, mountings, noise parameters"
    )
    assert "times larger than the noise model" in report["joint joint_2"].message
    assert float(values(report["joint joint_2"])["innovations / noise model"]) > 5.0
    assert report["joint joint_3"].level == DiagnosticStatus.OK
    bench.until(lambda: any(log.msg.startswith("inputs sound, innovations of joint_2") for log in logs), "a warning")


@pytest.mark.parametrize("name", ["kf", "kckf"])
def test_a_sound_filter(name: str, bench: Bench, tmp_path: Path) -> None:
    node = bench.estimator(shell(tmp_path), name)
    reports = bench.diagnostics(node)
    bench.send(node, SHELL)
    report = reports.until(lambda report: values(report["estimator"])["estimates"] == "400")
    assert {status.level for status in report.values()} == {DiagnosticStatus.OK}
    for joint in node.estimator.joints:
        assert 0.5 < float(values(report[f"joint {joint}"])["innovations / noise model"]) < 2.0


def test_a_bad_sensor_is_not_put_down_to_the_filter(bench: Bench, tmp_path: Path) -> None:
    wrong = shell(tmp_path, "child: link_3, axis: y", "child: link_3, axis: -y")
    node = bench.estimator(wrong, "kckf")
    reports = bench.diagnostics(node)
    spoiled = [
        (t, replaced(d, gyro=(math.nan,) * 3)) if t == "imu/imu_5" and k % 12 else (t, d)
        for k, (t, d) in enumerate(SHELL)
    ]
    bench.send(node, spoiled)
    report = reports.until(lambda report: "innovations" in report["estimator"].message)
    assert report[f"input {bench.namespace}/imu/imu_5"].level == DiagnosticStatus.WARN
    assert "not finite" in report[f"input {bench.namespace}/imu/imu_5"].message
    assert "inputs sound" not in report["estimator"].message
    assert f"look at the inputs {bench.namespace}/imu/imu_5" in report["estimator"].message
    assert "mend the inputs first" in report["estimator"].message


# ----------------------------------------------------------------- publishers


def test_no_publisher_and_one_that_says_nothing(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config)
    reports = bench.diagnostics(node)
    bench.probe.create_publisher(Imu, "imu/palm", queue())
    silent = f"{bench.namespace}/probe sends nothing"
    report = reports.until(lambda report: silent in report[f"input {bench.namespace}/imu/palm"].message)
    assert report[f"input {bench.namespace}/imu/palm"].message == f"never received: {silent}"
    assert report[f"input {bench.namespace}/imu/middle"].message == "never received: no publisher"
    assert values(report[f"input {bench.namespace}/imu/palm"])["publishers"] == f"{bench.namespace}/probe"
    assert values(report[f"input {bench.namespace}/imu/middle"])["publishers"] == "none"


def test_topics_of_the_same_type_are_named_where_nobody_publishes(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config)
    reports = bench.diagnostics(node)
    bench.probe.create_publisher(Imu, "imu/palm", queue())
    for name in ("thigh_imu", "shank_imu"):
        bench.probe.create_publisher(Imu, f"sensors/{name}", queue())
    bench.probe.create_publisher(String, "sensors/text", queue())
    where = ", ".join(f"{bench.namespace}/sensors/{name}" for name in ("shank_imu", "thigh_imu"))
    expected = f"never received: no publisher; sensor_msgs/msg/Imu comes on {where}"
    reports.until(lambda report: report[f"input {bench.namespace}/imu/middle"].message == expected)


def test_two_publishers_are_named(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config)
    reports, logs = bench.diagnostics(node), bench.log(node)
    other = bench.add(Node("other", namespace=bench.namespace, context=bench.context))
    publisher = other.create_publisher(Imu, "imu/palm", queue())
    bench.send(node, FINGER[:400])
    bench.probe.create_publisher(Imu, "imu/palm", queue())
    name = f"input {bench.namespace}/imu/palm"
    text = f"2 publishers, whose samples mix: {bench.namespace}/other, {bench.namespace}/probe; leave 1"

    def heard(report: Report) -> bool:
        publisher.publish(FINGER[0][1])  # a repetition: refused
        return text in report[name].message

    report = reports.until(heard)
    assert report[name].level == DiagnosticStatus.WARN
    bench.until(lambda: any(text in log.msg for log in logs), "a warning")


@pytest.mark.parametrize("executor", ["events", "single"])
def test_a_quality_of_service_that_does_not_match_is_named(executor: str, make_bench: Any, finger_config: Path) -> None:
    bench = make_bench(executor)
    node = bench.estimator(finger_config, reliability="reliable")
    reports, logs = bench.diagnostics(node), bench.log(node)
    qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = bench.probe.create_publisher(Imu, "imu/palm", qos)
    name = f"input {bench.namespace}/imu/palm"

    def told(report: Report) -> bool:
        publisher.publish(FINGER[0][1])
        return "QoS" in report[name].message

    report = reports.until(told)
    assert report[name].level == DiagnosticStatus.ERROR
    assert report[name].message == (
        f"never received: QoS of {bench.namespace}/probe: its reliability is best_effort, this node asks for reliable; "
        "start it with reliability:=best_effort, or let the publisher be reliable"
    )
    bench.until(lambda: any("its reliability is best_effort" in log.msg for log in logs), "a warning")


def test_another_type_is_named(make_bench: Any, finger_config: Path) -> None:
    bench, elsewhere = make_bench("events"), make_bench("events")
    node = bench.estimator(finger_config)
    reports = bench.diagnostics(node)
    elsewhere.probe.create_publisher(String, f"{bench.namespace}/imu/palm", queue())
    name = f"input {bench.namespace}/imu/palm"
    report = reports.until(lambda report: report[name].level == DiagnosticStatus.ERROR)
    assert report[name].message == (
        f"never received: {elsewhere.namespace}/probe publishes std_msgs/msg/String there, "
        "this node takes sensor_msgs/msg/Imu"
    )
