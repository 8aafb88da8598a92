"""Messages of a recording to frames, chunk after chunk: to the bit those of `Intake`, in half the time.

Where a chunk holds for every frame one sample of each sensor and one Hall message, nothing of it odd, it is decoded
topic by topic and assembled as a block (`core.frame_block`). Everything else goes message by message through `Intake`,
whose state both carry on.
"""

from __future__ import annotations

import numpy as np

from jointest_ros.bags.cdr import IMU, MAGNETIC_FIELD
from jointest_ros.bags.cdr_arrays import decode_float32_multiarrays, decode_imus
from jointest_ros.bags.intake import Intake
from jointest_ros.core.frame import FloatArray, Frame, Recording
from jointest_ros.core.frame_block import Block, Samples, add_block

Message = tuple[str, int, bytes]  # topic, record time ns, CDR bytes
Stretch = Recording | list[Frame]  # consecutive frames


class ArrayIntake:
    """Turns messages into stretches of frames.

    Args:
        intake: of the robot; its counters and warnings hold for what comes out here as well.
        found: absolute topic -> configured topic, of those that are in the recording.
    """

    def __init__(self, intake: Intake, found: dict[str, str]) -> None:
        self._intake = intake
        self._found = found
        self._sources = {topic: intake.sources(name) for topic, name in found.items()}
        self._usable = len(found) == len(intake.topics) and all(
            len(self._sources[topic]) == 1 and intake.topics[name] != MAGNETIC_FIELD for topic, name in found.items()
        )
        self._like: dict[
            str, bytes
        ] = {}  # the newest sound message that came one by one: those of a block must be like it
        self._numbers = {topic: number for number, topic in enumerate(found)}

    def add(self, messages: list[Message]) -> tuple[list[Stretch], list[Message]]:
        """Take a chunk: the frames that became ready, and what is left of it, to be put before the next one."""
        if not self._usable:
            return self._stretch(self._one_by_one(messages)), []
        frames: list[Frame] = []
        start = 0
        while start < len(messages) and not self._may_begin():
            frames += self._one_by_one(messages[start : start + 1])
            start += 1
        parts = self._stretch(frames)
        rows = (len(messages) - start) // len(self._found)
        if not rows:
            return parts, messages[start:]
        stop = start + rows * len(self._found)
        block = self._block(messages[start:stop])
        recording = None if block is None else add_block(self._intake.assembler, block)
        parts += [recording] if recording is not None else self._stretch(self._one_by_one(messages[start:stop]))
        return parts, messages[stop:]

    def finish(self, messages: list[Message]) -> list[Stretch]:
        """The end: what was left, and the frames that still waited."""
        return self._stretch(self._one_by_one(messages) + self._intake.flush())

    def _may_begin(self) -> bool:
        return len(self._like) == len(self._found) and self._intake.assembler.is_between_frames

    def _one_by_one(self, messages: list[Message]) -> list[Frame]:
        frames: list[Frame] = []
        for topic, time, data in messages:
            received = self._received(topic)
            frames += self._intake.handlers[self._found[topic]](data, time)
            if self._received(topic) > received:
                self._like[topic] = data
        return frames

    def _received(self, topic: str) -> int:
        return sum([source.received for source in self._sources[topic].values()])

    @staticmethod
    def _stretch(frames: list[Frame]) -> list[Stretch]:
        return [frames] if frames else []

    def _block(self, messages: list[Message]) -> Block | None:
        """The messages as one block, if there is one of each topic for every frame and all can be decoded."""
        topics, times, datas = zip(*messages, strict=True)
        width = len(self._found)
        order = np.array([self._numbers[topic] for topic in topics]).reshape(-1, width)
        places = np.argsort(order, axis=1)  # topic -> where it is in its row
        if (np.take_along_axis(order, places, axis=1) != np.arange(width)).any():
            return None
        rows = places + np.arange(0, len(messages), width)[:, None]
        samples: dict[str, Samples] = {}
        hall: FloatArray | None = None
        inertial = []
        for number, (topic, name) in enumerate(self._found.items()):
            same = [self._like[topic], *map(datas.__getitem__, rows[:, number].tolist())]
            if self._intake.topics[name] == IMU:
                decoded = decode_imus(same)
                if decoded is None:
                    return None
                (sensor,) = self._sources[topic]
                stamps, _, gyro, accel = decoded
                samples[sensor] = Samples(stamps[1:], gyro[1:], accel[1:])
                inertial.append(number)
            else:
                arrays = decode_float32_multiarrays(same)
                if arrays is None:
                    return None
                hall = arrays[0][1:]
                hall_number = number
        arrivals = np.array(times, dtype=np.int64).reshape(-1, width)
        first = places[:, inertial].min(axis=1)
        return Block(samples, arrivals, first, None if hall is None else (hall, places[:, hall_number]))
