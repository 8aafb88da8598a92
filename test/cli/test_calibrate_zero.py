"""`jointest calibrate zero`: the pose of a still phase becomes the zero of every joint."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from jointest_ros import config
from jointest_ros.bags.synthetic import messages, topics
from jointest_ros.bags.writer import BagWriter
from jointest_ros.config.text import robot_yaml
from jointest_ros.core.frame import Recording
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import conjugate, exp, log, multiply, norm, rotate_inverse
from jointest_ros.sim.simulated import SimulatedRobot

Jointest = Callable[..., Any]
JOINTS = ("finger_mcp", "finger_pip", "finger_dip")
RATE = 100.0


@pytest.fixture(scope="module")
def run(jointest: Jointest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that begins with 4 s of zero pose; IMUs mounted askew. Not to be changed."""
    bag = tmp_path_factory.mktemp("zero") / "run"
    options = ("--rate", 100, "--duration", 12, "--zero-pose", 4, "--mounting", "mounted", "--scenario", "PC")
    assert jointest("simulate", "finger", "-o", bag, *options, "--seed", 60).code == 0
    return bag


@pytest.fixture
def robot(run: Path, tmp_path: Path) -> Path:
    """Its configuration with the true axes, but each IMU turned about them; it takes no zero pose at the start."""
    document = yaml.safe_load(run.with_name("run.yaml").read_text(encoding="utf-8"))
    for sensor, angle in zip(document["sensors"].values(), (0.0, 0.1, -0.3, 0.2), strict=True):
        turned = multiply(exp((angle, 0.0, 0.0)), tuple(sensor["mounting"]["quaternion"]))
        sensor["mounting"] = {"quaternion": list(turned)}
    document["estimators"]["pcf"] = {"zero_at_start": False}
    path = tmp_path / "robot.yaml"
    path.write_text(
        yaml.safe_dump({"calibration_file": "calibrated.yaml", **document}, sort_keys=False), encoding="utf-8"
    )
    return path


def errors(jointest: Jointest, bag: Path, robot: Path) -> dict[str, float]:
    """Root mean square errors of the joints, deg."""
    figures = robot.with_name("figures.json")
    assert jointest("evaluate", bag, "-c", robot, "--skip", 6, "--json", figures).code == 0
    joints = json.loads(figures.read_text(encoding="utf-8"))["estimators"]["pcf"]["joints"]
    return {name: joint["rmse_deg"] for name, joint in joints.items()}


def test_the_joints_read_zero_there_and_keep_their_axes(jointest: Jointest, run: Path, robot: Path) -> None:
    before, configured = config.load(robot).robot, robot.read_bytes()
    assert min(errors(jointest, run, robot).values()) > 5.0
    result = jointest("calibrate", "zero", run, "--config", robot)
    assert (result.code, result.err) == (0, "")
    assert robot.read_bytes() == configured
    assert max(errors(jointest, run, robot).values()) < 0.12
    after = config.load(robot).robot
    x = (1.0, 0.0, 0.0)
    for one, other in zip(before.sensors, after.sensors, strict=True):
        assert rotate_inverse(other.mounting, x) == pytest.approx(rotate_inverse(one.mounting, x), abs=1e-6)
    turned = norm(log(multiply(after.sensors[0].mounting, conjugate(before.sensors[0].mounting))))
    assert turned < 1e-6  # the palm stays, the fingers turn


def test_what_it_says(jointest: Jointest, run: Path, robot: Path) -> None:
    result = jointest("calibrate", "zero", run, "-c", robot)
    assert "joint readings, still from 0.0 to 4.0 s" in result.out
    for joint, angle in zip(JOINTS, (-5.7, 22.9, -28.6), strict=True):
        (line,) = [line for line in result.out.splitlines() if joint in line]
        before, after = (float(cell) for cell in line.strip("│ \n").split("│")[1:])
        assert before == pytest.approx(angle, abs=0.5) and after == 0.0
    comment = robot.with_name("calibrated.yaml").read_text(encoding="utf-8").splitlines()
    assert comment[0] == "# Zero pose by: jointest calibrate zero run --config robot.yaml"
    assert comment[1].startswith("# Recording: run, recorded ") and comment[1].endswith("still from 0.0 to 4.0 s.")
    assert comment[2].startswith("# Before, the joints read there, deg: finger_mcp ")


def test_after_the_axes(jointest: Jointest, run: Path, robot: Path) -> None:
    """Both together: what is said of the axes stays in the file, and so do the axes."""
    document = yaml.safe_load(robot.read_text(encoding="utf-8"))
    for sensor in document["sensors"].values():
        sensor.pop("mounting")
    robot.write_text(yaml.safe_dump(document), encoding="utf-8")
    assert jointest("calibrate", "axis", run, "-c", robot).code == 0
    for _ in range(2):
        assert jointest("calibrate", "zero", run, "-c", robot).code == 0
    text = robot.with_name("calibrated.yaml").read_text(encoding="utf-8")
    assert text.count("Zero pose by:") == 1
    assert text.count("# Axes by: jointest calibrate axis run") == 1 and "#   finger_dip: middle (" in text
    assert max(errors(jointest, run, robot).values()) < 0.12


def test_one_joint_alone(jointest: Jointest, run: Path, robot: Path) -> None:
    before = errors(jointest, run, robot)
    assert jointest("calibrate", "zero", run, "-c", robot, "--joint", "finger_pip").code == 0
    after = errors(jointest, run, robot)
    assert after["finger_pip"] < 0.12
    assert after["finger_mcp"] == pytest.approx(before["finger_mcp"], abs=0.1)


def test_a_time_at_which_it_moves_is_refused(jointest: Jointest, run: Path, robot: Path, tmp_path: Path) -> None:
    text = jointest("calibrate", "zero", run, "-c", robot, "--at", 8).refusal()
    assert text == f"{run}: --at 8: the robot moves there; it is still at 0.0 to 4.0 s"
    assert jointest("calibrate", "zero", run, "-c", robot, "--at", "nan").refusal().startswith(f"{run}: --at nan")
    assert [path.name for path in tmp_path.iterdir()] == ["robot.yaml"]
    assert jointest("calibrate", "zero", run, "-c", robot, "--at", 3).code == 0


def test_a_recording_without_rest_is_refused(jointest: Jointest, robot: Path, tmp_path: Path) -> None:
    bag = tmp_path / "moving"
    options = ("--rate", 100, "--duration", 4, "--zero-pose", 0, "--scenario", "PC")
    assert jointest("simulate", "finger", "-o", bag, *options).code == 0
    text = jointest("calibrate", "zero", bag, "-c", robot).refusal()
    assert "the robot never stands still for 1 s (longest: " in text and "still_gyro_dps" in text


def test_thresholds_are_those_of_the_configuration(jointest: Jointest, run: Path, robot: Path) -> None:
    document = yaml.safe_load(robot.read_text(encoding="utf-8"))
    document["estimators"]["pcf"]["still_accel"] = 0.01
    robot.write_text(yaml.safe_dump(document), encoding="utf-8")
    assert "never stands still" in jointest("calibrate", "zero", run, "-c", robot).refusal()


def at_rest(
    bag: Path, axes: list[tuple[float, float, float]], base_rpy: tuple[float, float, float], still: int
) -> Path:
    """A recording of an arm that stands still in poses of 3 s, all joints at 0, then at .5 rad, and so on."""
    links = tuple(f"link_{k}" for k in range(len(axes) + 1))
    joints = tuple(Joint(f"joint_{k + 1}", links[k], links[k + 1], (axis,)) for k, axis in enumerate(axes))
    robot = Robot(links, joints, tuple(Sensor(f"imu_{k}", link) for k, link in enumerate(links)))
    samples, generator = round(3.0 * RATE), np.random.default_rng(1)
    gyro, accel = ({sensor.name: [] for sensor in robot.sensors} for _ in range(2))
    truth = []
    for pose in range(still):
        orientation = exp(base_rpy)
        for sensor, axis in zip(robot.sensors, [(0.0, 0.0, 0.0), *axes], strict=True):
            orientation = multiply(orientation, exp(tuple(0.5 * pose * a for a in axis)))
            rest = np.array(rotate_inverse(orientation, (0.0, 0.0, 9.81)))
            accel[sensor.name].append(rest + 0.02 * generator.standard_normal((samples, 3)))
            rates = 1e-3 * generator.standard_normal((samples, 3))
            rates[-20:] += 2.0 * math.sin(pose + 1.0)  # something moves between the poses
            gyro[sensor.name].append(rates)
        truth.append(np.full((samples, len(axes)), 0.5 * pose))
    stamps = np.round(np.arange(still * samples) * 1e9 / RATE).astype(np.int64)
    recording = Recording(
        stamps,
        {name: np.vstack(parts) for name, parts in gyro.items()},
        {name: np.vstack(parts) for name, parts in accel.items()},
        period=np.full(len(stamps), 1.0 / RATE),
    )
    position = np.vstack(truth)
    simulated = SimulatedRobot(robot, recording, robot.coordinates, position, np.zeros_like(position))
    with BagWriter(bag) as writer:
        for topic, msgtype in topics(robot).items():
            writer.add_topic(f"/{topic}", msgtype)
        for stamp, topic, data in messages([simulated]):
            writer.write(f"/{topic}", stamp, data)
    path = bag.with_name("robot.yaml")
    path.write_text(robot_yaml(robot, {"pcf": {}}, "an arm") + "calibration_file: calibrated.yaml\n", encoding="utf-8")
    return path


def test_the_phase_can_be_chosen(jointest: Jointest, tmp_path: Path) -> None:
    x = (1.0, 0.0, 0.0)
    robot = at_rest(tmp_path / "poses", [x, x], (0.0, 0.0, 0.0), 3)
    result = jointest("calibrate", "zero", tmp_path / "poses", "-c", robot, "--at", 7)
    assert result.code == 0
    first, second, third = config.load(robot).robot.sensors
    for sensor, turn in ((first, 0.0), (second, -1.0), (third, -2.0)):  # .5 rad a pose and joint, third pose
        assert log(sensor.mounting) == pytest.approx((-turn * 1.0, 0.0, 0.0), abs=2e-3)
    assert jointest("calibrate", "zero", tmp_path / "poses", "-c", robot, "--at", 2.95).code == 2


def test_an_upright_axis_is_left_alone_and_told(jointest: Jointest, tmp_path: Path) -> None:
    z, x = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    robot = at_rest(tmp_path / "poses", [z, x], (0.0, 0.0, 0.0), 1)
    result = jointest("calibrate", "zero", tmp_path / "poses", "-c", robot)
    assert result.code == 0
    assert result.err.startswith("warning: joint 'joint_1': its axis is within 10 deg of vertical in this pose")
    text = jointest("calibrate", "zero", tmp_path / "poses", "-c", robot, "--joint", "joint_1").refusal()
    assert "joint 'joint_1': its axis is within 10 deg of vertical" in text and "tilt the robot" in text


def test_axes_that_leave_no_freedom_are_told(jointest: Jointest, tmp_path: Path) -> None:
    """Crossing axes on both sides of the middle links fix their mountings: the pose at .5 rad cannot be made zero."""
    robot = at_rest(tmp_path / "poses", [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)], (0.3, 0.4, 0.0), 2)
    result = jointest("calibrate", "zero", tmp_path / "poses", "-c", robot, "--at", 4.5)
    assert result.code == 0
    assert "joint 'joint_2': its axes leave the mountings no freedom to make it read zero in this pose" in result.err
