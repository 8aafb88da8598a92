"""Forward kinematics of a robot: the pose of every link, from the joint positions that an estimator gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from jointest_ros.core.frame import Quat, Vec3
from jointest_ros.core.robot import Robot
from jointest_ros.core.rotation import IDENTITY, about, multiply, rotate


@dataclass(frozen=True, slots=True)
class Pose:
    """A link in its root link: the position of its frame's origin, m, and its orientation (link to root)."""

    position: Vec3 = (0.0, 0.0, 0.0)
    orientation: Quat = IDENTITY

    def point(self, at: Vec3) -> Vec3:
        """The point of the link `at` (link frame, m), in the root link, m."""
        (x, y, z), (a, b, c) = self.position, rotate(self.orientation, at)
        return (x + a, y + b, z + c)

    def moved(self, offset: Vec3) -> Pose:
        """The same orientation, with the origin at the link's point `offset`, m."""
        return Pose(self.point(offset), self.orientation)

    def turned(self, axis: Vec3, angle: float) -> Pose:
        """The same origin, turned about the link's unit `axis` by `angle`, rad."""
        turn = about(axis, angle)
        return Pose(self.position, multiply(self.orientation, turn))


def link_poses(robot: Robot, positions: Mapping[str, float]) -> dict[str, Pose]:
    """The pose of every link for joint positions (rad) by coordinate; a link without a joint is its own root.

    A roll-articular joint is two revolutes of half its position with the virtual link between them (Santaera et al.
    2015, section V).
    """
    poses: dict[str, Pose] = {}
    for joint in robot.ordered_joints:
        pose = poses.setdefault(joint.parent, Pose()).moved(joint.origin)
        if joint.roll_link is not None:
            half = 0.5 * positions[joint.name]
            pose = pose.turned(joint.axes[0], half).moved(joint.roll_link).turned(joint.axes[0], half)
        else:
            for coordinate, axis in zip(joint.coordinates, joint.axes, strict=True):
                pose = pose.turned(axis, positions[coordinate])
        poses[joint.child] = pose
    return {link: poses.get(link, Pose()) for link in robot.links}
