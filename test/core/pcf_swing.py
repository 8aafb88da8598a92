"""One joint between two IMUs in any motion, for tests of the PCF: exact samples, white noise and constant biases."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Recording, Vec3
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.sim.imu import EARTH_FIELD, GRAVITY, mean_rate

X: Vec3 = (1.0, 0.0, 0.0)
Y: Vec3 = (0.0, 1.0, 0.0)
Z: Vec3 = (0.0, 0.0, 1.0)
GYRO_NOISE = math.radians(0.005)  # rad/s/sqrt(Hz)
ACCEL_NOISE = 4e-3  # m/s^2/sqrt(Hz)
MAG_NOISE = 30e-9  # T/sqrt(Hz)

Motion = Callable[[FloatArray], FloatArray]


def sway(time: FloatArray) -> Rotation:
    """The parent link turns about all axes."""
    angles = np.column_stack([0.8 * np.sin(0.7 * time), 0.4 * np.sin(1.1 * time), 0.3 * np.sin(0.9 * time)])
    return Rotation.from_euler("ZYX", angles)


def rest(time: FloatArray) -> Rotation:
    """The parent link lies level."""
    return Rotation.identity(len(time))


def swing(
    motion: Motion,
    axes: tuple[Vec3, ...] = (X,),
    *,
    seconds: float = 20.0,
    rate: float = 100.0,
    noise: float = 1.0,
    bias: float = 0.0,
    parent: Callable[[FloatArray], Rotation] = rest,
    mag: bool = False,
    seed: int = 0,
    **joint: Any,
) -> tuple[Robot, Recording, FloatArray]:
    """(robot, recording, true positions (T, axes)) of `motion`: time s -> positions rad, (T,) or (T, axes).

    `noise` scales the noise, `bias` is the largest component of the gyro biases, rad/s.
    """
    generator = np.random.default_rng(seed)
    time = np.arange(-1, round(seconds * rate)) / rate
    positions = np.asarray(motion(time)).reshape(len(time), len(axes))
    base = parent(time)
    link = base
    for axis, column in zip(axes, positions.T, strict=True):
        link = link * Rotation.from_rotvec(np.outer(column, axis))
    gyro, accel, field, sensors = {}, {}, {}, []
    mountings = Rotation.from_rotvec(0.3 * generator.standard_normal((2, 3)))
    offsets = bias * generator.uniform(-1.0, 1.0, (2, 3))
    for name, orientation, mounting, offset in zip(("base", "link"), (base, link), mountings, offsets, strict=True):
        x, y, z, w = mounting.as_quat().tolist()
        sensors.append(
            Sensor(name, name, mounting=(x, y, z, w), mag=mag, gyro_noise=GYRO_NOISE, accel_noise=ACCEL_NOISE)
        )
        intervals = np.full(len(time) - 1, 1.0 / rate)
        at_stamps = orientation[1:]

        def white(density: float) -> FloatArray:
            samples = generator.standard_normal((len(time) - 1, 3))
            return np.asarray(noise * density * math.sqrt(rate) * samples)

        gyro[name] = mounting.apply(mean_rate(orientation, intervals), inverse=True) + offset + white(GYRO_NOISE)
        up = at_stamps.apply([0.0, 0.0, GRAVITY], inverse=True)
        accel[name] = mounting.apply(up, inverse=True) + white(ACCEL_NOISE)
        if mag:
            field[name] = mounting.apply(at_stamps.apply(EARTH_FIELD, inverse=True), inverse=True) + white(MAG_NOISE)
    robot = Robot(("base", "link"), (Joint("joint", "base", "link", axes, **joint),), tuple(sensors))
    stamps = np.round(time[1:] * 1e9).astype(np.int64)
    recording = Recording(stamps, gyro, accel, field, period=np.full(len(stamps), 1.0 / rate))
    return robot, recording, positions[1:]


def lose(recording: Recording, rows: FloatArray, sensors: tuple[str, ...] = ("base", "link")) -> Recording:
    """A copy in which the samples of `sensors` are missing in `rows` (mask or indices)."""

    def without(tables: dict[str, FloatArray]) -> dict[str, FloatArray]:
        copies = {name: table.copy() for name, table in tables.items()}
        for name in sensors:
            if name in copies:
                copies[name][rows] = np.nan
        return copies

    return Recording(
        recording.stamps,
        without(recording.gyro),
        without(recording.accel),
        without(recording.mag),
        period=recording.period,
        reset=recording.reset,
    )


def take(recording: Recording, rows: FloatArray) -> Recording:
    """Only `rows`: whole frames are lost."""
    return Recording(
        recording.stamps[rows],
        {name: table[rows] for name, table in recording.gyro.items()},
        {name: table[rows] for name, table in recording.accel.items()},
        {name: table[rows] for name, table in recording.mag.items()},
        period=None if recording.period is None else recording.period[rows],
        reset=None if recording.reset is None else recording.reset[rows],
    )
