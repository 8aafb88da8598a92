"""The soft hand gripper: nine angles from seven IMUs, and what the diagnostics tell when one of them slips."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from ros_bench import Bench, values
from scipy.spatial.transform import Rotation
from without_ros import Message

from jointest_ros.bags import synthetic
from jointest_ros.bags.ground_truth import TRUTH_JOINTS
from jointest_ros.sim.gripper import simulate

PAIRS = "IMU pairs"


def slipping(sensor: str, angle_deg: float, row: int) -> list[Message]:
    """25 s at rest, in which an IMU turns about its hinge's axis at sample `row`."""
    recorded = simulate("rest", rate_hz=100.0, duration_s=25.0, seed=7)
    accel = recorded.recording.accel[sensor].copy()
    accel[row:] = Rotation.from_euler("x", angle_deg, degrees=True).apply(accel[row:])
    recording = replace(recorded.recording, accel={**recorded.recording.accel, sensor: accel})
    messages = synthetic.messages([replace(recorded, recording=recording)])
    return [(topic, data) for _, topic, data in messages if topic != TRUTH_JOINTS]


def test_diagnostics_name_the_imu_that_slipped_until_a_zero_pose_is_taken(bench: Bench, gripper_config: Path) -> None:
    node = bench.estimator(gripper_config)
    log, reports = bench.log(node), bench.diagnostics(node)
    messages = slipping("left_middle", 10.0, 1500)
    first = 7 * 1400
    bench.send(node, messages[:first])
    report = reports.next()
    assert report[PAIRS].level == DiagnosticStatus.OK
    assert report[PAIRS].message.startswith("agree within 0.")
    figures = values(report[PAIRS])
    assert len(figures) == 2 * (6 + 4)
    assert abs(float(figures["left_mcp + left_pip (palm to left_middle): residual (deg)"])) < 0.5
    assert "joint palm_z" in report and report["joint palm_z"].message.startswith("axis near gravity: gyro only")

    bench.send(node, messages[first:])
    report = reports.until(lambda report: values(report["estimator"])["estimates"] == str(node.estimates))
    assert report[PAIRS].level == DiagnosticStatus.WARN
    text = report[PAIRS].message
    assert text.startswith("IMU left_middle: turned by ") and "slipped? take the zero pose anew" in text
    assert abs(float(text.split("turned by ")[1].split(" deg")[0]) - 10.0) < 1.0
    figures = values(report[PAIRS])
    turned = {key for key in figures if key.endswith("turned (deg)")}
    assert turned == {
        "left_pip (left_proximal to left_middle): turned (deg)",
        "left_dip (left_middle to left_distal): turned (deg)",
        "left_mcp + left_pip (palm to left_middle): turned (deg)",
    }
    bench.until(lambda: [line for line in log if line.msg.startswith("IMU left_middle")], "a warning")

    assert bench.trigger(node, "calibrate_zero") == (True, "done")
    figures = values(reports.next()[PAIRS])
    assert not any(key.endswith("turned (deg)") for key in figures)


def test_robots_without_pairs_have_no_such_entry(bench: Bench) -> None:
    exoshell = Path(__file__).resolve().parents[2] / "config" / "exoshell.yaml"
    node = bench.estimator(exoshell, "kckf")
    assert PAIRS not in bench.diagnostics(node).next()


def test_nine_angles_live_at_1_khz(bench: Bench, gripper_config: Path) -> None:
    """In real time, beside the truth that the simulated hardware publishes."""
    states, truths = bench.listen(), bench.listen("ground_truth/joint_states")
    bench.estimator(gripper_config)
    hardware = bench.hardware(
        source="gripper", scenario="grasp_medium", rate_hz=1000.0, duration_s=4.0, zero_pose_s=1.5, seed=8
    )
    bench.until(lambda: hardware.finished, "the end")
    bench.until(lambda: len(states) > 3900, "the states")
    last = states[-1]
    assert list(last.name) == [*(f"palm_{axis}" for axis in "zyx"), *_fingers()]
    (truth,) = [one for one in truths if one.header.stamp == last.header.stamp]
    assert list(truth.name) == list(last.name)
    np.testing.assert_allclose(last.position, truth.position, rtol=0.0, atol=math.radians(0.4))
    assert max(truth.position) > math.radians(40.0)


def _fingers() -> list[str]:
    return [f"{side}_{joint}" for side in ("left", "right") for joint in ("mcp", "pip", "dip")]
