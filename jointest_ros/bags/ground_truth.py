"""The topics of ground truth in a recording, and their reader."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable

import numpy as np

from jointest_ros.bags.cdr import (
    BOOL,
    JOINT_STATE,
    QUATERNION_STAMPED,
    decode_bool,
    decode_joint_state,
    decode_quaternion_stamped,
)
from jointest_ros.bags.errors import CdrError
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.typestore import decoded
from jointest_ros.evaluation.truth import Truth

TRUTH_JOINTS = "ground_truth/joint_states"
TRUTH_ORIENTATION = "ground_truth/imu_orientation"
TRUTH_MOVEMENT = "ground_truth/movement"


class TruthReader:
    """Collects the ground truth topics of a recording."""

    def __init__(self, reader: BagReader, namespace: str) -> None:
        self.refused = 0
        self.handlers: dict[str, Callable[[bytes, int], None]] = {}
        self._names: tuple[str, ...] = ()
        self._joints: dict[str, tuple[array[float], array[float]]] = {}
        self._stamps = array("q")
        self._orientation: dict[str, tuple[array[int], array[float]]] = {}
        self._movement: list[tuple[int, bool]] = []
        for name, msgtype, handler in (
            (TRUTH_JOINTS, JOINT_STATE, self._joint_state),
            (TRUTH_ORIENTATION, QUATERNION_STAMPED, self._orientation_of),
            (TRUTH_MOVEMENT, BOOL, self._movement_at),
        ):
            if reader.resolve(name, namespace) is not None:
                self.handlers[reader.require(name, msgtype, namespace)] = handler

    def _joint_state(self, data: bytes, _time: int) -> None:
        try:
            stamp, names, position, velocity = decoded(decode_joint_state, data, JOINT_STATE)
        except CdrError:
            self.refused += 1
            return
        if self._stamps and stamp <= self._stamps[-1]:
            self.refused += stamp < self._stamps[-1]
            return
        if len(position) == len(velocity) == len(names) and names == self._names:
            self._stamps.append(stamp)
            for (p, v), q, rate in zip(self._joints.values(), position, velocity, strict=True):
                p.append(q)
                v.append(rate)
            return
        for name in names:
            if name not in self._joints:
                unknown = [math.nan] * len(self._stamps)
                self._joints[name] = (array("d", unknown), array("d", unknown))
        self._names = tuple(self._joints)
        self._stamps.append(stamp)
        positions, velocities = dict(zip(names, position, strict=False)), dict(zip(names, velocity, strict=False))
        for name, (p, v) in self._joints.items():
            p.append(positions.get(name, math.nan))
            v.append(velocities.get(name, math.nan))

    def _movement_at(self, data: bytes, time: int) -> None:
        """The message has no stamp: its record time stands for it."""
        try:
            self._movement.append((time, decoded(decode_bool, data, BOOL)))
        except CdrError:
            self.refused += 1

    def _orientation_of(self, data: bytes, _time: int) -> None:
        try:
            stamp, sensor, quaternion = decoded(decode_quaternion_stamped, data, QUATERNION_STAMPED)
        except CdrError:
            self.refused += 1
            return
        stamps, rows = self._orientation.setdefault(sensor, (array("q"), array("d")))
        if not 0.9 < math.hypot(*quaternion) < 1.1:
            self.refused += 1
            return
        if stamps and stamp <= stamps[-1]:
            self.refused += stamp < stamps[-1]
            return
        stamps.append(stamp)
        rows.extend(quaternion)

    def truth(self) -> Truth:
        """All of it as arrays."""
        return Truth(
            np.frombuffer(self._stamps, dtype=np.int64) if self._stamps else np.empty(0, dtype=np.int64),
            {name: np.frombuffer(p) for name, (p, _) in self._joints.items()},
            {name: np.frombuffer(v) for name, (_, v) in self._joints.items()},
            {
                sensor: (np.frombuffer(stamps, dtype=np.int64), np.frombuffer(rows).reshape(-1, 4))
                for sensor, (stamps, rows) in self._orientation.items()
            },
            tuple(self._movement),
        )
