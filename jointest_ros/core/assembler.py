"""Gathers the samples of all sensors into frames of one stamp, and refuses what would give a silent wrong angle.

The policy, in sensor time (see also docs/conventions.md):

- A frame takes the samples within `sync_tolerance` of its stamp (that of its earliest sample). It is emitted when
  complete, or as a partial one when each missing sensor has shown that its sample will not come: it delivered a newer
  one, it has been silent, or the stream ran ahead by `max_wait`. So the order of arrival *between* topics, which DDS
  does not keep, changes nothing.
- A repeated or older stamp, a non-finite or implausible value in a field in use are refused and counted by cause.
- A stamp that is off by more than `max_gap` forward or `reset_jump` back is held until a second sample confirms it;
  without confirmation it is refused. Confirmed: up to `reset_jump` it was a gap, beyond it the next frame says `reset`.
- Hall messages have no stamp: a frame takes the one that arrived within `sync_tolerance` of its own first sample.
  Without one in time it goes out without, and what is left unpaired is dropped, so that a late or lost message never
  shifts the later ones.
"""

from __future__ import annotations

import math
from bisect import insort
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from statistics import median

from jointest_ros.core.frame import Frame, Vec3
from jointest_ros.core.robot import Sensor
from jointest_ros.core.timing import Timing

IMPLAUSIBLE_GYRO = 1e3  # rad/s, ten times the fastest MEMS gyro range
IMPLAUSIBLE_ACCEL = 1e5  # m/s^2, fifty times the widest MEMS shock accelerometer range
IMPLAUSIBLE_MAG = 1.0  # tesla
IMPLAUSIBLE_VOLTAGE = 1e3  # V
_NEVER = -(1 << 62)  # ns, before every stamp
_INTERVALS = 31  # intervals behind one estimate of the period
_MIN_WAIT = 20_000_000  # ns
_FIRST_TOLERANCE = 1_000_000  # ns, while the period is unknown


@dataclass(slots=True)
class Source:
    """What one input delivered: `received == used + sum(refused.values()) +` samples that still wait."""

    received: int = 0
    used: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    last: int = _NEVER  # ns, newest accepted stamp
    period: float = math.nan  # ns, median interval
    intervals: list[int] = field(default_factory=list)

    def accept(self, stamp: int) -> None:
        """Note an accepted stamp, and the median of the intervals before it."""
        if self.last != _NEVER:
            self.intervals.append(stamp - self.last)
            if len(self.intervals) == (_INTERVALS if self.period == self.period else 5):
                self.period = median(self.intervals)
                self.intervals.clear()
        self.last = stamp


@dataclass(slots=True)
class _Pending:
    frame: Frame
    arrival: int
    missing: set[str]

    def __lt__(self, other: _Pending) -> bool:
        return self.frame.stamp < other.frame.stamp


_Sample = tuple[str, int, Vec3, Vec3, int]  # sensor, stamp, gyro, accel, arrival


class FrameAssembler:
    """Assembles frames for `sensors`; every `add_*` returns the frames that became ready, in order of their stamps.

    Args:
        sensors: that deliver inertial samples; a sensor with neither gyro nor accelerometer in use is not waited for.
        timing: tolerances.
        hall_width: number of voltages in a Hall message; 0 where the robot has none.
    """

    def __init__(self, sensors: Iterable[Sensor], timing: Timing | None = None, hall_width: int = 0) -> None:
        self.timing = timing or Timing()
        self.hall_width = hall_width
        sensors = tuple(sensors)
        self.sources = {s.name: Source() for s in sensors if s.gyro or s.accel}
        self.mag_sources = {s.name: Source() for s in sensors if s.mag}
        self.hall_source = Source()
        self.frames = 0
        self.partial = 0
        self.resets = 0
        self.gaps = 0
        self._in_use = {s.name: (s.gyro, s.accel, round(s.delay * 1e9)) for s in sensors}
        self._expected = frozenset(self.sources)
        self._max_gap = round(self.timing.max_gap * 1e9)
        self._reset_jump = round(self.timing.reset_jump * 1e9)
        self._pending: list[_Pending] = []
        self._suspects: list[_Sample] = []
        self._hall: deque[tuple[int, tuple[float, ...]]] = deque()
        self._mag: dict[str, tuple[int, Vec3]] = {}
        self._newest = _NEVER  # newest accepted stamp of any sensor
        self._emitted = _NEVER  # stamp of the last frame
        self._arrival = _NEVER  # newest arrival of anything
        self._reset_next = False
        self._intervals = Source()  # of the frames: gives the period
        self._set_tolerances()

    # ---------------------------------------------------------------- inputs

    def add_imu(self, sensor: str, stamp: int, gyro: Vec3, accel: Vec3, arrival: int = 0) -> list[Frame]:
        """One inertial sample: stamp ns, rad/s, m/s^2. `arrival` ns matters for Hall pairing only."""
        source = self.sources[sensor]
        source.received += 1
        uses_gyro, uses_accel, delay = self._in_use[sensor]
        stamp -= delay
        # The comparison is false for NaN and infinity too.
        if (uses_gyro and not abs(gyro[0]) + abs(gyro[1]) + abs(gyro[2]) < IMPLAUSIBLE_GYRO) or (
            uses_accel and not abs(accel[0]) + abs(accel[1]) + abs(accel[2]) < IMPLAUSIBLE_ACCEL
        ):
            in_use = (gyro if uses_gyro else ()) + (accel if uses_accel else ())
            source.refused["implausible" if all(map(math.isfinite, in_use)) else "not finite"] += 1
            return []
        if arrival > self._arrival:
            self._arrival = arrival
        ahead = stamp - self._newest
        if self._newest != _NEVER and not -self._reset_jump <= ahead <= max(self._max_gap, 3 * self._period):
            return self._suspect((sensor, stamp, gyro, accel, arrival))
        if stamp <= source.last:
            source.refused["repeated stamp" if stamp == source.last else "older stamp"] += 1
            return []
        if self._suspects:
            self._refuse_suspects()
        self._place(sensor, stamp, gyro, accel, arrival)
        return self._ready()

    def add_mag(self, sensor: str, stamp: int, mag: Vec3) -> None:
        """One magnetometer sample, tesla. It goes with the next frame that is emitted, once, and is never waited for."""
        source = self.mag_sources[sensor]
        source.received += 1
        if not abs(mag[0]) + abs(mag[1]) + abs(mag[2]) < IMPLAUSIBLE_MAG:
            source.refused["implausible" if all(map(math.isfinite, mag)) else "not finite"] += 1
        elif -self._reset_jump <= stamp - source.last <= 0:
            source.refused["repeated stamp" if stamp == source.last else "older stamp"] += 1
        else:
            if sensor in self._mag:
                source.refused["unpaired"] += 1
            source.last = stamp
            self._mag[sensor] = (stamp, mag)

    def add_hall(self, voltages: tuple[float, ...], arrival: int) -> list[Frame]:
        """One Hall message in volts, NaN where there is no sensor, stamped by its arrival (in a bag: record time), ns."""
        source = self.hall_source
        source.received += 1
        if len(voltages) != self.hall_width:
            source.refused["wrong length"] += 1
            return []
        if any(abs(v) > IMPLAUSIBLE_VOLTAGE for v in voltages):
            source.refused["implausible"] += 1
            return []
        if arrival > self._arrival:
            self._arrival = arrival
        self._hall.append((arrival, voltages))
        if not self.timing.hall_per_frame:
            self._drop_hall(len(self._hall) - 1)
        elif len(self._hall) > 1:
            self._drop_hall_before(arrival - self._tolerance - self._max_gap)
        source.last = arrival
        return self._ready()

    def refuse(self, sensor: str, cause: str) -> None:
        """Count a message of `sensor` that could not even be decoded."""
        source = self.sources[sensor]
        source.received += 1
        source.refused[cause] += 1

    def flush(self) -> list[Frame]:
        """The end of the stream: emits what waits, refuses what was never confirmed or paired."""
        self._refuse_suspects()
        frames = [self._emit(pending, self._paired_hall(pending)) for pending in self._pending]
        self._pending.clear()
        self._drop_hall(len(self._hall))
        for sensor in self._mag:
            self.mag_sources[sensor].refused["unpaired"] += 1
        self._mag.clear()
        return frames

    # ---------------------------------------------------------------- odd stamps

    def _suspect(self, sample: _Sample) -> list[Frame]:
        sensor, stamp, _, _, _ = sample
        if self._suspects:
            last = self._suspects[-1]
            if last[0] == sensor and last[1] == stamp:
                self.sources[sensor].refused["repeated stamp"] += 1
                return []
            if abs(stamp - last[1]) > self._reset_jump or (last[0] == sensor and stamp < last[1]):
                self._refuse_suspects()
        self._suspects.append(sample)
        if len(self._suspects) < 2:
            return []
        confirmed = sorted(self._suspects, key=lambda s: s[1])
        self._suspects = []
        frames: list[Frame] = []
        if 0 < confirmed[0][1] - self._newest <= self._reset_jump:
            self.gaps += 1
        else:
            frames = [self._emit(pending, self._paired_hall(pending)) for pending in self._pending]
            self._pending.clear()
            for source in (*self.sources.values(), *self.mag_sources.values(), self._intervals):
                source.last = _NEVER
            self._newest = self._emitted = _NEVER
            self._reset_next = True
            self.resets += 1
        for sample in confirmed:
            self._place(*sample)
        return frames + self._ready()

    def _refuse_suspects(self) -> None:
        for sensor, *_ in self._suspects:
            self.sources[sensor].refused["odd stamp"] += 1
        self._suspects.clear()

    # ---------------------------------------------------------------- frames

    def _place(self, sensor: str, stamp: int, gyro: Vec3, accel: Vec3, arrival: int) -> None:
        source = self.sources[sensor]
        for pending in reversed(self._pending):
            frame = pending.frame
            if sensor in pending.missing and abs(stamp - frame.stamp) <= self._tolerance:
                if self._emitted < stamp < frame.stamp:
                    frame.stamp = stamp
                break
        else:
            if stamp <= self._emitted:
                source.refused["late"] += 1
                return
            frame = Frame(stamp)
            pending = _Pending(frame, arrival, set(self._expected))
            insort(self._pending, pending)
        uses_gyro, uses_accel, _ = self._in_use[sensor]
        if uses_gyro:
            frame.gyro[sensor] = gyro
        if uses_accel:
            frame.accel[sensor] = accel
        pending.missing.discard(sensor)
        source.used += 1
        source.accept(stamp)
        if stamp > self._newest:
            self._newest = stamp

    def _ready(self) -> list[Frame]:
        frames: list[Frame] = []
        while self._pending:
            pending = self._pending[0]
            if pending.missing and self._may_come(pending):
                break
            hall = self._paired_hall(pending)
            if hall is None and self._hall_may_come(pending):
                break
            del self._pending[0]
            frames.append(self._emit(pending, hall))
        return frames

    def _may_come(self, pending: _Pending) -> bool:
        stamp = pending.frame.stamp
        if self._newest - stamp > self._wait:
            return False
        for sensor in pending.missing:
            source = self.sources[sensor]
            if source.last > stamp:
                continue  # it delivered a newer sample: this one is lost
            if source.last != _NEVER and stamp - source.last > self._wait + 2 * self._period:
                continue  # silent: not waited for until it returns
            if source.period > 1.5 * self._period and stamp - source.last < 0.75 * source.period:
                continue  # slower than the stream, and not due yet
            return True
        return False

    def _emit(self, pending: _Pending, hall: tuple[float, ...] | None) -> Frame:
        frame = pending.frame
        if hall is not None:
            frame.hall = hall
            self.hall_source.used += 1
        for sensor, (stamp, mag) in self._mag.items():
            if abs(frame.stamp - stamp) <= self._max_gap:
                frame.mag[sensor] = mag
                self.mag_sources[sensor].used += 1
            else:
                self.mag_sources[sensor].refused["unpaired"] += 1
        self._mag.clear()
        frame.period = self._period * 1e-9 if self._period else math.nan
        frame.reset, self._reset_next = self._reset_next, False
        self.frames += 1
        self.partial += bool(pending.missing)
        self._emitted = frame.stamp
        before = self._intervals.period
        self._intervals.accept(frame.stamp)
        if self._intervals.period != before:
            self._set_tolerances()
        return frame

    def _set_tolerances(self) -> None:
        known = self._intervals.period == self._intervals.period
        self._period = round(self._intervals.period) if known else 0
        self._tolerance = round(self.timing.sync_tolerance * 1e9) or (self._period // 2 if known else _FIRST_TOLERANCE)
        self._wait = round(self.timing.max_wait * 1e9) or max(3 * self._period, _MIN_WAIT)

    # ---------------------------------------------------------------- Hall

    def _paired_hall(self, pending: _Pending) -> tuple[float, ...] | None:
        if not self._hall:
            return None
        if self.timing.hall_per_frame:
            self._drop_hall_before(pending.arrival - self._tolerance)
            if not self._hall or self._hall[0][0] > pending.arrival + self._tolerance:
                return None
        return self._hall.popleft()[1]

    def _hall_may_come(self, pending: _Pending) -> bool:
        waits = self.hall_width and self.timing.hall_per_frame and not self._hall
        return bool(waits) and self._arrival <= pending.arrival + self._tolerance

    def _drop_hall_before(self, arrival: int) -> None:
        while self._hall and self._hall[0][0] < arrival:
            self._drop_hall(1)

    def _drop_hall(self, count: int) -> None:
        for _ in range(count):
            self._hall.popleft()
            self.hall_source.refused["unpaired"] += 1
