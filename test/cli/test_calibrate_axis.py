"""`jointest calibrate axis`: from a recording of motion to mountings that every estimator uses."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bag_copies import Change, broken_off, copied

from jointest_ros import config
from jointest_ros.bags.cdr import decode_imu
from jointest_ros.bags.cdr_encode import ImuEncoder
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter
from jointest_ros.core.robot import Robot
from jointest_ros.core.rotation import IDENTITY, rotate_inverse
from jointest_ros.evaluation.measures import angle_between

Jointest = Callable[..., Any]
Published = Callable[[str, str], Path]
SENSORS = ("palm", "proximal", "middle", "distal")
JOINTS = ("finger_mcp", "finger_pip", "finger_dip")


def simulated(jointest: Jointest, bag: Path, scenario: str, *options: object) -> Path:
    """Such a recording at `bag`; beside it `robot.yaml`, which does not know how the IMUs are mounted."""
    fixed = ("--rate", 100, "--duration", 30, "--zero-pose", 4, "--mounting", "mounted", "--scenario", scenario)
    assert jointest("simulate", "finger", "-o", bag, *fixed, *options).code == 0
    document = yaml.safe_load(bag.with_name(f"{bag.name}.yaml").read_text(encoding="utf-8"))
    for sensor in document["sensors"].values():
        sensor.pop("mounting", None)
    robot = bag.with_name("robot.yaml")
    robot.write_text(
        yaml.safe_dump({"calibration_file": "calibrated.yaml", **document}, sort_keys=False), encoding="utf-8"
    )
    return robot


@pytest.fixture(scope="module")
def run(jointest: Jointest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording in which the palm turns too. Not to be changed."""
    bag = tmp_path_factory.mktemp("axis") / "run"
    simulated(jointest, bag, "PC", "--seed", 50)
    return bag


@pytest.fixture(scope="module")
def still_palm(jointest: Jointest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording in which it keeps still. Not to be changed."""
    bag = tmp_path_factory.mktemp("axis") / "run"
    simulated(jointest, bag, "PA", "--seed", 51)
    return bag


def robot_of(bag: Path, folder: Path) -> Path:
    """Its configuration in a folder of its own, without a calibration as yet."""
    path = folder / "robot.yaml"
    path.write_bytes(bag.with_name("robot.yaml").read_bytes())
    return path


@pytest.fixture
def robot(run: Path, tmp_path: Path) -> Path:
    return robot_of(run, tmp_path)


def axis_errors(configuration: Path, bag: Path) -> dict[tuple[str, str], float]:
    """Angle, deg, between each joint's axis in each of its sensors by `configuration` and by the truth of `bag`."""
    robots = [config.load(path).robot for path in (configuration, bag.with_name(f"{bag.name}.yaml"))]

    def axis(robot: Robot, sensor: str, joint: int) -> np.ndarray:
        return np.array(rotate_inverse(robot.sensor(sensor).mounting, robot.joints[joint].axes[0]))

    errors = {}
    for number, joint in enumerate(JOINTS):
        for sensor in SENSORS[number : number + 2]:
            found, true = (axis(robot, sensor, number) for robot in robots)
            errors[joint, sensor] = math.degrees(angle_between(found, true))
    return errors


def without(topic: str) -> Change:
    return lambda name, _, data: None if name == topic else data


def with_readings(topic: str, gyro: float = 1.0, accel: float = 1.0) -> Change:
    """Factors for the readings of one IMU."""
    encoder = ImuEncoder("imu")

    def changed(name: str, _time: int, data: bytes) -> bytes:
        if name != topic:
            return data
        stamp, _, w, a = decode_imu(data)
        return encoder.encode(stamp, tuple(gyro * x for x in w), tuple(accel * x for x in a))

    return changed


def test_mountings_are_found_and_used(jointest: Jointest, run: Path, robot: Path) -> None:
    configured = robot.read_bytes()
    assert min(axis_errors(robot, run).values()) > 0.5
    result = jointest("calibrate", "axis", run, "--config", robot)
    assert (result.code, result.err) == (0, "")
    assert robot.read_bytes() == configured
    assert max(axis_errors(robot, run).values()) < 0.09
    assert robot.with_name("calibrated_axis.png").read_bytes().startswith(b"\x89PNG")
    figures = robot.with_name("figures.json")
    assert jointest("evaluate", run, "-c", robot, "--skip", 8, "--json", figures).code == 0
    joints = json.loads(figures.read_text(encoding="utf-8"))["estimators"]["pcf"]["joints"]
    assert max(joint["rmse_deg"] for joint in joints.values()) < 0.12


def test_what_it_says(jointest: Jointest, run: Path, robot: Path) -> None:
    result = jointest("calibrate", "axis", run, "-c", robot)
    for name in (*JOINTS, *SENSORS):
        assert name in result.out
    assert f"{robot.with_name('calibrated.yaml')}: mountings of palm, proximal, middle, distal" in result.out
    assert "to use it" not in result.out
    assert max(map(len, result.out.splitlines()[:20])) <= 80
    lines = robot.with_name("calibrated.yaml").read_text(encoding="utf-8").splitlines()
    comment = [line for line in lines if line.startswith("#")]
    assert comment[0] == "# Axes by: jointest calibrate axis run --config robot.yaml"
    assert comment[1] == "# Recording: run, recorded 1970-01-01 00:00:01 UTC by its stamps."
    assert comment[3].startswith("#   finger_mcp: palm (") and " ± 0.0" in comment[3] and "deg/s" in comment[3]


def test_a_palm_that_keeps_still_is_refused(jointest: Jointest, still_palm: Path, tmp_path: Path) -> None:
    robot = robot_of(still_palm, tmp_path)
    result = jointest("calibrate", "axis", still_palm, "-c", robot)
    text = result.refusal()
    assert "joint 'finger_mcp': its axis in 'palm' is undetermined: 'palm' hardly turned across it" in text
    assert "turn it about several directions while the joint moves" in text and "--keep palm" in text
    assert "likewise" not in text and "nothing was written" in text
    (line,) = [line for line in result.out.splitlines() if "undetermined" in line]
    assert "palm" in line and "." not in line.partition("palm")[2]  # no axis is shown
    assert [path.name for path in tmp_path.iterdir()] == ["robot.yaml"]


def test_what_the_motion_shows_can_be_had(jointest: Jointest, still_palm: Path, tmp_path: Path) -> None:
    robot = robot_of(still_palm, tmp_path)
    assert jointest("calibrate", "axis", still_palm, "-c", robot, "--keep", "palm").code == 0
    loaded = config.load(robot).robot
    assert loaded.sensor("palm").mounting == IDENTITY
    errors = axis_errors(robot, still_palm)
    assert max(angle for (_, sensor), angle in errors.items() if sensor != "palm") < 0.09
    assert "palm (1.0000, 0.0000, 0.0000) kept" in robot.with_name("calibrated.yaml").read_text(encoding="utf-8")


def test_joints_can_be_chosen(jointest: Jointest, still_palm: Path, tmp_path: Path) -> None:
    robot = robot_of(still_palm, tmp_path)
    assert jointest("calibrate", "axis", still_palm, "-c", robot, "--joint", "finger_dip").code == 0
    loaded = config.load(robot).robot
    assert [sensor.mounting == IDENTITY for sensor in loaded.sensors] == [True, True, False, False]
    errors = axis_errors(robot, still_palm)
    assert errors["finger_dip", "middle"] < 0.09 and errors["finger_dip", "distal"] < 0.09
    assert jointest("calibrate", "axis", still_palm, "-c", robot, "--joint", "finger_pip").code == 0
    assert max(angle for (_, sensor), angle in axis_errors(robot, still_palm).items() if sensor != "palm") < 0.09


def test_other_sections_of_the_file_stay(jointest: Jointest, run: Path, robot: Path) -> None:
    accel = "# by hand\naccel:\n  palm: {matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], offset: [0, 0, 0.01]}\n"
    robot.with_name("calibrated.yaml").write_text(accel, encoding="utf-8")
    assert jointest("calibrate", "axis", run, "-c", robot).code == 0
    assert robot.with_name("calibrated.yaml").read_text(encoding="utf-8").startswith(accel)
    assert config.load(robot).robot.sensor("palm").accel_offset == (0.0, 0.0, 0.01)


def test_a_second_time_changes_nothing_much(jointest: Jointest, run: Path, robot: Path) -> None:
    mountings = []
    for _ in range(2):
        assert jointest("calibrate", "axis", run, "-c", robot).code == 0
        mountings.append([sensor.mounting for sensor in config.load(robot).robot.sensors])
    assert np.array(mountings[1]) == pytest.approx(np.array(mountings[0]), abs=1e-5)


def test_an_axis_that_is_configured_wrongly_is_told(jointest: Jointest, run: Path, robot: Path) -> None:
    """One joint's axis is 5 deg from where the configuration has it: its neighbours cannot all fit."""
    document = yaml.safe_load(robot.read_text(encoding="utf-8"))
    document["robot"]["joints"]["finger_pip"]["axes"] = [[math.cos(0.087), 0.0, math.sin(0.087)]]
    robot.write_text(yaml.safe_dump(document), encoding="utf-8")
    result = jointest("calibrate", "axis", run, "-c", robot)
    assert result.code == 0
    told = [line for line in result.err.splitlines() if "are not to each other as configured" in line]
    assert [line.split("'")[1] for line in told] == ["proximal", "middle"]


def test_gyros_with_scale_errors_are_told(jointest: Jointest, run: Path, robot: Path, tmp_path: Path) -> None:
    bag = copied(run, tmp_path / "scaled", with_readings("/imu/proximal", gyro=1.03))
    result = jointest("calibrate", "axis", bag, "-c", robot, "--joint", "finger_mcp")
    assert result.code == 0
    assert "warning: joint 'finger_mcp': a residual of" in result.err and "follows the motion" in result.err


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            without("/imu/distal"),
            "joint 'finger_dip': sensor 'distal' (topic imu/distal) gave no readings of gyro and accelerometer; "
            "without its joints: --joint finger_mcp --joint finger_pip",
        ),
        (with_readings("/imu/middle", gyro=math.nan), "joint 'finger_pip': sensor 'middle' (topic imu/middle) gave no"),
        (
            with_readings("/imu/middle", accel=math.inf),
            "joint 'finger_pip': sensor 'middle' (topic imu/middle) gave no",
        ),
    ],
    ids=["no topic", "nan", "infinity"],
)
def test_a_silent_sensor_is_refused(
    change: Callable[[str, bytes], bytes | None],
    expected: str,
    jointest: Jointest,
    run: Path,
    robot: Path,
    tmp_path: Path,
) -> None:
    text = jointest("calibrate", "axis", copied(run, tmp_path / "other", change), "-c", robot).refusal()
    assert expected in text
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other", "robot.yaml"]


def test_recordings_without_imus_are_refused(jointest: Jointest, run: Path, robot: Path, tmp_path: Path) -> None:
    bag = copied(run, tmp_path / "truth", lambda name, _, data: None if "imu" in name else data)
    assert (
        "no matching topic; the configuration wants imu/palm"
        in jointest("calibrate", "axis", bag, "-c", robot).refusal()
    )
    assert "no such" in jointest("calibrate", "axis", tmp_path / "none", "-c", robot).refusal()


def test_a_damaged_recording_gives_what_it_can(jointest: Jointest, run: Path, robot: Path, tmp_path: Path) -> None:
    result = jointest("calibrate", "axis", broken_off(run, tmp_path / "run", 0.8), "-c", robot)
    assert result.code == 2
    assert result.err.splitlines()[-1].endswith("the calibration rests on what came before")
    assert max(axis_errors(robot, run).values()) < 0.09


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--joint", "finger_pipp"], "robot.yaml: joint 'finger_pipp': unknown; did you mean 'finger_pip'?"),
        (["--keep", "thumb"], "--keep: 'thumb' is no sensor of these joints; known: palm, proximal, middle, distal"),
        (
            ["--joint", "finger_dip", "--keep", "middle", "--keep", "distal"],
            "--keep: both sensors of joint 'finger_dip' are to be kept",
        ),
        (["-o", "robot.yaml"], "robot.yaml: is the configuration, which is never written"),
        (["--plot", "calibrated.yaml"], "the suffix '.yaml' is not allowed"),
    ],
)
def test_options_that_will_not_do_are_refused(
    options: list[str], expected: str, jointest: Jointest, run: Path, robot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(robot.parent)
    assert expected in jointest("calibrate", "axis", run, "-c", robot.name, *options).refusal()


def test_joints_of_three_axes_are_left_out_with_a_word(jointest: Jointest, run: Path, robot: Path) -> None:
    document = yaml.safe_load(robot.read_text(encoding="utf-8"))
    document["robot"]["joints"]["finger_dip"]["axes"] = ["x", "y", "z"]
    robot.write_text(yaml.safe_dump(document), encoding="utf-8")
    result = jointest("calibrate", "axis", run, "-c", robot)
    assert result.code == 0
    assert result.err == (
        "warning: joint 'finger_dip': it has 3 axes; only joints of one or two axes can be calibrated; left out\n"
    )
    text = jointest("calibrate", "axis", run, "-c", robot, "--joint", "finger_dip").refusal()
    assert text.endswith("joint 'finger_dip': it has 3 axes; only joints of one or two axes can be calibrated")


@pytest.mark.parametrize(
    ("source", "configuration"), [("raw_pitch_slow", "song_pitch.yaml"), ("raw_roll_medium", "song_roll.yaml")]
)
def test_a_real_hinge_whose_base_is_fixed(
    source: str, configuration: str, jointest: Jointest, published: Published, tmp_path: Path
) -> None:
    """The axis in the fixed IMU does not show, and must not be made up; in the other one it is near that of the rig."""
    bag = tmp_path / "song"
    with BagReader(published("song", f"{source}.mat")) as reader, BagWriter(bag) as writer:
        for topic in ("/imu/imu_1", "/imu/imu_2"):
            writer.add_topic(topic, reader.topics[topic])
        for topic, time, data in reader.messages(("/imu/imu_1", "/imu/imu_2")):
            if time > reader.start_ns + 200 * 10**9:
                break
            writer.write(topic, time, data)
    text = (Path(__file__).resolve().parents[2] / "config" / configuration).read_text(encoding="utf-8")
    robot = tmp_path / "robot.yaml"
    robot.write_text(f"{text}\ncalibration_file: calibrated.yaml\n", encoding="utf-8")
    refused = jointest("calibrate", "axis", bag, "-c", robot).refusal()
    assert "joint 'shaft': its axis in 'imu_1' is undetermined: 'imu_1' hardly turned across it" in refused
    assert not (tmp_path / "calibrated.yaml").exists()

    assert jointest("calibrate", "axis", bag, "-c", robot, "--keep", "imu_1").code == 0
    calibrated = config.load(robot).robot
    axis = calibrated.joints[0].axes[0]
    found = np.array(rotate_inverse(calibrated.sensor("imu_2").mounting, axis))
    off = math.degrees(angle_between(found, np.array(axis)))
    print(f"{source}: {off:.2f} deg from the axis of the rig")
    assert 0.5 < off < 3.0  # the principal direction of its gyro is 1.6 and 1.9 deg off
    assert calibrated.sensor("imu_1").mounting == IDENTITY


@pytest.fixture(scope="module")
def leg(jointest: Jointest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a leg whose IMUs are mounted up to 10 deg askew; beside it its configuration, leg.yaml."""
    folder = tmp_path_factory.mktemp("leg")
    joints = ("hip:pelvis:thigh:y,x:0,0.1,0", "knee:thigh:shank:y:0,0,-0.4:0..110")
    path = folder / "leg.yaml"
    assert jointest("init", "-o", path, "--joints", *joints).code == 0
    options = ("--duration", 50, "--zero-pose", 3, "--mounting", "askew", "--seed", 4)
    assert jointest("simulate", "config", path, "-o", folder / "run", *options).code == 0
    return path


def test_a_joint_of_two_axes(leg: Path, jointest: Jointest, tmp_path: Path) -> None:
    """From mountings of up to 10 deg askew to angles that are as good as those of right mountings."""

    def errors() -> dict[str, float]:
        report = tmp_path / "report.json"
        assert jointest("evaluate", bag, "-c", path, "--skip", 5, "--json", report).code == 0
        joints = json.loads(report.read_text(encoding="utf-8"))["estimators"]["pcf"]["joints"]
        return {name: joint["rmse_deg"] for name, joint in joints.items()}

    path, bag = tmp_path / "leg.yaml", leg.with_name("run")
    text = leg.read_text(encoding="utf-8").replace("# lever_arms: false ", "lever_arms: true ")
    path.write_text(text, encoding="utf-8")
    before = errors()
    result = jointest("calibrate", "axis", bag, "-c", path)
    assert (result.code, result.err) == (0, "")
    assert [line for line in result.out.splitlines() if "hip_y" in line and "pelvis" in line]
    assert [line for line in result.out.splitlines() if "hip_x" in line and "thigh" in line]
    assert min(before.values()) > 1.0 and max(errors().values()) < 0.1
    path.write_text(text.replace("zero_at_start: true", "zero_at_start: false"), encoding="utf-8")
    before = errors()
    result = jointest("calibrate", "zero", bag, "-c", path)
    assert (result.code, result.err) == (0, "")
    assert [line for line in result.out.splitlines() if "hip_x" in line]
    assert max(before.values()) > 1.0 and max(errors().values()) < 0.15
