"""What is wrong with an IMU though every sample of it is sound: saturated, frozen, other units, far from g.

`saturation` and `Frozen` are the definitions, for estimators too. `InputQuality` watches a stream of frames by them, at
a cost that does not count: it looks at one frame in 50 ms.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from jointest_ros.core.errors import counted
from jointest_ros.core.frame import Frame, Recording, Vec3, vec3
from jointest_ros.core.robot import STANDARD_GRAVITY, Sensor

SATURATED = 0.99  # share of the full scale; with noise and rounding, a clipped axis does not read exactly that
FROZEN_AFTER = 500_000_000  # ns
MOVED = 0.5  # m/s^2, by which another accelerometer of a moving link changes: more than noise or a coarse digit
TURNS = 0.2  # rad/s, rate of a gyro on a moving link: more than a bias
NORM_TOLERANCE = 0.05  # share of g: more than latitude (0.3 %) and the offsets of a calibrated sensor

_LOOK = 50_000_000  # ns between frames that are looked at
_WINDOW = 1_000_000_000  # ns over which rest is judged
_FEWEST = 8  # samples in a window
_REST_ACCEL = 0.02  # largest standard deviation of an axis at rest, as a share of the norm: the units are in doubt
_REST_GYRO = 0.1  # rad/s, largest rate of an axis at rest, a bias included
_NO_GYRO: Mapping[str, Vec3] = {}
UNITS = {"g": 1.0, "mg": 1000.0}  # what a sensor at rest reads in them


def saturation_limit(sensor: Sensor) -> float:
    """A raw reading is saturated from here on in any axis, m/s^2; infinity where the full scale is not known."""
    return SATURATED * sensor.accel_range


def gyro_saturation_limit(sensor: Sensor) -> float:
    """The same of the gyro, rad/s."""
    return SATURATED * sensor.gyro_range


def gyro_of(sensor: str) -> str:
    """How the gyro of a sensor is called where its accelerometer is told of too."""
    return f"{sensor} gyro"


def saturation(sensor: Sensor) -> Callable[[Vec3], bool]:
    """A function that tells whether a reading in a `Frame`, which is calibrated, was a saturated one."""
    limit = saturation_limit(sensor)
    if math.isinf(limit):
        return lambda accel: False
    if not sensor.accel_calibrated:
        return lambda accel: max(accel) >= limit or min(accel) <= -limit
    inverse, offset = np.linalg.inv(np.array(sensor.accel_matrix)), np.array(sensor.accel_offset)
    return lambda accel: bool(np.abs(inverse @ (accel - offset)).max() >= limit)


class Frozen:
    """Finds accelerometers that repeat one reading to the last bit for half a second while their link moves.

    The link moves where another accelerometer of it changes, or the sensor's own gyro tells so. What other links do
    says nothing: a sensor with coarse digits on a link at rest may well repeat a reading for minutes. A sensor stays
    frozen until its reading changes.

    Args:
        sensors: of the robot or of an array.
        after: ns; an estimator takes a repeated reading of a link that moves for none, at once (0).

    Attributes:
        since: sensors that are frozen -> stamp of the first of the equal readings, ns.
    """

    def __init__(self, sensors: Iterable[Sensor], after: int = FROZEN_AFTER) -> None:
        sensors, self._after = list(sensors), after
        self._beside = {
            sensor.name: [other.name for other in sensors if other.link == sensor.link and other is not sensor]
            for sensor in sensors
        }
        self._held: dict[str, tuple[int, Mapping[str, Vec3]]] = {}  # when a reading was new, and all others of then
        self.since: dict[str, int] = {}

    def update(self, stamp: int, accel: Mapping[str, Vec3], gyro: Mapping[str, Vec3] = _NO_GYRO) -> None:
        """Take the readings of a frame (stamp ns), which must not change any more; not every frame is needed."""
        held = self._held
        for sensor in self._beside:
            reading = accel.get(sensor)
            if reading is None:
                continue
            last = held.get(sensor)
            if last is None or reading != last[1][sensor]:
                held[sensor] = (stamp, accel)
                if self.since:
                    self.since.pop(sensor, None)
            elif stamp - last[0] >= self._after and sensor not in self.since:
                turns = sensor in gyro and max(map(abs, gyro[sensor])) > TURNS
                if turns or self._moved(sensor, last[1], accel):
                    self.since[sensor] = last[0]

    def _moved(self, sensor: str, before: Mapping[str, Vec3], now: Mapping[str, Vec3]) -> bool:
        return any(
            math.dist(before[other], now[other]) > MOVED
            for other in self._beside[sensor]
            if other in before and other in now
        )

    def clear(self) -> None:
        """Forget everything."""
        self._held.clear()
        self.since.clear()

    def get_state(self) -> dict[str, Any]:
        """All that changes, as plain numbers, lists and dicts."""
        return {
            "held": {sensor: [stamp, dict(accel)] for sensor, (stamp, accel) in self._held.items()},
            "since": dict(self.since),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`, from YAML and JSON as well."""
        self._held = {
            sensor: (stamp, {other: (x, y, z) for other, (x, y, z) in accel.items()})
            for sensor, (stamp, accel) in state["held"].items()
        }
        self.since = dict(state["since"])


class InputQuality:
    """Watches the accelerometers of a stream of frames, and whether anything is saturated.

    Attributes:
        saturated: sensor -> number of its samples with a saturated axis of the accelerometer, and `gyro_of` the sensor
            -> of its gyro, where the full scale is known; whoever receives the raw samples counts them with `note`.
        rest_norm: sensor -> norm of its mean reading when it was last at rest, m/s^2.
        frozen_longest: sensor -> longest time for which it was frozen, s.
        at_rest: sensor -> whether it was, in the newest second of its samples; gyros count too.
    """

    def __init__(self, sensors: Iterable[Sensor]) -> None:
        sensors = list(sensors)
        self._all = [sensor.name for sensor in sensors]
        self._sensors = {sensor.name: sensor for sensor in sensors if sensor.accel}
        self.at_rest: dict[str, bool] = {}
        self._full_scales: dict[str, tuple[str, str]] = {}  # what may be saturated -> (sensor, how to say it)
        for sensor in sensors:
            if sensor.accel and math.isfinite(sensor.accel_range):
                self._full_scales[sensor.name] = sensor.name, f"{sensor.accel_range / STANDARD_GRAVITY:.3g} g"
            if sensor.gyro and math.isfinite(sensor.gyro_range):
                text = f"{math.degrees(sensor.gyro_range):.4g} deg/s"
                self._full_scales[gyro_of(sensor.name)] = sensor.name, text
        self.saturated = dict.fromkeys(self._full_scales, 0)
        self.rest_norm: dict[str, float] = {}
        self.frozen_longest: dict[str, float] = {}
        self._limits = {sensor.name: (gyro_saturation_limit(sensor), saturation_limit(sensor)) for sensor in sensors}
        self._frozen = Frozen(self._sensors.values())
        self._frames: list[Frame] = []
        self._next = -(1 << 62)  # ns, stamp from which on a frame is looked at

    def note(self, sensor: str, gyro: Vec3, accel: Vec3) -> None:
        """Count raw readings, rad/s and m/s^2, if they are saturated."""
        for what, reading, limit in zip((gyro_of(sensor), sensor), (gyro, accel), self._limits[sensor], strict=True):
            if what in self.saturated and max(map(abs, reading)) >= limit:
                self.saturated[what] += 1

    def add(self, frame: Frame) -> None:
        """Take every frame."""
        if frame.stamp < self._next and not frame.reset:
            return
        if frame.reset:
            self._frozen.clear()
            self._frames.clear()
        self._next = frame.stamp + _LOOK
        self._frozen.update(frame.stamp, frame.accel, frame.gyro)
        for sensor, since in self._frozen.since.items():
            self.frozen_longest[sensor] = max(self.frozen_longest.get(sensor, 0.0), (frame.stamp - since) * 1e-9)
        self._frames.append(frame)
        if frame.stamp - self._frames[0].stamp >= _WINDOW:
            self._judge_rest()
            self._frames.clear()

    def add_recording(self, recording: Recording) -> None:
        """`add` for all frames of a recording, with nothing missing and no reset."""
        while (row := int(np.searchsorted(recording.stamps, self._next))) < len(recording):
            gyro, accel = (
                {sensor: vec3(table[row]) for sensor, table in tables.items()}
                for tables in (recording.gyro, recording.accel)
            )
            self.add(Frame(int(recording.stamps[row]), gyro, accel))

    @property
    def frozen(self) -> Collection[str]:
        """The sensors that are frozen now."""
        return self._frozen.since.keys()

    def findings(self, sensor: str) -> Iterator[str]:
        """What is wrong with a sensor now, a text each."""
        yield from self._norm_finding(sensor)
        if sensor in self._frozen.since:
            yield f"{sensor} repeats one acceleration while its link moves: frozen?"

    def summary(self, received: Mapping[str, int]) -> Iterator[str]:
        """What was wrong with a whole recording, a line each; `received`: samples by sensor."""
        for sensor in self._sensors:
            yield from self._norm_finding(sensor)
            if sensor in self.frozen_longest:
                longest = self.frozen_longest[sensor]
                yield f"{sensor} repeats one acceleration for {longest:.1f} s while its link moves: frozen?"
        for what, count in self.saturated.items():
            if count:
                yield f"{self.saturation_text(what, count)}, {count / received[self._full_scales[what][0]]:.1%} of all"

    def saturation_text(self, what: str, count: int) -> str:
        """What to say of `count` saturated samples; `what`: a key of `saturated`."""
        return f"{what}: {counted(count, 'sample')} saturated at the full scale of {self._full_scales[what][1]}"

    def _norm_finding(self, sensor: str) -> Iterator[str]:
        norm = self.rest_norm.get(sensor, STANDARD_GRAVITY)
        if abs(norm / STANDARD_GRAVITY - 1.0) <= NORM_TOLERANCE:
            return
        for unit, gravity in UNITS.items():
            if abs(norm / gravity - 1.0) <= 2.0 * NORM_TOLERANCE:
                yield f"{sensor} reads {norm:.2f} at rest: is it in {unit} instead of m/s^2?"
                return
        yield (
            f"{sensor} reads {norm:.2f} m/s^2 at rest, gravity is {STANDARD_GRAVITY:.2f}: "
            "wrong units or full scale, or calibrate it (jointest calibrate accel)"
        )

    def _judge_rest(self) -> None:
        """Find the sensors that were at rest over the window, and the norm of what they read."""
        self.at_rest = {}
        for sensor in self._all:
            accel = np.array([frame.accel[sensor] for frame in self._frames if sensor in frame.accel])
            gyro = np.array([frame.gyro[sensor] for frame in self._frames if sensor in frame.gyro])
            if max(len(accel), len(gyro)) < _FEWEST:
                continue
            at_rest = not gyro.size or bool(np.abs(gyro).max() <= _REST_GYRO)
            if at_rest and len(accel) >= _FEWEST:
                norm = float(np.linalg.norm(accel.mean(axis=0)))
                at_rest = bool(accel.std(axis=0).max() <= _REST_ACCEL * norm)
                if at_rest:
                    self.rest_norm[sensor] = norm
            self.at_rest[sensor] = at_rest
