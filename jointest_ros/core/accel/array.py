"""Arrays of accelerometers on the two links of a joint, seen in its plane of motion (Woods & Vikas, section II).

Link a is the parent, link b the child, O the joint. In the axes of its link an accelerometer at r reads

    a_i = a_O + D(r_i) y,    y = [w^2, alpha],    D(r) = [[-r1, -r2], [-r2, r1]]                            (1), (2)

with a_O the specific force at O (gravity changes nothing), w and alpha the link's angular velocity and acceleration
about +axis. The joint position is that of the child relative to the parent: the negative of the paper's th_ab.

Channels are ordered as in the paper: x and y of each sensor of a, then of b: [a1x, a1y, a2x, ..., b1x, b1y, ...].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.rotation import rotate_inverse

COINCIDENT = 1e-4  # m: sensors nearer than this to their mean are at the same place


def lever(position: ArrayLike) -> FloatArray:
    """D(r) of equation (2), (..., 2, 2), for positions (..., 2), m."""
    r = np.asarray(position, dtype=float)
    x, y = r[..., 0], r[..., 1]
    return np.stack([np.stack([-x, -y], axis=-1), np.stack([-y, x], axis=-1)], axis=-2)


def array_matrices(positions: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """G and F of equations (5) to (9): [w^2, alpha] = G a and a_O = F a for the channels a (2N,) of one link.

    Exact for any N >= 2 sensors that do not coincide, on a line through the joint or not.

    Args:
        positions: (N, 2), m, from the joint, in the plane of motion.

    Returns:
        G (2, 2N), 1/m, rows w^2 and alpha; F (2, 2N).

    Raises:
        ConfigurationError: fewer than two sensors, or all at the same place: D~ has no rank.
    """
    r = np.asarray(positions, dtype=float)
    number, mean = len(r), r.mean(axis=0)
    if number < 2:
        raise ConfigurationError(f"{number} accelerometer on a link; angular acceleration needs two, apart")
    if np.linalg.norm(r - mean, axis=1).max() < COINCIDENT:
        raise ConfigurationError(
            "the accelerometers of a link coincide in the plane of motion; angular acceleration needs two, apart"
        )
    mean_of = np.tile(np.eye(2), number) / number  # F_m
    from_mean = np.eye(2 * number) - np.tile(mean_of, (number, 1))  # E
    g = np.linalg.pinv(lever(r - mean).reshape(2 * number, 2)) @ from_mean
    return g, mean_of + lever(-mean) @ g


def plane(axis: Vec3) -> FloatArray:
    """(2, 3): two unit vectors as rows that span the plane across `axis`; first x second = axis. About z: x and y."""
    n = np.array(axis)
    first = np.roll(np.eye(3)[np.argmax(np.abs(n))], 1)
    first = first - n * (n @ first)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(n, first)])


@dataclass(frozen=True, eq=False)
class LinkArray:
    """The N accelerometers of one link.

    Attributes:
        sensors: (N) of them.
        positions: (N, 2), m, from the joint, in the plane of motion.
        projections: (N, 2, 3): a reading in its sensor's frame to the plane of motion, in the axes of the link.
    """

    sensors: tuple[Sensor, ...]
    positions: FloatArray
    projections: FloatArray


@dataclass(frozen=True, eq=False)
class JointArrays:
    """A joint with its two arrays; `names` are the sensors in the order of the channels, those of the parent first."""

    joint: Joint
    parent: LinkArray
    child: LinkArray

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """In the order of the channels."""
        return (*self.parent.sensors, *self.child.sensors)

    @property
    def positions(self) -> FloatArray:
        """(Na + Nb, 2), m, in the order of the channels."""
        return np.concatenate([self.parent.positions, self.child.positions])

    @property
    def projections(self) -> FloatArray:
        """(Na + Nb, 2, 3), in the order of the channels."""
        return np.concatenate([self.parent.projections, self.child.projections])

    def channels(self, readings: FloatArray) -> FloatArray:
        """(..., 2 (Na + Nb)) m/s^2, from readings (..., Na + Nb, 3) in sensor frames; NaN stays NaN."""
        in_plane = np.einsum("nij,...nj->...ni", self.projections, readings)
        return in_plane.reshape(*readings.shape[:-2], -1)


def joint_arrays(robot: Robot) -> tuple[JointArrays, ...]:
    """Every one-axis joint with at least two accelerometers on either link, parents before children.

    Raises:
        ConfigurationError: there is none (the reason for the first joint), or an array's sensors coincide.
    """
    found, reason = [], "robot: no joints"
    for joint in robot.ordered_joints:
        if len(joint.axes) != 1:
            reason = f"joint '{joint.name}': {len(joint.axes)} axes; accelerometer arrays need one"
            continue
        if joint.roll_link is not None:
            reason = f"joint '{joint.name}': rolls; accelerometer arrays need a joint with one centre"
            continue
        links = (joint.parent, joint.origin), (joint.child, (0.0, 0.0, 0.0))
        arrays = [_link_array(robot, link, origin, joint.axes[0]) for link, origin in links]
        few = [link for (link, _), array in zip(links, arrays, strict=True) if len(array.sensors) < 2]
        if few:
            reason = f"joint '{joint.name}': link '{few[0]}' has fewer than two accelerometers; give two, apart"
            continue
        for (link, _), array in zip(links, arrays, strict=True):
            try:
                array_matrices(array.positions)
            except ConfigurationError as error:
                names = ", ".join(sensor.name for sensor in array.sensors)
                raise ConfigurationError(f"joint '{joint.name}': link '{link}' ({names}): {error}") from None
        found.append(JointArrays(joint, *arrays))
    if not found:
        raise ConfigurationError(reason)
    return tuple(found)


def _link_array(robot: Robot, link: str, origin: Vec3, axis: Vec3) -> LinkArray:
    sensors = tuple(sensor for sensor in robot.sensors_on(link) if sensor.accel)
    across = plane(axis)
    positions = np.array([sensor.position for sensor in sensors]).reshape(-1, 3) - np.array(origin)
    # mounting applied to a reading, then the rows of the plane: the rows, turned into the sensor's frame
    rows = [[rotate_inverse(sensor.mounting, (x, y, z)) for x, y, z in across.tolist()] for sensor in sensors]
    projections = np.array(rows).reshape(-1, 2, 3)
    return LinkArray(sensors, positions @ across.T, projections)
