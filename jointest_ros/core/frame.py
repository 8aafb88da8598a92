"""What goes into an estimator and what comes out: one stamp at a time, or a stretch of stamps as arrays.

Stamps are integer nanoseconds of the sensors' clock; everything else is SI (rad/s, m/s^2, tesla, volts, rad).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]  # x, y, z, w
FloatArray = NDArray[np.float64]


def vec3(row: FloatArray) -> Vec3:
    """A vector (3,) as a tuple."""
    x, y, z = row.tolist()
    return x, y, z


class Status(IntFlag):
    """What a user must know about one joint of one `Estimate`. Zero: all is well."""

    OK = 0
    STARTING = 1  # no estimate yet: position and velocity are 0 and mean nothing
    NO_DATA = 2  # a sensor of this joint is missing from this frame: extrapolated
    GAP = 4  # an interval longer than max_gap was predicted over: the variance has grown
    UNOBSERVABLE = 8  # the motion or posture gives no absolute information: the angle is gyro integration
    UNCALIBRATED = 16  # the gyro bias was never calibrated at rest
    STALE = 32  # no data for longer than stale_after: not published
    DISTURBED = 64  # a correction is suspended because its sensor is disturbed (magnetometer, saturation)


@dataclass(slots=True)
class Frame:
    """All that was measured at one stamp, keyed by sensor. A sensor or field that gave nothing is not in its dict.

    A gyro sample is the mean rate over the interval that ends at `stamp`: it carries the state from the previous
    frame to this one, then the other sensors of this frame update it.
    """

    stamp: int  # ns
    gyro: dict[str, Vec3] = field(default_factory=dict)  # rad/s, sensor frame
    accel: dict[str, Vec3] = field(default_factory=dict)  # m/s^2, sensor frame, +9.81 upward at rest
    mag: dict[str, Vec3] = field(default_factory=dict)  # tesla, sensor frame
    hall: tuple[float, ...] | None = None  # volts, in the order of the configuration; NaN: no such sensor or no reading
    period: float = float("nan")  # s, of the stream: the interval without losses; NaN while unknown
    reset: bool = False  # the clock jumped before this frame (looped bag, clock set): start afresh, keep calibrations


@dataclass(slots=True)
class Estimate:
    """One estimate. The tuples follow `Estimator.joints` (rad, rad/s, rad^2)."""

    stamp: int  # ns, that of the frame
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    variance: tuple[float, ...]
    status: tuple[int, ...]  # `Status` flags of each joint
    torso: Vec3 | None = None  # last link in the first: rotation vector or additive sums, rad
    torso_orientation: Quat | None = None
    orientation: dict[str, Quat] = field(default_factory=dict)  # sensor -> rotation sensor to world (z up)


@dataclass(slots=True)
class Recording:
    """A stretch of T consecutive frames as arrays: the batch twin of `Frame`. Missing samples are NaN."""

    stamps: NDArray[np.int64]  # (T,) ns
    gyro: dict[str, FloatArray]  # sensor -> (T, 3) rad/s
    accel: dict[str, FloatArray]  # sensor -> (T, 3) m/s^2
    mag: dict[str, FloatArray] = field(default_factory=dict)  # sensor -> (T, 3) tesla
    hall: FloatArray | None = None  # (T, M) volts; a row of NaN: no message
    period: FloatArray | None = None  # (T,) s
    reset: NDArray[np.bool_] | None = None  # (T,)

    def __len__(self) -> int:
        return len(self.stamps)

    @classmethod
    def from_frames(cls, frames: Sequence[Frame]) -> Recording:
        """Stack frames; a sensor is present when any of them has it."""

        def stack(name: str) -> dict[str, FloatArray]:
            tables = [getattr(frame, name) for frame in frames]
            sensors = dict.fromkeys(sensor for table in tables for sensor in table)
            nothing = (np.nan,) * 3
            return {s: np.array([table.get(s, nothing) for table in tables], dtype=float) for s in sensors}

        hall = None
        width = max((len(f.hall) for f in frames if f.hall is not None), default=0)
        if width:
            hall = np.array([f.hall if f.hall is not None else (np.nan,) * width for f in frames], dtype=float)
        return cls(
            stamps=np.array([f.stamp for f in frames], dtype=np.int64),
            gyro=stack("gyro"),
            accel=stack("accel"),
            mag=stack("mag"),
            hall=hall,
            period=np.array([f.period for f in frames]),
            reset=np.array([f.reset for f in frames], dtype=bool),
        )

    @classmethod
    def concatenate(cls, parts: Sequence[Recording]) -> Recording:
        """Join consecutive stretches, at least one; what a stretch has nothing of is NaN there, no reset."""

        def rows(tables: list[FloatArray | None], nothing: FloatArray) -> FloatArray:
            filled = [
                np.tile(nothing, (len(part), 1)) if table is None else table
                for part, table in zip(parts, tables, strict=True)
            ]
            return np.concatenate(filled)

        def table(name: str) -> dict[str, FloatArray]:
            tables: list[dict[str, FloatArray]] = [getattr(part, name) for part in parts]
            sensors = dict.fromkeys(sensor for one in tables for sensor in one)
            return {sensor: rows([one.get(sensor) for one in tables], np.full(3, np.nan)) for sensor in sensors}

        widths = [part.hall.shape[1] for part in parts if part.hall is not None]
        return cls(
            np.concatenate([part.stamps for part in parts]),
            table("gyro"),
            table("accel"),
            table("mag"),
            rows([part.hall for part in parts], np.full(widths[0], np.nan)) if widths else None,
            np.concatenate([np.full(len(p), np.nan) if p.period is None else p.period for p in parts]),
            np.concatenate([np.zeros(len(p), dtype=bool) if p.reset is None else p.reset for p in parts]),
        )

    def part(self, start: int, stop: int) -> Recording:
        """Rows `start` to `stop` (exclusive), without copying."""
        rows = slice(start, stop)
        return Recording(
            self.stamps[rows],
            {sensor: table[rows] for sensor, table in self.gyro.items()},
            {sensor: table[rows] for sensor, table in self.accel.items()},
            {sensor: table[rows] for sensor, table in self.mag.items()},
            None if self.hall is None else self.hall[rows],
            None if self.period is None else self.period[rows],
            None if self.reset is None else self.reset[rows],
        )

    def of(self, sensors: Collection[str]) -> Recording:
        """Only some of the sensors, without copying."""
        gyro, accel, mag = (
            {sensor: table for sensor, table in tables.items() if sensor in sensors}
            for tables in (self.gyro, self.accel, self.mag)
        )
        return Recording(self.stamps, gyro, accel, mag, self.hall, self.period, self.reset)

    def parts(self, rows: int = 512) -> Iterator[Recording]:
        """The recording in consecutive stretches: so many rows need be Python objects at the same time, not all."""
        for start in range(0, len(self), rows):
            yield self.part(start, start + rows)

    def frames(self) -> Iterator[Frame]:
        """The frames one by one; a row with NaN in it counts as missing (Hall rows: only when all of it is NaN)."""
        for part in self.parts():
            yield from part._frames()

    def _frames(self) -> Iterator[Frame]:
        def present(array: FloatArray) -> list[Vec3 | None]:
            valid: Any = np.isfinite(array).all(axis=1)
            return [(row[0], row[1], row[2]) if ok else None for row, ok in zip(array.tolist(), valid, strict=True)]

        gyro = {s: present(a) for s, a in self.gyro.items()}
        accel = {s: present(a) for s, a in self.accel.items()}
        mag = {s: present(a) for s, a in self.mag.items()}
        hall: list[tuple[float, ...] | None] = [None] * len(self)
        if self.hall is not None:
            seen: Any = np.isfinite(self.hall).any(axis=1)
            hall = [tuple(row) if any_ else None for row, any_ in zip(self.hall.tolist(), seen, strict=True)]
        period = [float("nan")] * len(self) if self.period is None else self.period.tolist()
        reset = [False] * len(self) if self.reset is None else self.reset.tolist()
        for k, stamp in enumerate(self.stamps.tolist()):
            yield Frame(
                stamp,
                {s: v for s, rows in gyro.items() if (v := rows[k]) is not None},
                {s: v for s, rows in accel.items() if (v := rows[k]) is not None},
                {s: v for s, rows in mag.items() if (v := rows[k]) is not None},
                hall[k],
                period[k],
                reset[k],
            )


@dataclass(slots=True)
class Series:
    """T estimates as arrays: the batch twin of `Estimate`, columns in the order of `Estimator.joints`."""

    stamps: NDArray[np.int64]  # (T,) ns
    position: FloatArray  # (T, n) rad
    velocity: FloatArray  # (T, n) rad/s
    variance: FloatArray  # (T, n) rad^2
    status: NDArray[np.int64]  # (T, n) `Status` flags
    torso: FloatArray | None = None  # (T, 3) rad
    torso_orientation: FloatArray | None = None  # (T, 4) x, y, z, w
    orientation: dict[str, FloatArray] = field(default_factory=dict)  # sensor -> (T, 4) x, y, z, w; NaN where missing

    def __len__(self) -> int:
        return len(self.stamps)

    @classmethod
    def from_estimates(cls, estimates: Sequence[Estimate], joints: int) -> Series:
        """Stack estimates of an estimator with `joints` joint positions."""

        def stack(name: str, dtype: type) -> NDArray[Any]:
            return np.array([getattr(e, name) for e in estimates], dtype=dtype).reshape(len(estimates), joints)

        def optional(name: str) -> FloatArray | None:
            rows = [getattr(e, name) for e in estimates]
            return None if not rows or rows[0] is None else np.array(rows, dtype=float)

        sensors = dict.fromkeys(s for e in estimates for s in e.orientation)
        nothing = (np.nan,) * 4
        return cls(
            stamps=np.array([e.stamp for e in estimates], dtype=np.int64),
            position=stack("position", float),
            velocity=stack("velocity", float),
            variance=stack("variance", float),
            status=stack("status", np.int64),
            torso=optional("torso"),
            torso_orientation=optional("torso_orientation"),
            orientation={s: np.array([e.orientation.get(s, nothing) for e in estimates]) for s in sensors},
        )

    @classmethod
    def concatenate(cls, parts: Sequence[Series]) -> Series:
        """Join consecutive series of the same estimator."""

        def join(name: str) -> Any:
            arrays = [getattr(p, name) for p in parts]
            return None if any(a is None for a in arrays) else np.concatenate(arrays)

        sensors = dict.fromkeys(s for p in parts for s in p.orientation)
        return cls(
            stamps=join("stamps"),
            position=join("position"),
            velocity=join("velocity"),
            variance=join("variance"),
            status=join("status"),
            torso=join("torso"),
            torso_orientation=join("torso_orientation"),
            orientation={
                s: np.concatenate([p.orientation.get(s, np.full((len(p), 4), np.nan)) for p in parts]) for s in sensors
            },
        )
