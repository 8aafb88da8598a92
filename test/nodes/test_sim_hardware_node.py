"""The simulated hardware: what it sends, when, and how it is stopped and started."""

from __future__ import annotations

import itertools
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.logging import LoggingSeverity
from rclpy.parameter import Parameter
from ros_bench import Bench, queue
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_srvs.srv import SetBool
from without_ros import Message, stamp, write_bag

from jointest_ros.bags.cdr import IMU, JOINT_STATE
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.reader import BagReader
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.nodes.messages import CLASSES
from jointest_ros.nodes.playback import SimulatedPlayback, sources
from jointest_ros.nodes.sim_hardware_node import PlayParams
from jointest_ros.sim.scenarios import OWN, OWN_OPTIONS, SCENARIOS
from jointest_ros.sim.simulated import SimulationError

BROAD = Path(__file__).resolve().parents[2] / "config" / "broad.yaml"
FINGER = {"source": "finger", "rate_hz": 100.0, "duration_s": 1.0}
TOPICS = ("imu/palm", "imu/proximal", "imu/middle", "imu/distal", "ground_truth/joint_states")


def read(bag: Path) -> list[Message]:
    """All messages of a recording, as far as it is sound."""
    messages = []
    with BagReader(bag) as reader:
        try:
            for topic, _, data in reader.messages():
                messages.append((topic.lstrip("/"), data))
        except BagError:
            assert reader.damage
    return messages


def listen_raw(bench: Bench) -> dict[str, list[bytes]]:
    """The bytes that arrive on each topic of the finger."""
    return {topic: bench.listen(topic, JointState if "truth" in topic else Imu, raw=True) for topic in TOPICS}


def by_topic(messages: list[Message]) -> dict[str, list[bytes]]:
    table: dict[str, list[bytes]] = {topic: [] for topic in TOPICS}
    for topic, data in messages:
        table[topic].append(data)
    return table


def play(bench: Bench, **parameters: Any) -> dict[str, list[bytes]]:
    """All that is sent until the end."""
    arrived = listen_raw(bench)
    hardware = bench.hardware(**parameters)
    bench.until(lambda: hardware.finished, "the end")
    bench.until(lambda: sum(map(len, arrived.values())) == hardware.sent, "all messages")
    return {topic: list(messages) for topic, messages in arrived.items()}


# ----------------------------------------------------------------- what is sent


def test_recording_is_sent_as_it_is(bench: Bench, finger_bag: Path) -> None:
    """At a speed at which all is due at once: it is behind from the first message on, and loses none."""
    assert play(bench, source="bag", bag=str(finger_bag), speed=1000.0) == by_topic(read(finger_bag))


def test_stamps_are_of_the_model(bench: Bench) -> None:
    states = bench.listen("ground_truth/joint_states")
    imu = bench.listen("imu/distal", Imu)
    hardware = bench.hardware(speed=20.0, **FINGER)
    bench.until(lambda: hardware.finished and len(states) == len(imu) == 100, "100 frames")
    expected = [1_000_000_000 + k * 10_000_000 for k in range(100)]
    assert [stamp(state) for state in states] == expected
    assert [stamp(message) for message in imu] == expected
    assert {message.header.frame_id for message in imu} == {"distal"}


def test_seed(bench: Bench) -> None:
    first, again, other = (
        play(bench, node_name=f"run{k}", speed=50.0, seed=s, **FINGER) for k, s in enumerate((1, 1, 2))
    )
    assert again == first
    assert other["imu/palm"] != first["imu/palm"]
    assert other["ground_truth/joint_states"] == first["ground_truth/joint_states"]


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_is_never_ahead_of_time(bench: Bench, speed: float) -> None:
    arrivals: list[float] = []
    bench.probe.create_subscription(Imu, "imu/palm", lambda _: arrivals.append(time.monotonic()), queue())
    hardware = bench.hardware(speed=speed, **{**FINGER, "duration_s": 0.5})
    bench.until(lambda: hardware.finished and len(arrivals) == 50, "50 messages")
    due = np.arange(50) * 0.01 / speed
    # the clock that the first message starts is read before it is sent, and so much earlier than it arrives
    assert (np.array(arrivals) - arrivals[0] - due).min() > -0.1 / speed


def test_after_a_standstill_all_that_is_due_is_sent(bench: Bench) -> None:
    arrived = listen_raw(bench)
    hardware = bench.hardware(**FINGER)
    bench.until(lambda: hardware.sent)
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        pass  # somebody else has the processor
    bench.until(lambda: hardware.finished and sum(map(len, arrived.values())) == 500, "all 500 messages")
    assert [len(messages) for messages in arrived.values()] == [100] * 5


def test_own_robot_is_played_into_its_estimator(bench: Bench, tmp_path: Path) -> None:
    """A hinge whose second sensor is turned by 90 deg on its link, and is late."""
    path = tmp_path / "own.yaml"
    path.write_text(
        "robot: {links: [a, b], joints: {ab: {parent: a, child: b, axis: y, limits_deg: [-20, 100]}}}\n"
        "sensors: {a: {topic: /lab/base}, b: {mounting: {rpy_deg: [0, 0, 90]}, delay_ms: 10}}\n"
        "estimators: {pcf: {zero_at_start: true}}\n",
        encoding="utf-8",
    )
    truth, states = bench.listen("ground_truth/joint_states"), bench.listen()
    bench.estimator(path)
    hardware = bench.hardware(source="config", config=str(path), duration_s=6.0, zero_pose_s=1.5, speed=8.0)
    bench.until(lambda: hardware.finished and len(truth) == 600 and len(states) > 590, "the end")
    angles = {stamp(state): state.position[0] for state in truth}
    found = {stamp(state): state.position[0] for state in states}
    assert np.ptp(list(angles.values())) > np.radians(60.0)
    both = sorted(set(angles) & set(found))
    assert len(both) > 500
    assert max(abs(np.degrees(angles[one] - found[one])) for one in both) < 1.0


# ----------------------------------------------------------------- how it is controlled


def test_loop_jumps_back_and_the_estimator_recovers(bench: Bench, finger_config: Path) -> None:
    truth, states = bench.listen("ground_truth/joint_states"), bench.listen()
    estimator = bench.estimator(finger_config)
    hardware = bench.hardware(loop=True, speed=8.0, **{**FINGER, "duration_s": 4.0, "zero_pose_s": 1.5})
    bench.until(lambda: len(truth) > 900 and len(states) > 880, "the third round")
    assert not hardware.finished
    stamps = [stamp(state) for state in states]
    assert sum(later < earlier for earlier, later in itertools.pairwise(stamps)) == 2
    assert estimator.intake.assembler.resets == 2
    angles = {stamp(state): dict(zip(state.name, state.position, strict=True)) for state in truth}
    for state in states[-80:]:
        for name, position in zip(state.name, state.position, strict=True):
            assert abs(np.degrees(position - angles[stamp(state)][name])) < 1.0


def test_pause(bench: Bench) -> None:
    arrived = listen_raw(bench)
    hardware = bench.hardware(paused=True, speed=4.0, **FINGER)
    service = f"{hardware.get_fully_qualified_name()}/pause"
    bench.spin_for(0.05)
    assert hardware.sent == 0
    response = bench.call(SetBool, service, SetBool.Request(data=False))
    assert (response.success, response.message) == (True, "playing")
    bench.until(lambda: hardware.sent > 50)
    response = bench.call(SetBool, service, SetBool.Request(data=True))
    assert (response.success, response.message) == (True, "paused")
    sent = hardware.sent
    bench.spin_for(0.1)
    assert hardware.sent == sent < 500
    bench.call(SetBool, service, SetBool.Request(data=False))
    bench.until(lambda: hardware.finished and sum(map(len, arrived.values())) == 500, "all 500 messages")
    paused = {topic: list(messages) for topic, messages in arrived.items()}
    assert paused == play(bench, node_name="unpaused", speed=50.0, **FINGER)


@pytest.mark.parametrize("use_sim_time", [False, True], ids=["system time", "its own clock"])
def test_clock(bench: Bench, use_sim_time: bool) -> None:
    clocks = bench.listen("/clock", Clock)
    bench.probe.set_parameters([Parameter("use_sim_time", value=True)])
    hardware = bench.hardware(clock=True, speed=5.0, use_sim_time=use_sim_time, **FINGER)
    last = 1_000_000_000 + 99 * 10_000_000
    bench.until(lambda: hardware.finished and bench.probe.get_clock().now().nanoseconds == last, "the end of time")
    times = [message.clock.sec * 1_000_000_000 + message.clock.nanosec for message in clocks]
    assert times == sorted(times)
    assert times[-1] == last


def test_waits_for_subscribers(bench: Bench) -> None:
    """Of any of the sensor topics: a robot need not use them all. Ground truth does not count."""
    bench.listen("ground_truth/joint_states")
    hardware = bench.hardware(wait_for_subscribers=2, speed=50.0, **FINGER)
    first = bench.listen("imu/palm", Imu)
    bench.spin_for(0.6)
    assert hardware.sent == 0
    second = bench.listen("imu/palm", Imu)
    bench.until(lambda: hardware.finished, "the end")
    bench.until(lambda: len(first) == len(second) == 100, "all messages")


# ----------------------------------------------------------------- what goes wrong


def test_damaged_recording_is_played_as_far_as_it_goes(bench: Bench, finger_bag: Path, tmp_path: Path) -> None:
    bag = tmp_path / "damaged"
    shutil.copytree(finger_bag, bag)
    (file,) = bag.glob("*.mcap")
    with file.open("rb+") as stream:
        stream.truncate(file.stat().st_size * 2 // 3)
    sound = read(bag)
    assert 0 < len(sound) < 7500
    arrived = listen_raw(bench)
    hardware = bench.hardware(source="bag", bag=str(bag), speed=1000.0)
    logs = bench.log(hardware)
    bench.until(lambda: hardware.finished and sum(map(len, arrived.values())) == len(sound), "the sound part")
    assert arrived == by_topic(sound)
    (error,) = (log.msg for log in logs if log.level >= int(LoggingSeverity.ERROR))
    assert str(bag) in error
    assert "damaged" in error
    assert "\n" not in error


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"bag": "nowhere"}, "nowhere: no such bag"),
        ({}, "bag: '' is not allowed with source bag; give the path of a recording"),
        ({"config": "a"}, "bag: '' is not allowed with source bag; give the path of a recording: -p bag:=PATH, or sim"),
        ({"source": "elbow"}, "source: 'elbow' is not allowed; give one of bag, finger"),
        ({"source": "finger", "scenario": "PX"}, "scenario: 'PX' is not allowed; give one of PA"),
        ({"source": "finger", "rate_hz": 20.0}, "rate_hz: 20.0 is not allowed; give 100 to 1000 Hz"),
        ({"source": "finger", "speed": 0}, "speed: 0 is not allowed"),
        ({"source": "finger", "sped": 2.0}, "sped: unknown parameter; did you mean 'speed'?"),
        ({"rate_hz": 100.0}, "rate_hz: unknown parameter"),
        ({"source": "finger", "seed": {}}, "seed: {} is not allowed"),
        ({"source": "finger", "bag": "run"}, "bag: 'run' is not allowed with source finger; leave either out"),
        ({"source": "config"}, "config: '' is not allowed with source config; give the path of a configuration"),
        ({"source": "config", "config": "nowhere.yaml"}, "nowhere.yaml: no such configuration file"),
        ({"source": "config", "config": str(BROAD)}, "robot.joints: none; "),
        ({"source": "config", "config": str(BROAD), "scenario": "PA"}, "scenario: unknown parameter"),
    ],
)
def test_bad_parameters(bench: Bench, parameters: dict[str, Any], message: str) -> None:
    with pytest.raises((ConfigurationError, BagError, SimulationError)) as raised:
        bench.hardware(**parameters)
    assert str(raised.value).startswith(message)
    assert "\n" not in str(raised.value)


def test_recording_without_sensors(bench: Bench, tmp_path: Path) -> None:
    bag = write_bag(
        tmp_path / "bag", {"/ground_truth/joint_states": JOINT_STATE}, [("/ground_truth/joint_states", 0, b"")]
    )
    with pytest.raises(BagError, match="no sensor topics to play; it has: /ground_truth/joint_states"):
        bench.hardware(bag=str(bag))


def test_recording_with_topics_of_other_types(bench: Bench, tmp_path: Path) -> None:
    """What no node of this package knows is left out."""
    types = {"/imu/palm": IMU, "/ground_truth/pose": "geometry_msgs/msg/PoseStamped", "/text": "std_msgs/msg/String"}
    bag = write_bag(tmp_path / "bag", types, [(topic, k, b"\0\1\0\0") for k, topic in enumerate(types)])
    hardware = bench.hardware(bag=str(bag))
    bench.until(lambda: hardware.finished, "the end")
    assert hardware.sent == 1


def test_every_rig_can_be_a_source() -> None:
    """Its options are parameters beside those of the node: no name twice, and every message type is known."""
    assert set(sources()) == {"bag", OWN, *SCENARIOS}
    assert not set(PlayParams.__dataclass_fields__) & set(OWN_OPTIONS.__dataclass_fields__)
    for rig in SCENARIOS.values():
        assert not set(PlayParams.__dataclass_fields__) & set(rig.options.__dataclass_fields__)
        assert set(SimulatedPlayback(rig, rig.options()).topics.values()) <= set(CLASSES)
