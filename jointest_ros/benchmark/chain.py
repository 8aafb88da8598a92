"""A simulated serial chain of any length: what steps are measured on. It moves from a still start, with plain noise."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Recording, Vec3
from jointest_ros.core.hall_sensor import HallSensor
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.sim.imu import Imu, ImuNoise, mean_rate
from jointest_ros.sim.motion import LinkMotion, Signal, minimum_jerk, sine, tree_motion

RATE_HZ = 500.0
STILL_S = 1.2  # at the start; longer than what pcf calibrates from
X: Vec3 = (1.0, 0.0, 0.0)
Y: Vec3 = (0.0, 1.0, 0.0)
Z: Vec3 = (0.0, 0.0, 1.0)

_LENGTH: Vec3 = (0.0, 0.2, 0.0)  # of a link, m
_NOISE = ImuNoise(gyro_noise=math.radians(0.01), accel_noise=0.004, gyro_bias=math.radians(0.3))
_HALL_SIGMA = 0.01  # V
_NARROW = math.radians(12.0)  # amplitude of every coordinate
_WIDE = math.radians(45.0)  # of arrays: slow links tell accelerometers little, and steps that start anew cost more


def hinges(joints: int) -> list[tuple[Vec3, ...]]:
    """Axes that alternate, as in the exoshell."""
    return [((X,), (Y,))[k % 2] for k in range(joints)]


def chain(axes: Sequence[tuple[Vec3, ...]], samples: int, accelerometers: bool = False) -> tuple[Robot, Recording]:
    """The robot and `samples` frames at 500 Hz; the root link stands still.

    Args:
        axes: of each joint, from the root.
        accelerometers: two accelerometers on every link; else an IMU on each, and two Hall sensors at every coordinate.
    """
    links = tuple(f"link_{k}" for k in range(len(axes) + 1))
    joints = tuple(Joint(f"joint_{k}", links[k], links[k + 1], one, origin=_LENGTH) for k, one in enumerate(axes))
    sensors = tuple(sensor for link in links for sensor in _sensors(link, accelerometers))
    names = [name for joint in joints for name in joint.coordinates]
    hall = () if accelerometers else tuple(_hall(name, mirrored) for name in names for mirrored in (False, True))
    robot = Robot(links, joints, sensors, name="chain", hall=hall)
    stamps = np.round(np.arange(-1, samples) * (1e9 / RATE_HZ)).astype(np.int64)
    time: FloatArray = stamps.astype(np.float64) * 1e-9
    signals = [_swing(time, number, _WIDE if accelerometers else _NARROW) for number in range(len(names))]
    still = LinkMotion.translating(np.zeros((len(time), 3)))
    moving = tree_motion(robot, still, dict(zip(names, signals, strict=True)))
    gyro, accel = {}, {}
    for sensor, seed in zip(sensors, np.random.SeedSequence(0).spawn(len(sensors)), strict=True):
        link = moving[sensor.link]
        imu = Imu(_NOISE, Rotation.identity(), RATE_HZ, seed)
        accel[sensor.name] = imu.accel(link.orientation, link.acceleration_at(sensor.position))[1:]
        if sensor.gyro:
            gyro[sensor.name] = imu.gyro_of(mean_rate(link.orientation, np.diff(time)))[0]
    volts = None
    if hall:
        noise = np.random.default_rng(0).standard_normal((samples, len(hall)))
        seen = [sensor.voltage(signals[k // 2].value[1:]) for k, sensor in enumerate(hall)]
        volts = np.column_stack(seen) + _HALL_SIGMA * noise
    return robot, Recording(stamps[1:], gyro, accel, hall=volts, period=np.full(samples, 1.0 / RATE_HZ))


def _sensors(link: str, accelerometers: bool) -> list[Sensor]:
    if not accelerometers:
        return [Sensor(link, link, (0.0, 0.1, 0.0))]
    return [Sensor(f"{link}_{y}", link, (0.0, y, 0.0), gyro=False) for y in (0.05, 0.15)]


def _hall(name: str, mirrored: bool) -> HallSensor:
    return HallSensor(name, mirrored=mirrored, noise=_HALL_SIGMA, hall_range=(0.0, 3.3))


def _swing(time: FloatArray, number: int, amplitude: float) -> Signal:
    """Back and forth, rad, every coordinate at a frequency of its own between 0.5 and 1 Hz."""
    moving = time - STILL_S
    return minimum_jerk(moving, 1.0) * sine(moving, 0.5 + 0.5 * math.modf(0.382 * number)[0]) * amplitude
