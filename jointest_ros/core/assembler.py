"""Gathers the samples of all sensors into frames of one stamp, and refuses what would give a silent wrong angle.

The policy, in sensor time (see also docs/conventions.md):

- A frame takes the samples within `sync_tolerance` of its stamp (that of its earliest sample). It is emitted when
  complete, or as a partial one when each missing sensor has shown that its sample will not come: it delivered a newer
  one, it has been silent, it is slower and not due yet, or the stream ran ahead by `max_wait`. So the order of arrival
  *between* topics, which DDS does not keep, changes nothing as long as no topic lags by more than `max_wait`.
- A repeated or older stamp, a non-finite or implausible value in a field in use are refused and counted by cause; so is
  a frozen IMU: one reading to the last bit, which says that the link turns.
- `frame_block` gives the same for whole blocks of a sound stream: a new rule here needs its condition there.
- Two streams on the topic of one IMU, which alternate (`Mixture`), are refused both, and Hall messages meanwhile.
- A stamp that is off by more than `max_gap` forward or `reset_jump` back is held until a second sample confirms it;
  without confirmation it is refused. Confirmed: up to `reset_jump` it was a gap, beyond it the next frame says `reset`.
- Hall messages have no stamp: a frame takes the one that arrived within `sync_tolerance` of its own first sample; once
  they regularly come after that sample, the one that comes before the next frame begins.
  Without one in time it goes out without, and what is left unpaired is dropped, so that a late or lost message never
  shifts the later ones.
"""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Iterable
from dataclasses import dataclass

from jointest_ros.core.assembler_inputs import NEVER, QUICK, HallQueue, Mixture, Source
from jointest_ros.core.frame import Frame, Vec3
from jointest_ros.core.input_quality import InputQuality, gyro_saturation_limit, saturation_limit
from jointest_ros.core.robot import UNCALIBRATED_SCALE, Sensor
from jointest_ros.core.timing import Timing

IMPLAUSIBLE_GYRO = 1e3  # rad/s, ten times the fastest MEMS gyro range
IMPLAUSIBLE_ACCEL = 1e5  # m/s^2, fifty times the widest MEMS shock accelerometer range
IMPLAUSIBLE_MAG = 1.0  # tesla
_MIN_WAIT = 20_000_000  # ns
_FIRST_TOLERANCE = 400_000  # ns, while the period is unknown: less than half a period at 1 kHz
_FIRST_HALL_TOLERANCE = 50_000_000  # ns, of arrival: a node that starts is slow at first
_STARTED = 20  # frames
_NOTHING: Vec3 = (0.0, 0.0, 0.0)
_GONE = 10  # periods after which a silent sensor says nothing about the period of the stream


@dataclass(slots=True)
class _Pending:
    frame: Frame
    arrival: int
    missing: set[str]
    hall_added: int  # Hall messages that had come before it
    awaited: str = ""  # the one of the missing that was last found to be still to come

    def __lt__(self, other: _Pending) -> bool:
        return self.frame.stamp < other.frame.stamp


_Sample = tuple[str, int, Vec3, Vec3, int]  # sensor, stamp, gyro, accel, arrival


def calibrated(reading: Vec3, row_x: Vec3, row_y: Vec3, row_z: Vec3, offset: Vec3) -> Vec3:
    """Acceleration of an accelerometer's reading, m/s^2: matrix (by rows) times reading, plus offset."""
    x, y, z = reading
    return (
        row_x[0] * x + row_x[1] * y + row_x[2] * z + offset[0],
        row_y[0] * x + row_y[1] * y + row_y[2] * z + offset[1],
        row_z[0] * x + row_z[1] * y + row_z[2] * z + offset[2],
    )


def _unsound(gyro: tuple[float, ...], accel: tuple[float, ...]) -> str:
    """Why a sample with these fields in use is refused; "" where it is not."""
    if not all(map(math.isfinite, gyro + accel)):
        return "not finite"
    if sum(map(abs, gyro)) < IMPLAUSIBLE_GYRO and sum(map(abs, accel)) < IMPLAUSIBLE_ACCEL:
        return ""
    return "implausible"


class FrameAssembler:
    """Assembles frames for `sensors`; every `add_*` returns the frames that became ready, in order of their stamps.

    Args:
        sensors: that deliver inertial samples; a sensor with neither gyro nor accelerometer in use is not waited for.
        timing: tolerances.
        hall_width: number of voltages in a Hall message; 0 where the robot has none.

    Attributes:
        sources, mag_sources: sensor -> what it delivered; `hall_source`: the same of the Hall topic.
        frames, partial: how many were emitted, and how many of them with a sensor missing.
        gaps, resets: how many were confirmed.
        quality: what it finds wrong with sensors in sound samples.
    """

    def __init__(self, sensors: Iterable[Sensor], timing: Timing | None = None, hall_width: int = 0) -> None:
        self.timing = timing or Timing()
        sensors = tuple(sensors)
        self.sources = {s.name: Source() for s in sensors if s.gyro or s.accel}
        self.mag_sources = {s.name: Source() for s in sensors if s.mag}
        self._hall = HallQueue(hall_width, self.timing.hall_per_frame)
        self.hall_source = self._hall.source
        self.frames = 0
        self.partial = 0
        self.resets = 0
        self.gaps = 0
        self.quality = InputQuality(sensors)
        self._in_use = {s.name: (s.gyro, s.accel, round(s.delay * 1e9)) for s in sensors}
        # the sum of all axes is checked against it: a smaller one needs no closer look
        self._conspicuous = {s.name: min(IMPLAUSIBLE_ACCEL, saturation_limit(s)) for s in sensors}
        self._conspicuous_gyro = {s.name: min(IMPLAUSIBLE_GYRO, gyro_saturation_limit(s)) for s in sensors}
        self._accel_calibrations = {s.name: (*s.accel_matrix, s.accel_offset) for s in sensors if s.accel_calibrated}
        self._gyro_scales = {s.name: s.gyro_scale for s in sensors if s.gyro_scale != UNCALIBRATED_SCALE}
        self._expected = frozenset(self.sources)
        self._max_gap = round(self.timing.max_gap * 1e9)
        self._reset_jump = round(self.timing.reset_jump * 1e9)
        self._pending: list[_Pending] = []
        self._suspects: list[_Sample] = []
        self._mag: dict[str, tuple[int, Vec3]] = {}
        self._first = NEVER  # stamp with which the stream began, or began again
        self._newest = NEVER  # newest accepted stamp of any sensor
        self._emitted = NEVER  # stamp of the last frame
        self._arrival = NEVER  # newest arrival of anything
        self._reset_next = False
        self._mixed: set[str] = set()  # sensors to which somebody else sends as well
        self._period = 0  # ns; 0: not known yet
        self._set_tolerances()

    # ---------------------------------------------------------------- inputs

    def add_imu(self, sensor: str, stamp: int, gyro: Vec3, accel: Vec3, arrival: int = 0) -> list[Frame]:
        """One inertial sample: stamp ns, rad/s, m/s^2. `arrival` ns matters for Hall pairing only."""
        source = self.sources[sensor]
        source.received += 1
        uses_gyro, uses_accel, delay = self._in_use[sensor]
        stamp -= delay
        # The comparison is false for NaN and infinity too.
        if (uses_gyro and not abs(gyro[0]) + abs(gyro[1]) + abs(gyro[2]) < self._conspicuous_gyro[sensor]) or (
            uses_accel and not abs(accel[0]) + abs(accel[1]) + abs(accel[2]) < self._conspicuous[sensor]
        ):
            cause = _unsound(gyro if uses_gyro else (), accel if uses_accel else ())
            if cause:
                source.refused[cause] += 1
                return []
            self.quality.note(sensor, gyro, accel)
        if arrival != self._arrival:
            self._note_arrival(arrival)
        if self._newest == NEVER:
            self._first = stamp
        elif not -self._reset_jump <= stamp - self._newest <= self._farthest:
            return self._suspect((sensor, stamp, gyro, accel, arrival))
        if stamp <= source.last:
            source.refused["repeated stamp" if stamp == source.last else "older stamp"] += 1
            return []
        if self._suspects:
            self._refuse_suspects()
        return self._ready() if self._place(sensor, stamp, gyro, accel, arrival) else []

    def add_mag(self, sensor: str, stamp: int, mag: Vec3) -> None:
        """One magnetometer sample, tesla. It goes with the next frame that is emitted, once, and is never awaited."""
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
        """One Hall message, V, NaN where there is no sensor; `arrival` (bags: record time), ns, is its only time."""
        self._note_arrival(arrival)
        if self._mixed:
            self._hall.refuse("two publishers")
            return []
        oldest = arrival - self._hall_tolerance - self._max_gap
        return self._ready() if self._hall.add(voltages, arrival, oldest) else []

    def flush(self) -> list[Frame]:
        """The end of the stream: emits what waits, refuses what was never confirmed or paired."""
        self._refuse_suspects()
        frames = self._emit_all()
        self._hall.drop_before(None)
        for sensor in self._mag:
            self.mag_sources[sensor].refused["unpaired"] += 1
        self._mag.clear()
        return frames

    def _note_arrival(self, arrival: int) -> None:
        if arrival > self._arrival:
            self._arrival = arrival
        elif arrival < self._arrival - self._reset_jump:  # the clock of the host was set back
            self._arrival = arrival
            self._hall.drop_before(None)
            for pending in self._pending:
                pending.arrival = arrival

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
            frames = self._emit_all()
            for source in (*self.sources.values(), *self.mag_sources.values()):
                source.last, source.mixture = NEVER, None
            self._mixed.clear()
            self._newest = self._emitted = NEVER
            self._first = confirmed[0][1]
            self._reset_next = True
            self.resets += 1
        for one in confirmed:
            self._place(*one)
        return frames + self._ready()

    def _refuse_suspects(self) -> None:
        for sensor, *_ in self._suspects:
            self.sources[sensor].refused["odd stamp"] += 1
        self._suspects.clear()

    # ---------------------------------------------------------------- frames

    def _place(self, sensor: str, stamp: int, gyro: Vec3, accel: Vec3, arrival: int) -> bool:
        """Put a sample into the frame that it belongs to; False where this can make no frame ready."""
        source = self.sources[sensor]
        uses_gyro, uses_accel, _ = self._in_use[sensor]
        if source.mixture is not None or stamp - source.last < QUICK * source.period:
            self._note_mixture(sensor, stamp, gyro, accel)
        if sensor in self._mixed:
            source.last = stamp
            self._newest = max(self._newest, stamp)
            source.refused["two publishers"] += 1
            return True
        if source.accept(stamp):
            self._set_tolerances()
        if stamp > self._newest:
            self._newest = stamp
        if uses_gyro and source.repeats(stamp, gyro, accel if uses_accel else None):
            source.refused["frozen"] += 1
            return True
        if stamp <= self._emitted:
            source.refused["late"] += 1
            return False
        source.used += 1
        for pending in self._pending:
            frame = pending.frame
            if sensor in pending.missing and abs(stamp - frame.stamp) <= self._tolerance:
                if stamp < frame.stamp:
                    frame.stamp = stamp
                joined = True
                break
        else:
            joined = False
            frame = Frame(stamp)
            pending = _Pending(frame, arrival, set(self._expected), self._hall.added)
            insort(self._pending, pending)
        if uses_gyro:
            scale = self._gyro_scales.get(sensor)
            frame.gyro[sensor] = gyro if scale is None else (scale[0] * gyro[0], scale[1] * gyro[1], scale[2] * gyro[2])
        if uses_accel:
            calibration = self._accel_calibrations.get(sensor)
            frame.accel[sensor] = accel if calibration is None else calibrated(accel, *calibration)
        pending.missing.remove(sensor)
        # The oldest frame may still wait for the same sensor as before.
        return not (joined and pending.awaited in pending.missing and pending is self._pending[0])

    def _note_mixture(self, sensor: str, stamp: int, gyro: Vec3, accel: Vec3) -> None:
        source = self.sources[sensor]
        uses_gyro, uses_accel, _ = self._in_use[sensor]
        mixture = source.mixture = source.mixture or Mixture(source.period)
        mixture.add(stamp, gyro if uses_gyro else _NOTHING, accel if uses_accel else _NOTHING)
        if mixture.over:
            source.mixture = None
            self._mixed.discard(sensor)
        elif mixture.mixed and sensor not in self._mixed:
            self._mixed.add(sensor)
            source.period = mixture.period
            source.intervals.clear()
            self._set_tolerances()

    def _ready(self) -> list[Frame]:
        frames: list[Frame] = []
        while self._pending:
            pending = self._pending[0]
            if pending.missing and self._may_come(pending):
                break
            hall = self._take_hall(0)
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
            last = source.last if source.last != NEVER else min(self._first, stamp)
            if last > stamp:
                continue  # it delivered a newer sample: this one is lost
            period = source.period or self._period
            if stamp - last > self._wait + 2 * period:
                continue  # silent: not waited for until it returns
            if period > 1.5 * self._period and stamp - last < 0.75 * period:
                continue  # slower than the stream, and not due yet
            pending.awaited = sensor
            return True
        return False

    def _take_hall(self, index: int) -> tuple[float, ...] | None:
        if not self._hall.waits:
            return None
        pending = self._pending[index]
        before_next = min([later.hall_added for later in self._pending[index + 1 :]], default=None)
        return self._hall.take(pending.arrival, self._hall_tolerance, pending.hall_added, before_next)

    @property
    def _hall_tolerance(self) -> int:
        return self._tolerance if self.frames >= _STARTED else _FIRST_HALL_TOLERANCE

    def _hall_may_come(self, pending: _Pending) -> bool:
        if not self._hall.awaited or self._newest - pending.frame.stamp > self._wait:
            return False
        if self._hall.follows:
            return len(self._pending) == 1
        return self._arrival <= pending.arrival + self._hall_tolerance

    def _emit_all(self) -> list[Frame]:
        frames = [self._emit(pending, self._take_hall(k)) for k, pending in enumerate(self._pending)]
        self._pending.clear()
        return frames

    def _emit(self, pending: _Pending, hall: tuple[float, ...] | None) -> Frame:
        frame = pending.frame
        frame.hall = hall
        if self._mag:
            self._add_mag(frame)
        frame.period = self._period * 1e-9 if self._period else math.nan
        frame.reset, self._reset_next = self._reset_next, False
        self.frames += 1
        self.partial += bool(pending.missing)
        self.quality.add(frame)
        self._emitted = frame.stamp
        return frame

    def _add_mag(self, frame: Frame) -> None:
        for sensor, (stamp, mag) in self._mag.items():
            source = self.mag_sources[sensor]
            if abs(frame.stamp - stamp) <= self._max_gap:
                frame.mag[sensor] = mag
                source.used += 1
            else:
                source.refused["unpaired"] += 1
        self._mag.clear()

    def _set_tolerances(self) -> None:
        """The period of the stream is that of its fastest sensor; tolerances follow it."""
        present = [s.period for s in self.sources.values() if s.period and self._newest - s.last <= _GONE * s.period]
        if present:
            self._period = min(present)
        given, half = round(self.timing.sync_tolerance * 1e9), self._period // 2 or _FIRST_TOLERANCE
        self._tolerance = min(given, half) if given else half
        self._wait = round(self.timing.max_wait * 1e9) or max(3 * self._period, _MIN_WAIT)
        self._farthest = max(self._max_gap, 3 * self._period)
