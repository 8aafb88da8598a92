"""Bad messages over DDS: counted, reported, told in the log; the good ones give what they give without the bad ones."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from ros_bench import Bench, values
from without_ros import Message, assert_same, estimate, shown, simulated, stamp

from jointest_ros.bags.cdr import decode_imu
from jointest_ros.bags.cdr_encode import ImuEncoder
from jointest_ros.nodes import diagnostics

GOOD = simulated(scenario="PC", rate_hz=100.0, duration_s=4.0, zero_pose_s=1.5, seed=2)
SENSORS = ("palm", "proximal", "middle", "distal")
VICTIM = "imu/middle"
BAD = 5  # messages of each kind
MS = 1_000_000  # ns
NAN = math.nan

Spoil = Callable[[bytes], bytes]


def changed(
    shift: int = 0, gyro: tuple[float, ...] | None = None, accel: tuple[float, ...] | None = None, frame: str = ""
) -> Spoil:
    """A function that makes another message of one: its stamp shifted (ns), fields replaced."""

    def spoil(data: bytes) -> bytes:
        when, frame_id, old_gyro, old_accel = decode_imu(data)
        return ImuEncoder(frame or frame_id).encode(when + shift, gyro or old_gyro, accel or old_accel)

    return spoil


def patched(offset: int, layout: str, *fields: float) -> Spoil:
    """A function that overwrites bytes of a message."""

    def spoil(data: bytes) -> bytes:
        copy = bytearray(data)
        struct.pack_into(layout, copy, offset, *fields)
        return bytes(copy)

    return spoil


# what is wrong -> (how a good message becomes the bad one that follows it, what it is counted as)
KINDS: dict[str, tuple[Spoil, str]] = {
    "NaN in a gyro": (changed(10 * MS, gyro=(0.0, NAN, 0.0)), "not finite"),
    "NaN in an accelerometer": (changed(10 * MS, accel=(NAN, NAN, NAN)), "not finite"),
    "infinity": (changed(10 * MS, gyro=(math.inf, 0.0, 0.0)), "not finite"),
    "absurd gyro": (changed(10 * MS, gyro=(0.0, 0.0, 1e30)), "implausible"),
    "absurd accelerometer": (changed(10 * MS, accel=(-1e300, 0.0, 0.0)), "implausible"),
    "repeated stamp": (changed(), "repeated stamp"),
    "older stamp": (changed(-20 * MS), "older stamp"),
    "stamp of tomorrow": (changed(86_400_000 * MS), "odd stamp"),
    "zero stamp": (patched(4, "<iI", 0, 0), "odd stamp"),
    "impossible stamp": (patched(4, "<iI", 2**31 - 1, 2**32 - 1), "undecodable"),
    "half a message": (lambda data: data[: len(data) // 2], "undecodable"),
    "no message": (lambda data: b"", "undecodable"),
    "noise": (lambda data: np.random.default_rng(len(data)).bytes(len(data)), "undecodable"),
    "frame id of 4 GB": (patched(12, "<I", 2**32 - 1), "undecodable"),
    "unknown encoding": (patched(0, "<H", 0x0700), "undecodable"),
}


def spoiled(spoil: Spoil) -> Iterator[Message]:
    """The good messages, and after some of those of one sensor a bad one."""
    after = set(range(50, 350, 60)[:BAD])
    number = 0
    for topic, data in GOOD:
        yield topic, data
        if topic == VICTIM:
            if number in after:
                yield topic, spoil(data)
            number += 1


@pytest.mark.parametrize("kind", KINDS)
def test_bad_messages(kind: str, bench: Bench, finger_config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnostics, "PERIOD", 0.1)
    spoil, cause = KINDS[kind]
    expected = estimate(GOOD, finger_config)
    states = bench.listen()
    node = bench.estimator(finger_config)
    reports, logs = bench.diagnostics(node), bench.log(node)
    bench.send(node, spoiled(spoil))
    bench.until(lambda: len(states) >= shown(expected[0]), "the joint states")
    assert_same(states, expected)

    assert node.intake.counts(VICTIM) == {"messages": 400 + BAD, "used": 400, "refused": {cause: BAD}}
    report = reports.until(
        lambda report: values(report[f"input {bench.namespace}/{VICTIM}"]).get(f"refused: {cause}") == str(BAD)
    )
    status = report[f"input {bench.namespace}/{VICTIM}"]
    assert status.level == DiagnosticStatus.WARN
    assert f"{cause} ({BAD} in all)" in status.message
    (warning,) = bench.until(lambda: [log.msg for log in logs if "refused" in log.msg], "a warning")
    assert warning.startswith(f"{bench.namespace}/{VICTIM}: messages refused: {cause} (")


def test_wrong_frame_id(bench: Bench, finger_config: Path, tmp_path: Path) -> None:
    """All sensors on one topic: each has its frame id, and a message with another one is nobody's."""
    path = tmp_path / "shared.yaml"
    text = finger_config.read_text(encoding="utf-8")
    for name in SENSORS:
        text = text.replace(f"  {name}: {{position", f"  {name}: {{topic: imu/all, frame_id: {name}, position")
    path.write_text(text, encoding="utf-8")
    expected = estimate(GOOD, finger_config)
    states = bench.listen()
    node = bench.estimator(path)
    strange = [("imu/all", changed(frame="thumb")(data)) for _, data in GOOD[400:410]]
    good = [("imu/all", data) for _, data in GOOD]
    bench.send(node, [*good[:400], *strange, *good[400:]])
    bench.until(lambda: len(states) >= shown(expected[0]), "the joint states")
    assert_same(states, expected)
    assert node.intake.counts("imu/all") == {"messages": 1610, "used": 1600, "refused": {"unknown frame_id": 10}}


def test_clock_that_is_set_back(bench: Bench, finger_config: Path) -> None:
    """A jump of all stamps restarts the estimator, in the middle of motion; it keeps its calibration."""
    states = bench.listen()
    node = bench.estimator(finger_config)
    later = [(topic, changed(-3_600_000 * MS)(data)) for topic, data in GOOD[1200:]]
    bench.send(node, [*GOOD[:1200], *later])
    bench.until(lambda: len(states) == 400, "400 joint states")
    expected, joints = estimate(GOOD, finger_config)
    assert stamp(states[300]) == expected.stamps[300] - 3_600_000 * MS
    for number, (state, position) in enumerate(zip(states[300:], expected.position[300:], strict=True)):
        assert tuple(state.name) == joints
        tolerance = np.radians(3.0 if number < 50 else 1.0)  # it starts from accelerometers that move
        np.testing.assert_allclose(state.position, position, rtol=0.0, atol=tolerance)
    assert node.estimator.calibrated
    assert node.intake.assembler.resets == 1


def test_a_silent_sensor(bench: Bench, finger_config: Path) -> None:
    """Its joint goes stale and is left out, the others go on as ever, and it comes back by itself."""
    frames = [GOOD[k : k + 4] for k in range(0, len(GOOD), 4)]
    silent = [[message for message in frame if message[0] != "imu/distal"] for frame in frames]
    sent = [message for frame in (*frames[:200], *silent[200:300], *frames[300:]) for message in frame]
    before, during = 800, 300
    states = bench.listen()
    node = bench.estimator(finger_config)
    reports, logs = bench.diagnostics(node), bench.log(node)
    name = f"input {bench.namespace}/imu/distal"

    bench.send(node, sent[:before])
    bench.until(lambda: len(states) == 200, "200 joint states")
    reports.next()
    bench.send(node, sent[before : before + during])
    report = reports.until(lambda report: report["joint finger_dip"].level == DiagnosticStatus.WARN)
    assert "stale" in report["joint finger_dip"].message
    assert report["joint finger_pip"].level == DiagnosticStatus.OK
    assert report[name].level == DiagnosticStatus.STALE
    assert report[name].message.startswith("no messages")
    bench.until(lambda: any(log.msg == f"no messages on {bench.namespace}/imu/distal" for log in logs), "a warning")

    bench.send(node, sent[before + during :])
    reports.until(lambda report: report["joint finger_dip"].level == DiagnosticStatus.OK)
    bench.until(lambda: any(log.msg == f"messages on {bench.namespace}/imu/distal" for log in logs), "the good news")

    expected = estimate(sent, finger_config)
    bench.until(lambda: len(states) >= shown(expected[0]), "the joint states")
    assert_same(states, expected)
    whole, joints = estimate(GOOD, finger_config)
    assert len(states) == len(whole)
    last = stamp(states[199])
    for state, position in zip(states, whole.position, strict=True):
        stale = 500 * MS < stamp(state) - last <= 1010 * MS  # the first sample after a silence is not waited for
        assert tuple(state.name) == (joints[:2] if stale else joints)
        np.testing.assert_allclose(state.position[:2], position[:2], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(states[-1].position[2], whole.position[-1, 2], rtol=0.0, atol=np.radians(1.0))
