"""Recordings and configurations that are none: one line and code 2 from `estimate` and from `evaluate` alike."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from bag_copies import copied

from jointest_ros.bags.cdr import IMU, JOINT_STATE
from jointest_ros.bags.cdr_encode import JointStateEncoder
from jointest_ros.bags.writer import BagWriter

Run = Callable[[Path, Path], str]  # recording, configuration -> text of the refusal


@pytest.fixture(params=["estimate", "evaluate"])
def refused(request: pytest.FixtureRequest, jointest: Callable[..., Any], tmp_path: Path) -> Run:
    """A function that expects a refusal, of either command, and no output."""

    def run(bag: Path, configuration: Path) -> str:
        output = ("-o", tmp_path / "out.csv") if request.param == "estimate" else ("--json", tmp_path / "out.csv")
        result = jointest(request.param, bag, "-c", configuration, *output)
        assert result.out == ""
        assert not (tmp_path / "out.csv").exists()
        text: str = result.refusal()
        return text

    return run


def test_paths_that_are_no_recording(refused: Run, finger_yaml: Path, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("hello, this is no bag at all", encoding="utf-8")
    (tmp_path / "empty.db3").touch()
    (tmp_path / "angles.csv").write_text("1,2", encoding="utf-8")
    for name, expected in {
        "absent": "no such bag",
        "folder": "not a bag; it has no metadata.yaml",
        "empty.mcap": "empty file",
        "text.mcap": "not a bag, in spite of its suffix",
        "empty.db3": "empty file",
        "angles.csv": "not a bag; give a rosbag2 directory",
    }.items():
        assert refused(tmp_path / name, finger_yaml).startswith(f"{tmp_path / name}: {expected}")


def test_a_recording_without_messages(refused: Run, finger_yaml: Path, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/imu/palm", IMU)
    assert refused(tmp_path / "bag", finger_yaml) == f"{tmp_path / 'bag'}: empty bag (no messages)"


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_recording_of_which_nothing_is_left(
    storage: str, refused: Run, finger_yaml: Path, jointest: Callable[..., Any], tmp_path: Path
) -> None:
    jointest("simulate", "finger", "-o", tmp_path / "bag", "--storage", storage, "--rate", 100, "--duration", 1)
    (file,) = (one for one in (tmp_path / "bag").iterdir() if one.name != "metadata.yaml")
    with file.open("rb+") as stream:
        stream.truncate(60)
    assert str(tmp_path / "bag") in refused(tmp_path / "bag", finger_yaml)


def test_topics_of_the_wrong_type(refused: Run, finger_yaml: Path, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        for topic in ("/imu/palm", "/ground_truth/joint_states"):
            writer.add_topic(topic, JOINT_STATE)
            writer.write(topic, 1, JointStateEncoder(["a"]).encode(1, [0.0]))
    assert refused(tmp_path / "bag", finger_yaml) == (
        f"{tmp_path / 'bag'}: topic '/imu/palm' is of type sensor_msgs/msg/JointState; expected sensor_msgs/msg/Imu"
    )


def test_no_matching_topic(refused: Run, finger: Path, finger_yaml: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    document = yaml.safe_load(finger_yaml.read_text(encoding="utf-8"))
    for name, sensor in document["sensors"].items():
        sensor["topic"] = f"elsewhere/{name}"
    other.write_text(yaml.safe_dump(document), encoding="utf-8")
    text = refused(finger, other)
    assert text.startswith(f"{finger}: no matching topic; the configuration wants elsewhere/")
    assert "/imu/palm" in text


def test_configurations_that_are_none(refused: Run, finger: Path, tmp_path: Path) -> None:
    wrong = tmp_path / "robot.yaml"
    assert refused(finger, wrong) == f"{wrong}: no such configuration file"
    for content, expected in {
        "": "robot: missing; give at least its links",
        "robot: [": "line 1: no valid YAML",
        "robot: {links: [a]}": "no section under estimators; name one of pcf",
        "robot: {links: [a]}\nestimators: {pcf: }": "robot: no joints between IMUs; pcf needs joints",
        "robot: {links: [a]}\nestimators: {pcf: {kp: -1}}": "estimators.pcf.kp: -1 is not allowed; give 0 to 100 1/s",
    }.items():
        wrong.write_text(content, encoding="utf-8")
        assert refused(finger, wrong).startswith(f"{wrong}: {expected}")
    sensors = "{upper: {topic: imu}, lower: {topic: imu}}"
    robot = "{links: [upper, lower], joints: {j: {parent: upper, child: lower, axis: x}}}"
    wrong.write_text(f"robot: {robot}\nsensors: {sensors}\nestimators: {{pcf: }}", encoding="utf-8")
    assert refused(finger, wrong) == (
        f"{wrong}: sensor 'lower'.topic: 'imu' is that of 'upper' too; give each a topic or a frame_id of its own"
    )


def test_estimators_that_are_none(
    jointest: Callable[..., Any], finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    for command in (("estimate", "-o", tmp_path / "x.csv"), ("evaluate",)):
        text = jointest(command[0], finger, "-c", finger_yaml, "-e", "pfc", *command[1:]).refusal()
        assert text.startswith("--estimator: 'pfc' is not allowed; give one of pcf, ")


def test_a_missing_topic_is_warned_of(
    jointest: Callable[..., Any], finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    path = copied(finger, tmp_path / "part", lambda topic, _, data: None if topic == "/imu/distal" else data)
    for command in (("estimate", path, "-o", tmp_path / "x.csv"), ("evaluate", path)):
        result = jointest(*command, "-c", finger_yaml)
        assert result.code == 0
        first, *others = result.err.splitlines()
        assert (
            first
            == f"warning: {path}: topic 'imu/distal' of the configuration is not in the bag; its joints go without"
        )
        told = ["warning: pcf: no estimate of finger_dip in the whole recording"] if command[0] == "estimate" else []
        assert others == told


def test_names_with_brackets_colons_and_blanks_are_shown_as_they_are(
    jointest: Callable[..., Any], finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    path = tmp_path / "[bold]run :bug: 1"
    shutil.copytree(finger, path)
    result = jointest("evaluate", path, "-c", finger_yaml)
    assert (result.code, result.err) == (0, "")
    assert result.out.splitlines()[0].startswith(f"{path}: 5.0 s")
    assert jointest("evaluate", f"{path}x", "-c", finger_yaml).refusal() == f"{path}x: no such bag"
