"""From the bytes of messages to frames: one path for nodes and recordings, so that both give the same numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

from jointest_ros.bags.cdr import (
    FLOAT32_MULTIARRAY,
    IMU,
    MAGNETIC_FIELD,
    Dims,
    decode_float32_multiarray,
    decode_imu,
    decode_magnetic_field,
)
from jointest_ros.bags.errors import CdrError
from jointest_ros.bags.typestore import decoded
from jointest_ros.core.assembler import FrameAssembler
from jointest_ros.core.assembler_inputs import Source
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import Frame
from jointest_ros.core.input_quality import gyro_of
from jointest_ros.core.robot import Robot, Sensor
from jointest_ros.core.timing import Timing

HALL_TOPIC = "hall_voltages"

_MOST_LAYOUTS = 16

Handler = Callable[[bytes, int], list[Frame]]  # CDR bytes, arrival or record time ns -> frames that became ready


class Intake:
    """Decodes the messages of a robot's sensors and assembles them.

    Attributes:
        topics: topic name as configured (relative) -> message type.
        handlers: topic name -> what takes its messages. A handler never raises: what it refuses is counted.
        assembler: with the counters of every sensor.

    Raises:
        ConfigurationError: a sensor has the topic of the Hall voltages.
    """

    def __init__(self, robot: Robot, timing: Timing) -> None:
        self.assembler = FrameAssembler(robot.sensors, timing, len(robot.hall))
        self.topics: dict[str, str] = {}
        self.handlers: dict[str, Handler] = {}
        self._refused: dict[str, Counter[str]] = {}
        self._sources: dict[str, list[Source]] = {}
        self._sensors: dict[str, list[str]] = {}  # topic -> whose samples it brings
        self._accels: dict[str, list[str]] = {}  # topic -> its accelerometers
        imus: dict[str, list[Sensor]] = {}
        for sensor in robot.sensors:
            if sensor.gyro or sensor.accel:
                imus.setdefault(sensor.topic, []).append(sensor)
        for topic, sensors in imus.items():
            # an empty frame id stands for any; `Robot` sees to it that it is then the only one
            self._add(topic, IMU, self._imu_handler(topic, {sensor.frame_id: sensor.name for sensor in sensors}))
            self._sources[topic] = [self.assembler.sources[sensor.name] for sensor in sensors]
            self._sensors[topic] = [sensor.name for sensor in sensors]
            self._accels[topic] = [sensor.name for sensor in sensors if sensor.accel]
        for sensor in robot.sensors:
            if sensor.mag:
                self._add(sensor.mag_topic, MAGNETIC_FIELD, self._mag_handler(sensor))
                self._sources[sensor.mag_topic] = [self.assembler.mag_sources[sensor.name]]
                self._sensors[sensor.mag_topic] = [sensor.name]
        if robot.hall:
            self._add(HALL_TOPIC, FLOAT32_MULTIARRAY, self._hall_handler(robot))
            self._sources[HALL_TOPIC] = [self.assembler.hall_source]
            self._sensors[HALL_TOPIC] = ["hall"]

    def counts(self, topic: str) -> dict[str, Any]:
        """`messages`, `used` and `refused` by cause of one topic; after `flush`, messages = used + refused."""
        refused = Counter(self._refused[topic])
        messages, used = refused.total(), 0
        for source in self._sources[topic]:
            refused.update(source.refused)
            messages += source.received
            used += source.used
        return {"messages": messages, "used": used, "refused": dict(refused)}

    def sources(self, topic: str) -> dict[str, Source]:
        """Sensor -> what it delivered on one topic; the Hall voltages are one sensor, "hall"."""
        return dict(zip(self._sensors[topic], self._sources[topic], strict=True))

    def findings(self, topic: str) -> list[str]:
        """What is wrong with the accelerometers of one topic now, though their samples are sound."""
        return [text for sensor in self._accels.get(topic, ()) for text in self.assembler.quality.findings(sensor)]

    def saturated(self, topic: str) -> dict[str, int]:
        """Number of saturated samples of the accelerometers (by sensor) and gyros (`gyro_of` the sensor) of one topic.

        Only those of known full scale.
        """
        counts = self.assembler.quality.saturated
        both = [what for sensor in self._sensors[topic] for what in (sensor, gyro_of(sensor))]
        return {what: counts[what] for what in both if what in counts}

    def warnings(self) -> list[str]:
        """What was wrong with accelerometers and gyros in all that was received, a line each."""
        received = {sensor: source.received for sensor, source in self.assembler.sources.items()}
        return list(self.assembler.quality.summary(received))

    def flush(self) -> list[Frame]:
        """The end of the stream: the frames that still waited."""
        return self.assembler.flush()

    # ---------------------------------------------------------------- handlers

    def _add(self, topic: str, msgtype: str, handler: Handler) -> None:
        if topic in self.topics:
            raise ConfigurationError(f"sensors: the topic '{topic}' is that of the Hall voltages; give another one")
        self.topics[topic], self.handlers[topic] = msgtype, handler
        self._refused[topic] = Counter()

    def _imu_handler(self, topic: str, sensors: dict[str, str]) -> Handler:
        add = self.assembler.add_imu
        anyone = sensors.get("")

        def handle(data: bytes, arrival: int) -> list[Frame]:
            decoded = self._decode(topic, IMU, decode_imu, data)
            if decoded is None:
                return []
            stamp, frame_id, gyro, accel = decoded
            sensor = anyone or sensors.get(frame_id)
            if sensor is None:
                self._refused[topic]["unknown frame_id"] += 1
                return []
            return add(sensor, stamp, gyro, accel, arrival)

        return handle

    def _mag_handler(self, sensor: Sensor) -> Handler:
        def handle(data: bytes, _arrival: int) -> list[Frame]:
            decoded = self._decode(sensor.mag_topic, MAGNETIC_FIELD, decode_magnetic_field, data)
            if decoded is not None:
                stamp, _, field = decoded
                self.assembler.add_mag(sensor.name, stamp, field)
            return []

        return handle

    def _hall_handler(self, robot: Robot) -> Handler:
        joints, width = len({hall.joint for hall in robot.hall}), len(robot.hall)
        layouts = {(), (width,), (joints, width // joints)}
        sound: set[Dims] = {()}  # those that came

        def handle(data: bytes, arrival: int) -> list[Frame]:
            decoded = self._decode(HALL_TOPIC, FLOAT32_MULTIARRAY, decode_float32_multiarray, data)
            if decoded is None:
                return []
            voltages, dims = decoded
            if dims not in sound and len(voltages) == width:  # another length is counted as such
                labels, sizes = zip(*dims, strict=True)
                if sizes not in layouts or labels == ("sensor", "joint"):
                    self._refused[HALL_TOPIC]["wrong layout"] += 1
                    return []
                if len(sound) < _MOST_LAYOUTS:  # labels may be anything
                    sound.add(dims)
            return self.assembler.add_hall(voltages, arrival)

        return handle

    def _decode(self, topic: str, msgtype: str, decode: Callable[[bytes], Any], data: bytes) -> Any:
        try:
            return decoded(decode, data, msgtype)
        except CdrError:
            self._refused[topic]["undecodable"] += 1
            return None
