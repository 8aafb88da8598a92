"""The robot as a kinematic tree of links and joints, and the sensors that sit on its links.

All link frames coincide in orientation at the zero pose, so that a joint axis has the same components in both of its
links; what is not aligned is a sensor's `mounting`. A joint position is the child relative to the parent about +axis.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

from jointest_ros.core.errors import ConfigurationError, did_you_mean
from jointest_ros.core.frame import Quat, Vec3
from jointest_ros.core.hall_sensor import HallSensor
from jointest_ros.core.learned import Learned
from jointest_ros.core.rotation import IDENTITY, dot, norm

STANDARD_GRAVITY = 9.80665  # m/s^2
UNCALIBRATED_MATRIX = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
UNCALIBRATED_SCALE = (1.0, 1.0, 1.0)
_PARALLEL = 0.9999  # cosine: 0.8 deg apart


@dataclass(frozen=True)
class Joint:
    """Succession of one to three revolutes between two links, in the listed order.

    Attributes:
        name: of the joint; its coordinates are `name`, or `name_x`, `name_y`, ... when there is more than one axis.
        axes: unit vectors, equal in parent and child frame at the zero pose; successive ones are not parallel.
        origin: of the joint in the parent frame, m; the origin of the child frame is there too.
        limits: lowest and highest position of each coordinate, rad, or None where unknown.
        continuous: positions are equal modulo 2 pi (errors are wrapped).
        roll_link: of a roll-articular (Hillberry) joint, two equal cylinders that roll on each other: from the axis of
            the parent's to that of the child's at the zero pose, m. It is two revolutes of half the position each, with
            this virtual link between them; the origin of the child frame is on the second. None: a plain revolute.
        names: of the coordinates, one an axis; (): as said at `name`.
    """

    name: str
    parent: str
    child: str
    axes: tuple[Vec3, ...]
    limits: tuple[tuple[float, float], ...] | None = None
    continuous: bool = False
    origin: Vec3 = (0.0, 0.0, 0.0)
    roll_link: Vec3 | None = None
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        where, number = f"joint '{self.name}'", len(self.axes)
        if not 1 <= number <= 3:
            raise ConfigurationError(f"{where}.axes: {number} are not allowed; give one to three axes")
        for axis in self.axes:
            if not abs(norm(axis) - 1.0) < 1e-6:
                raise ConfigurationError(f"{where}.axes: {axis} is not allowed; its length must be 1")
        for one, other in pairwise(self.axes):
            if abs(dot(one, other)) > _PARALLEL:
                raise ConfigurationError(f"{where}.axes: {one} and {other} are parallel; turns about them are one turn")
        if self.names and len(self.names) != number:
            raise ConfigurationError(f"{where}.names: {list(self.names)} is not allowed; give one for each axis")
        if self.limits is not None and len(self.limits) != number:
            raise ConfigurationError(f"{where}.limits: {self.limits} is not allowed; give (low, high) for each axis")
        if self.roll_link is not None and (number > 1 or abs(dot(self.roll_link, self.axes[0])) > 1e-6):
            raise ConfigurationError(
                f"{where}.roll_link: {self.roll_link} is not allowed; rolling joints have one axis, perpendicular to it"
            )

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the joint positions, one an axis: by letter, or by number where it has none or they repeat."""
        if self.names:
            return self.names
        if len(self.axes) == 1:
            return (self.name,)
        numbers = [str(number) for number, _ in enumerate(self.axes, 1)]
        letters = [_axis_letter(axis) or number for axis, number in zip(self.axes, numbers, strict=True)]
        if len(set(letters)) < len(letters):
            letters = numbers
        return tuple(f"{self.name}_{letter}" for letter in letters)


@dataclass(frozen=True)
class Sensor:
    """An inertial sensor on a link. Noise figures are those of the data sheet, in SI.

    Attributes:
        link: the link that it is fixed to.
        position: of the sensor in the link frame, m.
        mounting: rotation sensor frame to link frame, quaternion x, y, z, w.
        gyro, accel, mag: which of its fields are in use; only these are checked.
        gyro_noise: white noise density, rad/s/sqrt(Hz).
        gyro_bias_walk: random walk of the gyro bias, rad/s/sqrt(s).
        accel_noise: white noise density, m/s^2/sqrt(Hz).
        gyro_range, accel_range: full scale, rad/s and m/s^2; infinity where unknown.
        accel_matrix, accel_offset: calibration: acceleration = matrix reading + offset (m/s^2), in the sensor frame;
            the assembler applies it.
        gyro_scale: calibration: rate = scale times reading of each axis, in the sensor frame; applied there too.
        delay: how long after the measurement the sensor's filter delivers it (group delay of the data sheet), s; the
            assembler subtracts it from the stamps, so that estimates are stamped by when they were true.
        topic, mag_topic: names of its Imu and MagneticField topics; imu/<name> and mag/<name> unless given.
        frame_id: when set, only messages with this frame id are this sensor's (several sensors on one topic).
    """

    name: str
    link: str
    position: Vec3 = (0.0, 0.0, 0.0)
    mounting: Quat = IDENTITY
    gyro: bool = True
    accel: bool = True
    mag: bool = False
    gyro_noise: float = math.radians(0.005)
    gyro_bias_walk: float = math.radians(0.001)
    accel_noise: float = 400e-6 * STANDARD_GRAVITY
    gyro_range: float = math.inf
    accel_range: float = math.inf
    accel_matrix: tuple[Vec3, Vec3, Vec3] = UNCALIBRATED_MATRIX
    accel_offset: Vec3 = (0.0, 0.0, 0.0)
    gyro_scale: Vec3 = UNCALIBRATED_SCALE
    delay: float = 0.0
    topic: str = ""
    mag_topic: str = ""
    frame_id: str = ""

    @property
    def accel_calibrated(self) -> bool:
        """Readings of the accelerometer are to be corrected."""
        return self.accel_matrix != UNCALIBRATED_MATRIX or self.accel_offset != (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "topic", self.topic or f"imu/{self.name}")
        object.__setattr__(self, "mag_topic", self.mag_topic or f"mag/{self.name}")


@dataclass(frozen=True)
class Robot:
    """Links, joints and sensors. Made once, checked when made. `hall` has the order of the voltages in `Frame.hall`.

    Attributes:
        world: the link that stands still with its z axis up, or "". It needs no sensor: the angles of joints from it
            are those of the child relative to gravity, and, about gravity, relative to the start.
        learned: estimator -> what it found out in an earlier run, from which it starts.

    Raises:
        ConfigurationError: a joint or sensor names an unknown link, a link has two parents, a joint closes a loop, a
            Hall sensor names an unknown joint coordinate, sensors share a topic and cannot be told apart, the world
            link is unknown, has a parent or a sensor.
    """

    links: tuple[str, ...]
    joints: tuple[Joint, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    name: str = "robot"
    hall: tuple[HallSensor, ...] = ()
    world: str = ""
    learned: Mapping[str, Learned] = field(default_factory=dict, hash=False)
    _by_name: dict[str, Sensor] = field(init=False, repr=False, compare=False, default_factory=dict)

    def __post_init__(self) -> None:
        _no_repetition("links", self.links)
        _no_repetition("joints", [joint.name for joint in self.joints])
        _no_repetition("joint coordinates", self.coordinates)
        _no_repetition("sensors", [sensor.name for sensor in self.sensors])
        parent_of: dict[str, str] = {}
        for joint in self.joints:
            self._known_link(joint.parent, f"joint '{joint.name}'.parent")
            self._known_link(joint.child, f"joint '{joint.name}'.child")
            if joint.child in parent_of:
                raise ConfigurationError(
                    f"joint '{joint.name}'.child: '{joint.child}' has the parent '{parent_of[joint.child]}' already; "
                    "a link has one parent"
                )
            ancestor: str | None = joint.parent
            while ancestor is not None:
                if ancestor == joint.child:
                    raise ConfigurationError(
                        f"joint '{joint.name}'.child: '{joint.child}' is its own ancestor; joints must form a tree"
                    )
                ancestor = parent_of.get(ancestor)
            parent_of[joint.child] = joint.parent
        for sensor in self.sensors:
            self._known_link(sensor.link, f"sensor '{sensor.name}'.link")
            self._by_name[sensor.name] = sensor
        if self.world:
            self._known_link(self.world, "world")
            if self.world in parent_of:
                raise ConfigurationError(
                    f"world: '{self.world}' moves on '{parent_of[self.world]}'; the world link has no parent"
                )
            if on_world := self.sensors_on(self.world):
                raise ConfigurationError(
                    f"sensor '{on_world[0].name}'.link: '{self.world}' is the world, which stands still; "
                    "sensors belong on links that move"
                )
        self._check_topics()
        for number, hall in enumerate(self.hall):
            if hall.joint not in self.coordinates:
                raise ConfigurationError(
                    f"hall[{number}].joint: '{hall.joint}' is no joint coordinate; "
                    f"{_known(hall.joint, self.coordinates)}"
                )

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Names of all joint positions in the order of the configuration."""
        return tuple(name for joint in self.joints for name in joint.coordinates)

    @cached_property
    def ordered_joints(self) -> tuple[Joint, ...]:
        """Joints with every parent before its children."""
        children = {joint.child for joint in self.joints}
        roots = [link for link in self.links if link not in children]
        return tuple(joint for root in roots for joint in self.joints_below(root))

    def joints_below(self, link: str) -> Iterator[Joint]:
        """The joints that carry what hangs on `link`, every parent before its children."""
        for joint in self.joints:
            if joint.parent == link:
                yield joint
                yield from self.joints_below(joint.child)

    def sensor(self, name: str) -> Sensor:
        """The sensor of that name. Raises ConfigurationError when there is none."""
        if name not in self._by_name:
            raise ConfigurationError(f"sensor '{name}': unknown; {_known(name, list(self._by_name))}")
        return self._by_name[name]

    def sensors_on(self, link: str) -> tuple[Sensor, ...]:
        """The sensors of one link in the order of the configuration."""
        return tuple(sensor for sensor in self.sensors if sensor.link == link)

    def _check_topics(self) -> None:
        """Several IMUs may be on one topic when each has a frame id; magnetometers have topics of their own."""
        taken: list[tuple[str, str, str]] = []
        for sensor in self.sensors:
            inputs = [(sensor.topic, sensor.frame_id)] if sensor.gyro or sensor.accel else []
            inputs += [(sensor.mag_topic, "")] if sensor.mag else []
            for topic, frame_id in inputs:
                for other, other_topic, other_id in taken:
                    if topic == other_topic and (not frame_id or not other_id or frame_id == other_id):
                        raise ConfigurationError(
                            f"sensor '{sensor.name}'.topic: '{topic}' is that of '{other}' too; "
                            "give each a topic or a frame_id of its own"
                        )
                taken.append((sensor.name, topic, frame_id))

    def _known_link(self, link: str, where: str) -> None:
        if link not in self.links:
            raise ConfigurationError(f"{where}: '{link}' is not a link; {_known(link, self.links)}")


def _known(name: str, names: Sequence[str]) -> str:
    return did_you_mean(name, names, f"known: {', '.join(names) or 'none'}")


def _no_repetition(what: str, names: Sequence[str]) -> None:
    for name in names:
        if list(names).count(name) > 1:
            raise ConfigurationError(f"{what}: '{name}' is given twice; names must differ")


def _axis_letter(axis: Vec3) -> str:
    for letter, component in zip("xyz", axis, strict=True):
        if abs(component) == 1.0:
            return letter
    return ""
