"""`jointest estimate`: joint angles into CSV and rosbag2, and the ways in which it refuses."""

from __future__ import annotations

import csv
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_copies import copied

from jointest_ros import config
from jointest_ros.bags import offline
from jointest_ros.bags.cdr import JOINT_STATE, decode_joint_state
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.cli.common import load_estimators
from jointest_ros.core.frame import Series, Status
from jointest_ros.core.timing import Timing

Jointest = Callable[..., Any]
JOINTS = ("finger_mcp", "finger_pip", "finger_dip")


def expected(bag: Path, configuration: Path) -> dict[str, Series]:
    """The estimates of every estimator of a configuration."""
    read = config.load(configuration)
    estimators = load_estimators(read, None)
    sink = offline.SeriesSink(estimators)
    with BagReader(bag) as reader:
        offline.run(reader, Intake(read.robot, Timing()), estimators, sink)
    return {name: sink.series(name) for name in estimators}


def table(path: Path) -> tuple[list[str], np.ndarray]:
    """Header and rows of a CSV file."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, dtype=float)


@pytest.fixture
def without_truth(finger: Path, tmp_path: Path) -> Path:
    """The recording `finger` without its ground truth."""
    return copied(finger, tmp_path / "without_truth", lambda topic, _, data: data if "imu/" in topic else None)


def test_csv(without_truth: Path, finger_yaml: Path, jointest: Jointest, tmp_path: Path) -> None:
    out = tmp_path / "angles.csv"
    result = jointest("estimate", without_truth, "-c", finger_yaml, "-o", out)
    assert result == (0, f"{out}: 500 frames, pcf\n", "")
    header, rows = table(out)
    parts = ("rad", "rad_s", "std_rad", "status")
    assert header == ["stamp_ns", *(f"{joint}_{part}" for joint in JOINTS for part in parts)]
    series = expected(without_truth, finger_yaml)["pcf"]
    assert np.array_equal(rows[:, 0], series.stamps)
    assert np.array_equal(rows[:, 1::4], series.position)
    assert np.array_equal(rows[:, 2::4], series.velocity)
    assert rows[:, 3::4] == pytest.approx(np.sqrt(series.variance), rel=1e-12)
    assert np.array_equal(rows[:, 4::4], series.status)


def test_csv_of_several_estimators(shell: Path, jointest: Jointest, tmp_path: Path) -> None:
    out = tmp_path / "angles.CSV"
    assert jointest("estimate", shell, "-c", f"{shell}.yaml", "-o", out).code == 0
    header, rows = table(out)
    series = expected(shell, shell.with_name("shell.yaml"))
    assert len(series) > 2
    for name, one in series.items():
        columns = [header.index(f"{name}/joint_{number}_rad") for number in range(1, 5)]
        assert np.array_equal(rows[:, columns], one.position)
    assert jointest("estimate", shell, "-c", f"{shell}.yaml", "-e", "kf", "-o", tmp_path / "kf.csv").code == 0
    assert table(tmp_path / "kf.csv")[0][1] == "joint_1_rad"


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_rosbag2(storage: str, without_truth: Path, finger_yaml: Path, jointest: Jointest, tmp_path: Path) -> None:
    out = tmp_path / "angles"
    result = jointest("estimate", without_truth, "-c", finger_yaml, "-o", out, "--storage", storage)
    assert (result.code, result.err) == (0, "")
    series = expected(without_truth, finger_yaml)["pcf"]
    shown = (series.status & int(Status.STARTING | Status.STALE) == 0).all(axis=1)
    with BagReader(out) as reader:
        assert reader.topics == {"/joint_states": JOINT_STATE}
        messages = [(time, decode_joint_state(data)) for _, time, data in reader.messages()]
    assert [time for time, _ in messages] == [stamp for _, (stamp, *_) in messages] == series.stamps[shown].tolist()
    assert np.array_equal([position for _, (_, _, position, _) in messages], series.position[shown])
    assert np.array_equal([velocity for _, (_, _, _, velocity) in messages], series.velocity[shown])
    assert messages[0][1][1] == JOINTS


def test_rosbag2_of_several_estimators(shell: Path, jointest: Jointest, tmp_path: Path) -> None:
    out = tmp_path / "angles"
    assert jointest("estimate", shell, "-c", f"{shell}.yaml", "-e", "kf", "-e", "kckf", "-o", out).code == 0
    with BagReader(out) as reader:
        assert set(reader.topics) == {"/kf/joint_states", "/kckf/joint_states"}


@pytest.mark.parametrize("name", ["angles.csv", "angles"])
def test_a_damaged_recording_gives_what_came_before(
    name: str, damaged: Path, finger_yaml: Path, jointest: Jointest, tmp_path: Path
) -> None:
    out = tmp_path / name
    result = jointest("estimate", damaged, "-c", finger_yaml, "-o", out)
    text = result.refusal()
    assert text.startswith(f"{damaged}: damaged after ")
    assert text.endswith(f"; what came before is in {out}")
    if out.is_dir():
        with BagReader(out) as reader:
            assert reader.message_count > 1000
    else:
        assert len(table(out)[1]) > 1000


def test_what_exists_is_kept_unless_told_otherwise(
    finger: Path, finger_yaml: Path, jointest: Jointest, tmp_path: Path
) -> None:
    for name in ("angles.csv", "angles"):
        arguments = ("estimate", finger, "-c", finger_yaml, "-o", tmp_path / name)
        assert jointest(*arguments).code == 0
        assert f"{tmp_path / name}: exists already" in jointest(*arguments).refusal()
        assert jointest(*arguments, "--overwrite").code == 0


def test_the_recording_itself_is_never_overwritten(
    finger: Path, finger_yaml: Path, jointest: Jointest, tmp_path: Path
) -> None:
    bag = tmp_path / "run"
    shutil.copytree(finger, bag)
    (file,) = bag.glob("*.mcap")
    content = file.read_bytes()
    link = tmp_path / "link"
    link.symlink_to(bag)
    for source, target in ((bag, bag), (file, bag), (link, bag), (bag, link)):
        text = jointest("estimate", source, "-c", finger_yaml, "-o", target, "--overwrite").refusal()
        assert text == f"{target}: is the recording itself; choose another name"
    assert file.read_bytes() == content


@pytest.mark.parametrize("name", ["-", "angles.txt", "angles.mcap"])
def test_a_name_that_is_neither_csv_nor_a_bag(
    name: str, finger: Path, finger_yaml: Path, jointest: Jointest, tmp_path: Path
) -> None:
    text = jointest("estimate", finger, "-c", finger_yaml, "-o", tmp_path / name).refusal()
    advice = "give a name that ends in .csv, or the name of a new bag (no extension)"
    assert text == f"{tmp_path / name}: is not allowed as output; {advice}"
    assert list(tmp_path.iterdir()) == []


def test_outputs_that_cannot_be_written(finger: Path, finger_yaml: Path, jointest: Jointest, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder.csv").mkdir()
    for out in (tmp_path / "absent" / "angles.csv", tmp_path / "file" / "angles.csv", tmp_path / "file" / "angles"):
        text = jointest("estimate", finger, "-c", finger_yaml, "-o", out).refusal()
        assert text.startswith(f"{out}: cannot be written: ")
    text = jointest("estimate", finger, "-c", finger_yaml, "-o", tmp_path / "folder.csv", "--overwrite").refusal()
    assert text == f"{tmp_path}/folder.csv: cannot be written: Is a directory"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_a_full_disk(finger: Path, finger_yaml: Path, jointest: Jointest, tmp_path: Path) -> None:
    out = tmp_path / "angles.csv"
    out.symlink_to("/dev/full")
    text = jointest("estimate", finger, "-c", finger_yaml, "-o", out, "--overwrite").refusal()
    assert text == f"{out}: cannot be written: No space left on device"


def test_a_robot_without_joints(finger: Path, jointest: Jointest, tmp_path: Path) -> None:
    path = tmp_path / "broad.yaml"
    shutil.copy(Path(__file__).resolve().parents[2] / "config/broad.yaml", path)
    text = jointest("estimate", finger, "-c", path, "-o", tmp_path / "x.csv").refusal()
    assert text == f"{path}: robot.joints: none; there is no joint angle to estimate"
    assert not (tmp_path / "x.csv").exists()
