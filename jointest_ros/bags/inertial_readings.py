"""The inertial sensors of a recording as window means, with its still phases, assembled as the estimators have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from jointest_ros.bags import offline
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.usage import unusual, used_text
from jointest_ros.core.progress import Progress, no_progress
from jointest_ros.core.robot import Robot, Sensor
from jointest_ros.core.stillness import Stillness
from jointest_ros.core.timing import Timing
from jointest_ros.evaluation.inertial_windows import WindowMeans, Windows


@dataclass(frozen=True)
class InertialReadings:
    """What a recording holds of some sensors.

    Attributes:
        means: of the sensors whose topic is in the recording.
        warnings: what a user should know, one line each.
        damage: why the recording could not be read to its end; empty when it could.
    """

    means: WindowMeans
    warnings: list[str]
    damage: str


def read_inertial(
    reader: BagReader,
    robot: Robot,
    sensors: Sequence[Sensor],
    timing: Timing,
    stillness: Stillness,
    namespace: str = "",
    progress: Progress = no_progress,
) -> InertialReadings:
    """Read these sensors of the robot, in the memory of a chunk and the means, from an open recording.

    Args:
        stillness: fresh, with the thresholds to use; it is given the sensors that are there.

    Raises:
        BagError: there is no topic of the sensors, one is of another type, or none of their messages can be used.
    """
    used = replace(robot, sensors=tuple(replace(sensor, mag=False) for sensor in sensors), hall=())
    intake = Intake(used, timing)
    there = [sensor.name for sensor in sensors if reader.resolve(sensor.topic, namespace) is not None]
    windows = Windows(tuple(there), replace(stillness, sensors=tuple(there)))
    outcome = offline.read_recordings(reader, intake, windows.add, namespace, progress)
    warnings = outcome.warnings
    for topic, counts in outcome.inputs.items():
        if unusual(counts):
            warnings.append(f"{reader.path}: {topic}: {used_text(counts)}")
    if not outcome.frames:
        raise BagError(
            outcome.damage or warnings[-1] if warnings else f"{reader.path}: no message of {', '.join(there)}"
        )
    return InertialReadings(windows.means(), warnings, outcome.damage)
