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
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from jointest_ros.core.assembler_inputs import NEVER, QUICK, HallQueue, Mixture, Source
from jointest_ros.core.channel import Channel, calibrated
from jointest_ros.core.frame import Frame, Vec3
from jointest_ros.core.input_quality import InputQuality
from jointest_ros.core.pace import Pace
from jointest_ros.core.robot import Sensor
from jointest_ros.core.timing import Timing

IMPLAUSIBLE_MAG = 1.0  # tesla
_FIRST_HALL_TOLERANCE = 50_000_000  # ns, of arrival: a node that starts is slow at first
_STARTED = 20  # frames
_NOTHING: Vec3 = (0.0, 0.0, 0.0)


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
        channels: sensor -> how it is taken; `pace`: of the stream; `hall`: messages that wait; `arrival`: newest one of
            anything, ns. For `frame_block`.
    """

    def __init__(self, sensors: Iterable[Sensor], timing: Timing | None = None, hall_width: int = 0) -> None:
        self.timing = timing or Timing()
        sensors = tuple(sensors)
        self.sources = {s.name: Source() for s in sensors if s.gyro or s.accel}
        self.mag_sources = {s.name: Source() for s in sensors if s.mag}
        self.hall = HallQueue(hall_width, self.timing.hall_per_frame)
        self.hall_source = self.hall.source
        self.frames = 0
        self.partial = 0
        self.resets = 0
        self.gaps = 0
        self.quality = InputQuality(sensors)
        self.channels = {s.name: Channel.of(s) for s in sensors}
        self.pace = Pace(self.timing)
        self._expected = frozenset(self.sources)
        self._pending: list[_Pending] = []
        self._suspects: list[_Sample] = []
        self._mag: dict[str, tuple[int, Vec3]] = {}
        self._first = NEVER  # stamp with which the stream began, or began again
        self._emitted = NEVER  # stamp of the last frame
        self.arrival = NEVER
        self._reset_next = False
        self._mixed: set[str] = set()  # sensors to which somebody else sends as well

    # ---------------------------------------------------------------- inputs

    def add_imu(self, sensor: str, stamp: int, gyro: Vec3, accel: Vec3, arrival: int = 0) -> list[Frame]:
        """One inertial sample: stamp ns, rad/s, m/s^2. `arrival` ns matters for Hall pairing only."""
        source = self.sources[sensor]
        source.received += 1
        channel = self.channels[sensor]
        stamp -= channel.delay
        # The comparison is false for NaN and infinity too.
        if (channel.gyro and not abs(gyro[0]) + abs(gyro[1]) + abs(gyro[2]) < channel.gyro_limit) or (
            channel.accel and not abs(accel[0]) + abs(accel[1]) + abs(accel[2]) < channel.accel_limit
        ):
            cause = channel.unsound(gyro, accel)
            if cause:
                source.refused[cause] += 1
                return []
            self.quality.note(sensor, gyro, accel)
        if arrival != self.arrival:
            self._note_arrival(arrival)
        pace = self.pace
        if pace.newest == NEVER:
            self._first = stamp
        elif not -pace.reset_jump <= stamp - pace.newest <= pace.farthest:
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
        elif -self.pace.reset_jump <= stamp - source.last <= 0:
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
            self.hall.refuse("two publishers")
            return []
        oldest = arrival - self._hall_tolerance - self.pace.max_gap
        return self._ready() if self.hall.add(voltages, arrival, oldest) else []

    def flush(self) -> list[Frame]:
        """The end of the stream: emits what waits, refuses what was never confirmed or paired."""
        self._refuse_suspects()
        frames = self._emit_all()
        self.hall.drop_before(None)
        for sensor in self._mag:
            self.mag_sources[sensor].refused["unpaired"] += 1
        self._mag.clear()
        return frames

    # ---------------------------------------------------------------- blocks

    @property
    def is_between_frames(self) -> bool:
        """Everything was emitted, nothing is doubtful, the period of all sensors is known: a block may begin."""
        return (
            self.frames >= _STARTED
            and not self._pending
            and not self._suspects
            and not self._mag
            and not self.hall.waits
            and not self._reset_next
            and not self._mixed
            and all(source.period and source.mixture is None for source in self.sources.values())
        )

    def carry_on(self, pace: Pace, sources: Mapping[str, Source], frames: int, emitted: int, arrival: int) -> None:
        """After whole frames that were assembled elsewhere: so many, the last one with the stamp `emitted`."""
        self.pace = pace
        for sensor, source in sources.items():
            self.sources[sensor].become(source)
        self.frames += frames
        self._emitted, self.arrival = emitted, arrival

    # ---------------------------------------------------------------- arrivals

    def _note_arrival(self, arrival: int) -> None:
        if arrival > self.arrival:
            self.arrival = arrival
        elif arrival < self.arrival - self.pace.reset_jump:  # the clock of the host was set back
            self.arrival = arrival
            self.hall.drop_before(None)
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
            if abs(stamp - last[1]) > self.pace.reset_jump or (last[0] == sensor and stamp < last[1]):
                self._refuse_suspects()
        self._suspects.append(sample)
        if len(self._suspects) < 2:
            return []
        confirmed = sorted(self._suspects, key=lambda s: s[1])
        self._suspects = []
        frames: list[Frame] = []
        if 0 < confirmed[0][1] - self.pace.newest <= self.pace.reset_jump:
            self.gaps += 1
        else:
            frames = self._emit_all()
            for source in (*self.sources.values(), *self.mag_sources.values()):
                source.last, source.mixture = NEVER, None
            self._mixed.clear()
            self.pace.newest = self._emitted = NEVER
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
        channel, pace = self.channels[sensor], self.pace
        if source.mixture is not None or stamp - source.last < QUICK * source.period:
            self._note_mixture(sensor, stamp, gyro, accel)
        if sensor in self._mixed:
            source.last = stamp
            pace.newest = max(pace.newest, stamp)
            source.refused["two publishers"] += 1
            return True
        if source.accept(stamp):
            pace.follow(self.sources.values())
        if stamp > pace.newest:
            pace.newest = stamp
        if channel.gyro and source.repeats(stamp, gyro, accel if channel.accel else None):
            source.refused["frozen"] += 1
            return True
        if stamp <= self._emitted:
            source.refused["late"] += 1
            return False
        source.used += 1
        for pending in self._pending:
            frame = pending.frame
            if sensor in pending.missing and abs(stamp - frame.stamp) <= pace.tolerance:
                if stamp < frame.stamp:
                    frame.stamp = stamp
                joined = True
                break
        else:
            joined = False
            frame = Frame(stamp)
            pending = _Pending(frame, arrival, set(self._expected), self.hall.added)
            insort(self._pending, pending)
        if channel.gyro:
            scale = channel.gyro_scale
            frame.gyro[sensor] = gyro if scale is None else (scale[0] * gyro[0], scale[1] * gyro[1], scale[2] * gyro[2])
        if channel.accel:
            calibration = channel.accel_calibration
            frame.accel[sensor] = accel if calibration is None else calibrated(accel, *calibration)
        pending.missing.remove(sensor)
        # The oldest frame may still wait for the same sensor as before.
        return not (joined and pending.awaited in pending.missing and pending is self._pending[0])

    def _note_mixture(self, sensor: str, stamp: int, gyro: Vec3, accel: Vec3) -> None:
        source = self.sources[sensor]
        channel = self.channels[sensor]
        mixture = source.mixture = source.mixture or Mixture(source.period)
        mixture.add(stamp, gyro if channel.gyro else _NOTHING, accel if channel.accel else _NOTHING)
        if mixture.over:
            source.mixture = None
            self._mixed.discard(sensor)
        elif mixture.mixed and sensor not in self._mixed:
            self._mixed.add(sensor)
            source.period = mixture.period
            source.intervals.clear()
            self.pace.follow(self.sources.values())

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
        if self.pace.newest - stamp > self.pace.wait:
            return False
        for sensor in pending.missing:
            source = self.sources[sensor]
            last = source.last if source.last != NEVER else min(self._first, stamp)
            if last > stamp:
                continue  # it delivered a newer sample: this one is lost
            period = source.period or self.pace.period
            if stamp - last > self.pace.wait + 2 * period:
                continue  # silent: not waited for until it returns
            if period > 1.5 * self.pace.period and stamp - last < 0.75 * period:
                continue  # slower than the stream, and not due yet
            pending.awaited = sensor
            return True
        return False

    def _take_hall(self, index: int) -> tuple[float, ...] | None:
        if not self.hall.waits:
            return None
        pending = self._pending[index]
        before_next = min([later.hall_added for later in self._pending[index + 1 :]], default=None)
        return self.hall.take(pending.arrival, self._hall_tolerance, pending.hall_added, before_next)

    @property
    def _hall_tolerance(self) -> int:
        return self.pace.tolerance if self.frames >= _STARTED else _FIRST_HALL_TOLERANCE

    def _hall_may_come(self, pending: _Pending) -> bool:
        if not self.hall.awaited or self.pace.newest - pending.frame.stamp > self.pace.wait:
            return False
        if self.hall.follows:
            return len(self._pending) == 1
        return self.arrival <= pending.arrival + self._hall_tolerance

    def _emit_all(self) -> list[Frame]:
        frames = [self._emit(pending, self._take_hall(k)) for k, pending in enumerate(self._pending)]
        self._pending.clear()
        return frames

    def _emit(self, pending: _Pending, hall: tuple[float, ...] | None) -> Frame:
        frame = pending.frame
        frame.hall = hall
        if self._mag:
            self._add_mag(frame)
        frame.period = self.pace.period * 1e-9 if self.pace.period else math.nan
        frame.reset, self._reset_next = self._reset_next, False
        self.frames += 1
        self.partial += bool(pending.missing)
        self.quality.add(frame)
        self._emitted = frame.stamp
        return frame

    def _add_mag(self, frame: Frame) -> None:
        for sensor, (stamp, mag) in self._mag.items():
            source = self.mag_sources[sensor]
            if abs(frame.stamp - stamp) <= self.pace.max_gap:
                frame.mag[sensor] = mag
                source.used += 1
            else:
                source.refused["unpaired"] += 1
        self._mag.clear()
