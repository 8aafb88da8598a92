"""The accelerometer readings of a recording, uncalibrated, at the stamps of the frames that estimators would get."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointest_ros.bags import offline
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.progress import Progress, no_progress
from jointest_ros.core.robot import UNCALIBRATED_MATRIX, Robot
from jointest_ros.core.timing import Timing, rising


@dataclass
class AccelReadings:
    """T readings of each accelerometer that gave any.

    Attributes:
        stamps: (T,) ns, rising.
        accel: sensor -> (T, 3) as it came, m/s^2 if its driver keeps to the convention; NaN where there is none.
        warnings: what a user should know, one line each.
        damage: why the recording could not be read to its end; empty when it could.
    """

    stamps: NDArray[np.int64]
    accel: dict[str, FloatArray]
    warnings: list[str]
    damage: str


def read_accel(
    reader: BagReader,
    robot: Robot,
    timing: Timing,
    namespace: str = "",
    progress: Progress = no_progress,
) -> AccelReadings:
    """Read them from an open recording.

    Raises:
        BagError: none of the topics is in the recording, one is of another type, or no message can be used.
    """
    raw = replace(
        robot,
        sensors=tuple(
            replace(sensor, accel_matrix=UNCALIBRATED_MATRIX, accel_offset=(0.0, 0.0, 0.0)) for sensor in robot.sensors
        ),
    )
    recording, outcome = offline.read_recording(reader, Intake(raw, timing), namespace, progress)
    if not recording.accel:
        raise BagError(f"{reader.path}: no accelerometer message could be used")
    stamps = recording.stamps
    kept = rising(stamps)
    accel = {
        sensor.name: recording.accel[sensor.name][kept] for sensor in robot.sensors if sensor.name in recording.accel
    }
    return AccelReadings(stamps[kept], accel, outcome.warnings, outcome.damage)
