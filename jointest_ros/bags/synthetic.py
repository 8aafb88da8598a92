"""Simulated recordings as the messages that the hardware would send, for bags and for the simulated hardware node."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from jointest_ros.bags.cdr import FLOAT32_MULTIARRAY, IMU, JOINT_STATE, MAGNETIC_FIELD
from jointest_ros.bags.cdr_encode import ImuEncoder, JointStateEncoder, encode_float32_multiarray, encode_magnetic_field
from jointest_ros.bags.ground_truth import TRUTH_JOINTS
from jointest_ros.bags.intake import HALL_TOPIC
from jointest_ros.bags.writer import BagWriter
from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.robot import Robot, Sensor
from jointest_ros.sim.simulated import SimulatedRobot

FIRST_STAMP = 1_000_000_000  # ns, added to the model's time: a zero stamp means "not set" to many a receiver

Message = tuple[int, str, bytes]  # stamp ns (also its record time), topic as configured, CDR bytes


def topics(robot: Robot) -> dict[str, str]:
    """Topic -> message type of all that `messages` yields for this robot."""
    table = {sensor.topic: IMU for sensor in robot.sensors if sensor.gyro or sensor.accel}
    table |= {sensor.mag_topic: MAGNETIC_FIELD for sensor in robot.sensors if sensor.mag}
    if robot.hall:
        table[HALL_TOPIC] = FLOAT32_MULTIARRAY
    return {**table, TRUTH_JOINTS: JOINT_STATE}


def messages_a_frame(robot: Robot) -> int:
    """How many messages there are for each stamp; several sensors may have one topic."""
    imus = sum(sensor.gyro or sensor.accel for sensor in robot.sensors)
    return imus + sum(sensor.mag for sensor in robot.sensors) + bool(robot.hall) + 1


def messages(stretches: Iterable[SimulatedRobot]) -> Iterator[Message]:
    """The messages of consecutive stretches of one simulation, in the order of their stamps."""
    for simulated in stretches:
        recording = simulated.recording
        rate = 1.0 / float(recording.period[0]) if recording.period is not None else 1.0
        imus = [sensor for sensor in simulated.robot.sensors if sensor.gyro or sensor.accel]
        columns = [_imu_column(sensor, simulated, rate) for sensor in imus]
        columns += [_mag_column(sensor, recording.mag[sensor.name]) for sensor in simulated.robot.sensors if sensor.mag]
        if recording.hall is not None:
            columns.append(_hall_column(simulated.robot, recording.hall))
        columns.append(_truth_column(simulated))
        for k, stamp in enumerate((recording.stamps + FIRST_STAMP).tolist()):
            for topic, encode in columns:
                yield stamp, topic, encode(k, stamp)


def write(
    writer: BagWriter,
    robot: Robot,
    stretches: Iterable[SimulatedRobot],
    report: Callable[[int], None] = lambda done: None,
) -> None:
    """Write a simulation of `robot` into an open recording, truth included; `report` is told how many messages."""
    absolute = {topic: f"/{topic.lstrip('/')}" for topic in topics(robot)}
    for topic, msgtype in topics(robot).items():
        writer.add_topic(absolute[topic], msgtype, "reliable" if msgtype == JOINT_STATE else "sensor")
    for done, (stamp, topic, data) in enumerate(messages(stretches)):
        writer.write(absolute[topic], stamp, data)
        if done % 10000 == 0:
            report(done)


_Column = tuple[str, Callable[[int, int], bytes]]  # topic, (row, stamp) -> CDR bytes


def _imu_column(sensor: Sensor, simulated: SimulatedRobot, rate_hz: float) -> _Column:
    """The variances are those of one sample: density squared times the rate."""
    encoder = ImuEncoder(
        sensor.frame_id or sensor.name,
        sensor.gyro_noise**2 * rate_hz if sensor.gyro else None,
        sensor.accel_noise**2 * rate_hz if sensor.accel else None,
    )
    nothing = [(float("nan"),) * 3] * len(simulated.recording)
    gyro = simulated.recording.gyro[sensor.name].tolist() if sensor.gyro else nothing
    accel = simulated.recording.accel[sensor.name].tolist() if sensor.accel else nothing
    return sensor.topic, lambda k, stamp: encoder.encode(stamp, gyro[k], accel[k])


def _mag_column(sensor: Sensor, field: FloatArray) -> _Column:
    rows: list[Vec3] = [(x, y, z) for x, y, z in field.tolist()]
    return sensor.mag_topic, lambda k, stamp: encode_magnetic_field(stamp, sensor.frame_id or sensor.name, rows[k])


def _hall_column(robot: Robot, voltages: FloatArray) -> _Column:
    number, joints = len(robot.hall), len({hall.joint for hall in robot.hall})
    dims: tuple[tuple[str, int], ...] = (("joint", joints), ("sensor", number // joints))
    if number % joints:  # no rectangle
        dims = (("sensor", number),)
    rows = voltages.tolist()
    return HALL_TOPIC, lambda k, _stamp: encode_float32_multiarray(rows[k], dims)


def _truth_column(simulated: SimulatedRobot) -> _Column:
    encoder = JointStateEncoder(simulated.joint_names)
    position, velocity = simulated.truth_position.tolist(), simulated.truth_velocity.tolist()
    return TRUTH_JOINTS, lambda k, stamp: encoder.encode(stamp, position[k], velocity[k])
