"""Which joints a calibration by motion can use."""

from __future__ import annotations

import pytest

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.evaluation.joint_pairs import hinge_pairs

X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
ROBOT = Robot(
    ("base", "palm", "finger", "tip", "thumb"),
    (
        Joint("dip", "finger", "tip", (X,)),  # before its parent's, in the configuration
        Joint("wrist", "base", "palm", (X, Z)),
        Joint("mcp", "palm", "finger", (X,)),
        Joint("opposition", "palm", "thumb", (Z,)),
    ),
    (
        Sensor("base", "base"),
        Sensor("palm_gyro", "palm", accel=False),
        Sensor("palm", "palm"),
        Sensor("finger", "finger"),
        Sensor("tip", "tip"),
        Sensor("thumb", "thumb", gyro=False),
    ),
)


def test_hinges_with_an_imu_on_either_side_are_used_and_the_others_named() -> None:
    pairs, left_out = hinge_pairs(ROBOT)
    assert [(pair.joint.name, pair.parent.name, pair.child.name) for pair in pairs] == [
        ("mcp", "palm", "finger"),
        ("dip", "finger", "tip"),
    ]
    assert left_out == [
        "joint 'wrist': it has 2 axes; only joints of one axis can be calibrated",
        "joint 'opposition': link 'thumb' carries no sensor with gyro and accelerometer; one on either side is needed",
    ]
    assert [pair.joint.name for pair in hinge_pairs(ROBOT, ["dip"])[0]] == ["dip"]


@pytest.mark.parametrize(
    ("chosen", "expected"),
    [
        (["dpi"], "joint 'dpi': unknown; did you mean 'dip'?"),
        (["elbow"], "joint 'elbow': unknown; known: dip, wrist, mcp, opposition"),
        (["dip", "wrist"], "joint 'wrist': it has 2 axes"),
        (["opposition"], "joint 'opposition': link 'thumb' carries no sensor"),
    ],
)
def test_a_choice_that_cannot_be_used_is_refused(chosen: list[str], expected: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        hinge_pairs(ROBOT, chosen)
    assert expected in str(refused.value)


def test_a_robot_without_such_a_joint_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"robot\.joints: none"):
        hinge_pairs(Robot(("palm",), (), (Sensor("palm", "palm"),)))
    with pytest.raises(ConfigurationError, match=r"joint 'wrist': it has 2 axes"):
        hinge_pairs(Robot(("base", "palm"), (ROBOT.joints[1],), ROBOT.sensors[:3]))
