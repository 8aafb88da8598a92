"""`jointest calibrate accel`: from a recording of still poses to accelerometers that read what is there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bag_copies import broken_off

from jointest_ros import config
from jointest_ros.bags.cdr import decode_imu
from jointest_ros.bags.cdr_encode import ImuEncoder
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter
from jointest_ros.core.robot import UNCALIBRATED_MATRIX, Robot

Jointest = Callable[..., Any]
Change = Callable[[str, float, np.ndarray], "np.ndarray | None"]  # topic, time s, reading -> reading
SENSORS = ["a1", "a2", "b1", "b2"]
HERE = ("--gravity", 9.81)
PLANAR, SPATIAL = "+y,+x,-y,-x,-y,+x,+y", "+y,+x,-y,-x,-z,+z,+y"


@pytest.fixture(scope="module")
def recordings(jointest: Jointest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The poses of the paper, and those with z up, by the same uncalibrated sensors. Not to be changed."""
    folder = tmp_path_factory.mktemp("accel")
    for scenario in ("poses", "poses_xyz"):
        options = ("--scenario", scenario, "--duration", 28, "--calibration", "none", "--sensor", "bno055")
        assert jointest("simulate", "two_link_arm", "-o", folder / scenario, *options).code == 0
    return folder


@pytest.fixture
def arm(recordings: Path, tmp_path: Path) -> Path:
    """Their robot, in a folder of its own and with a calibration file that is not there yet."""
    path = tmp_path / "arm.yaml"
    document = yaml.safe_load((recordings / "poses.yaml").read_text(encoding="utf-8"))
    path.write_text(yaml.safe_dump({"calibration_file": "accel.yaml", **document}), encoding="utf-8")
    return path


def copied(source: Path, target: Path, change: Change) -> Path:
    """The recording `source` with other accelerations at `target`; None: without that message."""
    with BagReader(source) as reader, BagWriter(target) as writer:
        topics = [topic for topic in reader.topics if "imu" in topic]
        for topic in topics:
            writer.add_topic(topic, reader.topics[topic])
        for topic, time, data in reader.messages(topics):
            stamp, frame_id, gyro, accel = decode_imu(data)
            changed = change(topic, time * 1e-9, np.array(accel))
            if changed is not None:
                x, y, z = changed.tolist()
                writer.write(topic, time, ImuEncoder(frame_id).encode(stamp, gyro, (x, y, z)))
    return target


def readings(bag: Path, robot: Robot) -> dict[str, list[np.ndarray]]:
    """Sensor -> calibrated mean acceleration in the middle of each of the seven poses, m/s^2."""
    names = {f"/imu/{name}": name for name in SENSORS}
    rows: dict[str, list[list[np.ndarray]]] = {name: [[] for _ in range(7)] for name in SENSORS}
    with BagReader(bag) as reader:
        for topic, time, data in reader.messages(tuple(names)):
            number, phase = divmod(time * 1e-9 - 1.0, 4.0)
            if 0.3 < phase < 2.2:
                sensor = robot.sensor(names[topic])
                raw = np.array(decode_imu(data)[3])
                rows[sensor.name][int(number)].append(np.array(sensor.accel_matrix) @ raw + sensor.accel_offset)
    return {name: [np.mean(one, axis=0) for one in poses] for name, poses in rows.items()}


def expected(poses: str) -> np.ndarray:
    axes = {"x": 0, "y": 1, "z": 2}
    rows = np.zeros((7, 3))
    for row, name in zip(rows, poses.split(","), strict=True):
        row[axes[name[1]]] = 9.81 if name[0] == "+" else -9.81
    return rows


def test_all_poses(jointest: Jointest, recordings: Path, arm: Path) -> None:
    configured, bag = arm.read_bytes(), recordings / "poses_xyz"
    before = readings(bag, config.load(arm).robot)
    result = jointest("calibrate", "accel", bag, "-c", arm, *HERE)
    assert (result.code, result.err) == (0, "")
    assert arm.read_bytes() == configured
    assert arm.with_name("accel.png").read_bytes().startswith(b"\x89PNG")
    after = readings(bag, config.load(arm).robot)
    for name in SENSORS:
        assert abs(before[name] - expected(SPATIAL)).max() > 0.1
        assert abs(after[name] - expected(SPATIAL)).max() < 0.3 * 9.81e-3
    assert "accel.yaml: 4 of 4 accelerometers fitted" in result.out
    assert "12 of 12" in result.out and "full" in result.out


def test_the_seven_poses_of_the_paper(jointest: Jointest, recordings: Path, arm: Path) -> None:
    """In their plane as good as all, and across it nothing is pretended; told in the warning and in the file."""
    result = jointest("calibrate", "accel", recordings / "poses", "-c", arm, *HERE)
    assert result.code == 0
    (warning,) = result.err.splitlines()
    assert warning == (
        "warning: a1, a2, b1, b2: the poses lie in one plane (rank 9 of 12; not told: S_xz, S_yz, S_zz); "
        "fitted is that plane, the rest stays as configured"
    )
    robot = config.load(arm).robot
    for name, rows in readings(recordings / "poses", robot).items():
        assert abs(rows - expected(PLANAR))[:, :2].max() < 0.3 * 9.81e-3
        sensor = robot.sensor(name)
        assert sensor.accel_matrix[2] == UNCALIBRATED_MATRIX[2] and sensor.accel_offset[2] == 0.0
    comment = [line for line in arm.with_name("accel.yaml").read_text().splitlines() if line.startswith("#")]
    assert comment[0] == "# Accelerometers by: jointest calibrate accel poses --config arm.yaml"
    assert comment[1] == "# Recording: poses, recorded 1970-01-01 00:00:01 UTC by its stamps; gravity 9.81 m/s^2."
    assert comment[3].startswith("#   a1: ") and comment[3].endswith(" mg after; planar, rank 9 of 12")
    assert comment[4] == f"#     7 poses: {PLANAR}"
    assert "not told by them, and as it was" in comment[5]


def test_it_is_the_raw_reading_that_is_calibrated(jointest: Jointest, recordings: Path, arm: Path) -> None:
    """A second calibration does not build on the first one."""
    once, twice = [], []
    for results in (once, twice):
        assert jointest("calibrate", "accel", recordings / "poses_xyz", "-c", arm, *HERE).code == 0
        results += [(s.accel_matrix, s.accel_offset) for s in config.load(arm).robot.sensors]
    assert once == twice
    planar = jointest("calibrate", "accel", recordings / "poses", "-c", arm, *HERE)
    assert planar.code == 0
    for sensor, (matrix, _) in zip(config.load(arm).robot.sensors, once, strict=True):
        assert sensor.accel_matrix[2] == pytest.approx(matrix[2])  # what planar poses do not tell stays


@pytest.mark.parametrize(
    "options",
    [
        (f"--poses={SPATIAL}",),
        ("--poses", f"link_a:{SPATIAL}"),
        ("--poses", f"link_a:{SPATIAL}", "--poses", f"link_b:{SPATIAL}", "--cone", "1"),
        ("--poses", SPATIAL.replace("-z", "0/0/-2")),
    ],
)
def test_given_directions(options: tuple[str, ...], jointest: Jointest, recordings: Path, arm: Path) -> None:
    result = jointest("calibrate", "accel", recordings / "poses_xyz", "-c", arm, *HERE, *options)
    assert (result.code, result.err) == (0, "")
    after = readings(recordings / "poses_xyz", config.load(arm).robot)
    assert max(abs(after[name] - expected(SPATIAL)).max() for name in SENSORS) < 0.3 * 9.81e-3


def test_a_phase_can_be_left_out(jointest: Jointest, recordings: Path, arm: Path) -> None:
    result = jointest("calibrate", "accel", recordings / "poses_xyz", "-c", arm, "--poses", "+y,+x,-y,?,?,+z,?")
    assert result.code == 0
    assert "a1: no pose to spare, so that the residuals say nothing" in result.err
    assert "4 poses: +y,+x,-y,+z" in arm.with_name("accel.yaml").read_text()


def test_readings_in_g(jointest: Jointest, recordings: Path, arm: Path, tmp_path: Path) -> None:
    bag = copied(recordings / "poses_xyz", tmp_path / "in_g", lambda topic, time, accel: accel / 9.81)
    result = jointest("calibrate", "accel", bag, "-c", arm, *HERE)
    assert result.code == 0
    assert result.err.count("the matrix is far from unity") == 4
    after = readings(bag, config.load(arm).robot)
    assert max(abs(after[name] - expected(SPATIAL)).max() for name in SENSORS) < 0.3 * 9.81e-3


def test_a_sensor_that_cannot_be_fitted_stays(jointest: Jointest, recordings: Path, arm: Path, tmp_path: Path) -> None:
    """Link b was clamped to the bench all the time, and a2 broke."""

    def change(topic: str, time: float, accel: np.ndarray) -> np.ndarray | None:
        return None if "a2" in topic else np.array([0.0, 0.0, 9.8]) if "/b" in topic else accel

    result = jointest("calibrate", "accel", copied(recordings / "poses_xyz", tmp_path / "bag", change), "-c", arm)
    assert result.code == 0
    assert "accel.yaml: 1 of 4 accelerometers fitted" in result.out
    warnings = result.err.splitlines()
    assert "warning: not calibrated: 'a2': no reading" in warnings
    assert sum("'b1': 7 poses of rank 3 of 12" in line for line in warnings) == 1
    robot = config.load(arm).robot
    assert [robot.sensor(name).accel_calibrated for name in SENSORS] == [True, False, False, False]


def test_lengths_alone(jointest: Jointest, arm: Path, recordings: Path, tmp_path: Path) -> None:
    """Each pose of the recording in another random direction."""
    directions = np.random.default_rng(5).standard_normal((7, 3))
    directions *= 9.81 / np.linalg.norm(directions, axis=1)[:, None]

    def change(topic: str, time: float, accel: np.ndarray) -> np.ndarray:
        part = int((time - 1.0) / 2.0)  # a pose and a motion, two parts
        up = directions[part // 2] * (1.0 if part % 2 else [1.0, -1.0, 1.0])
        return (
            np.array([1.02, 0.99, 1.0]) * up + 0.05 + 0.02 * np.random.default_rng(int(time * 1e4)).standard_normal(3)
        )

    bag = copied(recordings / "poses", tmp_path / "bag", change)
    result = jointest("calibrate", "accel", bag, "-c", arm, "--method", "norm", *HERE)
    assert (result.code, result.err) == (0, "")
    assert "9 of 9" in result.out and "14" in result.out
    for sensor in config.load(arm).robot.sensors:
        np.testing.assert_allclose(sensor.accel_matrix, np.diag(1.0 / np.array([1.02, 0.99, 1.0])), atol=3e-3)
        np.testing.assert_allclose(sensor.accel_offset, -0.05 / np.array([1.02, 0.99, 1.0]), atol=2e-2)


def test_other_sections_of_the_calibration_stay(jointest: Jointest, recordings: Path, arm: Path) -> None:
    target = arm.with_name("accel.yaml")
    target.write_text("# by hand\nmountings:\n  a1: {quaternion: [0, 0, 0, 1]}\n", encoding="utf-8")
    assert jointest("calibrate", "accel", recordings / "poses_xyz", "-c", arm).code == 0
    assert "# by hand\nmountings:\n" in target.read_text(encoding="utf-8")
    assert config.load(arm).robot.sensor("a1").accel_calibrated


def test_a_damaged_recording_gives_what_it_can(jointest: Jointest, recordings: Path, arm: Path, tmp_path: Path) -> None:
    bag = broken_off(recordings / "poses_xyz", tmp_path / "run", 0.9)
    result = jointest("calibrate", "accel", bag, "-c", arm)
    assert result.code == 2
    assert result.err.splitlines()[-1].endswith("the calibration rests on what came before")
    assert config.load(arm).robot.sensor("b2").accel_calibrated


def shaken(topic: str, time: float, accel: np.ndarray) -> np.ndarray:
    return accel + 3.0 * np.sin(2.0 * np.pi * np.array([1.3, 2.1, 0.7]) * time)


@pytest.mark.parametrize(
    ("change", "options", "expected"),
    [
        (shaken, (), "0 still phases; hold the robot still in each pose for 2 s"),
        (lambda topic, time, accel: accel, ("--shortest", 10), "0 still phases, 7 too short; hold the robot still"),
        (lambda topic, time, accel: np.array([0.0, 9.8, 0.1]), (), "1 still phase (at 0.0 s); 'a1': 1 pose of rank 3"),
        (
            lambda topic, time, accel: accel if time < 12.0 else None,
            ("--poses", "+z,-z,+x"),
            "3 still phases (at 0.0, 4.2, 8.2 s); 'a1': the poses do not fit",
        ),
        (lambda topic, time, accel: accel, ("--poses", "+x,-x"), "--poses: 2 directions, but 7 still phases (at 0.0"),
        (lambda topic, time, accel: accel, ("--poses", "+x,+y,-x,-y,-z,+z,+y"), "the poses do not fit: residual"),
        (lambda topic, time, accel: accel, ("--method", "norm"), "7 still poses; without known directions 9 are"),
        (
            lambda topic, time, accel: accel[[1, 0, 2]] * [1, -1, 1] if "a2" in topic else accel,
            (),
            "by 'a1', +x by 'a2'",
        ),
    ],
    ids=["moves", "short", "one pose", "wrong", "number", "order", "few for norm", "disagree"],
)
def test_an_unsuitable_recording_is_refused_and_nothing_written(
    change: Change,
    options: tuple[Any, ...],
    expected: str,
    jointest: Jointest,
    recordings: Path,
    arm: Path,
    tmp_path: Path,
) -> None:
    bag = copied(recordings / "poses_xyz", tmp_path / "bag", change)
    text = jointest("calibrate", "accel", bag, "-c", arm, *options).refusal()
    assert expected in text and str(bag) in text
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.yaml", "bag"]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--gravity", 98.1), "--gravity: 98.1 is not allowed; give 9 to 10.5 m/s^2"),
        (("--gravity", "nan"), "--gravity: nan is not allowed"),
        (("--cone", 60), "--cone: 60.0 is not allowed; give 1 to 44 deg"),
        (("--shortest", -1), "--shortest: -1.0 is not allowed"),
        (("--poses", "up,down"), "--poses: 'up' is no direction; give +x, -x, +y"),
        (("--poses", "thumb:+x"), "--poses: 'thumb' is not a link; known: link_a, link_b"),
        (("--poses", "+x", "--method", "norm"), "--poses: is of no use with --method norm"),
    ],
)
def test_options_that_will_not_do_are_refused(
    options: tuple[Any, ...], expected: str, jointest: Jointest, recordings: Path, arm: Path
) -> None:
    assert expected in jointest("calibrate", "accel", recordings / "poses", "-c", arm, *options).refusal()
    assert not arm.with_name("accel.yaml").exists()


def test_a_robot_without_accelerometers_is_refused(jointest: Jointest, recordings: Path, tmp_path: Path) -> None:
    path = tmp_path / "gyros.yaml"
    path.write_text("robot: {links: [a]}\nsensors: {g: {link: a, accel: false}}\n", encoding="utf-8")
    text = jointest("calibrate", "accel", recordings / "poses", "-c", path).refusal()
    assert text.endswith("sensors: none with an accelerometer")
