"""Simulated hardware, DDS and an estimator node give what the offline evaluation of the same recording gives."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from ros_bench import Bench, received
from without_ros import assert_same, evaluate, shown, write_simulation

EXECUTORS = pytest.mark.parametrize("executor", ["events", "single"])


def play_and_compare(bench: Bench, recording: Path, config: Path, **parameters: Any) -> None:
    expected = evaluate(recording, config)
    states = bench.listen()
    estimator = bench.estimator(config)
    hardware = bench.hardware(**parameters)
    bench.until(lambda: hardware.finished, "the end of the recording")
    bench.until(lambda: len(states) >= shown(expected[0]), f"{shown(expected[0])} joint states")
    assert_same(states, expected)
    assert len(states) == estimator.estimates
    assert all(not estimator.intake.counts(topic)["refused"] for topic in estimator.intake.topics)
    assert received(estimator) == sum(estimator.intake.counts(topic)["used"] for topic in estimator.intake.topics)


@EXECUTORS
def test_recording(executor: str, make_bench: Callable[[str], Bench], finger_bag: Path, finger_config: Path) -> None:
    play_and_compare(make_bench(executor), finger_bag, finger_config, source="bag", bag=str(finger_bag), speed=15.0)


@EXECUTORS
@pytest.mark.parametrize(("rate_hz", "speed"), [(100.0, 10.0), (1000.0, 2.0)])
def test_simulation(
    executor: str, rate_hz: float, speed: float, make_bench: Callable[[str], Bench], finger_config: Path, tmp_path: Path
) -> None:
    seconds = 600.0 / rate_hz + 2.0
    options = {"scenario": "PC", "rate_hz": rate_hz, "duration_s": seconds, "zero_pose_s": 1.5, "seed": 3}
    bag = write_simulation(tmp_path / "bag", "finger", **options)
    play_and_compare(make_bench(executor), bag, finger_config, source="finger", speed=speed, **options)


def test_gripper_at_1_khz(bench: Bench, gripper_config: Path, tmp_path: Path) -> None:
    """Seven IMUs, and a link without one."""
    options = {"scenario": "palm", "rate_hz": 1000.0, "duration_s": 3.0, "zero_pose_s": 1.5, "seed": 4}
    bag = write_simulation(tmp_path / "bag", "gripper", **options)
    play_and_compare(bench, bag, gripper_config, source="gripper", **options)
