"""The Hall voltages of a recording and the ground truth beside them, paired as the estimators pair them."""

from __future__ import annotations

from array import array
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointest_ros.bags import ground_truth, offline
from jointest_ros.bags.cdr import FLOAT32_MULTIARRAY, JOINT_STATE, decode_float32_multiarray
from jointest_ros.bags.errors import BagError, CdrError
from jointest_ros.bags.intake import HALL_TOPIC, Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.typestore import decoded
from jointest_ros.bags.usage import unusual, used_text
from jointest_ros.core.frame import FloatArray, Frame
from jointest_ros.core.progress import Progress, no_progress
from jointest_ros.core.robot import Robot
from jointest_ros.core.timing import Timing, rising
from jointest_ros.evaluation.truth import Truth


@dataclass
class HallReadings:
    """N readings of h sensors.

    Attributes:
        stamps: (N,) ns, rising, of the frame that a message belongs to; its record time where there are no frames.
        volts: (N, h) in the order of the configuration, NaN where there is no reading.
        truth: of the recording.
        warnings: what a user should know, one line each.
        damage: why the recording could not be read to its end; empty when it could.
    """

    stamps: NDArray[np.int64]
    volts: FloatArray
    truth: Truth
    warnings: list[str]
    damage: str

    @property
    def time(self) -> FloatArray:
        """(N,) s after the first reading."""
        return np.asarray((self.stamps - self.stamps[0]) * 1e-9)


def read_hall(
    reader: BagReader,
    robot: Robot,
    timing: Timing,
    namespace: str = "",
    progress: Progress = no_progress,
) -> HallReadings:
    """Read them from an open recording.

    Raises:
        BagError: the Hall topic or the ground truth of the joints is absent or of another type, or no Hall message can
            be used.
    """
    topic = reader.require(HALL_TOPIC, FLOAT32_MULTIARRAY, namespace)
    reader.require(ground_truth.TRUTH_JOINTS, JOINT_STATE, namespace)
    stamps, volts = array("q"), array("d")

    def collect(frames: list[Frame]) -> None:
        for frame in frames:
            if frame.hall is not None:
                stamps.append(frame.stamp)
                volts.extend(frame.hall)

    outcome = offline.read_frames(reader, Intake(robot, timing), collect, namespace, progress)
    counts = outcome.inputs[topic]
    used = f"{reader.path}: {topic}: {used_text(counts)}"
    if not outcome.frames:
        outcome.warnings = [f"{reader.path}: no IMU message to give the voltages a stamp; their record times are used"]
        _by_record_time(reader, topic, len(robot.hall), stamps, volts)
    elif unusual(counts):
        outcome.warnings.append(used)
    if not stamps:
        raise BagError(used)
    times = np.array(stamps, dtype=np.int64)
    kept = rising(times)
    return HallReadings(
        times[kept],
        np.array(volts, dtype=float).reshape(-1, len(robot.hall))[kept],
        outcome.truth,
        outcome.warnings,
        outcome.damage,
    )


def _by_record_time(reader: BagReader, topic: str, width: int, stamps: array[int], volts: array[float]) -> None:
    with suppress(BagError):  # a damage: the first pass has told it
        for _, time, data in reader.messages((topic,)):
            with suppress(CdrError):
                voltages = decoded(decode_float32_multiarray, data, FLOAT32_MULTIARRAY)[0]
                if len(voltages) == width:
                    stamps.append(time)
                    volts.extend(voltages)
