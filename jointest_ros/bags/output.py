"""Estimates as messages, the same from a node and into a recording."""

from __future__ import annotations

from jointest_ros.bags.cdr_encode import JointStateEncoder
from jointest_ros.core.frame import Estimate, Status

_HIDDEN = int(Status.STARTING | Status.STALE)


class JointStateOutput:
    """JointState messages of one estimator: position and velocity; a joint without current data is left out."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self._joints = joints
        self._encoders: dict[tuple[bool, ...], tuple[JointStateEncoder, list[int]]] = {}

    @staticmethod
    def hides(estimate: Estimate) -> bool:
        """Whether a joint is left out: then there is no torso either."""
        return any(status & _HIDDEN for status in estimate.status)

    def encode(self, estimate: Estimate) -> bytes | None:
        """The message, or None while no joint has an estimate."""
        shown = tuple([not status & _HIDDEN for status in estimate.status])
        if shown not in self._encoders:
            columns = [column for column, visible in enumerate(shown) if visible]
            self._encoders[shown] = JointStateEncoder([self._joints[column] for column in columns]), columns
        encoder, columns = self._encoders[shown]
        if not columns:
            return None
        if len(columns) == len(shown):
            return encoder.encode(estimate.stamp, estimate.position, estimate.velocity)
        position, velocity = estimate.position, estimate.velocity
        return encoder.encode(estimate.stamp, [position[c] for c in columns], [velocity[c] for c in columns])
