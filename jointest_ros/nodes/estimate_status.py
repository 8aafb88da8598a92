"""What /diagnostics say of the joints and of the estimator as a whole, and how innovations are judged."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, Status
from jointest_ros.core.pcf.pair_checks import CONTRADICTION, PairCheck, contradicts, verdict

Entry = tuple[bytes, str, dict[str, Any]]  # level, message, values

_UNSURE_DEG = 10.0  # standard deviation of a joint from which on it is no angle to rely on
_FEWEST = 10  # innovations that are judged together
_WORDS = {
    Status.STARTING: "no estimate yet",
    Status.NO_DATA: "a sensor is missing",
    Status.GAP: "predicted over a gap",
    Status.STALE: "stale: not published",
    Status.DISTURBED: "correction suspended",
}
_BY_READINGS = Status.UNOBSERVABLE | Status.DISTURBED  # what unsound readings feign
NOTHING_YET = _WORDS[Status.STARTING]
NOTHING_NEW = "no new estimate"


class Innovations:
    """Root mean square of the normalised innovations by joint since the latest report: 1 where the noise is right."""

    def __init__(self) -> None:
        self._sums: dict[str, list[float]] = {}  # joint -> sum of squares, number

    def add(self, estimator: Estimator) -> None:
        """Take those of the newest frame."""
        values = estimator.innovations()
        joints = estimator.innovation_joints() or ("",) * len(values)
        for joint, value in zip(joints, values, strict=False):
            if value == value:
                sums = self._sums.setdefault(joint, [0.0, 0.0])
                sums[0] += value * value
                sums[1] += 1.0

    def take(self) -> dict[str, float]:
        """By joint; begins anew."""
        ratios = {joint: math.sqrt(s / n) for joint, (s, n) in self._sums.items() if n >= _FEWEST}
        self._sums = {}
        return ratios


def joint_entry(
    estimator: Estimator,
    number: int,
    estimate: Estimate | None,
    new: bool,
    ratio: float | None,
    rest: bool | None,
    unsound: Sequence[str] = (),
) -> Entry:
    """One joint.

    Args:
        number: of the joint.
        estimate: the newest one; `new`: since the report before.
        ratio: of its innovations to the noise model.
        rest: its links are at rest; None: not known.
        unsound: what is wrong with the readings of its sensors; that is then the reason of what they feign.
    """
    if estimate is None:
        return DiagnosticStatus.STALE, "; ".join([NOTHING_YET, *unsound]), {}
    flags = Status(estimate.status[number])
    told = flags & ~_BY_READINGS if unsound else flags
    words = [text for flag, text in (_WORDS | {Status.UNOBSERVABLE: estimator.unobservable}).items() if told & flag]
    words += unsound
    deviation = math.degrees(math.sqrt(estimate.variance[number]))
    if ratio is not None and ratio > estimator.innovation_limit and not unsound:
        words.append(f"innovations {ratio:.1f} times larger than the noise model")
    if deviation > _UNSURE_DEG and not words:
        words.append(f"known to +-{deviation:.0f} deg only: nothing holds it, or not yet")
    level = DiagnosticStatus.WARN if words else DiagnosticStatus.OK
    if not new:
        level, words = DiagnosticStatus.STALE, [NOTHING_NEW, *unsound]
    values = {
        "standard deviation (deg)": f"{deviation:.3f}",
        "innovations / noise model": "" if ratio is None else f"{ratio:.2f}",
        "observable": "no" if flags & Status.UNOBSERVABLE else "yes",
        "still": "unknown" if rest is None else yes_no(rest),
        "stale": yes_no(bool(flags & Status.STALE) or not new),
    }
    if hasattr(estimator, "calibrate_gyro_bias"):
        values["gyro bias calibrated"] = yes_no(not flags & Status.UNCALIBRATED)
    return level, "; ".join(words) or f"+-{deviation:.2f} deg", values


def pairs_entry(pairs: Sequence[PairCheck], estimate: Estimate | None, new: bool) -> Entry:
    """Whether the IMUs agree with each other."""
    if estimate is None:
        return DiagnosticStatus.STALE, NOTHING_YET, {}
    values: dict[str, str] = {}
    for pair in pairs:
        name = f"{' + '.join(pair.joints)} ({' to '.join(pair.sensors)})"
        figures = {"residual": pair.residual, "tilt": pair.tilt} | ({"turned": pair.turned} if pair.turned else {})
        values |= {f"{name}: {what} (deg)": f"{math.degrees(value):.2f}" for what, value in figures.items()}
    if not new:
        return DiagnosticStatus.STALE, NOTHING_NEW, values
    if text := verdict(pairs):
        return DiagnosticStatus.WARN, text, values
    largest = math.degrees(max(max(abs(pair.residual), abs(pair.tilt)) for pair in pairs))
    return DiagnosticStatus.OK, f"agree within {largest:.1f} deg", values


def lacking(estimator: Estimator, estimate: Estimate | None, new: bool) -> list[str]:
    """What keeps an estimator from being ready, a text each, apart from its inputs."""
    if estimate is None:
        return [NOTHING_YET]
    if not new:
        return [NOTHING_NEW]
    texts = []
    for flag, word in ((Status.STARTING, NOTHING_YET), (Status.STALE, "stale")):
        joints = [name for name, flags in zip(estimator.joints, estimate.status, strict=True) if flags & flag]
        if joints:
            texts.append(f"{word}: {', '.join(joints)}")
    if any(flags & Status.UNCALIBRATED for flags in estimate.status):
        start = getattr(estimator.params, "still_start", 0.0)
        wait = f"keep still for {start + 1.0:g} s at the start, or " if start else ""
        texts.append(
            f"not calibrated: gyro bias of {', '.join(_uncalibrated(estimator, estimate))} unknown; {wait}"
            "call ~/calibrate_gyro_bias at rest"
        )
    return texts


def suspicion(estimator: Estimator, ratios: Mapping[str, float], pairs: Sequence[PairCheck], inputs_sound: bool) -> str:
    """What innovations that are too large say: the filter is wrong, where its inputs are sound; or ""."""
    wrong = {joint: ratio for joint, ratio in ratios.items() if ratio > estimator.innovation_limit}
    if not wrong:
        return ""
    where = f" of {', '.join(wrong)}" if any(wrong) else ""
    size = f"innovations{where} {max(wrong.values()):.1f} times larger than the noise model"
    if inputs_sound and contradicts(pairs):
        return f"{size}: {CONTRADICTION}"
    if inputs_sound:
        return f"inputs sound, {size}: check axes, mountings, noise parameters"
    return f"{size}: mend the inputs first"


def links_at_rest(estimator: Estimator, at_rest: Mapping[str, bool]) -> list[bool | None]:
    """Whether both links of each joint are at rest, by sensor; None: a link has no sensor that tells."""
    found: dict[str, bool | None] = {}
    for joint in estimator.robot.joints:
        links = [link for link in (joint.parent, joint.child) if link != estimator.robot.world]
        told = [[at_rest[s.name] for s in estimator.robot.sensors_on(link) if s.name in at_rest] for link in links]
        rest = None if not all(told) else all(all(one) for one in told)
        found |= dict.fromkeys(joint.coordinates, rest)
    return [found.get(name) for name in estimator.joints]


def unsound_readings(estimator: Estimator, findings: Callable[[str], Iterable[str]]) -> list[list[str]]:
    """What is wrong with the readings of the sensors on both links of each joint; `findings`: by sensor."""
    found: dict[str, list[str]] = {}
    for joint in estimator.robot.joints:
        sensors = [s.name for link in (joint.parent, joint.child) for s in estimator.robot.sensors_on(link)]
        texts = [text for sensor in sensors for text in findings(sensor)]
        found |= {name: texts for name in joint.coordinates}
    return [found.get(name, []) for name in estimator.joints]


def yes_no(value: bool) -> str:
    """In words."""
    return "yes" if value else "no"


def _uncalibrated(estimator: Estimator, estimate: Estimate) -> list[str]:
    """The gyros of the joints that say so."""
    pairs = zip(estimator.joints, estimate.status, strict=True)
    joints = {name for name, flags in pairs if flags & Status.UNCALIBRATED}
    links = {
        link
        for joint in estimator.robot.joints
        if joints.intersection(joint.coordinates)
        for link in (joint.parent, joint.child)
    }
    return [sensor.name for sensor in estimator.robot.sensors if sensor.gyro and sensor.link in links]
