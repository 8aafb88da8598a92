"""What `evaluate` and `estimate` say of accelerometers whose samples are sound and still wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from bag_copies import copied

from jointest_ros.bags.cdr import decode_imu
from jointest_ros.bags.cdr_encode import ImuEncoder

Jointest = Callable[..., Any]
VICTIM = "/imu/middle"


@pytest.fixture
def in_g(finger: Path, tmp_path: Path) -> Path:
    """The finger at rest and in motion, one accelerometer in g."""

    def change(topic: str, _time: int, data: bytes) -> bytes:
        if topic != VICTIM:
            return data
        stamp, frame_id, gyro, (x, y, z) = decode_imu(data)
        return ImuEncoder(frame_id).encode(stamp, gyro, (x / 9.81, y / 9.81, z / 9.81))

    return copied(finger, tmp_path / "in_g", change)


@pytest.mark.parametrize("command", ["evaluate", "estimate"])
def test_units_in_g_are_told(command: str, in_g: Path, finger_yaml: Path, jointest: Jointest, tmp_path: Path) -> None:
    options = ("-o", tmp_path / "out.csv") if command == "estimate" else ()
    result = jointest(command, in_g, "--config", finger_yaml, *options)
    assert result.code == 0
    (line,) = result.err.splitlines()
    assert line == f"warning: {in_g}: middle reads 1.00 at rest: is it in g instead of m/s^2?"


def test_a_full_scale_that_is_reached_is_told(
    finger: Path, finger_yaml: Path, jointest: Jointest, tmp_path: Path
) -> None:
    """Sensors that are said to end at 1 g, and read more than that."""
    small = tmp_path / "small.yaml"
    document = yaml.safe_load(finger_yaml.read_text(encoding="utf-8"))
    small.write_text(yaml.safe_dump({"sensor_defaults": {"accel_range_g": 1}, **document}), encoding="utf-8")
    result = jointest("evaluate", finger, "--config", small)
    assert result.code == 0
    warnings = result.err.splitlines()
    assert len(warnings) == 4
    assert all(" samples saturated at the full scale of 1 g, " in line for line in warnings)
