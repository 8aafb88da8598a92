"""Drafts of configurations from a few words: joints, kind of sensors, topics."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

from jointest_ros.config.template import Draft
from jointest_ros.core.errors import ConfigurationError, counted, did_you_mean
from jointest_ros.core.frame import Vec3
from jointest_ros.core.hall_sensor import HallSensor
from jointest_ros.core.robot import Joint, Robot, Sensor

KINDS = {
    "imu": "gyro and accelerometer on each link: pcf",
    "gyro+hall": "a gyro on each link, two Hall sensors on each joint: kckf",
    "accel": "two accelerometers on each link, no gyro: accel_ekf",
}
JOINT = "NAME:PARENT:CHILD:AXES[:X,Y,Z][:LOW..HIGH]"
_AXES: dict[str, Vec3] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_SPREAD = 0.1  # m, between two accelerometers whose places nobody gave
_ESTIMATORS: dict[str, dict[str, dict[str, object]]] = {
    "imu": {"pcf": {"zero_at_start": True}},
    "gyro+hall": {"kckf": {}},
    "accel": {"accel_ekf": {}},
}


def parse_joint(text: str) -> Joint:
    """A joint in one word: knee:thigh:shank:y, with origin (m) and limits (deg) knee:thigh:shank:y:0,0,-0.4:0..130.

    Raises:
        ConfigurationError: it is something else.
    """

    def refusal(what: str) -> ConfigurationError:
        return ConfigurationError(f"--joints: '{text}': {what}; give {JOINT}, such as knee:thigh:shank:y")

    parts = [part.strip() for part in text.split(":")]
    if not 4 <= len(parts) <= 6 or not all(parts):
        raise refusal(counted(len(parts), "part"))
    name, parent, child, axes, *others = parts
    letters = re.findall(r"[+-]?[xyz]", axes)
    if axes not in ("".join(letters), ",".join(letters)) or len(letters) > 3:
        raise refusal(f"axes '{axes}': one to three of x, y, z, -x, -y, -z, such as y,x")
    vectors = tuple(_axis(letter) for letter in letters)
    origin: Vec3 | None = None
    limits: tuple[tuple[float, float], ...] | None = None
    for other in others:
        given = limits if ".." in other else origin
        if given is not None:
            raise refusal(f"'{other}': {'second limits' if '..' in other else 'a second origin'}")
        if ".." in other:
            ranges = [_numbers(one.replace("..", ",")) for one in other.split(",")]
            if len(ranges) in (1, len(vectors)) and all(len(one) == 2 and one[0] < one[1] for one in ranges):
                ranges = ranges * len(vectors) if len(ranges) == 1 else ranges
                limits = tuple([(math.radians(low), math.radians(high)) for low, high in ranges])
                continue
        else:
            numbers = _numbers(other)
            if len(numbers) == 3:
                origin = (numbers[0], numbers[1], numbers[2])
                continue
        raise refusal(f"'{other}' is neither an origin X,Y,Z (m) nor limits LOW..HIGH (deg), one or one for each axis")
    return Joint(name, parent, child, vectors, limits, origin=origin or (0.0, 0.0, 0.0))


def _axis(letter: str) -> Vec3:
    x, y, z = _AXES[letter[-1]]
    sign = -1.0 if letter[0] == "-" else 1.0
    return (sign * x + 0.0, sign * y + 0.0, sign * z + 0.0)


def _numbers(text: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return []
    return numbers if all(map(math.isfinite, numbers)) else []


def links_of(joints: Sequence[Joint]) -> tuple[str, ...]:
    """All links, parents before their children as far as they are given so."""
    return tuple(dict.fromkeys(link for joint in joints for link in (joint.parent, joint.child)))


def second_roots(joints: Sequence[Joint]) -> Iterator[str]:
    """One line for each link but the first that no joint moves: most often a parent's name that is mistyped."""
    moved = {joint.child for joint in joints}
    links = links_of(joints)
    first, *others = [link for link in links if link not in moved] or [""]
    for link in others:
        hint = did_you_mean(link, [one for one in links if one != link], f"its tree is apart from that of '{first}'")
        yield f"'{link}' is a second root, no joint moves it; {hint}"


def draft(
    name: str,
    joints: Sequence[Joint],
    kind: str,
    links: Sequence[str] = (),
    sensors: Sequence[Sensor] = (),
    world: str = "",
    places_known: bool = False,
) -> Draft:
    """A robot with its sensors and the estimator that suits them.

    Args:
        kind: one of `KINDS`.
        links: in their order; by default those of the joints.
        sensors: IMUs that are known; every other link gets one at the origin of its frame.
        places_known: origins of joints are known.

    Raises:
        ConfigurationError: no joints, or what `Robot` refuses.
    """
    if not joints:
        raise ConfigurationError("no joint that turns")
    links = tuple(links) or links_of(joints)
    bearing = [link for link in links if link != world]
    measure = set() if places_known else {f"joints.{joint.name}.origin" for joint in joints if not any(joint.origin)}
    hall: tuple[HallSensor, ...] = ()
    if kind == "accel":
        sensors = tuple(_arrays(joints, bearing))
    else:
        lacking = [link for link in bearing if link not in {sensor.link for sensor in sensors}]
        sensors = (
            *(replace(sensor, name=_word(sensor.name), topic="", mag_topic="") for sensor in sensors),
            *(Sensor(_word(link), link) for link in lacking),
        )
        measure |= {f"sensors.{_word(link)}.position" for link in lacking}
    if kind == "gyro+hall":
        sensors = tuple(replace(sensor, accel=False) for sensor in sensors)
        coordinates = [coordinate for joint in joints for coordinate in joint.coordinates]
        hall = tuple(HallSensor(one, mirrored=mirrored) for one in coordinates for mirrored in (False, True))
        measure = set()  # kckf uses no places
    if kind == "accel":
        measure |= {f"sensors.{sensor.name}.position" for sensor in sensors}
    robot = Robot(links, tuple(joints), tuple(sensors), name, hall, world)
    return Draft(robot, _ESTIMATORS[kind], frozenset(measure))


def _arrays(joints: Sequence[Joint], links: Sequence[str]) -> Iterator[Sensor]:
    """Two accelerometers on each link, at its own origin and at that of its first joint, or somewhere apart."""
    for link in links:
        axis = next((joint.axes[0] for joint in joints if link in (joint.parent, joint.child)), _AXES["z"])
        end = next((joint.origin for joint in joints if joint.parent == link and any(joint.origin)), None)
        if end is None:
            end = (_SPREAD, 0.0, 0.0) if abs(axis[0]) < 0.5 else (0.0, _SPREAD, 0.0)
        for number, share in ((1, 0.1), (2, 0.9)):
            x, y, z = (share * component for component in end)
            yield Sensor(f"{_word(link)}_{number}", link, (x, y, z), gyro=False)


def _word(name: str) -> str:
    """The name of a link as a topic can have it: upper_arm for "upper arm"."""
    word = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return f"_{word}" if word[:1].isdigit() else word


def with_topics(draft: Draft, pattern: str) -> Draft:
    """The draft with the topics of its sensors by a pattern: {sensor} and {link} stand for their names.

    A pattern without either is one topic for all, told apart by frame_id.
    """
    shared = not re.search(r"\{(sensor|link)\}", pattern)
    sensors = tuple(
        replace(
            sensor,
            topic=pattern.replace("{sensor}", sensor.name).replace("{link}", _word(sensor.link)),
            frame_id=sensor.name if shared and len(draft.robot.sensors) > 1 else "",
        )
        for sensor in draft.robot.sensors
    )
    return replace(draft, robot=replace(draft.robot, sensors=sensors))


def with_sources(draft: Draft, sources: Mapping[str, Sequence[str]]) -> tuple[Draft, list[str]]:
    """The draft with the topics and frame ids that were recorded, and one line for each that could not be placed.

    Args:
        sources: topic -> frame ids on it. A sensor takes the topic or frame id that has its name, or its link's, in it.
    """
    free = [(topic, frame_id, len(ids) > 1) for topic, ids in sources.items() for frame_id in ids]
    taken: dict[str, tuple[str, str, bool]] = {}
    for closely in (True, False):
        for sensor in draft.robot.sensors:
            if sensor.name in taken:
                continue
            found = _near(sensor, free, closely)
            if found is not None:
                taken[sensor.name] = found
                free.remove(found)
    sensors = tuple(
        replace(s, topic=taken[s.name][0], frame_id=taken[s.name][1] if taken[s.name][2] else "")
        if s.name in taken
        else s
        for s in draft.robot.sensors
    )
    notes = [f"sensor '{s.name}': no topic of the recording has its name" for s in sensors if s.name not in taken]
    notes += [f"topic {topic} (frame_id '{frame_id}') belongs to no sensor" for topic, frame_id, _ in free]
    return replace(draft, robot=replace(draft.robot, sensors=sensors)), notes


def _near(sensor: Sensor, free: Collection[tuple[str, str, bool]], closely: bool) -> tuple[str, str, bool] | None:
    """The source that names a sensor: exactly so, or nearly."""
    names = (sensor.name.lower(), sensor.link.lower())
    for source in free:
        words = [*source[0].lower().strip("/").split("/"), source[1].lower()]
        if any(name in words for name in names):
            return source
    if closely:
        return None
    for source in free:
        text = f"{source[0]} {source[1]}".lower()
        words = re.split(r"[/_ ]", text)
        if any(name in text for name in names) or any(difflib.get_close_matches(name, words, 1, 0.8) for name in names):
            return source
    return None
