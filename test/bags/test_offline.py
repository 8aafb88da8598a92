"""A recording through the estimators: the results of its sound part, what was refused, and in how much memory."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from jointest_ros.bags import cdr, offline, synthetic
from jointest_ros.bags.cdr_encode import ImuEncoder, JointStateEncoder, encode_quaternion_stamped
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.ground_truth import TRUTH_JOINTS, TRUTH_ORIENTATION
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.offline import Outcome, SeriesSink
from jointest_ros.bags.output import JointStateOutput
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter, StorageName
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, Series, Status
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.robot import Robot, Sensor
from jointest_ros.core.timing import Timing
from jointest_ros.sim import finger
from jointest_ros.sim.simulated import SimulatedRobot

Message = tuple[str, int, bytes]  # topic, record time ns, bytes
TYPES = {
    "imu/": cdr.IMU,
    TRUTH_JOINTS: cdr.JOINT_STATE,
    TRUTH_ORIENTATION: cdr.QUATERNION_STAMPED,
}
IMUS = [f"/imu/{link}" for link in finger.LINKS]


@pytest.fixture(scope="module")
def hand() -> SimulatedRobot:
    return finger.simulate("PC", rate_hz=100.0, duration_s=4.0, zero_pose_s=1.0, seed=2)


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """A function that writes messages into a bag; types are those of the topics' names, unless given."""

    def to_bag(messages: Iterable[Message], types: dict[str, str] | None = None, storage: StorageName = "mcap") -> Path:
        path = tmp_path / f"bag_{len(list(tmp_path.iterdir()))}"
        declared: set[str] = set()
        with BagWriter(path, storage) as bag:
            for topic, time, data in messages:
                if topic not in declared:
                    declared.add(topic)
                    kind = next(msgtype for name, msgtype in TYPES.items() if f"/{name}" in topic)
                    bag.add_topic(topic, (types or {}).get(topic, kind))
                bag.write(topic, time, data)
        return path

    return to_bag


def messages_of(hand: SimulatedRobot, prefix: str = "/") -> list[Message]:
    return [(f"{prefix}{topic}", stamp, data) for stamp, topic, data in synthetic.messages([hand])]


def evaluated(path: Path, robot: Robot, namespace: str = "") -> tuple[Outcome, Series]:
    """Outcome and estimates of a recording."""
    estimators: dict[str, Estimator] = {"pcf": Pcf(robot)}
    sink = SeriesSink(estimators)
    with BagReader(path) as reader:
        outcome = offline.run(reader, Intake(robot, Timing()), estimators, sink, namespace=namespace)
    for counts in outcome.inputs.values():
        assert counts["messages"] == counts["used"] + sum(counts["refused"].values())
    return outcome, sink.series("pcf")


def equal(one: Series, two: Series) -> bool:
    names = ("stamps", "position", "velocity", "variance", "status")
    return all(np.array_equal(getattr(one, name), getattr(two, name)) for name in names)


# -------------------------------------------------------------------- sound recordings


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_the_same_numbers_as_from_the_simulated_frames(
    storage: StorageName, hand: SimulatedRobot, write: Callable[..., Path]
) -> None:
    outcome, series = evaluated(write(messages_of(hand), storage=storage), hand.robot)
    intake, estimator = Intake(hand.robot, Timing()), Pcf(hand.robot)
    frames = [
        frame
        for stamp, topic, data in synthetic.messages([hand])
        if topic in intake.handlers
        for frame in intake.handlers[topic](data, stamp)
    ] + intake.flush()
    expected = Series.from_estimates([estimator.update(frame) for frame in frames], 3)
    assert equal(series, expected)
    assert len(series) == outcome.frames == 400
    assert outcome.inputs == {topic: {"messages": 400, "used": 400, "refused": {}} for topic in IMUS}
    assert (outcome.warnings, outcome.damage) == ([], "")
    assert outcome.ns_per_frame["pcf"] is not None
    assert outcome.ns_per_frame["pcf"] > 0.0


def test_the_truth_is_that_of_the_simulation(hand: SimulatedRobot, write: Callable[..., Path]) -> None:
    truth = evaluated(write(messages_of(hand)), hand.robot)[0].truth
    assert np.array_equal(truth.stamps, hand.recording.stamps + synthetic.FIRST_STAMP)
    for column, joint in enumerate(finger.JOINTS):
        assert np.array_equal(truth.position[joint], hand.truth_position[:, column])
        assert np.array_equal(truth.velocity[joint], hand.truth_velocity[:, column])
    assert truth.orientation == {}


@pytest.mark.parametrize("namespace", ["/left/hand", "left/hand", "/left/hand/"])
def test_a_namespace_is_put_before_relative_names(
    namespace: str, hand: SimulatedRobot, write: Callable[..., Path]
) -> None:
    path = write([*messages_of(hand, "/left/hand/"), *messages_of(hand, "/right/hand/")][::7])
    outcome, _ = evaluated(path, hand.robot, namespace)
    assert list(outcome.inputs) == [f"/left/hand{topic}" for topic in IMUS]
    assert len(outcome.truth.stamps)
    with BagReader(path) as reader:
        assert offline.has_truth(reader, namespace)
        assert not offline.has_truth(reader)
        with pytest.raises(BagError, match=r"no matching topic; the configuration wants imu/palm, .*it has: /left"):
            offline.check_topics(reader, Intake(hand.robot, Timing()))


def test_an_absolute_topic_is_the_same_in_every_namespace(hand: SimulatedRobot, write: Callable[..., Path]) -> None:
    sensors = [Sensor(s.name, s.link, s.position, s.mounting, topic=f"/imu/{s.name}") for s in hand.robot.sensors]
    robot = Robot(hand.robot.links, hand.robot.joints, tuple(sensors))
    outcome, _ = evaluated(write(messages_of(hand)), robot, "/elsewhere")
    assert list(outcome.inputs) == IMUS
    assert not outcome.truth


# -------------------------------------------------------------------- recordings with faults


def test_a_topic_that_is_missing(hand: SimulatedRobot, write: Callable[..., Path]) -> None:
    """Its joint goes without, the others are as good as ever."""
    sound = messages_of(hand)
    outcome, series = evaluated(write(m for m in sound if m[0] != "/imu/distal"), hand.robot)
    (warning,) = outcome.warnings
    assert "topic 'imu/distal' of the configuration is not in the bag" in warning
    assert list(outcome.inputs) == IMUS[:3]
    assert outcome.frames == 400
    unusable = int(Status.STARTING | Status.STALE)
    assert (series.status[:, 2] & unusable).all()
    assert not (series.status[50:, :2] & unusable).any()
    _, whole = evaluated(write(sound), hand.robot)
    assert series.position[50:, :2] == pytest.approx(whole.position[50:, :2], abs=math.radians(0.5))


def test_topics_of_the_wrong_type(hand: SimulatedRobot, write: Callable[..., Path]) -> None:
    for topic, wrong, right in (
        ("/imu/middle", cdr.JOINT_STATE, cdr.IMU),
        ("/ground_truth/joint_states", cdr.IMU, cdr.JOINT_STATE),
    ):
        path = write(messages_of(hand)[:50], types={topic: wrong})
        with pytest.raises(BagError, match=rf"{path}: topic '{topic}' is of type {wrong}; expected {right}"):
            evaluated(path, hand.robot)


def test_refused_messages_are_counted_and_the_rest_gives_its_result(
    hand: SimulatedRobot, write: Callable[..., Path]
) -> None:
    nan = (math.nan, 0.0, 0.0)
    faulty: list[Message] = []
    for topic, time, data in messages_of(hand):
        faulty.append((topic, time, data))
        if topic == "/imu/palm" and time % 1_000_000_000 == 0:
            older = ImuEncoder("palm").encode(time - 500_000_000, (0.0,) * 3, (0.0, 0.0, 9.81))
            faulty += [(topic, time, data), (topic, time, older), (topic, time, data[:60]), (topic, time, b"")]
            faulty.append((topic, time, ImuEncoder("palm").encode(time + 5_000_000, nan, nan)))
    outcome, series = evaluated(write(faulty), hand.robot)
    refused = {"repeated stamp": 4, "older stamp": 4, "undecodable": 8, "not finite": 4}
    assert outcome.inputs["/imu/palm"] == {"messages": 420, "used": 400, "refused": refused}
    assert outcome.inputs["/imu/distal"] == {"messages": 400, "used": 400, "refused": {}}
    assert equal(series, evaluated(write(messages_of(hand)), hand.robot)[1])


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_truncated_recording_gives_the_results_of_its_sound_part(
    storage: StorageName, write: Callable[..., Path]
) -> None:
    hand = finger.simulate("PC", rate_hz=100.0, duration_s=20.0, zero_pose_s=1.0, seed=2)
    path = write(messages_of(hand), storage=storage)
    _, whole = evaluated(path, hand.robot)
    (file,) = (one for one in path.iterdir() if one.name != "metadata.yaml")
    with file.open("rb+") as stream:
        stream.truncate(int(file.stat().st_size * 0.7))
    outcome, series = evaluated(path, hand.robot)
    assert str(path) in outcome.damage
    assert "damaged after" in outcome.damage
    assert 500 < outcome.frames < 1900
    first = slice(0, outcome.frames - 1)  # the last frame may be a partial one
    for name in ("stamps", "position", "variance"):
        assert np.array_equal(getattr(series, name)[first], getattr(whole, name)[first])
    assert 500 < len(outcome.truth.stamps) < 1900


def test_a_sink_that_fails_is_no_damage_of_the_recording(hand: SimulatedRobot, write: Callable[..., Path]) -> None:
    def full(_name: str, _estimates: list[Estimate]) -> None:
        raise BagError("out: no space left")

    with BagReader(write(messages_of(hand) * 6)) as reader, pytest.raises(BagError, match="no space left"):
        offline.run(reader, Intake(hand.robot, Timing()), {"pcf": Pcf(hand.robot)}, full)


# -------------------------------------------------------------------- ground truth


@pytest.fixture
def truth_of(write: Callable[..., Path]) -> Callable[[str, list[bytes]], Outcome]:
    """A function that reads a recording of one IMU sample and of truth messages, in the order given."""

    def read(topic: str, messages: list[bytes]) -> Outcome:
        robot = Robot(("imu",), sensors=(Sensor("imu", "imu"),))
        sample = ImuEncoder("imu").encode(0, (0.0,) * 3, (0.0, 0.0, 9.81))
        path = write([("/imu/imu", 0, sample), *((f"/{topic}", time, data) for time, data in enumerate(messages))])
        with BagReader(path) as reader:
            return offline.run(reader, Intake(robot, Timing()), {}, lambda _name, _estimates: None)

    return read


def test_truth_with_changing_joints_and_faulty_messages(truth_of: Callable[..., Outcome]) -> None:
    both = JointStateEncoder(["b", "a"])
    outcome = truth_of(
        TRUTH_JOINTS,
        [
            JointStateEncoder(["a"]).encode(10, [1.0]),
            both.encode(20, [2.0, 1.5], [0.2, 0.1]),
            both.encode(20, [9.0, 9.0], [9.0, 9.0]),
            both.encode(15, [9.0, 9.0], [9.0, 9.0]),
            b"\0\1\0\0 rubbish",
            JointStateEncoder(["b"]).encode(30, [3.0], [0.3]),
        ],
    )
    truth = outcome.truth
    assert truth.stamps.tolist() == [10, 20, 30]
    assert np.array_equal(truth.position["a"], [1.0, 1.5, math.nan], equal_nan=True)
    assert np.array_equal(truth.position["b"], [math.nan, 2.0, 3.0], equal_nan=True)
    assert np.array_equal(truth.velocity["a"], [math.nan, 0.1, math.nan], equal_nan=True)
    assert any("2 ground truth messages refused" in warning for warning in outcome.warnings)


def test_true_orientations(truth_of: Callable[..., Outcome]) -> None:
    half = math.sqrt(0.5)
    rows = [
        (10, "imu", (0.0, 0.0, 0.0, 1.0)),
        (20, "imu", (half, 0.0, 0.0, half)),
        (20, "imu", (0.0, 1.0, 0.0, 0.0)),
        (20, "other", (0.0, 0.0, 1.0, 0.0)),
        (5, "imu", (0.0, 1.0, 0.0, 0.0)),
        (30, "imu", (0.0, 0.0, 0.0, 0.0)),
        (30, "unknown", (math.nan,) * 4),
    ]
    outcome = truth_of(TRUTH_ORIENTATION, [encode_quaternion_stamped(stamp, name, q) for stamp, name, q in rows])
    stamps, quaternions = outcome.truth.orientation["imu"]
    assert stamps.tolist() == [10, 20]
    assert quaternions.tolist() == [[0.0, 0.0, 0.0, 1.0], [half, 0.0, 0.0, half]]
    assert len(outcome.truth.orientation["other"][0]) == 1
    assert len(outcome.truth.orientation["unknown"][0]) == 0
    assert any("3 ground truth messages refused" in warning for warning in outcome.warnings)


# -------------------------------------------------------------------- results


def test_hidden_joints_are_left_out_of_joint_states() -> None:
    output = JointStateOutput(("a", "b"))

    def shown(*status: int) -> tuple[tuple[str, ...], tuple[float, ...]] | None:
        data = output.encode(Estimate(5, (1.0, 2.0), (0.1, 0.2), (0.0, 0.0), status))
        return None if data is None else cdr.decode_joint_state(data)[1:3]

    assert shown(0, int(Status.NO_DATA | Status.GAP)) == (("a", "b"), (1.0, 2.0))
    assert shown(int(Status.STALE), 0) == (("b",), (2.0,))
    assert shown(int(Status.STARTING), int(Status.STALE)) is None


def estimates(count: int, first: int = 0) -> list[Estimate]:
    return [Estimate(k, (0.1 * k,) * 3, (0.2,) * 3, (0.3 * k,) * 3, (k % 3,) * 3) for k in range(first, first + count)]


def test_a_series_sink_keeps_numbers_not_objects() -> None:
    pcf = Pcf(finger.simulate(duration_s=0.1, rate_hz=100.0).robot)
    sink = SeriesSink({"pcf": pcf})
    chunks, size = 20, 1000
    tracemalloc.start()  # before the first chunk, whose arrays grow with the others
    try:
        sink("pcf", estimates(size))
        before = tracemalloc.get_traced_memory()[0]
        for chunk in range(1, chunks):
            sink("pcf", estimates(size, chunk * size))
        kept = (tracemalloc.get_traced_memory()[0] - before) / ((chunks - 1) * size)
    finally:
        tracemalloc.stop()
    assert kept < 1.1 * 8 * (1 + 4 * len(pcf.joints))  # bytes an estimate: stamp, and four numbers a joint
    assert equal(sink.series("pcf"), Series.from_estimates(estimates(chunks * size), 3))


def test_no_estimate_gives_an_empty_series() -> None:
    pcf = Pcf(finger.simulate(duration_s=0.1, rate_hz=100.0).robot)
    series = SeriesSink({"pcf": pcf}).series("pcf")
    assert (len(series), series.position.shape) == (0, (0, 3))


def test_memory_does_not_grow_with_the_recording(write: Callable[..., Path]) -> None:
    robot = Robot(("imu",), sensors=(Sensor("imu", "imu"),))
    encoder = ImuEncoder("imu")

    def peak(count: int) -> int:
        stamps = range(0, count * 1_000_000, 1_000_000)
        path = write(("/imu/imu", stamp, encoder.encode(stamp, (0.0,) * 3, (0.0, 0.0, 9.81))) for stamp in stamps)
        tracemalloc.start()
        try:
            with BagReader(path) as reader:
                outcome = offline.run(reader, Intake(robot, Timing()), {}, lambda _name, _estimates: None)
            assert outcome.frames == count
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    short, long = peak(9_000), peak(27_000)  # both longer than the two chunks that are alive at a time
    assert long < 1.1 * short
