"""One's own robot, as its configuration describes it: what its sensors would say before there is any hardware.

After a rest in the zero pose every joint coordinate swings over the whole of its limits, each at a frequency of its
own, and the root link turns about all directions; both set in with a continuous acceleration.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Vec3
from jointest_ros.core.params import param
from jointest_ros.core.robot import Robot, Sensor
from jointest_ros.sim import hand
from jointest_ros.sim.hall import HallReadout
from jointest_ros.sim.hand import GYRO_BIAS, LARGEST_MOUNTING_ANGLE, PALM_TURNS, HandRecording, ImuOptions
from jointest_ros.sim.imu import GRAVITY, Imu, ImuNoise, random_mounting
from jointest_ros.sim.motion import LinkMotion, Signal, constant, minimum_jerk, raised_cosine, sine, tree_motion
from jointest_ros.sim.simulated import SimulationError

USUAL_LIMITS = (math.radians(-45.0), math.radians(45.0))  # where the configuration has none
FARTHEST = math.radians(150.0)  # from the zero pose, however wide the limits are
ONSET_S = 3.0
SLOWEST_HZ, FASTEST_HZ = 0.2, 0.5
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)  # its multiples modulo 1 are spread evenly, however many there are
# which direction of the root link points up -> how it is turned: axis, deg
_UP: dict[str, tuple[Vec3, float]] = {
    "z": ((1.0, 0.0, 0.0), 0.0),
    "-z": ((1.0, 0.0, 0.0), 180.0),
    "y": ((1.0, 0.0, 0.0), 90.0),
    "-y": ((1.0, 0.0, 0.0), -90.0),
    "x": ((0.0, 1.0, 0.0), -90.0),
    "-x": ((0.0, 1.0, 0.0), 90.0),
}


@dataclass(frozen=True)
class OwnOptions(ImuOptions):
    """What can be chosen of the recording of one's own robot."""

    rate_hz: float = param(100.0, "samples per second of every sensor", unit="Hz", low=10.0, high=1000.0)
    tempo: float = param(1.0, "factor of the speed of the joints; 0: they do not move", low=0.0, high=10.0)
    root_turns: bool = param(True, "the root link turns about all directions (never where a world link is configured)")
    up: str = param("z", "direction of the root link that points up at the start", choices=tuple(_UP))
    mounting: str = param(
        "configured",
        "all IMUs as in the configuration, or each turned by up to 10 deg besides",
        choices=("configured", "askew"),
    )


def stretches(robot: Robot, options: OwnOptions, chunk_s: float = 10.0) -> Iterator[HandRecording]:
    """The recording in consecutive stretches of `chunk_s` seconds, in the memory of one of them.

    Readings are those of the sensors themselves: with the calibration of `robot` not yet applied.

    Raises:
        SimulationError: the robot cannot be simulated.
    """
    _check(robot, options)
    *seeds, hall_seed = np.random.SeedSequence(options.seed).spawn(len(robot.sensors) + 1)
    imus = [_imu(sensor, options, seed) for sensor, seed in zip(robot.sensors, seeds, strict=True)]
    offsets = np.zeros(len(robot.hall))
    hall = HallReadout(robot.hall, offsets, 0.0, 0.0, hall_seed, options.noise) if robot.hall else None
    sensors = []
    for sensor, imu in zip(robot.sensors, imus, strict=True):
        x, y, z, w = imu.mounting.as_quat().tolist()
        sensors.append(replace(sensor, mounting=(x, y, z, w)))
    robot = replace(robot, sensors=tuple(sensors))
    return hand.measured(options, robot, imus, partial(_motion, options, robot), chunk_s, hall)


def _check(robot: Robot, options: OwnOptions) -> None:
    if not robot.joints:
        raise SimulationError("robot.joints: none; a robot without joints has no angles that could be simulated")
    if not robot.hall and not any(sensor.gyro or sensor.accel or sensor.mag for sensor in robot.sensors):
        raise SimulationError("sensors: none in use, nor is there hall; a robot without sensors cannot be simulated")
    if robot.world and options.up != "z":
        raise SimulationError(f"up: '{options.up}' is not allowed; z of the world link '{robot.world}' points up")
    for joint in robot.joints:
        for name, (low, high) in zip(joint.coordinates, joint.limits or (), strict=False):
            if not low <= 0.0 <= high:
                raise SimulationError(
                    f"robot.joints.{joint.name}.limits_deg: {math.degrees(low):g} to {math.degrees(high):g} is not "
                    f"allowed; a simulation starts in the zero pose, where '{name}' is 0"
                )


def _imu(sensor: Sensor, options: OwnOptions, seed: np.random.SeedSequence) -> Imu:
    """The sensor with the errors of its data sheet, and with those that its calibration takes out again."""
    mounting_seed, imu_seed = seed.spawn(2)
    askew = LARGEST_MOUNTING_ANGLE if options.mounting == "askew" else 0.0
    noise = ImuNoise(
        gyro_noise=sensor.gyro_noise if options.noise else 0.0,
        accel_noise=sensor.accel_noise if options.noise else 0.0,
        mag_noise=hand.MAG_NOISE if options.noise else 0.0,
        gyro_bias=GYRO_BIAS if options.bias else 0.0,
        gyro_bias_walk=sensor.gyro_bias_walk if options.bias else 0.0,
        gyro_scale=options.gyro_scale,
        accel_bias=1e-3 * options.accel_bias_mg * GRAVITY,
        gyro_range=sensor.gyro_range,
        accel_range=sensor.accel_range,
    )
    mounting = Rotation.from_quat(sensor.mounting) * random_mounting(np.random.default_rng(mounting_seed), askew)
    imu = Imu(noise, mounting, options.rate_hz, imu_seed)
    imu.gyro_scale = imu.gyro_scale / np.array(sensor.gyro_scale)
    imu.accel_axes = np.asarray(np.linalg.inv(sensor.accel_matrix), dtype=float)
    imu.accel_bias = imu.accel_bias - imu.accel_axes @ np.array(sensor.accel_offset)
    return imu


def _motion(
    options: OwnOptions, robot: Robot, time: FloatArray
) -> tuple[Mapping[str, Signal], Mapping[str, LinkMotion]]:
    """Joint angles (rad) and the motion of all links at `time` (n,), s."""
    tau = time - options.zero_pose_s
    root = LinkMotion.translating(np.zeros((len(time), 3)))
    if options.root_turns and not robot.world:
        for (axis, *_), angle in zip(PALM_TURNS, hand.palm_turns(tau, minimum_jerk), strict=True):
            root = root.child(axis, angle)
    axis, turned_deg = _UP[options.up]
    root = root.child(axis, constant(time, math.radians(turned_deg)))
    limits = [pair for joint in robot.joints for pair in joint.limits or (USUAL_LIMITS,) * len(joint.axes)]
    angles = {
        name: _swing(tau, options.tempo * (SLOWEST_HZ + (FASTEST_HZ - SLOWEST_HZ) * (k * _GOLDEN % 1.0)), *pair)
        for k, (name, pair) in enumerate(zip(robot.coordinates, limits, strict=True))
    }
    return angles, tree_motion(robot, root, angles)


def _swing(tau: FloatArray, frequency_hz: float, low: float, high: float) -> Signal:
    """A harmonic oscillation between `low` and `high`, rad, that sets in at 0: middle + half the width times sin(.)."""
    low, high = max(low, -FARTHEST), min(high, FARTHEST)
    wave = sine(tau, frequency_hz) * math.sqrt(-low * high) + raised_cosine(tau, frequency_hz) * (low + high)
    return minimum_jerk(tau, ONSET_S) * wave
