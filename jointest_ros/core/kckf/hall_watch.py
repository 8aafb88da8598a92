"""Hall sensors against the angles of a filter that fuses them with gyros: frozen sensors, and a filter gone astray.

Frozen   a joint whose readings all repeat to the last bit, though by the gyros it has of late turned by so much that
         they should differ by MOVED standard deviations. Its readings are left out until one changes: a filter that
         takes them learns a wrong bias, and needs a minute to unlearn it.
Astray   a joint whose angle by the Hall sensors alone has for LOST_AFTER been farther from the filter's than sensors
         that are off could explain. A filter that is sure of a wrong angle, after a fault of the gyros, may be where
         the curve is flat and never find back.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from jointest_ros.core.hall_sensor import HallSensor, VoltageTable
from jointest_ros.core.kckf.linkage import Linkage
from jointest_ros.core.robot import Robot

MOVED = 3.0  # standard deviations of a reading
OF_LATE = 2.0  # s; in a longer time what is not known of the biases turns the joint too
LOST_AFTER = 0.25  # s
LOST_ANGLE = math.radians(10.0)
LOST_SHARE = 0.04  # of the range, error of a voltage by assembly and calibration
_LOOK = 0.1  # s between comparisons of the angles


@dataclass(frozen=True, slots=True)
class _Sensor:
    """What is needed of a Hall sensor, worked out once: `HallSensor` does so anew each time."""

    index: int  # of its voltage in a frame
    low: float  # V; from here to `high` a reading is certainly not clipped
    high: float
    sign: float
    offset: float  # V
    table: VoltageTable
    variance: float  # V^2
    moved: float  # V^2, change of a voltage that shows
    tolerance: float  # V, see LOST_SHARE

    @classmethod
    def of(cls, index: int, sensor: HallSensor) -> _Sensor:
        (low, high), margin = sensor.hall_range, sensor.gate_margin
        return cls(
            index,
            low + margin,
            high - margin,
            sensor.sign,
            sensor.offset,
            sensor.table,
            sensor.variance,
            MOVED * MOVED * sensor.variance,
            LOST_SHARE * (high - low),
        )


class HallWatch:
    """See the module text.

    Attributes:
        frozen: coordinates whose readings are left out now.
    """

    def __init__(self, robot: Robot, linkage: Linkage) -> None:
        self._sensors = [[_Sensor.of(index, robot.hall[index]) for index in own] for own in linkage.hall]
        self._first = [(number, own[0]) for number, own in enumerate(linkage.hall) if own]
        self.restart()

    def restart(self) -> None:
        """Forget everything."""
        self.frozen: set[int] = set()
        self._turned: dict[int, float] = {}  # rad, of the coordinates whose readings repeat, since they were new
        self._before: Sequence[float] | None = None
        self._elapsed = 0.0  # s since the last look
        self._contradicted = [0.0] * len(self._sensors)  # s

    def trusted(
        self, dt: float, hall: Sequence[float] | None, angles: Sequence[float], velocities: Sequence[float]
    ) -> Sequence[float] | None:
        """The voltages of a frame, NaN for those of frozen joints.

        `angles` and `velocities` (m), rad and rad/s, are those of the frame before, `dt` s earlier.
        """
        repeating, before = self._turned, self._before
        for number, turned in repeating.items():
            repeating[number] = turned * math.exp(-dt / OF_LATE) + velocities[number] * dt
        if hall is None:
            return None
        self._before = hall
        if before is None:
            return hall
        repeated = [number for number, index in self._first if hall[index] == before[index]]
        if not repeated and not repeating:
            return hall
        for number in set(repeating) - set(repeated):
            self._changed(number)
        for number in repeated:
            own = self._sensors[number]
            if any([hall[one.index] != before[one.index] for one in own[1:]]):
                self._changed(number)
                continue
            turned = repeating.setdefault(number, velocities[number] * dt)
            if number not in self.frozen and _moved(own, hall, angles[number], turned):
                self.frozen.add(number)
        if not self.frozen:
            return hall
        left_out = {one.index for number in self.frozen for one in self._sensors[number]}
        return [math.nan if index in left_out else reading for index, reading in enumerate(hall)]

    def _changed(self, number: int) -> None:
        self._turned.pop(number, None)
        self.frozen.discard(number)

    def astray(self, dt: float, hall: Sequence[float] | None, angles: Sequence[float]) -> Collection[int]:
        """Coordinates of which the filter knows nothing after all; `dt` s since the frame before."""
        self._elapsed += dt
        if self._elapsed < _LOOK or hall is None:
            return ()
        elapsed, self._elapsed = min(self._elapsed, LOST_AFTER / 2.0), 0.0
        lost = []
        for number, own in enumerate(self._sensors):
            contradicted = _contradicts(own, hall, angles[number])
            if contradicted is None:
                continue
            self._contradicted[number] = self._contradicted[number] + elapsed if contradicted else 0.0
            if self._contradicted[number] >= LOST_AFTER:
                self._contradicted[number] = 0.0
                lost.append(number)
        return lost

    def get_state(self) -> list[Any]:
        """All that changes."""
        before = None if self._before is None else list(self._before)
        return [
            sorted(self.frozen),
            list(map(list, self._turned.items())),
            before,
            self._elapsed,
            list(self._contradicted),
        ]

    def set_state(self, state: list[Any]) -> None:
        """Continue from `get_state`."""
        frozen, turned, self._before, self._elapsed, contradicted = state
        self.frozen, self._turned, self._contradicted = set(frozen), dict(turned), list(contradicted)


def _moved(own: Sequence[_Sensor], hall: Sequence[float], angle: float, turned: float) -> bool:
    """Whether readings should differ that are the same as before the joint has `turned` to `angle`."""
    for one in own:
        if one.low <= hall[one.index] <= one.high:
            change = one.table.voltage(one.sign * angle)[0] - one.table.voltage(one.sign * (angle - turned))[0]
            if change * change > one.moved:
                return True
    return False


def _contradicts(own: Sequence[_Sensor], hall: Sequence[float], angle: float) -> bool | None:
    """Whether the Hall sensors of a joint say something quite different; None: they say nothing."""
    weights = weighted = tolerance = 0.0
    for one in own:
        reading = hall[one.index]
        if not one.low <= reading <= one.high:
            continue
        theta = one.table.angle(reading - one.offset)
        slope = abs(one.table.voltage(theta)[1])
        weight = slope * slope / one.variance
        weights += weight
        weighted += weight * one.sign * theta
        tolerance += weight * one.tolerance / max(slope, 1e-9)
    if not weights:
        return None
    return abs(weighted / weights - angle) > LOST_ANGLE + tolerance / weights
