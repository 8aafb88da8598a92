"""A robot written as YAML and read back is the same robot."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

from jointest_ros import config
from jointest_ros.config.text import robot_yaml
from jointest_ros.core.hall_sensor import ExponentialCurve, HallSensor, SplineCurve
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.sim.scenarios import SCENARIOS

HALF = math.sqrt(0.5)
ARM = Robot(
    links=("upper", "lower", "hand"),
    joints=(
        Joint("elbow", "upper", "lower", ((0.0, 0.6, 0.8),), ((-0.1, 2.5),)),
        Joint("wrist", "lower", "hand", ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0)), ((-1.0, 1.0), (-0.5, 0.25))),
    ),
    sensors=(
        Sensor("upper", "upper", (0.0, 0.1, -0.02), (0.5, -0.5, 0.5, 0.5), gyro_range=math.radians(2000.0)),
        Sensor("strap", "lower", accel=False, gyro_noise=1e-4, gyro_bias_walk=2e-5, accel_noise=3e-3, delay=0.0123),
        Sensor("glove", "hand", gyro=False, mag=True, accel_range=160.0, topic="/glove/imu", frame_id="chip_2"),
        Sensor("ring", "hand", (1 / 3, 0.0, 0.0), topic="/glove/imu", mag_topic="compass", frame_id="chip_1"),
    ),
    name="arm",
    hall=(
        HallSensor("elbow", ExponentialCurve(0.08, 2.9, 2.0e5, 8.0), True, 0.01, 0.02, (0.3, 1.7), 0.0),
        HallSensor("wrist_x", SplineCurve((0.2, 1.0, 1.8), (-30.0, 5.0, 90.0))),
    ),
)
KNEE = Robot(("a", "b"), (Joint("knee", "a", "b", ((HALF, HALF, 0.0),), continuous=True),), (Sensor("a", "a"),))


def rounded(value: Any) -> Any:
    """Any dataclass as plain values, numbers to 8 significant digits."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: rounded(getattr(value, f.name)) for f in dataclasses.fields(value) if f.compare}
    if isinstance(value, (tuple, list)):
        return [rounded(one) for one in value]
    return f"{value + 0.0:.8g}" if isinstance(value, float) else value


@pytest.mark.parametrize("robot", [ARM, KNEE], ids=lambda robot: robot.name)
def test_round_trip(robot: Robot) -> None:
    text = robot_yaml(robot, {"pcf": {"formulation": "relative"}}, "two\nlines")
    assert text.startswith("# two\n# lines\n")
    read = config.parse(text)
    assert rounded(read.robot) == rounded(robot)
    assert vars(read.estimators["pcf"])["formulation"] == "relative"


@pytest.mark.parametrize("rig", SCENARIOS.values(), ids=lambda rig: rig.name)
def test_round_trip_of_the_simulated_rigs(rig: Any) -> None:
    robot = rig.make(duration_s=0.1).robot
    read = config.parse(robot_yaml(robot, rig.estimators, ""))
    assert rounded(read.robot) == rounded(robot)
    assert list(read.estimators) == list(rig.estimators)
