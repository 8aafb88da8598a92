"""The rig `finger`: a palm and three links, four IMUs, three hinges about x.

Scenarios of the specification of the passive complementary filter on IMU pairs (Santaera et al. 2015), section 3. They
begin with a zero pose in which everything is still; tau counts from its end. Then the joints follow
q_i = s A_i (1 - cos 2 pi f_i tau) / 2 and, where the palm moves, its orientation in the world is
Rz(60 sin .10 Hz) Ry(30 sin .17 Hz) Rx(30 sin .13 Hz) deg; both set in with a smoothstep s.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray, Recording, Vec3
from jointest_ros.core.params import param
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.sim.imu import GRAVITY, Imu, ImuNoise, random_mounting
from jointest_ros.sim.motion import LinkMotion, Signal, constant, raised_cosine, sine, smoothstep
from jointest_ros.sim.simulated import SimulatedRobot, SimulationOptions, read_options

LINKS = ("palm", "proximal", "middle", "distal")  # each bears one IMU, named like its link
JOINTS = ("finger_mcp", "finger_pip", "finger_dip")
AXIS: Vec3 = (1.0, 0.0, 0.0)
LENGTHS = (0.050, 0.040, 0.025, 0.020)  # m, along y; of the palm: from its reference point to the first joint

JOINT_AMPLITUDES_DEG = (70.0, 60.0, 40.0)
JOINT_FREQUENCIES_HZ = (0.35, 0.35, 0.5)
JOINT_ONSET_S = 2.0
PALM_TURNS: tuple[tuple[Vec3, float, float], ...] = (  # axis, deg, Hz; z first
    ((0.0, 0.0, 1.0), 60.0, 0.10),
    ((0.0, 1.0, 0.0), 30.0, 0.17),
    ((1.0, 0.0, 0.0), 30.0, 0.13),
)
PALM_ONSET_S = 3.0
SHAKING_PEAK = 0.3 * GRAVITY  # m/s^2
SHAKING_HZ = (1.5, 1.9, 2.3)  # world x, y, z

LARGEST_MOUNTING_ANGLE = math.radians(10.0)
GYRO_NOISE = math.radians(0.005)  # rad/s/sqrt(Hz): this and the next three are an MPU6050
GYRO_BIAS_WALK = math.radians(0.001)  # rad/s/sqrt(s)
GYRO_BIAS = math.radians(3.0)  # rad/s
ACCEL_NOISE = 400e-6 * GRAVITY  # m/s^2/sqrt(Hz)
MAG_NOISE = 30e-9  # tesla/sqrt(Hz), .3 uT a sample at 100 Hz; the specification has no magnetometer


@dataclass(frozen=True)
class FingerScenario:
    """What moves: the joints at `tempo` times their frequencies (0: not at all), the palm, and the whole hand."""

    description: str
    tempo: float = 1.0
    palm: bool = False
    shaking: bool = False


SCENARIOS = {
    "PA": FingerScenario("joints move, palm still"),
    "PC": FingerScenario("joints move, palm turns about all axes", palm=True),
    "PD": FingerScenario("as PC, and the hand is shaken by 0.3 g on every axis", palm=True, shaking=True),
    "PE": FingerScenario("as PA, three times as fast", tempo=3.0),
    "still": FingerScenario("nothing moves: the noise floor", tempo=0.0),
}


@dataclass(frozen=True)
class FingerOptions(SimulationOptions):
    """What can be chosen of a finger recording."""

    scenario: str = param("PA", "which motion", choices=tuple(SCENARIOS))
    zero_pose_s: float = param(10.0, "time at the start during which everything is still", unit="s", low=0.0)
    mounting: str = param(
        "ideal", "all IMUs aligned with their links, or each turned by up to 10 deg", choices=("ideal", "mounted")
    )
    noise: bool = param(True, "white noise of all sensors")
    bias: bool = param(True, "gyro biases of up to 3 deg/s a component, and their random walk")
    lever_arm: bool = param(True, "sensors at their places; false: all at the palm's reference point")
    accel_bias_mg: float = param(
        0.0, "norm of a constant accelerometer bias in a random direction for each IMU", unit="mg", low=0.0
    )
    elevation_deg: float = param(0.0, "elevation of the hinge axes above horizontal", unit="deg", low=0.0, high=90.0)
    mag: bool = param(False, "magnetometers as well, in an undisturbed field")


@dataclass(frozen=True, slots=True)
class FingerRecording(SimulatedRobot):
    """A finger recording with its ground truth.

    Attributes:
        orientation: sensor -> (T, 4) true rotation sensor to world, x, y, z, w.
        gyro_bias: sensor -> (T, 3) true bias, rad/s, sensor frame.
        accel_bias: sensor -> (3,) true bias, m/s^2, sensor frame.
    """

    orientation: dict[str, FloatArray]
    gyro_bias: dict[str, FloatArray]
    accel_bias: dict[str, FloatArray]


def simulate(scenario: str = "PA", **options: Any) -> FingerRecording:
    """A whole recording, its first stamp 0; `options` are the fields of `FingerOptions`.

    Raises:
        SimulationError: an unknown scenario or option, or a value that is not allowed.
    """
    chosen = read_options(FingerOptions, {"scenario": scenario, **options})
    return next(_stretches(chosen, _samples(chosen)))


def chunks(scenario: str = "PA", *, chunk_s: float = 10.0, **options: Any) -> Iterator[FingerRecording]:
    """The recording of `simulate` in consecutive stretches of `chunk_s` seconds, in the memory of one of them.

    Raises:
        SimulationError: an unknown scenario or option, or a value that is not allowed.
    """
    return stretches(read_options(FingerOptions, {"scenario": scenario, **options}), chunk_s)


def stretches(options: FingerOptions, chunk_s: float = 10.0) -> Iterator[FingerRecording]:
    """`chunks` for options that are made already."""
    return _stretches(options, max(1, round(chunk_s * options.rate_hz)))


def _samples(options: FingerOptions) -> int:
    return round(options.duration_s * options.rate_hz)


def _stretches(options: FingerOptions, size: int) -> Iterator[FingerRecording]:
    robot, imus = _assemble(options)
    samples = _samples(options)
    for start in range(0, samples, size):
        # one instant more than samples: the first gyro sample covers the interval before it
        instants = np.arange(start - 1, min(start + size, samples))
        stamps = np.round(instants * (1e9 / options.rate_hz)).astype(np.int64)
        yield _measure(options, robot, imus, stamps)


def _assemble(options: FingerOptions) -> tuple[Robot, list[Imu]]:
    """The robot and its IMUs, with everything that is drawn once."""
    noise = ImuNoise(
        gyro_noise=GYRO_NOISE if options.noise else 0.0,
        accel_noise=ACCEL_NOISE if options.noise else 0.0,
        mag_noise=MAG_NOISE if options.noise else 0.0,
        gyro_bias=GYRO_BIAS if options.bias else 0.0,
        gyro_bias_walk=GYRO_BIAS_WALK if options.bias else 0.0,
        accel_bias=1e-3 * options.accel_bias_mg * GRAVITY,
    )
    imus, sensors = [], []
    for number, seed in enumerate(np.random.SeedSequence(options.seed).spawn(len(LINKS))):
        mounting_seed, imu_seed = seed.spawn(2)
        largest = LARGEST_MOUNTING_ANGLE if options.mounting == "mounted" else 0.0
        mounting = random_mounting(np.random.default_rng(mounting_seed), largest)
        imus.append(Imu(noise, mounting, options.rate_hz, imu_seed))
        x, y, z, w = mounting.as_quat().tolist()
        sensors.append(
            Sensor(
                LINKS[number],
                LINKS[number],
                position=(0.0, 0.5 * _length(options, number) if number else 0.0, 0.0),
                mounting=(x, y, z, w),
                mag=options.mag,
                gyro_noise=GYRO_NOISE,
                gyro_bias_walk=GYRO_BIAS_WALK,
                accel_noise=ACCEL_NOISE,
            )
        )
    joints = tuple(Joint(name, LINKS[i], LINKS[i + 1], (AXIS,)) for i, name in enumerate(JOINTS))
    return Robot(LINKS, joints, tuple(sensors), name="finger"), imus


def _length(options: FingerOptions, link: int) -> float:
    return LENGTHS[link] if options.lever_arm else 0.0


def _measure(options: FingerOptions, robot: Robot, imus: list[Imu], stamps: NDArray[np.int64]) -> FingerRecording:
    """The samples at stamps[1:]."""
    time: FloatArray = stamps.astype(np.float64) * 1e-9
    intervals = np.diff(time)
    angles, links = _motion(options, time)
    recording = Recording(stamps[1:], gyro={}, accel={}, period=np.full(len(intervals), 1.0 / options.rate_hz))
    orientation, gyro_bias, accel_bias = {}, {}, {}
    for sensor, imu, link in zip(robot.sensors, imus, links, strict=True):
        at_stamps = link.orientation[1:]
        recording.gyro[sensor.name], gyro_bias[sensor.name] = imu.gyro(link.orientation, intervals)
        recording.accel[sensor.name] = imu.accel(at_stamps, link.acceleration_at(sensor.position)[1:])
        if options.mag:
            recording.mag[sensor.name] = imu.mag(at_stamps)
        orientation[sensor.name] = np.asarray((at_stamps * imu.mounting).as_quat())
        accel_bias[sensor.name] = imu.accel_bias
    return FingerRecording(
        robot,
        recording,
        JOINTS,
        np.column_stack([angle.value[1:] for angle in angles]),
        np.column_stack([angle.rate[1:] for angle in angles]),
        orientation,
        gyro_bias,
        accel_bias,
    )


def _motion(options: FingerOptions, time: FloatArray) -> tuple[list[Signal], list[LinkMotion]]:
    """Joint angles (rad) and the motion of palm and links at `time` (n,), s."""
    scenario = SCENARIOS[options.scenario]
    tau = time - options.zero_pose_s
    onset = smoothstep(tau, PALM_ONSET_S)
    shaking = np.zeros((len(time), 3))
    if scenario.shaking:
        shaking = SHAKING_PEAK * np.column_stack([(onset * sine(tau, f)).value for f in SHAKING_HZ])
    link = LinkMotion.translating(shaking)
    if scenario.palm:
        for axis, amplitude_deg, frequency_hz in PALM_TURNS:
            link = link.child(axis, onset * sine(tau, frequency_hz) * math.radians(amplitude_deg))
    # about -y: raises the x axis
    link = link.child((0.0, -1.0, 0.0), constant(time, math.radians(options.elevation_deg)))

    links, angles = [link], []
    onset = smoothstep(tau, JOINT_ONSET_S)
    for number, frequency_hz in enumerate(JOINT_FREQUENCIES_HZ):
        amplitude = math.radians(JOINT_AMPLITUDES_DEG[number])
        angle = onset * raised_cosine(tau, scenario.tempo * frequency_hz) * amplitude
        link = link.child(AXIS, angle, position=(0.0, _length(options, number), 0.0))
        angles.append(angle)
        links.append(link)
    return angles, links
