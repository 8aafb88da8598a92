"""Calibration files: what is written is read again, and nothing is loaded from a file that is not whole."""

from __future__ import annotations

import dataclasses
import os
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from jointest_ros import config
from jointest_ros.config import calibration
from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.hall_sensor import ExponentialCurve, HallSensor, SplineCurve
from jointest_ros.core.learned import Learned

ROBOT = """
calibration_file: calibrated.yaml
robot: {links: [upper, lower], joints: {elbow: {parent: upper, child: lower, axis: x}}}
sensors: {upper: {}, lower: {}}
hall_defaults: {hall_range: [0.3, 1.7], resolution_v: 0.001, offset_v: 0.01}
hall:
  - {joint: elbow}
  - {joint: elbow, mirrored: true}
"""
FITTED = (
    HallSensor("elbow", ExponentialCurve(0.0812345678901234, 2.7, 1.6e5, 8.0), False, 0.0, 0.0123),
    HallSensor("elbow", SplineCurve((0.4, 1.0, 1.5), (-40.0, -3.0, 11.5)), True, -0.02, 0.02),
)
GONE = object()


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """A configuration that names a calibration file, which is not there yet."""
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT, encoding="utf-8")
    return path


@pytest.fixture
def calibrated(robot: Path) -> Path:
    """Its calibration file."""
    path = robot.with_name("calibrated.yaml")
    calibration.save_hall(path, FITTED, "by hand")
    return path


def test_a_file_that_does_not_exist_yet_changes_nothing(robot: Path) -> None:
    loaded = config.load(robot)
    assert loaded.calibration_file == robot.with_name("calibrated.yaml")
    assert loaded.robot == config.parse(ROBOT.replace("calibration_file: calibrated.yaml", "")).robot
    assert loaded.robot.hall[0].curve == ExponentialCurve()


def test_what_is_written_takes_precedence(robot: Path, calibrated: Path) -> None:
    assert calibrated.is_file()
    for fitted, loaded in zip(FITTED, config.load(robot).robot.hall, strict=True):
        # range and converter are not calibrated: they stay the configuration's
        assert loaded == dataclasses.replace(fitted, hall_range=(0.3, 1.7), resolution=0.001)


def test_the_file_is_found_beside_the_configuration(
    robot: Path, calibrated: Path, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    assert config.load(os.path.relpath(robot)).robot.hall[0].noise == 0.0123
    robot.write_text(ROBOT.replace("calibrated.yaml", str(calibrated)), encoding="utf-8")
    assert config.load(robot).robot.hall[0].noise == 0.0123


def test_the_heading_is_a_comment_whatever_stands_in_it(robot: Path, calibrated: Path) -> None:
    calibration.save_hall(calibrated, FITTED, "a bag named\nhall: []\n\n# or so")
    lines = calibrated.read_text(encoding="utf-8").splitlines()
    assert lines[:5] == ["# a bag named", "# hall: []", "#", "# # or so", "hall:"]
    assert config.load(robot).robot.hall[0].noise == 0.0123


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("hall", GONE, "no section; give some of hall, accel, gyro, mountings, learned, or remove the file"),
        ("hall", None, "hall: None is not allowed; give 2 entries as in the configuration, or remove the file"),
        ("hall", {}, "hall: {} is not allowed"),
        ("elbow", 1, "elbow: unknown key; allowed: hall, accel, gyro, mountings, learned"),
        ("hall.1", GONE, "give 2 entries as in the configuration"),
        ("hall.0", None, "hall[0].joint: missing"),
        ("hall.0", "elbow", "hall[0]: 'elbow' is not allowed; give keys with values"),
        ("hall.0.joint", "knee", "hall[0].joint: 'knee' is not allowed; give 'elbow' as in the configuration"),
        ("hall.0.mirrored", True, "hall[0].mirrored: True is not allowed; give False as in the configuration"),
        ("hall.1.noise_v", GONE, "hall[1].noise_v: missing"),
        ("hall.1.noise_v", 0.0, "hall[1].noise_v: 0.0 is not allowed"),
        ("hall.1.noise_v", 2.0, "hall[1]: hall sensor of 'elbow'.hall_range: (0.3, 1.7) is not allowed"),
        ("hall.1.offset_v", "a bit", "hall[1].offset_v: 'a bit' is not allowed"),
        ("hall.1.gain", 1.0, "hall[1].gain: unknown key"),
        ("hall.0.curve", GONE, "hall[0].curve: missing"),
        ("hall.0.curve", None, "hall[0].curve.a_deg: missing"),
        ("hall.0.curve.d", GONE, "hall[0].curve.d: missing"),
        ("hall.0.curve.d", -1.0, "hall[0]: hall curve (a, b, c, d): "),
        ("hall.0.curve.d", "steep", "hall[0].curve.d"),
        ("hall.1.curve.angles_deg", GONE, "hall[1].curve.angles_deg: missing"),
        ("hall.1.curve.angles_deg", [1.0, 0.0, 2.0], "hall[1]: hall curve.angles_deg: (1.0, 0.0, 2.0) is not allowed"),
    ],
)
def test_a_file_that_is_wrong_is_refused_with_file_and_key(
    key: str, value: Any, expected: str, robot: Path, calibrated: Path
) -> None:
    document = yaml.safe_load(calibrated.read_text(encoding="utf-8"))
    *parents, last = (int(part) if part.isdigit() else part for part in key.split("."))
    section = document
    for parent in parents:
        section = section[parent]
    if value is GONE:
        del section[last]
    else:
        section[last] = value
    calibrated.write_text(yaml.safe_dump(document), encoding="utf-8")
    assert expected in refusal(robot)


@pytest.mark.parametrize(
    "content", [b"", b"hall: [", b"\x00\x01", b"\xff\xfe\x00", b"[1, 2]", b"hall: !!python/object:a.b {}"]
)
def test_a_damaged_file_is_refused(content: bytes, robot: Path, calibrated: Path) -> None:
    calibrated.write_bytes(content)
    refusal(robot)


def test_a_file_that_broke_off_is_refused_wherever_that_was(robot: Path, calibrated: Path) -> None:
    text = calibrated.read_text(encoding="utf-8").rstrip()
    for end in range(text.rindex("noise_v")):
        calibrated.write_text(text[:end], encoding="utf-8")
        refusal(robot)


def test_a_folder_in_its_place_is_refused(robot: Path) -> None:
    robot.with_name("calibrated.yaml").mkdir()
    assert "cannot be read as a calibration" in refusal(robot)


@pytest.mark.parametrize("value", ["3", "[a.yaml]", "null"])
def test_its_name_must_be_a_text(value: str) -> None:
    with pytest.raises(ConfigurationError, match=r"calibration_file: .* is not allowed; give the name of a file"):
        config.parse(ROBOT.replace("calibrated.yaml", value))


def test_an_interrupted_writer_leaves_the_old_file_whole(calibrated: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = calibrated.read_bytes()

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", fail)
        with pytest.raises(CalibrationError, match=r"calibrated.yaml: cannot be written: No space left on device"):
            calibration.save_hall(calibrated, FITTED[:1], "")
    assert calibrated.read_bytes() == before
    assert sorted(path.name for path in calibrated.parent.iterdir()) == ["calibrated.yaml", "robot.yaml"]


def test_each_kind_of_calibration_leaves_the_others(robot: Path, calibrated: Path) -> None:
    upper, lower = config.load(robot).robot.sensors
    scaled = dataclasses.replace(upper, accel_matrix=((1.1, 0.0, 0.1), (0.0, 0.9, 0.0), (0.0, 0.0, 1.0)))
    scaled = dataclasses.replace(scaled, accel_offset=(0.1, -0.2, 0.3))
    turned = dataclasses.replace(lower, mounting=(0.6, 0.0, 0.0, 0.8))
    calibration.save_mountings(calibrated, [turned], "mounted by hand")
    calibration.save_accel(calibrated, [scaled], "weighed by hand")
    scaled = dataclasses.replace(scaled, gyro_scale=(1.0, 0.98, 1.01))
    calibration.save_gyro(calibrated, [scaled], "turned by hand")
    calibration.save_mountings(calibrated, [dataclasses.replace(upper, mounting=(0.0, 0.0, 0.0, -1.0))], "once more")
    loaded = config.load(robot).robot
    assert loaded.hall[0].noise == 0.0123
    assert loaded.sensors == (dataclasses.replace(scaled, mounting=(0.0, 0.0, 0.0, -1.0)), turned)
    comments = [line for line in calibrated.read_text(encoding="utf-8").splitlines() if line.startswith("#")]
    assert comments == ["# by hand", "# weighed by hand", "# turned by hand", "# once more"]


LEARNED = Learned("robot-1e5", {"upper.x": (0.0123456789012345, 1e-5)}, {"elbow": (0.6, 0.0, 0.0, 0.8)}, "2026-11-22")


def test_what_estimators_learned_is_kept_by_each_and_comes_back_exactly(robot: Path, calibrated: Path) -> None:
    calibration.save_learned(calibrated, "pcf", LEARNED, "first")
    kckf = dataclasses.replace(LEARNED, zero={})
    calibration.save_learned(calibrated, "kckf", kckf, "second")
    calibration.save_hall(calibrated, FITTED, "third")
    loaded = config.load(robot).robot
    assert loaded.learned == {"pcf": LEARNED, "kckf": kckf}
    assert loaded.hall[0].noise == 0.0123
    assert calibration.heading(calibrated, "learned") == "second"


def test_another_file_than_the_one_that_is_named(robot: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    calibration.save_hall(other, FITTED, "")
    loaded = config.load(robot, other)
    assert loaded.calibration_file == other
    assert loaded.robot.hall[0].noise == 0.0123


@pytest.mark.parametrize("content", ["", "hall: [", "hall: []", "learned: {pcf: {}}", "accel: {wrist: {}}"])
def test_a_node_leaves_out_a_damaged_file_as_a_whole(content: str, robot: Path, calibrated: Path) -> None:
    """Sound sections of it too."""
    before = config.parse(ROBOT.replace("calibration_file: calibrated.yaml", "")).robot
    whole = calibrated.read_text(encoding="utf-8") if content.startswith(("learned", "accel")) else ""
    calibrated.write_text(whole + content, encoding="utf-8")
    loaded = config.load(robot, tolerant=True)
    assert loaded.robot == before
    assert loaded.calibration_damage.startswith(f"{calibrated}: ")
    assert str(robot) + ": " + loaded.calibration_damage == refusal(robot)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("accel: {}", "accel: {} is not allowed; give an entry for each sensor"),
        ("accel: {wrist: {}}", "accel.wrist: no sensor of the configuration; known: upper, lower"),
        ("accel: {upper: {offset: [0, 0, 0]}}", "accel.upper.matrix: missing"),
        ("accel: {upper: {matrix: [[1, 0], [0, 1]], offset: [0, 0, 0]}}", "give three rows of three numbers"),
        ("accel: {upper: {matrix: [[1, 0, 0], [0, 1, 0], [0, 0]], offset: [0, 0, 0]}}", "accel.upper.matrix[2]"),
        ("accel: {upper: {matrix: [[1, 0, 0], [0, 1, 0], [0, 0, .nan]], offset: [0, 0, 0]}}", "accel.upper.matrix[2]"),
        ("mountings: {lower: {quaternion: [0, 0, 0, 2]}}", "mountings.lower.quaternion"),
        ("gyro: {upper: {}}", "gyro.upper.scale: missing"),
        ("gyro: {upper: {scale: 1.0}}", "gyro.upper.scale"),
        ("gyro: {upper: {scale: [1, 1, 0]}}", "[1, 1, 0] is not allowed; give three numbers from 0.5"),
        ("mountings: {lower: {}}", "mountings.lower.quaternion: missing"),
        ("learned: {}", "learned: {} is not allowed; give an entry for each estimator"),
        ("learned: {pcf: {robot: r, saved: s, biases: {}}}", "learned.pcf.zero: missing"),
        ("learned: {pcf: {robot: 1, saved: s, biases: {}, zero: {}}}", "learned.pcf.robot: 1 is not allowed"),
        ("learned: {pcf: {robot: r, saved: s, biases: {a: 1.0}, zero: {}}}", "learned.pcf.biases.a: 1.0 is not"),
        ("learned: {pcf: {robot: r, saved: s, biases: {a: [.nan, 1]}, zero: {}}}", "learned.pcf.biases.a: [nan, 1]"),
        ("learned: {pcf: {robot: r, saved: s, biases: {a: [1, -1]}, zero: {}}}", "give a standard deviation of 0 or"),
        ("learned: {pcf: {robot: r, saved: s, biases: {a: [1e3, 1]}, zero: {}}}", "give a value of no more than 10"),
        ("learned: {pcf: {robot: r, saved: s, biases: {}, zero: {a: [1e3]}}}", "give an angle (rad) or"),
        ("learned: {pcf: {robot: r, saved: s, biases: {}, zero: {a: [1, 2]}}}", "give an angle (rad) or x, y, z, w"),
        ("learned: {pcf: {robot: r, saved: s, biases: {}, zero: {a: [1, 1, 1, 1]}}}", "or x, y, z, w of length 1"),
    ],
)
def test_sections_by_sensor_are_refused_with_their_key(text: str, expected: str, robot: Path, calibrated: Path) -> None:
    calibrated.write_text(text, encoding="utf-8")
    assert expected in refusal(robot)


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    link = tmp_path / "calibrated.yaml"
    link.symlink_to(tmp_path / "kept" / "real.yaml")
    calibration.save_hall(link, FITTED, "")
    assert link.is_symlink()
    robot = dataclasses.replace(config.parse(ROBOT.replace("calibration_file: calibrated.yaml", "")).robot, hall=FITTED)
    assert calibration.load(link, robot) == robot


def test_a_folder_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="cannot be written: No such file or directory"):
        calibration.save_hall(tmp_path / "none" / "calibrated.yaml", FITTED, "")


def refusal(robot: Path) -> str:
    """The one line with which a configuration is refused; it names the configuration and the calibration file."""
    with pytest.raises(ConfigurationError, match=r"^[^\n]+$") as caught:
        config.load(robot)
    assert re.match(re.escape(f"{robot}: {robot.with_name('calibrated.yaml')}: "), str(caught.value))
    return str(caught.value)
