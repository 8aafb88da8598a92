"""Prescribed motions with exact derivatives: signals of one coordinate, and links of a chain that follow them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.robot import Robot


@dataclass(frozen=True, slots=True)
class Signal:
    """A scalar function of time at n instants with its first and second derivative, each (n,)."""

    value: FloatArray
    rate: FloatArray
    acceleration: FloatArray

    def __add__(self, other: Signal) -> Signal:
        """The sum."""
        return Signal(self.value + other.value, self.rate + other.rate, self.acceleration + other.acceleration)

    def __mul__(self, other: Signal | float) -> Signal:
        """The product, by the product rule."""
        if not isinstance(other, Signal):
            return Signal(self.value * other, self.rate * other, self.acceleration * other)
        return Signal(
            self.value * other.value,
            self.rate * other.value + self.value * other.rate,
            self.acceleration * other.value + 2.0 * self.rate * other.rate + self.value * other.acceleration,
        )


def constant(time: FloatArray, value: float) -> Signal:
    """`value` at every instant of `time` (n,)."""
    return Signal(np.full_like(time, value), np.zeros_like(time), np.zeros_like(time))


def smoothstep(time: FloatArray, duration: float) -> Signal:
    """u^2 (3 - 2 u) with u = time / duration clipped to 0..1; the acceleration jumps at both ends."""
    u = np.clip(time / duration, 0.0, 1.0)
    inside = (time > 0.0) & (time < duration)
    return Signal(
        u * u * (3.0 - 2.0 * u),
        6.0 * u * (1.0 - u) / duration,
        np.where(inside, (6.0 - 12.0 * u) / duration**2, 0.0),
    )


def minimum_jerk(time: FloatArray, duration: float) -> Signal:
    """u^3 (10 - 15 u + 6 u^2) with u = time / duration clipped to 0..1: from rest to rest, continuous acceleration."""
    u = np.clip(time / duration, 0.0, 1.0)
    return Signal(
        u**3 * (10.0 - 15.0 * u + 6.0 * u**2),
        30.0 * u**2 * (1.0 - u) ** 2 / duration,
        60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / duration**2,
    )


def sine(time: FloatArray, frequency_hz: float) -> Signal:
    """sin(2 pi f t)."""
    omega = 2.0 * np.pi * frequency_hz
    s, c = np.sin(omega * time), np.cos(omega * time)
    return Signal(s, omega * c, -(omega**2) * s)


def raised_cosine(time: FloatArray, frequency_hz: float) -> Signal:
    """(1 - cos(2 pi f t)) / 2, between 0 and 1."""
    omega = 2.0 * np.pi * frequency_hz
    s, c = np.sin(omega * time), np.cos(omega * time)
    return Signal(0.5 * (1.0 - c), 0.5 * omega * s, 0.5 * omega**2 * c)


@dataclass(frozen=True, slots=True)
class LinkMotion:
    """Motion of a rigid link at n instants. All vectors are in the link's own frame.

    Attributes:
        orientation: n rotations, link to world.
        rate: (n, 3) angular rate, rad/s.
        rate_derivative: (n, 3) angular acceleration, rad/s^2.
        acceleration: (n, 3) of the link's origin relative to the world, without gravity, m/s^2.
    """

    orientation: Rotation
    rate: FloatArray
    rate_derivative: FloatArray
    acceleration: FloatArray

    @classmethod
    def translating(cls, acceleration: FloatArray) -> LinkMotion:
        """A link that keeps the world's orientation and whose origin accelerates: (n, 3), world frame, m/s^2."""
        zero = np.zeros_like(acceleration)
        return cls(Rotation.identity(len(acceleration)), zero, zero, acceleration)

    def acceleration_at(self, position: Vec3) -> FloatArray:
        """(n, 3) acceleration, link frame, of the point of the link at `position` (link frame, m)."""
        arm = np.asarray(position)
        return self.acceleration + np.cross(self.rate_derivative, arm) + np.cross(self.rate, np.cross(self.rate, arm))

    def child(self, axis: Vec3, angle: Signal, position: Vec3 = (0.0, 0.0, 0.0)) -> LinkMotion:
        """The link that a revolute at `position` (m, this link's frame) turns by `angle` (rad) about the unit `axis`.

        Forward recursion of Newton and Euler; the child's origin lies on the joint.
        """
        along = np.asarray(axis)
        turn = Rotation.from_rotvec(angle.value[:, None] * along)
        carried, own = turn.apply(self.rate, inverse=True), angle.rate[:, None] * along
        derivative = turn.apply(self.rate_derivative, inverse=True) + np.cross(carried, own)
        return LinkMotion(
            self.orientation * turn,
            carried + own,
            derivative + angle.acceleration[:, None] * along,
            turn.apply(self.acceleration_at(position), inverse=True),
        )


def tree_motion(robot: Robot, root: LinkMotion, angles: Mapping[str, Signal]) -> dict[str, LinkMotion]:
    """The motion of every link; those without a parent move as `root`; angles (rad) by coordinate.

    A roll-articular joint is two revolutes of half the angle, with its virtual link between them.
    """
    children = {joint.child for joint in robot.joints}
    links = {link: root for link in robot.links if link not in children}
    for joint in robot.ordered_joints:
        link, place = links[joint.parent], joint.origin
        if joint.roll_link is not None:
            half = angles[joint.name] * 0.5
            link, place = link.child(joint.axes[0], half, place), joint.roll_link
            turns = [(joint.axes[0], half)]
        else:
            turns = [(axis, angles[name]) for axis, name in zip(joint.axes, joint.coordinates, strict=True)]
        for axis, angle in turns:
            link, place = link.child(axis, angle, place), (0.0, 0.0, 0.0)
        links[joint.child] = link
    return links
