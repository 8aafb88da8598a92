"""What a node learned is saved on request and is where the next one starts, with the numbers of an offline run."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped
from rcl_interfaces.srv import SetParameters
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.parameter import Parameter
from ros_bench import Bench, values
from without_ros import Message, assert_same, estimate, shown, simulated

from jointest_ros import config
from jointest_ros.bags.cdr import decode_imu
from jointest_ros.bags.cdr_encode import ImuEncoder
from jointest_ros.bags.intake import HALL_TOPIC
from jointest_ros.config import calibration
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.nodes import services

CONFIGS = Path(__file__).resolve().parents[2] / "config"
MOVING = simulated(scenario="PC", rate_hz=100.0, duration_s=4.0, zero_pose_s=1.5, seed=2)
STILL = [*simulated(scenario="still", rate_hz=100.0, duration_s=3.0, seed=2)]
START = 600  # messages: here the finger moves


def held(source: str, **options: Any) -> list[Message]:
    """The first readings of a simulation over and over, for 3 s: whoever moves there is held."""
    messages = simulated(source, rate_hz=100.0, duration_s=0.1, **options)
    first = list(dict(reversed(messages)).items())[::-1]
    noise = np.random.default_rng(1)
    frames = []
    for k in range(300):
        for topic, data in first:
            if topic == HALL_TOPIC:
                frames.append((topic, data))
                continue
            stamp, frame_id, _, accel = decode_imu(data)
            shaken = accel + noise.normal(0.0, 0.01, 3)
            frames.append(
                (topic, ImuEncoder(frame_id).encode(stamp + k * 10_000_000, (0.01, 0.0, -0.01), tuple(shaken)))
            )
    return frames


HELD_SHELL = held("exoshell", scenario="bench")
HELD_ARM = held("two_link_arm", scenario="slow_periodic")


def configured(tmp_path: Path, source: str, *changes: tuple[str, str], file: str = "calibrated.yaml") -> Path:
    """A shipped configuration in a folder of its own, with its calibration file there."""
    text = (CONFIGS / source).read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    text = "\n".join(line for line in text.splitlines() if not line.startswith("calibration_file"))
    path = tmp_path / source
    path.write_text(text + (f"\ncalibration_file: {file}\n" if file else "\n"), encoding="utf-8")
    return path


@pytest.fixture
def finger(tmp_path: Path) -> Path:
    """The finger, whose zero pose is not taken at each start."""
    return configured(tmp_path, "finger.yaml", ("zero_at_start: true", "zero_at_start: false"))


def taught(bench: Bench, path: Path, *, zero: bool = False) -> str:
    """Let a node measure and save; what it answers."""
    node = bench.estimator(path)
    bench.send(node, STILL)
    if zero:
        assert bench.trigger(node, "calibrate_zero") == (True, "done")
    success, message = bench.trigger(node, "save_calibration")
    assert success
    bench.remove(node)
    return message


# ----------------------------------------------------------------- saving


def test_saved_biases_and_zero_poses_are_where_the_next_node_starts(
    make_bench: Callable[[str], Bench], finger: Path, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    cold_folder = tmp_path_factory.mktemp("cold")
    message = taught(make_bench("events"), finger, zero=True)
    bench = make_bench("events")
    assert message.startswith(f"{tmp_path / 'calibrated.yaml'}: biases palm.x, palm.y")
    assert message.endswith("zero poses of finger_mcp, finger_pip, finger_dip")
    expected = estimate(MOVING[START:], finger)
    cold_config = configured(cold_folder, "finger.yaml", ("zero_at_start: true", "zero_at_start: false"), file="")
    cold = estimate(MOVING[START:], cold_config)
    assert abs(expected[0].velocity - cold[0].velocity)[:50].max() > 1e-3  # it makes a difference

    states = bench.listen()
    node = bench.estimator(finger)
    reports = bench.diagnostics(node)
    bench.send(node, MOVING[START:])
    bench.until(lambda: len(states) >= shown(expected[0]), "the joint states")
    assert_same(states, expected)
    report = reports.next()
    assert values(report["joint finger_pip"])["gyro bias calibrated"] == "yes"
    assert values(report["estimator"])["warm start"].startswith("from what was saved 2")
    assert values(report["estimator"])["calibration file"] == str(tmp_path / "calibrated.yaml")
    assert values(report["estimator"])["calibration written"].endswith(" UTC")


def test_a_warm_start_is_told_in_the_log(bench: Bench, finger: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taught(bench, finger, zero=True)
    told: list[str] = []
    monkeypatch.setattr(RcutilsLogger, "info", lambda _, text: told.append(text))
    bench.estimator(finger)
    bench.estimator(finger, namespace="cold", warm_start=False)
    (text,) = [text for text in told if text.startswith("warm start")]
    assert text.startswith("warm start: biases palm.x, palm.y")
    assert "zero poses of finger_mcp, finger_pip, finger_dip, saved 2" in text


def test_zero_poses_that_every_start_takes_are_not_saved(bench: Bench, tmp_path: Path) -> None:
    message = taught(bench, configured(tmp_path, "finger.yaml"))
    assert message.endswith("; zero poses not: zero_at_start takes them at every start")


def test_a_warm_start_can_be_switched_off(bench: Bench, finger: Path) -> None:
    taught(bench, finger)
    node = bench.estimator(finger, warm_start=False)
    assert not node.estimator.calibrated
    assert bench.estimator(finger, namespace="other").estimator.calibrated


@pytest.mark.parametrize(
    ("name", "source", "messages"),
    [
        ("gyro", "finger.yaml", STILL),
        ("kf", "exoshell.yaml", HELD_SHELL),
        ("kckf", "exoshell.yaml", HELD_SHELL),
        ("accel_ekf", "two_link_accel.yaml", HELD_ARM),
    ],
)
def test_others_that_learn(name: str, source: str, messages: list[Message], bench: Bench, tmp_path: Path) -> None:
    path = configured(tmp_path, source)
    node = bench.estimator(path, name)
    bench.send(node, messages)
    if hasattr(node.estimator, "calibrate_gyro_bias"):
        success, message = bench.trigger(node, "save_calibration")
        assert not success
        assert "~/calibrate_gyro_bias" in message
        assert bench.trigger(node, "calibrate_gyro_bias") == (True, "done")
    success, message = bench.trigger(node, "save_calibration")
    assert success, message
    biases = node.estimator.biases()
    assert biases
    second = bench.estimator(path, name, namespace="second")
    assert not second.estimator.unfit
    assert second.estimator.biases().keys() == biases.keys()
    saved = config.load(path).robot.learned[name].biases
    known = {key: value for key, (value, deviation) in saved.items() if deviation < 0.01}
    assert {key: second.estimator.biases()[key] for key in known} == known
    assert {key: biases[key] for key in known} == known


@pytest.mark.parametrize("name", ESTIMATORS)
def test_services_are_those_that_fit(name: str, bench: Bench) -> None:
    source = {"pcf": "finger.yaml"}.get(name, "two_link_accel.yaml" if "accel" in name else "exoshell.yaml")
    node = bench.estimator(CONFIGS / source, name)
    offered = {service.srv_name.split("/")[-1] for service in node.services}
    own = offered & {"reset", "calibrate_zero", "calibrate_gyro_bias", "save_calibration"}
    expected = {
        "pcf": {"reset", "calibrate_zero", "calibrate_gyro_bias", "save_calibration"},
        "gyro": {"reset", "calibrate_zero", "calibrate_gyro_bias", "save_calibration"},
        "kf": {"reset", "save_calibration"},
        "kckf": {"reset", "save_calibration"},
        "accel_ekf": {"reset", "save_calibration"},
    }
    assert own == expected.get(name, {"reset"})


def test_without_a_file_in_the_configuration_it_says_how_to_use_the_new_one(bench: Bench, tmp_path: Path) -> None:
    path = configured(tmp_path, "finger.yaml", file="")
    message = taught(bench, path)
    written = tmp_path / "finger_calibration.yaml"
    assert message.startswith(f"{written}: biases ")
    assert "zero poses of" not in message  # they are taken at each start
    assert message.endswith(f"write into {path}: calibration_file: finger_calibration.yaml")
    assert bench.estimator(path, calibration_file=str(written)).estimator.calibrated


def test_other_sections_and_other_estimators_stay(bench: Bench, finger: Path, tmp_path: Path) -> None:
    file = tmp_path / "calibrated.yaml"
    sensor = dataclasses.replace(config.load(finger).robot.sensors[0], gyro_scale=(1.0, 1.01, 0.99))
    calibration.save_gyro(file, [sensor], "by hand")
    taught(bench, finger)
    loaded = config.load(finger).robot
    assert loaded.sensors[0].gyro_scale == (1.0, 1.01, 0.99)
    assert set(loaded.learned) == {"pcf"}
    assert "# by hand" in file.read_text(encoding="utf-8")


# ----------------------------------------------------------------- refusals


@pytest.mark.parametrize("service", ["reset", "calibrate_zero", "calibrate_gyro_bias", "save_calibration"])
def test_services_refuse_while_the_robot_moves(service: str, bench: Bench, finger: Path, tmp_path: Path) -> None:
    node = bench.estimator(finger)
    bench.send(node, MOVING)
    before = node.estimator.get_state()
    success, message = bench.trigger(node, service)
    assert not success
    assert message.startswith("the robot moves")
    assert node.estimator.get_state() == before
    assert not (tmp_path / "calibrated.yaml").exists()


@pytest.mark.parametrize("service", ["reset", "calibrate_zero", "calibrate_gyro_bias", "save_calibration"])
def test_services_refuse_without_data(
    service: str, bench: Bench, finger: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = bench.estimator(finger)
    for _ in range(2):
        success, message = bench.trigger(node, service)
        assert not success
        assert message.startswith("no data arrives")
        bench.send(node, STILL)
        monkeypatch.setattr(services, "NO_DATA", 0.0)  # since then it may have moved


def test_a_file_that_cannot_be_written_is_told(bench: Bench, tmp_path: Path) -> None:
    path = configured(tmp_path, "finger.yaml", file="nowhere/calibrated.yaml")
    node = bench.estimator(path)
    bench.send(node, STILL)
    success, message = bench.trigger(node, "save_calibration")
    assert not success
    assert message.endswith("cannot be written: No such file or directory")


# ----------------------------------------------------------------- damaged files


def damaged(finger: Path) -> Path:
    """A calibration file with a sound section and one that is not."""
    file = finger.with_name("calibrated.yaml")
    calibration.save_mountings(file, config.load(finger).robot.sensors[:1], "sound")
    with file.open("a", encoding="utf-8") as text:
        text.write("learned: {pcf: {robot: robot-1, saved: today, biases: {palm.x: [1.0")
    return file


def test_a_damaged_file_is_told_and_ignored(bench: Bench, finger: Path) -> None:
    file = damaged(finger)
    content = file.read_bytes()
    node = bench.estimator(finger)
    reports = bench.diagnostics(node)
    plain = configured(finger.parent, "finger.yaml", ("zero_at_start: true", "zero_at_start: false"), file="")
    assert node.estimator.robot == config.load(plain).robot
    bench.send(node, STILL)
    report = reports.until(lambda report: values(report["estimator"])["ready"] == "yes")
    status = report["estimator"]
    assert status.level == DiagnosticStatus.WARN
    assert f"calibration file ignored: {file}: " in status.message
    success, message = bench.trigger(node, "save_calibration")
    assert not success
    assert message.startswith(f"{file}: ")
    assert "it stays as it is" in message
    assert file.read_bytes() == content


def test_what_was_learned_on_another_robot_is_told_and_not_used(bench: Bench, finger: Path) -> None:
    taught(bench, finger)
    finger.write_text(
        finger.read_text(encoding="utf-8").replace("rpy_deg: [0, 0, 0]", "rpy_deg: [0, 0, 1]"), encoding="utf-8"
    )
    node = bench.estimator(finger)
    reports = bench.diagnostics(node)
    assert not node.estimator.calibrated
    status = reports.next()["estimator"]
    assert "saved with other joints, mountings" in status.message
    assert values(status)["warm start"] == "no"


# ----------------------------------------------------------------- output rate


def stamps(states: list[Any]) -> list[int]:
    """ms since the first."""
    first = states[0].header.stamp
    return [
        round((s.header.stamp.sec - first.sec) * 1e3 + (s.header.stamp.nanosec - first.nanosec) * 1e-6) for s in states
    ]


@pytest.mark.parametrize(("rate", "expected"), [(25.0, range(0, 4000, 40)), (1000.0, range(0, 4000, 10))])
def test_the_output_rate_is_limited_by_the_stamps(
    rate: float, expected: range, bench: Bench, finger_config: Path
) -> None:
    states = bench.listen()
    node = bench.estimator(finger_config, output_rate_hz=rate)
    bench.send(node, MOVING)
    bench.until(lambda: len(states) >= len(expected), "the joint states")
    assert stamps(states) == list(expected)
    assert node.estimates == 400


def test_the_output_rate_changes_while_it_runs(bench: Bench, finger_config: Path) -> None:
    states = bench.listen()
    node = bench.estimator(finger_config)
    name = f"{node.get_fully_qualified_name()}/set_parameters"

    def limit(rate: float) -> bool:
        change = Parameter("output_rate_hz", value=rate).to_parameter_msg()
        return bool(bench.call(SetParameters, name, SetParameters.Request(parameters=[change])).results[0].successful)

    sent = 0
    for rate, expected in ((25.0, 25), (-1.0, 25), (0.0, 100)):
        assert limit(rate) == (rate >= 0.0)
        before, wanted = len(states), len(states) + expected
        bench.send(node, MOVING[sent : sent + 400])
        bench.until(partial(lambda number: len(states) >= number, wanted), "the joint states")
        assert len(states) - before == expected
        sent += 400
    assert node.estimates == 300


def test_torso_and_joints_are_limited_together(bench: Bench) -> None:
    states, angles = bench.listen(), bench.listen("torso_angle", Vector3Stamped)
    node = bench.estimator(CONFIGS / "exoshell.yaml", "kckf", output_rate_hz=30.0)
    messages: list[Message] = simulated("exoshell", scenario="bench", rate_hz=100.0, duration_s=4.0)
    bench.send(node, messages)
    bench.until(lambda: len(states) >= 120 and len(angles) >= 120, "120 of each")
    assert len(states) == len(angles) == 120  # 30 Hz from 100 Hz: 3, 3, 4 frames apart
    assert [s.header.stamp for s in states] == [a.header.stamp for a in angles]
    assert stamps(states)[::3] == list(range(0, 4000, 100))
