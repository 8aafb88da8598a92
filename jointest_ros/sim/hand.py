"""What the simulated hands share: an MPU6050 on each link, what can be chosen, and the samples of a motion.

Scenarios begin with a zero pose in which everything is still; tau counts from its end. Section 3 of the specification
of the passive complementary filter on IMU pairs (Santaera et al. 2015).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray, Recording, Vec3
from jointest_ros.core.params import param
from jointest_ros.core.robot import Robot, Sensor
from jointest_ros.sim.hall import HallReadout
from jointest_ros.sim.imu import GRAVITY, Imu, ImuNoise, random_mounting
from jointest_ros.sim.motion import LinkMotion, Signal, sine, smoothstep
from jointest_ros.sim.simulated import SimulatedRobot, SimulationOptions

PALM_TURNS: tuple[tuple[Vec3, float, float], ...] = (  # axis, deg, Hz; z first
    ((0.0, 0.0, 1.0), 60.0, 0.10),
    ((0.0, 1.0, 0.0), 30.0, 0.17),
    ((1.0, 0.0, 0.0), 30.0, 0.13),
)
PALM_ONSET_S = 3.0

LARGEST_MOUNTING_ANGLE = math.radians(10.0)
GYRO_NOISE = math.radians(0.005)  # rad/s/sqrt(Hz): this and the next three are an MPU6050
GYRO_BIAS_WALK = math.radians(0.001)  # rad/s/sqrt(s)
GYRO_BIAS = math.radians(3.0)  # rad/s
ACCEL_NOISE = 400e-6 * GRAVITY  # m/s^2/sqrt(Hz)
MAG_NOISE = 30e-9  # tesla/sqrt(Hz), .3 uT a sample at 100 Hz; the specification has no magnetometer


@dataclass(frozen=True)
class ImuOptions(SimulationOptions):
    """What can be chosen of the recording of anything with IMUs."""

    zero_pose_s: float = param(10.0, "time at the start during which everything is still", unit="s", low=0.0)
    noise: bool = param(True, "white noise of all sensors")
    bias: bool = param(True, "gyro biases of up to 3 deg/s a component, and their random walk")
    gyro_scale: float = param(
        0.0, "error of the scale of each gyro axis, uniform in +- this share of it", low=0.0, high=0.5
    )
    accel_bias_mg: float = param(
        0.0, "norm of a constant accelerometer bias in a random direction for each IMU", unit="mg", low=0.0
    )


@dataclass(frozen=True)
class HandOptions(ImuOptions):
    """What can be chosen of the recording of any hand."""

    mounting: str = param(
        "ideal", "all IMUs aligned with their links, or each turned by up to 10 deg", choices=("ideal", "mounted")
    )
    lever_arm: bool = param(True, "sensors at their places; false: all at the palm's reference point")
    mag: bool = param(False, "magnetometers as well, in an undisturbed field")


@dataclass(frozen=True, slots=True)
class HandRecording(SimulatedRobot):
    """The recording of IMUs on moving links with its ground truth.

    Attributes:
        orientation: sensor -> (T, 4) true rotation sensor to world, x, y, z, w.
        gyro_bias: sensor -> (T, 3) true bias, rad/s, sensor frame.
        accel_bias: sensor -> (3,) true bias, m/s^2, sensor frame.
        gyro_scale: sensor -> (3,) reading over rate of each axis.
    """

    orientation: dict[str, FloatArray]
    gyro_bias: dict[str, FloatArray]
    accel_bias: dict[str, FloatArray]
    gyro_scale: dict[str, FloatArray] = field(default_factory=dict)


# the angle of every joint coordinate and the motion of every link at the given times (n,), s
Motion = Callable[[FloatArray], tuple[Mapping[str, Signal], Mapping[str, LinkMotion]]]


def palm_turns(tau: FloatArray, rise: Callable[[FloatArray, float], Signal] = smoothstep) -> list[Signal]:
    """The angles (rad) of `PALM_TURNS` at `tau`, s, that set in with `rise`."""
    onset = rise(tau, PALM_ONSET_S)
    return [onset * sine(tau, frequency_hz) * math.radians(amplitude) for _, amplitude, frequency_hz in PALM_TURNS]


def stretches(options: HandOptions, robot: Robot, motion: Motion, chunk_s: float) -> Iterator[HandRecording]:
    """The recording in consecutive stretches of `chunk_s` seconds; `robot` has its sensors ideally mounted."""
    robot, imus = _instrument(options, robot)
    yield from measured(options, robot, imus, motion, chunk_s)


def measured(
    options: SimulationOptions,
    robot: Robot,
    imus: Sequence[Imu],
    motion: Motion,
    chunk_s: float,
    hall: HallReadout | None = None,
) -> Iterator[HandRecording]:
    """What `imus` (one for each sensor of the robot) and Hall sensors say of a motion, in stretches of `chunk_s` s."""
    samples, size = round(options.duration_s * options.rate_hz), max(1, round(chunk_s * options.rate_hz))
    for start in range(0, samples, size):
        # one instant more than samples: the first gyro sample covers the interval before it
        instants = np.arange(start - 1, min(start + size, samples))
        stamps = np.round(instants * (1e9 / options.rate_hz)).astype(np.int64)
        yield _measure(options.rate_hz, robot, imus, stamps, motion, hall)


def _instrument(options: HandOptions, robot: Robot) -> tuple[Robot, list[Imu]]:
    """The robot with its sensors as they are mounted, and the IMUs, with everything that is drawn once."""
    noise = ImuNoise(
        gyro_noise=GYRO_NOISE if options.noise else 0.0,
        accel_noise=ACCEL_NOISE if options.noise else 0.0,
        mag_noise=MAG_NOISE if options.noise else 0.0,
        gyro_bias=GYRO_BIAS if options.bias else 0.0,
        gyro_bias_walk=GYRO_BIAS_WALK if options.bias else 0.0,
        gyro_scale=options.gyro_scale,
        accel_bias=1e-3 * options.accel_bias_mg * GRAVITY,
    )
    imus: list[Imu] = []
    sensors: list[Sensor] = []
    for sensor, seed in zip(robot.sensors, np.random.SeedSequence(options.seed).spawn(len(robot.sensors)), strict=True):
        mounting_seed, imu_seed = seed.spawn(2)
        largest = LARGEST_MOUNTING_ANGLE if options.mounting == "mounted" else 0.0
        mounting = random_mounting(np.random.default_rng(mounting_seed), largest)
        imus.append(Imu(noise, mounting, options.rate_hz, imu_seed))
        x, y, z, w = mounting.as_quat().tolist()
        sensors.append(
            replace(
                sensor,
                mounting=(x, y, z, w),
                mag=options.mag,
                gyro_noise=GYRO_NOISE,
                gyro_bias_walk=GYRO_BIAS_WALK,
                accel_noise=ACCEL_NOISE,
            )
        )
    return replace(robot, sensors=tuple(sensors)), imus


def _measure(
    rate_hz: float,
    robot: Robot,
    imus: Sequence[Imu],
    stamps: NDArray[np.int64],
    motion: Motion,
    hall: HallReadout | None,
) -> HandRecording:
    """The samples at stamps[1:]; those of gyros and accelerometers were true earlier, by the delay of their sensor."""
    time: FloatArray = stamps.astype(np.float64) * 1e-9
    intervals = np.diff(time)
    angles, links = motion(time)
    recording = Recording(stamps[1:], gyro={}, accel={}, period=np.full(len(intervals), 1.0 / rate_hz))
    if hall is not None:
        recording.hall = hall.read(np.column_stack([angles[sensor.joint].value[1:] for sensor in robot.hall]))
    orientation, gyro_bias, accel_bias, gyro_scale = {}, {}, {}, {}
    delayed = {0.0: links}
    for sensor, imu in zip(robot.sensors, imus, strict=True):
        if sensor.delay not in delayed:
            delayed[sensor.delay] = motion(time - sensor.delay)[1]
        at_stamps, link = links[sensor.link].orientation[1:], delayed[sensor.delay][sensor.link]
        if sensor.gyro:
            recording.gyro[sensor.name], gyro_bias[sensor.name] = imu.gyro(link.orientation, intervals)
        if sensor.accel:
            recording.accel[sensor.name] = imu.accel(link.orientation[1:], link.acceleration_at(sensor.position)[1:])
        if sensor.mag:
            recording.mag[sensor.name] = imu.mag(at_stamps)
        orientation[sensor.name] = np.asarray((at_stamps * imu.mounting).as_quat())
        accel_bias[sensor.name], gyro_scale[sensor.name] = imu.accel_bias, imu.gyro_scale
    return HandRecording(
        robot,
        recording,
        robot.coordinates,
        np.column_stack([angles[name].value[1:] for name in robot.coordinates]),
        np.column_stack([angles[name].rate[1:] for name in robot.coordinates]),
        orientation,
        gyro_bias,
        accel_bias,
        gyro_scale,
    )
