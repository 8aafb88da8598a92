"""Which stream of a recording is which sensor of a configuration, and where the two do not fit."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence

from jointest_ros.bags.cdr import FLOAT32_MULTIARRAY, IMU, MAGNETIC_FIELD
from jointest_ros.bags.intake import HALL_TOPIC
from jointest_ros.bags.reader import absolute_name
from jointest_ros.bags.survey import Survey
from jointest_ros.core.errors import counted
from jointest_ros.core.robot import Robot, Sensor
from jointest_ros.evaluation.inspection.findings import LOOK, WRONG, Finding
from jointest_ros.evaluation.inspection.stream import Stream


def match(survey: Survey, robot: Robot, namespace: str) -> tuple[dict[str, Stream], list[Finding]]:
    """(stream by sensor, findings) for the inertial sensors of a robot; relative topics are meant in `namespace`."""
    streams: dict[str, Stream] = {}
    findings: list[Finding] = []
    wanted = [sensor for sensor in robot.sensors if sensor.gyro or sensor.accel]
    taken = {absolute_name(sensor.topic, namespace) for sensor in wanted}
    free = [topic for topic, (kind, _) in survey.topics.items() if kind == IMU and topic not in taken]
    missing = [sensor for sensor in wanted if absolute_name(sensor.topic, namespace) not in survey.topics]
    if missing and len(missing) == len(wanted) and (prefix := _namespace(survey, missing)):
        text = f"no topic of the configuration is in the recording, but all of them are under '{prefix}'"
        return {}, [Finding(WRONG, "topics", "topic", text, f"give --namespace {prefix}, and start the node in it")]
    for sensor in wanted:
        topic = absolute_name(sensor.topic, namespace)
        if sensor in missing:
            findings.append(_missing(sensor, topic, free, survey))
        elif survey.topics[topic][0] != IMU:
            text = f"topic '{topic}' is of type {survey.topics[topic][0]}, not {IMU}"
            findings.append(Finding(WRONG, sensor.name, "topic", text, "mend topic:"))
        else:
            own = [stream for stream in survey.streams if stream.topic == topic]
            findings += _choose(sensor, topic, own, streams)
    claimed = {(stream.topic, stream.frame_id) for stream in streams.values()}
    for topic in free:
        messages = counted(survey.topics[topic][1], "message")
        text = f"topic '{topic}' ({messages}) belongs to no sensor of the configuration"
        findings.append(Finding(LOOK, topic, "unused", text, "add a sensor with this topic:, or ignore it"))
    for stream in survey.streams:
        if stream.topic in taken and (stream.topic, stream.frame_id) not in claimed:
            text = f"frame_id '{stream.frame_id}' on '{stream.topic}' belongs to no sensor of the configuration"
            findings.append(
                Finding(LOOK, stream.topic, "unused", text, "add a sensor with this frame_id:, or ignore it")
            )
    findings += [*_mags(survey, robot, namespace), *_hall(survey, robot, namespace)]
    return streams, findings


def match_fields(survey: Survey, robot: Robot, namespace: str) -> dict[str, Stream]:
    """Readings of the magnetometers by sensor, where there are any; their frame_id is not looked at, as in a node."""
    fields: dict[str, Stream] = {}
    for sensor in robot.sensors:
        own = [s for s in survey.fields if s.topic == absolute_name(sensor.mag_topic, namespace)] if sensor.mag else []
        if own:
            fields[sensor.name] = max(own, key=len)
    return fields


def _namespace(survey: Survey, sensors: Sequence[Sensor]) -> str:
    """The one namespace in which all of the relative topics are; "" where there is none."""
    if any(sensor.topic.startswith("/") for sensor in sensors):
        return ""
    ending = f"/{sensors[0].topic}"
    prefixes = [topic.removesuffix(ending) for topic in survey.topics if topic.endswith(ending)]
    found = [p for p in prefixes if p and all(absolute_name(s.topic, p) in survey.topics for s in sensors)]
    return found[0] if len(found) == 1 else ""


def _missing(sensor: Sensor, topic: str, free: Sequence[str], survey: Survey) -> Finding:
    text = f"topic '{topic}' is not in the recording"
    near = difflib.get_close_matches(topic, free, n=1)
    if near or len(free) == 1:
        action = f"did you mean topic: {(near or list(free))[0]} ?"
    elif free:
        action = f"topics of {IMU} that no sensor has: {', '.join(free)}"
    else:
        imus = [name for name, (kind, _) in survey.topics.items() if kind == IMU]
        action = f"record it; {'there is ' + ', '.join(imus) if imus else f'there is no topic of {IMU} at all'}"
    return Finding(WRONG, sensor.name, "topic", text, action)


def _choose(sensor: Sensor, topic: str, own: Sequence[Stream], streams: dict[str, Stream]) -> Iterator[Finding]:
    """Put the stream of a sensor into `streams`."""
    ids = [stream.frame_id for stream in own]
    if sensor.frame_id and sensor.frame_id not in ids:
        listed = ", ".join(f"'{one}'" for one in ids) or "none"
        text = f"no message on '{topic}' has the frame_id '{sensor.frame_id}'; there is: {listed}"
        yield Finding(
            WRONG, sensor.name, "frame_id", text, "mend frame_id:, or leave it out where the topic has one sensor"
        )
        return
    if not sensor.frame_id and len(ids) > 1:
        text = f"'{topic}' has messages of {', '.join(repr(one) for one in ids)}: several sensors on one topic?"
        yield Finding(WRONG, sensor.name, "frame_id", text, "give each its frame_id:")
    chosen = [stream for stream in own if not sensor.frame_id or stream.frame_id == sensor.frame_id]
    if not chosen:
        yield Finding(WRONG, sensor.name, "topic", f"no message on '{topic}' can be read", "is its driver running?")
        return
    streams[sensor.name] = max(chosen, key=len)


def _mags(survey: Survey, robot: Robot, namespace: str) -> Iterator[Finding]:
    for sensor in robot.sensors:
        topic = absolute_name(sensor.mag_topic, namespace)
        if sensor.mag and survey.topics.get(topic, ("", 0))[0] != MAGNETIC_FIELD:
            text = f"topic '{topic}' of {MAGNETIC_FIELD} is not in the recording"
            yield Finding(WRONG, sensor.name, "topic", text, "mend mag_topic:, or mag: false")


def _hall(survey: Survey, robot: Robot, namespace: str) -> Iterator[Finding]:
    if not robot.hall:
        return
    topic = absolute_name(HALL_TOPIC, namespace)
    if survey.topics.get(topic, ("", 0))[0] != FLOAT32_MULTIARRAY:
        others = [name for name, (kind, _) in survey.topics.items() if kind == FLOAT32_MULTIARRAY]
        hint = f"; there is {', '.join(others)}: remap it" if others else ""
        text = f"topic '{topic}' of {FLOAT32_MULTIARRAY} is not in the recording{hint}"
        yield Finding(WRONG, "hall", "topic", text, "record it, or leave hall: out")
    elif survey.hall is not None and survey.hall[1].shape[1] != len(robot.hall):
        voltages, sensors = counted(survey.hall[1].shape[1], "voltage"), counted(len(robot.hall), "sensor")
        text = f"messages have {voltages}, the configuration {sensors} under hall:"
        yield Finding(WRONG, "hall", "length", text, "list every place, one without sensor too (NaN)")
