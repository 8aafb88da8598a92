"""The estimators on link gyros and Hall sensors, side by side on one stream; Hall messages lost, slower or wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
from ros_bench import Bench, queue
from std_msgs.msg import Float32MultiArray
from without_ros import write_simulation

from jointest_ros import config
from jointest_ros.bags import offline, synthetic
from jointest_ros.bags.cdr import FLOAT32_MULTIARRAY, NANOSECONDS
from jointest_ros.bags.cdr_encode import encode_float32_multiarray
from jointest_ros.bags.intake import HALL_TOPIC, Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.frame import Estimate
from jointest_ros.nodes import diagnostics
from jointest_ros.nodes.estimator_node import EstimatorNode
from jointest_ros.sim.exoshell import ExoshellOptions, stretches

NAMES = ("kckf", "kf", "gyro", "hall")
OPTIONS = {"scenario": "clipped", "rate_hz": 100.0, "duration_s": 3.0, "seed": 5}
MESSAGES = list(synthetic.messages(stretches(ExoshellOptions(**OPTIONS))))


@pytest.fixture
def exoshell() -> Path:
    """The shipped configuration, which suits the scenario."""
    return Path(__file__).resolve().parents[2] / "config" / "exoshell.yaml"


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """The same simulation as a recording."""
    return write_simulation(tmp_path / "bag", "exoshell", **OPTIONS)


def evaluate(recording: Path, path: Path, name: str) -> list[Estimate]:
    """What the offline evaluation gives."""
    configuration = config.load(path)
    estimator = ESTIMATORS[name](configuration.robot, configuration.estimators[name], configuration.timing)
    estimates: list[Estimate] = []
    with BagReader(recording) as reader:
        intake = Intake(configuration.robot, configuration.timing)
        offline.run(reader, intake, {name: estimator}, lambda _, more: estimates.extend(more))
    return estimates


def play(node: EstimatorNode, order: Callable[[int], tuple[str, ...]] = lambda tick: ("imu", "hall")) -> list[Any]:
    """Feed the handlers of a node by a clock of our own, in the order of `order`; its frames' (tick, Hall voltages)."""
    frames: list[Any] = []
    handlers = node.intake.handlers
    ticks: dict[int, list[tuple[str, bytes]]] = {}
    for stamp, topic, data in MESSAGES:
        ticks.setdefault(stamp, []).append((topic, data))
    for tick, (stamp, messages) in enumerate(ticks.items()):
        for number, part in enumerate(order(tick)):
            for topic, data in messages:
                if topic in handlers and (topic == HALL_TOPIC) == (part == "hall"):
                    frames += handlers[topic](data, stamp + number * 1_000_000)
    return frames


def test_side_by_side_in_namespaces_of_their_own(bench: Bench, recording: Path, exoshell: Path) -> None:
    states = {name: bench.listen(f"{name}/joint_states") for name in NAMES}
    torsos = bench.listen("kckf/torso_angle", Vector3Stamped)
    orientations = bench.listen("kckf/torso_orientation", QuaternionStamped)
    nodes = [bench.estimator(exoshell, name, name, sensor_namespace=bench.namespace) for name in NAMES]
    hardware = bench.hardware(source="exoshell", **OPTIONS)
    bench.until(lambda: hardware.finished and all(node.estimates == 300 for node in nodes), "the end")
    expected = {name: evaluate(recording, exoshell, name) for name in NAMES}
    for name, node in zip(NAMES, nodes, strict=True):
        assert not node.intake.counts(HALL_TOPIC)["refused"]
        bench.until(lambda name=name: len(states[name]) == len(expected[name]), f"states of {name}")
        for state, estimate in zip(states[name], expected[name], strict=True):
            assert state.header.stamp.sec * NANOSECONDS + state.header.stamp.nanosec == estimate.stamp
            assert tuple(state.name) == node.estimator.joints
            np.testing.assert_allclose(state.position, estimate.position, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(state.velocity, estimate.velocity, rtol=0.0, atol=1e-9)
    bench.until(lambda: len(torsos) == len(orientations) == 300, "torsos")
    for angle, orientation, estimate in zip(torsos, orientations, expected["kckf"], strict=True):
        assert angle.header.frame_id == orientation.header.frame_id == "link_1"
        vector, q = angle.vector, orientation.quaternion
        np.testing.assert_allclose((vector.x, vector.y, vector.z), estimate.torso, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose((q.x, q.y, q.z, q.w), estimate.torso_orientation, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("first", ["imu", "hall"])
def test_hall_messages_find_their_frames_in_either_order(first: str, bench: Bench, exoshell: Path) -> None:
    node = bench.estimator(exoshell, "kckf")
    order = ("imu", "hall") if first == "imu" else ("hall", "imu")
    frames = play(node, lambda tick: order) + node.intake.flush()
    assert len(frames) == 300
    assert node.intake.counts(HALL_TOPIC) == {"messages": 300, "used": 300, "refused": {}}
    assert len({frame.hall for frame in frames}) > 250  # each its own


@pytest.mark.parametrize("order", [("imu", "hall"), ("hall", "imu")])
def test_lost_hall_messages_shift_nothing(order: tuple[str, str], bench: Bench, exoshell: Path) -> None:
    node = bench.estimator(exoshell, "kckf")
    complete = [frame.hall for frame in play(node, lambda tick: order) + node.intake.flush()]
    again = bench.estimator(exoshell, "kckf", "again")
    lost = set(range(50, 300, 7))
    frames = play(again, lambda tick: tuple(p for p in order if p == "imu" or tick not in lost)) + again.intake.flush()
    assert [frame.hall for frame in frames] == [None if tick in lost else v for tick, v in enumerate(complete)]


def test_a_slower_hall_topic_is_used_once_each(bench: Bench, exoshell: Path, tmp_path: Path) -> None:
    path = tmp_path / "slow.yaml"
    path.write_text(exoshell.read_text().replace("hall_per_frame: true", "hall_per_frame: false"))
    node = bench.estimator(path, "kckf")
    frames = play(node, lambda tick: ("hall", "imu") if tick % 4 == 0 else ("imu",)) + node.intake.flush()
    assert [frame.hall is not None for frame in frames] == [tick % 4 == 0 for tick in range(300)]


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        (encode_float32_multiarray((1.0,) * 7), "wrong length"),
        (encode_float32_multiarray((1.0,) * 8, (("sensor", 2), ("joint", 4))), "wrong layout"),
        (encode_float32_multiarray((float("inf"),) * 8), "not finite"),
        (encode_float32_multiarray((1e30,) * 8), "implausible"),
    ],
)
def test_bad_hall_messages_are_refused_and_counted(
    data: bytes, cause: str, bench: Bench, exoshell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(diagnostics, "PERIOD", 0.1)
    node = bench.estimator(exoshell, "kckf")
    log = bench.log(node)
    publisher = bench.probe.create_publisher(Float32MultiArray, HALL_TOPIC, queue())
    assert node.intake.topics[HALL_TOPIC] == FLOAT32_MULTIARRAY
    bench.until(publisher.get_subscription_count)
    publisher.publish(data)
    bench.until(lambda: node.intake.counts(HALL_TOPIC)["refused"] == {cause: 1}, cause)
    bench.until(lambda: any(cause in line.msg and HALL_TOPIC in line.msg for line in log), "a warning")
    assert len(play(node) + node.intake.flush()) == 300  # what is good goes on


def test_voltages_at_a_rail_are_gated_and_counted(bench: Bench, exoshell: Path) -> None:
    node = bench.estimator(exoshell, "kckf")
    for frame in play(node) + node.intake.flush():
        node.estimator.update(frame)
    gated = node.estimator.gated()
    assert sum(gated) > 100
    assert len(gated) == 8
