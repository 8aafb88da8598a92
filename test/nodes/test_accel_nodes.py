"""The estimators on arrays of accelerometers, side by side on one stream of Imu messages without gyros."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from ros_bench import Bench
from std_msgs.msg import Float64MultiArray
from without_ros import assert_same, estimate, evaluate, shown, simulated, write_simulation

from jointest_ros.bags import cdr
from jointest_ros.core.frame import Status

NAMES = ("accel_analytical", "accel_ekf", "accel_ukf")
OPTIONS = {"scenario": "slow_periodic", "duration_s": 4.0, "seed": 4}


@pytest.fixture
def config() -> Path:
    """The shipped configuration, which suits the rig."""
    return Path(__file__).resolve().parents[2] / "config" / "two_link_accel.yaml"


@pytest.mark.parametrize("rate_hz", [100.0, 500.0])
def test_side_by_side_they_give_what_the_offline_evaluation_gives(
    bench: Bench, config: Path, tmp_path: Path, rate_hz: float
) -> None:
    options = OPTIONS | {"rate_hz": rate_hz}
    bag = write_simulation(tmp_path / "bag", "two_link_arm", **options)
    states = {name: bench.listen(f"{name}/joint_states") for name in NAMES}
    velocities = {name: bench.listen(f"{name}/link_velocities", Float64MultiArray) for name in NAMES[1:]}
    covariances = bench.listen("accel_ekf/joint_covariance", Float64MultiArray)
    nodes = {name: bench.estimator(config, name, name, sensor_namespace=bench.namespace) for name in NAMES}
    hardware = bench.hardware(source="two_link_arm", speed=1000.0 / rate_hz, **options)
    bench.until(lambda: hardware.finished, "the end of the simulation")
    for name in NAMES:
        expected = evaluate(bag, config, name)
        count = shown(expected[0])
        bench.until(lambda name=name, count=count: len(states[name]) >= count, f"{count} joint states")
        assert_same(states[name], expected)
        assert nodes[name].estimates == len(expected[0].stamps)
    for name, received in velocities.items():
        bench.until(lambda received=received: received, "link velocities")
        assert [dimension.label for dimension in received[-1].layout.dim] == ["link_a", "link_b"]
        w_a, w_b = received[-1].data
        assert w_b - w_a == pytest.approx(states[name][-1].velocity[0], abs=1e-9)
    bench.until(lambda: covariances, "covariances")
    assert math.degrees(math.sqrt(covariances[-1].data[0])) < 5.0


def test_their_gyros_are_not_looked_at(bench: Bench, config: Path) -> None:
    """What a driver without gyro sends as angular velocity is NaN, and nothing is refused for it."""
    messages = simulated("two_link_arm", **OPTIONS)
    _, _, gyro, accel = cdr.decode_imu(messages[0][1])
    assert np.isnan(gyro).all()
    assert np.isfinite(accel).all()
    node = bench.estimator(config, "accel_ekf")
    bench.send(node, messages)
    assert node.estimates == 400
    assert not any(node.intake.counts(topic)["refused"] for topic in node.intake.topics)


def test_a_silent_accelerometer_is_told_of_and_the_others_go_on(bench: Bench, config: Path) -> None:
    messages = simulated("two_link_arm", **OPTIONS)
    half = len(messages) // 2
    messages[half:] = [(topic, data) for topic, data in messages[half:] if topic != "imu/b2"]
    expected = estimate(messages, config, name="accel_ekf")
    assert (expected[0].status[-100:] & Status.NO_DATA).all()
    node = bench.estimator(config, "accel_ekf")
    diagnoses = bench.diagnostics(node)
    states = bench.listen("joint_states")
    bench.send(node, messages)
    bench.until(lambda: len(states) >= shown(expected[0]), "joint states")
    assert_same(states, expected)
    diagnoses.until(lambda report: report[f"input {bench.namespace}/imu/b2"].level == DiagnosticStatus.STALE)
