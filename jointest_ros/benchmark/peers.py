"""A step of the peers that are installed, each as its own documentation calls it, on the samples of one IMU."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from jointest_ros.benchmark.cost import Task
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import STANDARD_GRAVITY


@dataclass(frozen=True)
class Peer:
    """What one peer does in a round: sample by sample, and by arrays where it can."""

    name: str
    update: Task
    arrays: Task | None = None


def installed(gyro: list[FloatArray], accel: list[FloatArray], rate_hz: float) -> Iterator[Peer]:
    """Those that are installed; `gyro` (rad/s), `accel` (m/s^2): (n, 3) arrays, one a round."""
    missing = absent()
    for package, make in _PEERS.items():
        if package not in missing:
            yield make(gyro, accel, rate_hz)


def absent() -> list[str]:
    """Packages of peers that are not installed."""
    return [package for package in _PEERS if importlib.util.find_spec(package) is None]


def _loop(step: Callable[[FloatArray, FloatArray], object], gyro: list[FloatArray], accel: list[FloatArray]) -> Task:
    samples = [list(zip(rates, forces, strict=True)) for rates, forces in zip(gyro, accel, strict=True)]

    def task(number: int) -> int:
        for rate, force in samples[number]:
            step(rate, force)
        return len(samples[number])

    return task


def _vqf(gyro: list[FloatArray], accel: list[FloatArray], rate_hz: float) -> Peer:
    vqf = importlib.import_module("vqf").VQF
    by_step, by_arrays = vqf(1.0 / rate_hz), vqf(1.0 / rate_hz)

    def batch(number: int) -> int:
        by_arrays.updateBatch(gyro[number], accel[number])
        return len(gyro[number])

    return Peer("vqf", _loop(by_step.update, gyro, accel), batch)


def _imufusion(gyro: list[FloatArray], accel: list[FloatArray], rate_hz: float) -> Peer:
    imufusion = importlib.import_module("imufusion")
    filter_, settings = imufusion.Ahrs(), imufusion.AhrsSettings()
    settings.sample_rate = rate_hz
    filter_.set_settings(settings)
    degrees, in_g = [np.degrees(one) for one in gyro], [one / STANDARD_GRAVITY for one in accel]
    return Peer("imufusion", _loop(filter_.update_no_magnetometer, degrees, in_g))


def _mahony(gyro: list[FloatArray], accel: list[FloatArray], rate_hz: float) -> Peer:
    mahony = importlib.import_module("ahrs.filters").Mahony
    filter_ = mahony(frequency=rate_hz)
    attitude = np.array([1.0, 0.0, 0.0, 0.0])

    def step(rate: FloatArray, force: FloatArray) -> None:
        nonlocal attitude
        attitude = filter_.updateIMU(attitude, rate, force)

    def batch(number: int) -> int:
        mahony(gyr=gyro[number], acc=accel[number], frequency=rate_hz)
        return len(gyro[number])

    return Peer("ahrs Mahony", _loop(step, gyro, accel), batch)


def _filterpy(gyro: list[FloatArray], accel: list[FloatArray], _rate_hz: float) -> Peer:
    """Its bare machinery, with the sizes of the accelerometer paper's model: 3 states, 4 measurements."""
    filter_ = importlib.import_module("filterpy.kalman").ExtendedKalmanFilter(dim_x=3, dim_z=4)
    filter_.F = np.eye(3)
    jacobian = np.vstack([np.eye(3), np.ones(3)])

    def step(_rate: FloatArray, _force: FloatArray) -> None:
        filter_.predict()
        filter_.update(np.zeros((4, 1)), lambda x: jacobian, lambda x: jacobian @ x)

    return Peer("filterpy EKF", _loop(step, gyro, accel))


_PEERS: dict[str, Callable[[list[FloatArray], list[FloatArray], float], Peer]] = {
    "vqf": _vqf,
    "imufusion": _imufusion,
    "ahrs": _mahony,
    "filterpy": _filterpy,
}
