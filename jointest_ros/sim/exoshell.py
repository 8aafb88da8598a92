"""The rig `exoshell`: five links, four hinges, a gyro on each link, a mirrored pair of Hall sensors at each hinge.

Scenarios of the specification of the kinematically constrained Kalman filter (Yumbla et al. 2023), section 4, and the
paper's bending user. Some keep to the paper's sums of rates ("additive"), others compose the joints as rotations.

The voltages are read by a converter of 12 bits over 3.3 V (see hall.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray, Recording, Vec3
from jointest_ros.core.hall_sensor import HallSensor, SplineCurve
from jointest_ros.core.params import param
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.core.torso import torsos_of
from jointest_ros.sim.exoshell_motion import (
    MOTION_B,
    TABLE_1,
    Pose,
    X,
    Y,
    bend,
    fixed_base,
    gait,
    hold,
    walking_base,
)
from jointest_ros.sim.hall import HallReadout
from jointest_ros.sim.imu import Imu, ImuNoise, mean_rate
from jointest_ros.sim.motion import LinkMotion
from jointest_ros.sim.simulated import SimulatedRobot, SimulationOptions, read_options

LINKS = tuple(f"link_{number}" for number in range(1, 6))
JOINTS = tuple(f"joint_{number}" for number in range(1, 5))
GYROS = tuple(f"imu_{number}" for number in range(1, 6))
GYRO_NOISE = math.radians(0.0038)  # rad/s/sqrt(Hz), LSM6DSO
GYRO_BIAS_WALK = math.radians(0.002)  # rad/s/sqrt(s)
SIGMA = math.radians(3.2)  # rad, the paper's Hall noise
RAILS = (0.2, 1.8)  # V, DRV5053
SUPPLY = (0.0, 3.3)  # V
TWO_AXES = (X, Y, X, Y)
ONE_AXIS = (X, X, X, X)
# A sensor that is linear in the angle, 100 deg/V, so that noise of 3.2 deg is 32 mV everywhere.
LINEAR = SplineCurve((0.0, 3.3), (-165.0, 165.0))
_SUBSTEPS = 4  # orientations for each gyro sample: its mean rate is that of the rate, not of the turn
_PER_JOINT = tuple[tuple[float, float], ...]


_FREE = HallSensor("", hall_range=SUPPLY)


@dataclass(frozen=True)
class ExoshellScenario:
    """One scenario.

    Attributes:
        description: one line.
        move: angles of the joints over time.
        base: motion of the first link; None: the rates of the links are sums, as in the paper.
        axes: of the four joints.
        sensor: what all Hall sensors have in common.
        hall_noise: V, for each joint where they differ.
        hall_offsets: V, for both sensors of each joint.
        biases_dps: (5, 3) constant gyro biases; None: uniform in +-1 deg/s and a random walk.
    """

    description: str
    move: Callable[[FloatArray], Pose]
    base: Callable[[FloatArray], LinkMotion] | None = None
    axes: tuple[Vec3, ...] = TWO_AXES
    sensor: HallSensor = _FREE
    hall_noise: tuple[float, ...] | None = None
    hall_offsets: _PER_JOINT = ((0.0, 0.0),) * 4
    biases_dps: tuple[Vec3, ...] | None = None
    bias_walk: float = GYRO_BIAS_WALK


_TABLE_1_BIASES = (  # reproduce the paper's column "Gyro" in 100 s
    (0.05, -0.43, 0.0),
    (0.59836729, -0.34339746, 0.0),
    (0.22320508, -0.17400289, 0.0),
    (0.28729096, -0.01846473, 0.0),
    (0.247627, 0.33227556, 0.0),
)
_DRIFT_BIASES = tuple((bias, 0.0, 0.0) for bias in (0.10, -0.06, 0.12, -0.02, 0.2528))
_CLIPPED = HallSensor("", hall_range=RAILS, noise=0.020)
_LINEAR = HallSensor("", curve=LINEAR, hall_range=SUPPLY, noise=SIGMA / math.radians(100.0), resolution=0.0)
_DRIFT = ExoshellScenario(
    "about one axis, a posture held for an hour",
    hold(),
    axes=ONE_AXIS,
    sensor=_LINEAR,
    biases_dps=_DRIFT_BIASES,
    bias_walk=0.0,
)

SCENARIOS = {
    "bench": ExoshellScenario("motion like gait, sensors never clipped", gait(MOTION_B)),
    "table1": ExoshellScenario(
        "large motion, clipped sensors with voltage errors: made to look like the paper's Table 1",
        gait(TABLE_1),
        sensor=_CLIPPED,
        hall_noise=(0.0049, 0.0076, 0.0030, 0.0178),
        hall_offsets=((-0.0649, 0.0036), (-0.0116, 0.0454), (0.0582, -0.0094), (-0.0016, 0.0464)),
        biases_dps=_TABLE_1_BIASES,
    ),
    "clipped": ExoshellScenario("as bench, sensors of 0.2 to 1.8 V", gait(MOTION_B), sensor=_CLIPPED),
    "offset": ExoshellScenario(
        "1.8 times as large, clipped sensors that are off by -40 and +20 mV",
        gait(MOTION_B, 1.8),
        sensor=replace(_CLIPPED, noise=0.010),
        hall_offsets=((-0.040, 0.020),) * 4,
    ),
    "composed": ExoshellScenario("as bench, the joints as rotations", gait(MOTION_B), base=fixed_base),
    "composed-free": ExoshellScenario("as composed, the wearer walks and turns", gait(MOTION_B), base=walking_base),
    "drift": _DRIFT,
    "drift-hall-error": replace(
        _DRIFT, description="as drift, Hall sensors wrong by +4, -2, +3, +2 deg", move=hold((4.0, -2.0, 3.0, 2.0))
    ),
    "monte-carlo": ExoshellScenario(
        "about one axis, Hall noise of 3.2 deg", gait(MOTION_B), axes=ONE_AXIS, sensor=_LINEAR
    ),
    "human": ExoshellScenario(
        "a user bends by 30 deg; compression and over-extension shift the sensors",
        bend,
        base=fixed_base,
        sensor=_CLIPPED,
    ),
}


@dataclass(frozen=True)
class ExoshellOptions(SimulationOptions):
    """What can be chosen of an exoshell recording."""

    rate_hz: float = param(100.0, "samples per second of every sensor", unit="Hz", low=10.0, high=1000.0)
    duration_s: float = param(120.0, "length of the recording", unit="s", low=0.1, high=86400.0)
    scenario: str = param("bench", "which motion", choices=tuple(SCENARIOS))
    hall_offset_mv: float = param(
        0.0, "taken from the first voltage of every joint, added to the second", unit="mV", low=-500.0, high=500.0
    )
    hall_gain_percent: float = param(0.0, "error of the angle that Hall sensors see", unit="%", low=-50.0, high=50.0)
    hysteresis_deg: float = param(
        0.0, "play of the Hall sensors: width of the loop of angle seen over angle", unit="deg", low=0.0, high=45.0
    )


@dataclass(frozen=True, slots=True)
class ExoshellRecording(SimulatedRobot):
    """An exoshell recording with its ground truth.

    Attributes:
        truth_torso: (T, 3) rad, rotation vector of the last link in the first, or the sums of the angles (additive).
        truth_torso_orientation: (T, 4) the same as quaternions x, y, z, w.
        gyro_bias: sensor -> (T, 3) true bias, rad/s.
    """

    truth_torso: FloatArray
    truth_torso_orientation: FloatArray
    gyro_bias: dict[str, FloatArray]


def simulate(scenario: str = "bench", **options: Any) -> ExoshellRecording:
    """A whole recording, its first stamp 0; `options` are the fields of `ExoshellOptions`.

    Raises:
        SimulationError: an unknown scenario or option, or a value that is not allowed.
    """
    chosen = read_options(ExoshellOptions, {"scenario": scenario, **options})
    return next(stretches(chosen, chosen.duration_s))


def stretches(options: ExoshellOptions, chunk_s: float = 10.0) -> Iterator[ExoshellRecording]:
    """The recording of `simulate` in consecutive stretches of `chunk_s` seconds, in the memory of one of them."""
    samples, size = round(options.duration_s * options.rate_hz), max(1, round(chunk_s * options.rate_hz))
    rig = _Rig(options)
    for start in range(0, samples, size):
        yield rig.measure(start, min(start + size, samples))


def exoshell(scenario: str) -> Robot:
    """The robot of a scenario as its user knows it: with the noise of its sensors, but not their errors."""
    chosen = SCENARIOS[scenario]
    joints = [Joint(name, LINKS[k], LINKS[k + 1], (chosen.axes[k],)) for k, name in enumerate(JOINTS)]
    gyros = [
        Sensor(name, link, accel=False, gyro_noise=GYRO_NOISE, gyro_bias_walk=GYRO_BIAS_WALK)
        for name, link in zip(GYROS, LINKS, strict=True)
    ]
    noise = chosen.hall_noise or (chosen.sensor.noise,) * len(JOINTS)
    hall = [
        replace(chosen.sensor, joint=name, mirrored=mirrored, noise=sigma)
        for name, sigma in zip(JOINTS, noise, strict=True)
        for mirrored in (False, True)
    ]
    return Robot(LINKS, tuple(joints), tuple(gyros), name="exoshell", hall=tuple(hall))


class _Rig:
    """The robot with everything that is drawn once, and the state of what continues from stretch to stretch."""

    def __init__(self, options: ExoshellOptions) -> None:
        self.options, self.scenario = options, SCENARIOS[options.scenario]
        self.robot = exoshell(options.scenario)
        *gyro_seeds, hall_seed = np.random.SeedSequence(options.seed).spawn(len(GYROS) + 1)
        drawn = self.scenario.biases_dps is None
        noise = ImuNoise(
            gyro_noise=GYRO_NOISE,
            gyro_bias=math.radians(1.0) if drawn else 0.0,
            gyro_bias_walk=self.scenario.bias_walk,
        )
        self._imus = [Imu(noise, Rotation.identity(), options.rate_hz, seed) for seed in gyro_seeds]
        self._biases = np.radians(self.scenario.biases_dps or np.zeros((len(GYROS), 3)))
        both = 1e-3 * options.hall_offset_mv * np.array([-1.0, 1.0])
        self._hall = HallReadout(
            self.robot.hall,
            (np.array(self.scenario.hall_offsets) + both).ravel(),
            0.01 * options.hall_gain_percent,
            math.radians(options.hysteresis_deg),
            hall_seed,
        )

    def measure(self, start: int, end: int) -> ExoshellRecording:
        """Samples `start` to `end` - 1."""
        rate = self.options.rate_hz
        # one instant more than samples: the first gyro sample covers the interval before it
        stamps = np.round(np.arange(start - 1, end) * (1e9 / rate)).astype(np.int64)
        time: FloatArray = stamps.astype(np.float64) * 1e-9
        pose = self.scenario.move(time)
        position = np.column_stack([joint.value for joint in pose.joints])
        gyro: dict[str, FloatArray] = {}
        bias: dict[str, FloatArray] = {}
        for k, (name, rates) in enumerate(zip(GYROS, self._link_rates(time, position), strict=True)):
            gyro[name], bias[name] = (table + self._biases[k] for table in self._imus[k].gyro_of(rates))
        torso, orientation = torsos_of(self.scenario.axes, position[1:], self.scenario.base is not None)
        volts = self._hall.read(np.repeat(pose.seen[1:], 2, axis=1))
        return ExoshellRecording(
            self.robot,
            Recording(stamps[1:], gyro, {}, hall=volts, period=np.full(end - start, 1.0 / rate)),
            JOINTS,
            position[1:],
            np.column_stack([joint.rate[1:] for joint in pose.joints]),
            torso,
            orientation,
            bias,
        )

    def _link_rates(self, time: FloatArray, position: FloatArray) -> list[FloatArray]:
        """Mean rates (n, 3) of all links over the intervals between `time` (n + 1), link frames."""
        if self.scenario.base is None:
            rates = [np.zeros((len(time) - 1, 3))]
            means = np.diff(position, axis=0) / np.diff(time)[:, None]
            for mean, axis in zip(means.T, self.scenario.axes, strict=True):
                rates.append(rates[-1] + mean[:, None] * np.array(axis))
            return rates
        fine = np.interp(np.arange(_SUBSTEPS * (len(time) - 1) + 1) / _SUBSTEPS, np.arange(len(time)), time)
        links = [self.scenario.base(fine)]
        for joint, axis in zip(self.scenario.move(fine).joints, self.scenario.axes, strict=True):
            links.append(links[-1].child(axis, joint))
        steps = np.diff(fine)
        return [mean_rate(link.orientation, steps).reshape(-1, _SUBSTEPS, 3).mean(axis=1) for link in links]
