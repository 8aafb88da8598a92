"""`jointest calibrate zero`: the pose of a still phase becomes the zero pose of the joints."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from jointest_ros import config
from jointest_ros.cli.calibrate_common import add_options, command, finish, target_file
from jointest_ros.cli.calibrate_mountings import add_joints, chosen_pairs, joints_given, read_pairs, save
from jointest_ros.cli.common import Parsers, out, warn
from jointest_ros.cli.tables import columns
from jointest_ros.config import calibration
from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.frame import Quat
from jointest_ros.evaluation.inertial_windows import StillPhase, WindowMeans
from jointest_ros.evaluation.joint_pairs import Pair, hinge_pairs
from jointest_ros.evaluation.mounting_fit import readings, turned, zeroed

_SHORTEST = 1.0  # s, of a still phase
_LEFT_OVER = math.radians(0.05)  # worth a word
_NEXT_TO_NOTHING = 1e-7  # rad


def add_parser(kinds: Parsers[Any]) -> None:
    """Declare the kind."""
    zero = kinds.add_parser(
        "zero",
        help="the pose in which every joint reads zero",
        description="Take the pose of a still phase as the zero pose: mountings are changed so that the joints read "
        "zero there. Axes stay where they are in the IMUs.",
        epilog="The robot has to stand still for a second or longer, in a pose in which no axis is within 10 deg of "
        "vertical. The first such phase counts, or that of --at. What is still is decided by still_gyro_dps, "
        "still_accel and largest_bias_dps under estimators: pcf:.",
    )
    add_options(zero)
    add_joints(zero, "zero")
    zero.add_argument(
        "--at", type=float, metavar="SECONDS", help="the still phase at this time after the start of the recording"
    )
    zero.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of `calibrate zero`."""
    bag, configuration = arguments.bag, config.load(arguments.config)
    pairs, left_out = chosen_pairs(arguments, configuration, 2)
    target = target_file(arguments, configuration)
    recording, when = read_pairs(arguments, configuration, pairs)
    phase = _phase(arguments, recording.means)
    by_node = "left out: zero_at_start, or the service ~/calibrate_zero, takes its zero pose"
    for text in (*recording.warnings, *(f"{text}; {by_node}" for text in left_out)):
        warn(text)
    before = _readings(pairs, phase)
    upright = [pair.joint.name for pair in pairs if before[pair.joint.coordinates[0]] is None]
    if len(upright) == len(pairs):
        raise CalibrationError(f"{bag}: joint '{upright[0]}': {_UPRIGHT}")
    for name in upright:
        warn(f"joint '{name}': {_UPRIGHT}; left as it is")
    zeroing = {pair.joint.name for pair in pairs if pair.joint.name not in upright}
    everything = hinge_pairs(configuration.robot, most_axes=2)[0]
    mountings = zeroed(everything, phase.accel, zeroing)
    after = _readings([_with(pair, mountings) for pair in pairs], phase)
    times = f"still from {_seconds(phase.start, recording.means):.1f} to {_seconds(phase.end, recording.means):.1f} s"
    own = {sensor.name for pair in pairs for sensor in pair.sensors}
    sensors = list({sensor.name: sensor for pair in everything for sensor in pair.sensors}.values())
    sensors = [s for s in sensors if s.name in own or turned(s, mountings[s.name]) > _NEXT_TO_NOTHING]
    save(
        target,
        sensors,
        mountings,
        _heading(arguments, f"{when}; {times}", before, calibration.heading(target, "mountings")),
    )
    table = columns(f"joint readings, {times}", ["joint"], ["before\ndeg", "after\ndeg"])
    for name, angle in before.items():
        table.add_row(name, _degrees(angle), _degrees(after[name]))
        if (now := after[name]) is not None and abs(now) > _LEFT_OVER and angle is not None:
            warn(
                f"joint '{name}': its axes leave the mountings no freedom to make it read zero in this pose; "
                "check the axes of the joints beside it, or the pose"
            )
    out.print(table)
    turns = [f"{s.name} {math.degrees(turned(s, mountings[s.name])):.2f} deg" for s in sensors]
    out.print(f"turned: {', '.join(turns)}")
    out.print(f"{target}: mountings of {', '.join(sensor.name for sensor in sensors)}")
    return finish(arguments, configuration, target, recording.damage)


_UPRIGHT = "its axis is within 10 deg of vertical in this pose, where its angle does not show; tilt the robot"


def _phase(arguments: argparse.Namespace, means: WindowMeans) -> StillPhase:
    """The still phase to take. Raises CalibrationError."""
    phases = [phase for phase in means.still if phase.duration >= _SHORTEST]
    if not phases:
        longest = max((phase.duration for phase in means.still), default=0.0)
        raise CalibrationError(
            f"{arguments.bag}: the robot never stands still for {_SHORTEST:g} s (longest: {longest:.1f} s); hold it "
            "still in its zero pose, or see still_gyro_dps, still_accel, largest_bias_dps under estimators: pcf:"
        )
    if arguments.at is None:
        return phases[0]
    for phase in phases:
        if _seconds(phase.start, means) <= arguments.at <= _seconds(phase.end, means):
            return phase
    still = ", ".join(f"{_seconds(p.start, means):.1f} to {_seconds(p.end, means):.1f} s" for p in phases)
    raise CalibrationError(f"{arguments.bag}: --at {arguments.at:g}: the robot moves there; it is still at {still}")


def _seconds(stamp: int, means: WindowMeans) -> float:
    return (stamp - means.first) * 1e-9


def _readings(pairs: Sequence[Pair], phase: StillPhase) -> dict[str, float | None]:
    """By coordinate, rad; None: gravity does not show those of the joint."""
    found: dict[str, float | None] = {}
    for pair in pairs:
        angles = readings(pair, phase.accel[pair.parent.name], phase.accel[pair.child.name])
        found |= zip(pair.joint.coordinates, angles or (None,) * len(pair.joint.axes), strict=True)
    return found


def _with(pair: Pair, mountings: dict[str, Quat]) -> Pair:
    one, two = (replace(sensor, mounting=mountings[sensor.name]) for sensor in pair.sensors)
    return replace(pair, parent=one, child=two)


def _degrees(angle: float | None) -> str:
    return "vertical" if angle is None else f"{round(math.degrees(angle), 3) + 0.0:.3f}"


def _heading(arguments: argparse.Namespace, when: str, before: dict[str, float | None], old: str) -> str:
    """The comment of the section, with what it says of the axes."""
    at = () if arguments.at is None else (f"--at {arguments.at:g}",)
    lines = [
        f"Zero pose by: {command(arguments, 'zero', *joints_given(arguments), *at)}",
        f"Recording: {when}.",
        f"Before, the joints read there, deg: {', '.join(f'{name} {_degrees(a)}' for name, a in before.items())}",
    ]
    return "\n".join([*lines, *([old[old.index("Axes by:") :]] if "Axes by:" in old else [])])
