"""`jointest calibrate hall`: from a recording with a reference to a configuration that estimates better."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bag_copies import broken_off, copied

from jointest_ros import config
from jointest_ros.bags.cdr import FLOAT32_MULTIARRAY, decode_float32_multiarray, decode_joint_state
from jointest_ros.bags.cdr_encode import JointStateEncoder, encode_float32_multiarray
from jointest_ros.bags.writer import BagWriter
from jointest_ros.core.hall_sensor import ExponentialCurve, SplineCurve

Jointest = Callable[..., Any]
HALL, TRUTH = "/hall_voltages", "/ground_truth/joint_states"
JOINTS = ["joint_1", "joint_2", "joint_3", "joint_4"]
OFFSETS = (-0.040, 0.020)  # V, of the scenario "offset"
WRONG = {"a_deg": 0.05, "b": 3.1, "c_deg": 1.2e5, "d": 7.9}


def simulated(jointest: Jointest, bag: Path, seed: int = 0, duration: float = 20.0, scenario: str = "offset") -> Path:
    """Such a recording at `bag`, whose curves and offsets the configuration `robot.yaml` beside it does not know."""
    options = ("--duration", duration, "--seed", seed, "--scenario", scenario)
    assert jointest("simulate", "exoshell", "-o", bag, *options).code == 0
    document = yaml.safe_load(bag.with_name(f"{bag.name}.yaml").read_text(encoding="utf-8"))
    for entry in document["hall"]:
        entry |= {"curve": WRONG, "noise_v": 0.03}
    robot = bag.with_name("robot.yaml")
    robot.write_text(yaml.safe_dump({"calibration_file": "calibrated.yaml", **document}), encoding="utf-8")
    return robot


@pytest.fixture(scope="module")
def run(jointest: Jointest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 8 s. Not to be changed."""
    bag = tmp_path_factory.mktemp("hall") / "run"
    simulated(jointest, bag, duration=8.0)
    return bag


@pytest.fixture
def robot(run: Path, tmp_path: Path) -> Path:
    """Its configuration in a folder of its own, without a calibration as yet."""
    path = tmp_path / "robot.yaml"
    path.write_bytes(run.with_name("robot.yaml").read_bytes())
    return path


def with_volts(change: Callable[[list[float]], list[float]]) -> Callable[[str, int, bytes], bytes]:
    """Changes the voltages of every Hall message."""

    def changed(topic: str, _time: int, data: bytes) -> bytes:
        if topic != HALL:
            return data
        volts = change(list(decode_float32_multiarray(data)[0]))
        return encode_float32_multiarray(volts, (("joint", 4), ("sensor", len(volts) // 4)))

    return changed


def with_truth(names: list[str], shift_ns: int = 0) -> Callable[[str, int, bytes], bytes]:
    """Keeps only some joints of the ground truth, at other stamps."""
    encoder = JointStateEncoder(names)

    def changed(topic: str, _time: int, data: bytes) -> bytes:
        if topic != TRUTH:
            return data
        stamp, known, position, velocity = decode_joint_state(data)
        columns = [known.index(name) if name in known else 0 for name in names]
        return encoder.encode(stamp + shift_ns, [position[c] for c in columns], [velocity[c] for c in columns])

    return changed


def errors(jointest: Jointest, bag: Path, robot: Path) -> dict[str, list[float]]:
    """Root mean square errors of the joints after 5 s, deg, by estimator."""
    result = jointest("evaluate", bag, "-c", robot, "-e", "hall", "-e", "kckf", "--skip", 5, "--json", "-")
    assert result.code == 0
    figures = json.loads(result.out)["estimators"]
    return {name: [table["joints"][joint]["rmse_deg"] for joint in JOINTS] for name, table in figures.items()}


@pytest.mark.parametrize(("seed", "curve"), [(1, "exponential"), (2, "exponential"), (3, "spline")])
def test_after_calibration_the_estimators_are_as_good_as_with_the_true_curves(
    seed: int, curve: str, jointest: Jointest, tmp_path: Path
) -> None:
    bag, fresh = tmp_path / "run", tmp_path / "fresh"
    robot = simulated(jointest, bag, seed)
    simulated(jointest, fresh, seed + 100)  # judged on another recording than that of the fit
    configured = robot.read_bytes()
    before = errors(jointest, fresh, robot)
    result = jointest("calibrate", "hall", bag, "--config", robot, "--curve", curve)
    assert result.code == 0
    assert robot.read_bytes() == configured
    assert (tmp_path / "calibrated.png").read_bytes().startswith(b"\x89PNG")
    after = errors(jointest, fresh, robot)

    true = tmp_path / "true.yaml"
    document = yaml.safe_load((tmp_path / "run.yaml").read_text(encoding="utf-8"))
    for number, entry in enumerate(document["hall"]):
        entry["offset_v"] = OFFSETS[number % 2]
    true.write_text(yaml.safe_dump(document), encoding="utf-8")
    best = errors(jointest, fresh, true)
    for k in range(4):
        assert after["hall"][k] < 1.1 * best["hall"][k] < 0.6 * before["hall"][k]
        assert after["kckf"][k] < best["kckf"][k] + 0.1 < 0.2 * before["kckf"][k]
    for sensor in config.load(robot).robot.hall:
        assert isinstance(sensor.curve, ExponentialCurve if curve == "exponential" else SplineCurve)
        assert sensor.noise == pytest.approx(0.010, rel=0.1)


def test_what_it_says(jointest: Jointest, run: Path, robot: Path) -> None:
    result = jointest("calibrate", "hall", run, "-c", robot)
    assert result.code == 0
    assert all(f"{joint} #{number}" in result.out for joint in JOINTS for number in (1, 2))
    assert f"{robot.with_name('calibrated.yaml')}: 8 of 8 Hall sensors fitted" in result.out
    assert "to use it" not in result.out
    comment = [line for line in robot.with_name("calibrated.yaml").read_text().splitlines() if line.startswith("#")]
    assert comment[0] == "# Hall sensors by: jointest calibrate hall run --config robot.yaml"
    assert comment[1].startswith("# Recording: run, recorded 1970-01-01 00:00:01 UTC by its stamps; reference ")
    assert comment[4].startswith("#   joint_1 #2: ") and " mV, " in comment[4]


def test_the_output_may_be_elsewhere(jointest: Jointest, run: Path, robot: Path, tmp_path: Path) -> None:
    picture = tmp_path / "curves.svg"
    result = jointest("calibrate", "hall", run, "-c", robot, "-o", tmp_path / "other.yaml", "--plot", picture)
    assert result.code == 0
    assert f"to use it, write into {robot}: calibration_file: other.yaml" in result.out
    assert "<svg" in picture.read_text(encoding="utf-8")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["curves.svg", "other.yaml", "robot.yaml"]


def test_half_of_the_range_is_told(jointest: Jointest, run: Path, robot: Path) -> None:
    document = yaml.safe_load(robot.read_text(encoding="utf-8"))
    for name, joint in document["robot"]["joints"].items():
        joint["limits_deg"] = [-80.0, 80.0] if name == "joint_1" else [-20.0, 20.0]
    robot.write_text(yaml.safe_dump(document), encoding="utf-8")
    result = jointest("calibrate", "hall", run, "-c", robot)
    assert result.code == 0
    warned = result.err.splitlines()
    assert [line.partition(": covers")[0] for line in warned] == ["warning: joint_1 #1", "warning: joint_1 #2"]
    assert all("move the joint further" in line for line in warned)


def test_joints_can_be_calibrated_one_after_the_other(
    jointest: Jointest, run: Path, robot: Path, tmp_path: Path
) -> None:
    for count, joint in enumerate(JOINTS[:2], 1):
        bag = copied(run, tmp_path / joint, with_truth([joint]))
        result = jointest("calibrate", "hall", bag, "-c", robot)
        assert result.code == 0
        assert "2 of 8 Hall sensors fitted" in result.out
        wrong = ExponentialCurve(**WRONG)
        assert [sensor.curve == wrong for sensor in config.load(robot).robot.hall].index(True) == 2 * count
    assert "joint_3 #1, joint_3 #2" in result.out


def test_a_place_without_a_sensor_stays(jointest: Jointest, run: Path, robot: Path, tmp_path: Path) -> None:
    bag = copied(run, tmp_path / "run", with_volts(lambda volts: [*volts[:7], math.nan]))
    result = jointest("calibrate", "hall", bag, "-c", robot)
    assert result.code == 0
    assert "without reference or reading: joint_4 #2" in result.out
    assert config.load(robot).robot.hall[7].curve == ExponentialCurve(**WRONG)


def test_without_imus_the_record_times_count(jointest: Jointest, run: Path, robot: Path, tmp_path: Path) -> None:
    assert jointest("calibrate", "hall", run, "-c", robot).code == 0
    paired = config.load(robot).robot.hall
    bag = copied(run, tmp_path / "bench", lambda topic, _, data: None if "imu" in topic else data)
    result = jointest("calibrate", "hall", bag, "-c", robot)
    assert result.code == 0
    assert "no IMU message to give the voltages a stamp" in result.err
    volts = np.linspace(1.1, 1.7, 10)
    for one, other in zip(config.load(robot).robot.hall, paired, strict=True):
        assert one.angle(volts) == pytest.approx(other.angle(volts), abs=1e-3)


def test_a_lag_is_told(jointest: Jointest, run: Path, robot: Path, tmp_path: Path) -> None:
    earlier: list[list[float]] = []

    def late(volts: list[float]) -> list[float]:
        earlier.append(volts)
        return earlier[max(0, len(earlier) - 4)]

    result = jointest("calibrate", "hall", copied(run, tmp_path / "late", with_volts(late)), "-c", robot)
    assert result.code == 0
    assert sum("the voltages lag behind the reference by " in line for line in result.err.splitlines()) == 8


def test_a_damaged_recording_gives_what_it_can(jointest: Jointest, run: Path, robot: Path, tmp_path: Path) -> None:
    result = jointest("calibrate", "hall", broken_off(run, tmp_path / "run", 0.7), "-c", robot)
    assert result.code == 2
    assert result.err.splitlines()[-1].endswith("the calibration rests on what came before")
    assert config.load(robot).robot.hall[0].noise == pytest.approx(0.010, rel=0.1)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda topic, _, data: None if topic == HALL else data, "topic '/hall_voltages' is not in the bag"),
        (
            lambda topic, _, data: None if topic == TRUTH else data,
            "topic '/ground_truth/joint_states' is not in the bag",
        ),
        (with_truth(["knee"]), "no angle of joint_1, joint_2, joint_3, joint_4; it has: knee"),
        (with_truth(JOINTS, 3600 * 10**9), "the reference of joint_1 and the voltages have no stamps in common"),
        (
            with_volts(lambda volts: [*volts[:2], 1.8, *volts[3:]]),
            "joint_2 #1: 0 of 800 readings are between the rails",
        ),
        (with_volts(lambda volts: [math.nan] * 8), "gave no voltage"),
        (with_volts(lambda volts: volts[:4]), "0 of 800 messages used, 800 wrong length"),
        (
            with_volts(lambda volts: [volts[1], volts[0], *volts[2:]]),
            "joint_1 #1: the voltage falls where it should rise",
        ),
    ],
    ids=["no hall", "no reference", "other joints", "no overlap", "rail", "nan", "length", "swapped"],
)
def test_an_unsuitable_recording_is_refused_and_nothing_written(
    change: Callable[[str, int, bytes], bytes | None],
    expected: str,
    jointest: Jointest,
    run: Path,
    robot: Path,
    tmp_path: Path,
) -> None:
    bag = copied(run, tmp_path / "other", change)
    text = jointest("calibrate", "hall", bag, "-c", robot).refusal()
    assert expected in text and str(bag) in text
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other", "robot.yaml"]


def test_a_topic_of_another_type_is_refused(jointest: Jointest, robot: Path, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "other") as writer:
        for topic in (HALL, TRUTH):
            writer.add_topic(topic, FLOAT32_MULTIARRAY)
            writer.write(topic, 1, encode_float32_multiarray([1.0] * 8))
    text = jointest("calibrate", "hall", tmp_path / "other", "-c", robot).refusal()
    assert text.endswith(
        f"topic '{TRUTH}' is of type std_msgs/msg/Float32MultiArray; expected sensor_msgs/msg/JointState"
    )


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["-o", "robot.yaml"], "robot.yaml: is the configuration, which is never written"),
        (["-o", "notes.txt"], "it is no calibration of this robot, and stays"),
        (["-o", "none/calibrated.yaml", "--plot", "a.png"], "calibrated.yaml: cannot be written: No such file"),
        (["--plot", "curves.doc"], "curves.doc: the suffix '.doc' is not allowed"),
        (["--plot", "none/curves.png"], "curves.png: cannot be written: No such file"),
        (["-o", "curves.png"], "curves.png: is the calibration file"),
    ],
)
def test_a_place_to_write_that_will_not_do_is_refused(
    options: list[str], expected: str, jointest: Jointest, run: Path, robot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(robot.parent)
    notes = robot.with_name("notes.txt")
    notes.write_text("to do", encoding="utf-8")
    configured = robot.read_bytes()
    assert expected in jointest("calibrate", "hall", run, "-c", robot.name, *options).refusal()
    assert (notes.read_text(encoding="utf-8"), robot.read_bytes()) == ("to do", configured)


def test_a_configuration_that_will_not_do_is_refused(
    jointest: Jointest, run: Path, robot: Path, finger_yaml: Path
) -> None:
    assert "hall: none; list the sensors" in jointest("calibrate", "hall", run, "-c", finger_yaml).refusal()
    text = jointest("calibrate", "hall", run, "-c", run.with_name("run.yaml")).refusal()
    assert "calibration_file: none; name a file there, or give -o FILE" in text
    robot.with_name("calibrated.yaml").write_text("hall: []", encoding="utf-8")
    text = jointest("calibrate", "hall", run, "-c", robot).refusal()
    assert "calibrated.yaml: hall: [] is not allowed; give 8 entries" in text
    assert "remove the file and calibrate again" in text
