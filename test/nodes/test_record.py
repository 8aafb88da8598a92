"""The recorder: what comes over ROS is in the recording, byte by byte."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from ros_bench import Bench
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import String
from without_ros import assert_same, evaluate, shown

from jointest_ros import config
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter
from jointest_ros.cli.main import main
from jointest_ros.nodes import recorder as module
from jointest_ros.nodes.recorder import Recorder, Wanted

EXOSHELL = Path(__file__).resolve().parents[2] / "config" / "exoshell.yaml"
FINGER = ("imu/palm", "imu/proximal", "imu/middle", "imu/distal")
Record = Callable[..., Recorder]


@pytest.fixture
def record(bench: Bench, tmp_path: Path) -> Iterator[Record]:
    """A function that starts a recorder of a configuration into tmp_path/run; all are ended after the test."""
    with ExitStack() as stack:

        def start(configuration: Path, **wanted: Any) -> Recorder:
            robot = config.load(configuration)
            topics = Intake(robot.robot, robot.timing).topics
            inputs = {f"{bench.namespace}/{topic}": msgtype for topic, msgtype in topics.items()}
            one = bench.add(Recorder(tmp_path / "run", Wanted(inputs, **wanted), context=bench.context))
            stack.callback(one.close)
            return one

        yield start


def read(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Times and bytes of a sound recording, by topic."""
    with BagReader(path) as reader:
        assert not reader.damage
        table: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in reader.topics}
        for topic, stamp, data in reader.messages():
            table[topic].append((stamp, data))
    return table


def test_bytes_and_times_of_receipt(bench: Bench, record: Record, finger_config: Path, tmp_path: Path) -> None:
    sent = {topic: bench.listen(topic, Imu, raw=True) for topic in FINGER}
    before = time.time_ns()
    recorder = record(finger_config)
    hardware = bench.hardware(source="finger", rate_hz=100.0, duration_s=1.0, speed=10.0)
    bench.until(lambda: hardware.finished and sum(recorder.received.values()) == 400, "all messages")
    recorder.close()
    after = time.time_ns()
    recorded = read(tmp_path / "run")
    assert {topic.removeprefix(f"{bench.namespace}/") for topic in recorded} == set(FINGER)
    for topic in FINGER:
        times = [stamp for stamp, _ in recorded[f"{bench.namespace}/{topic}"]]
        assert [data for _, data in recorded[f"{bench.namespace}/{topic}"]] == sent[topic]
        assert before <= times[0] <= times[-1] <= after
        assert times == sorted(times)


def test_a_silent_input_names_what_may_be_meant(bench: Bench, record: Record, finger_config: Path) -> None:
    recorder = record(finger_config)
    topic = f"{bench.namespace}/imu/palm"
    assert recorder.silent(topic).startswith(f"no messages yet on {topic}")
    driver = bench.add(Node("driver", namespace=bench.namespace, context=bench.context))
    driver.create_publisher(Imu, "imu/plam", 1)
    bench.until(lambda: f"{bench.namespace}/imu/plam" in recorder.silent(topic), "the other topic")
    assert f"no messages yet on {topic}; sensor_msgs/msg/Imu comes on " in recorder.silent(topic)


def test_a_recording_gives_what_the_node_gave(bench: Bench, record: Record, tmp_path: Path) -> None:
    """Hall voltages, which are paired by their arrival, included."""
    states = bench.listen()
    bench.estimator(EXOSHELL, "kckf")
    recorder = record(EXOSHELL)
    hardware = bench.hardware(source="exoshell", rate_hz=100.0, duration_s=4.0)
    bench.until(lambda: hardware.finished and sum(recorder.received.values()) == 2400, "all messages")
    recorder.close()
    renamed = tmp_path / "renamed"
    _without_namespace(tmp_path / "run", renamed, bench.namespace)
    expected = evaluate(renamed, EXOSHELL, "kckf")
    bench.until(lambda: len(states) >= shown(expected[0]), "the states")
    assert len(states) > 380
    assert_same(states, expected)


def _without_namespace(bag: Path, target: Path, namespace: str) -> None:
    with BagReader(bag) as reader, BagWriter(target) as writer:
        for topic, msgtype in reader.topics.items():
            writer.add_topic(topic.removeprefix(namespace), msgtype)
        for topic, stamp, data in reader.messages():
            writer.write(topic.removeprefix(namespace), stamp, data)


def test_five_imus_and_hall_sensors_at_1_khz(bench: Bench, record: Record, tmp_path: Path) -> None:
    """Nothing is lost, although sender and recorder share a thread here."""
    recorder = record(EXOSHELL)
    hardware = bench.hardware(source="exoshell", rate_hz=1000.0, duration_s=2.0)
    bench.until(lambda: hardware.finished and sum(recorder.received.values()) == 12_000, "all 12000 messages")
    recorder.close()
    recorded = read(tmp_path / "run")
    assert {topic: len(messages) for topic, messages in recorded.items()} == recorder.writer.counts
    assert set(recorder.writer.counts.values()) == {2000}


def test_what_else_there_is(bench: Bench, record: Record, finger_config: Path, tmp_path: Path) -> None:
    """Outputs of estimators in any namespace, ground truth, diagnostics and topics by name, when they come up."""
    extra = f"{bench.namespace}/remark"
    recorder = record(finger_config, topics=[extra], also=["outputs", "truth", "diagnostics"])
    bench.estimator(finger_config, namespace="left", sensor_namespace=bench.namespace)
    bench.hardware(source="finger", rate_hz=100.0, loop=True, duration_s=2.0)
    remarks = bench.probe.create_publisher(String, extra, 10)

    def all_came() -> bool:
        recorder.discover()
        remarks.publish(String(data="hello"))
        names = ("left/joint_states", "ground_truth/joint_states", "remark")
        wanted = ["/diagnostics", *(f"{bench.namespace}/{name}" for name in names)]
        return all(recorder.received.get(topic, 0) > 2 for topic in wanted)

    bench.until(all_came, "messages on all topics")
    recorder.close()
    assert not recorder.problems
    with BagReader(tmp_path / "run") as reader:
        assert reader.topics[f"{bench.namespace}/left/joint_states"] == "sensor_msgs/msg/JointState"
        assert reader.topics[extra] == "std_msgs/msg/String"
        assert reader.topics["/diagnostics"] == "diagnostic_msgs/msg/DiagnosticArray"
        others = [topic for topic in reader.topics if "/biases" in topic or "covariance" in topic]
    assert not others  # they are made only for who asks for them


def test_nothing_but_inputs_unless_asked_for(bench: Bench, record: Record, finger_config: Path) -> None:
    bench.probe.create_publisher(JointState, "joint_states", 10)
    bench.probe.create_publisher(DiagnosticArray, "/diagnostics", 10)
    recorder = record(finger_config)
    bench.until(lambda: bench.probe.count_publishers("/diagnostics"))
    recorder.discover()
    assert set(recorder.received) == {f"{bench.namespace}/{topic}" for topic in FINGER}


def test_an_input_of_another_type_is_named(
    bench: Bench, make_bench: Callable[[str], Bench], record: Record, finger_config: Path
) -> None:
    other = make_bench("single")  # a process has one type for a topic
    other.probe.create_publisher(String, f"{bench.namespace}/imu/palm", 10)
    recorder = record(finger_config)
    bench.until(lambda: recorder.discover() or recorder.problems, "the problem")
    (problem,) = recorder.problems.values()
    assert problem.startswith(f"{bench.namespace}/imu/palm is of several types: ")


def test_a_full_disk_ends_it_and_the_recording_is_sound(
    bench: Bench, record: Record, finger_config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_FLUSH", 0.0)
    recorder = record(finger_config)
    bench.hardware(source="finger", rate_hz=1000.0, loop=True)
    bench.until(lambda: sum(recorder.writer.counts.values()) > 1000, "the first chunks")

    def fail(*_: Any) -> None:
        recorder.writer._write = original  # type: ignore[method-assign]
        raise OSError(errno.ENOSPC, "No space left on device")

    original = recorder.writer._write
    recorder.writer._write = fail  # type: ignore[method-assign]
    bench.until(lambda: not recorder.running, "the end")
    assert str(recorder.failure) == f"{tmp_path / 'run'}: cannot be written: No space left on device"
    assert sum(len(messages) for messages in read(tmp_path / "run").values()) > 1000


def test_a_target_that_is_there_is_refused(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    with pytest.raises(BagError, match="exists already"):
        Recorder(tmp_path / "run", Wanted({}), context=bench.context)
    assert "recorder" not in bench.probe.get_node_names()
    assert list(tmp_path.iterdir()) == [tmp_path / "run"]
    assert not list((tmp_path / "run").iterdir())


def test_names_of_attributes_are_not_those_of_rclpy(bench: Bench, record: Record, finger_config: Path) -> None:
    plain = Node("plain", context=bench.context)
    taken = set(vars(plain)) | {name for name in dir(Node) if not name.startswith("__")}
    own = {name for name in vars(Recorder) if not name.startswith("__")}
    assert not taken & (own | (set(vars(record(finger_config))) - set(vars(plain))))
    plain.destroy_node()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--duration", "-1"), "--duration: -1 is not allowed; give seconds, or 0 for no end"),
        (("--output", "{taken}"), "{taken}: exists already; remove it or choose another name"),
        (("--config", "nowhere.yaml"), "nowhere.yaml: no such configuration file"),
        (
            ("--topics", "a topic"),
            "'/a topic': Invalid topic name: topic name must not contain characters other than alphanumerics, '_', "
            "or '/'",
        ),
    ],
)
def test_mistakes(
    arguments: tuple[str, ...],
    message: str,
    tmp_path: Path,
    finger_config: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    taken = tmp_path / "taken"
    taken.mkdir()
    usual = ("--output", str(tmp_path / "run"), "--config", str(finger_config))
    assert main(["record", *usual, *(word.format(taken=taken) for word in arguments)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == f"jointest record: error: {message.format(taken=taken)}\n"
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
