"""Joints from the world link, which stands still with z up: the child's IMU alone tells their angles.

A joint of three axes takes them from Algorithm 1 on that IMU, in every formulation. What is not about gravity is
absolute, also after a calibration of the zero pose. The angle about gravity is the integrated gyro since the start or
the latest zero pose; it is flagged UNOBSERVABLE and has the variance

    N^2 t + (bias_std t)^2        N: gyro noise density; bias_std: of its bias; see angle_variance.py

With magnetometers it is absolute too: y of the world is north. Joints of one axis need no filter of their own: they see
a parent that does not turn and reads +g upward.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jointest_ros.core.frame import Frame, Quat, Recording, Status, Vec3
from jointest_ros.core.pcf.absolute import AbsolutePair
from jointest_ros.core.pcf.attitude import STILL, Gains, joint_angles
from jointest_ros.core.pcf.imu import AbsoluteImu, Gaps
from jointest_ros.core.pcf.pair import JointOutput
from jointest_ros.core.pcf.settings import BiasNoise
from jointest_ros.core.robot import STANDARD_GRAVITY, Joint, Sensor
from jointest_ros.core.rotation import about, multiply, rotate_inverse

UPWARD: Vec3 = (0.0, 0.0, STANDARD_GRAVITY)
_UNOBSERVABLE = int(Status.UNOBSERVABLE)
_VERTICAL = 0.999999  # cosine


def world_sensor(link: str) -> Sensor:
    """The IMU that the world link would bear; no sensor of a configuration can have its name."""
    return Sensor(f"({link})", link, gyro_noise=0.0, gyro_bias_walk=0.0, accel_noise=0.0)


def with_world(frame: Frame, sensor: str) -> Frame:
    """The frame with the samples of the world's IMU."""
    gyro, accel = {**frame.gyro, sensor: STILL}, {**frame.accel, sensor: UPWARD}
    return Frame(frame.stamp, gyro, accel, frame.mag, frame.hall, frame.period, frame.reset)


def recording_with_world(recording: Recording, sensor: str) -> Recording:
    """The recording with the samples of the world's IMU."""
    shape = (len(recording), 3)
    return Recording(
        recording.stamps,
        {**recording.gyro, sensor: np.broadcast_to(np.array(STILL), shape)},
        {**recording.accel, sensor: np.broadcast_to(np.array(UPWARD), shape)},
        recording.mag,
        recording.hall,
        recording.period,
        recording.reset,
    )


class WorldPair(AbsolutePair):
    """The attitude of `child` in the world as the angles of a joint; see the module text."""

    def __init__(
        self,
        joint: Joint,
        child: AbsoluteImu,
        below: Sequence[AbsoluteImu],
        gains: Gains,
        gaps: Gaps,
        bias: BiasNoise,
    ) -> None:
        super().__init__(joint, AbsoluteImu(world_sensor(joint.parent), gains, gaps), child, below, gains, gaps, bias)

    def update(self, frame: Frame) -> JointOutput:
        """Take the angles from the attitude."""
        self._one.stamp, self._one.mag_stamp = self._two.stamp, self._two.mag_stamp
        return super().update(frame)

    def first_guess(self, a1: Vec3, a2: Vec3) -> Quat:
        """The attitude by gravity; the angle about it, where that is the first one, is zero."""
        guess, first = super().first_guess(a1, a2), self.joint.axes[0]
        if len(self.axes) == 1 or abs(first[2]) < _VERTICAL:
            return guess
        angle = -joint_angles(self.axes, multiply(self._from_zero, guess))[0]
        return multiply(about(first, angle), guess)

    def _judge(self, stamp: int, angles: tuple[float, ...], a2: Vec3, added: float) -> None:
        """By gravity of the attitude, without the noise of one sample."""
        super()._judge(stamp, angles, rotate_inverse(self._two.attitude.rotation, UPWARD) if any(a2) else a2, added)

    def _first_turn_variance(self, unobservable: Sequence[bool]) -> float:
        """The first angle about gravity is zero by definition."""
        return 0.0

    def set_zero(self, accel: dict[str, Vec3]) -> None:
        """What is about gravity is zero from now on; the rest is absolute."""
        self._turn_to(self.first_guess(UPWARD, accel[self.child.name]))
        keep = [not flags & _UNOBSERVABLE for flags in self.status]
        self.position = tuple([q if kept else 0.0 for q, kept in zip(self.position, keep, strict=True)])
        self.variance = tuple([v if kept else 0.0 for v, kept in zip(self.variance, keep, strict=True)])
        self.turn.begin(0.0)
