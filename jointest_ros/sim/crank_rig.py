"""The rig `slider_crank`: scenarios of `slider_crank` as recordings of a robot.

Links `crank` (a) and `rod` (b) meet at the joint `crank_pin` (O), whose position is the angle of the rod relative to
the crank: -th_ab. The frame of the crank begins at its pivot, x towards O; z is the joint's axis, horizontal where the
scenario has gravity in the plane of motion, else vertical: then z of all accelerometers reads gravity.

At 100 Hz, x and y of the sensors are trial `seed` of the scenario; at other rates the density of the noise is the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from jointest_ros.core.frame import Recording
from jointest_ros.core.params import param
from jointest_ros.core.robot import Joint, Robot, Sensor
from jointest_ros.sim.imu import GRAVITY
from jointest_ros.sim.simulated import SimulatedRobot, SimulationOptions, read_options
from jointest_ros.sim.slider_crank import PERIOD, SCENARIOS, CrankMotion, motion

LINKS = ("crank", "rod")
JOINT = "crank_pin"


@dataclass(frozen=True)
class CrankOptions(SimulationOptions):
    """What can be chosen of a recording of the slider-crank."""

    rate_hz: float = param(100.0, "samples per second of every sensor", unit="Hz", low=100.0, high=1000.0)
    duration_s: float = param(10.01, "length of the recording", unit="s", low=0.1, high=86400.0)
    scenario: str = param("B", "which motion", choices=tuple(SCENARIOS))
    length: float = param(0.3, "L, length of the crank, where the scenario has none", unit="m", low=0.02, high=10.0)
    noise: float = param(1.0, "factor on the noise of the scenario; 0: none", low=0.0, high=100.0)


def simulate(scenario: str = "B", **options: Any) -> SimulatedRobot:
    """A whole recording, its first stamp 0; `options` are the fields of `CrankOptions`.

    Raises:
        SimulationError: an unknown scenario or option, or a value that is not allowed.
    """
    chosen = read_options(CrankOptions, {"scenario": scenario, **options})
    return next(stretches(chosen, chosen.duration_s))


def stretches(options: CrankOptions, chunk_s: float = 10.0) -> Iterator[SimulatedRobot]:
    """The recording of `simulate` in consecutive stretches of `chunk_s` seconds, in the memory of one of them."""
    scenario, period = SCENARIOS[options.scenario], 1.0 / options.rate_hz
    sigma = options.noise * scenario.sigma * math.sqrt(PERIOD / period)
    in_plane, across = np.random.default_rng(options.seed), np.random.default_rng((options.seed, 1))
    upward = 0.0 if scenario.gravity else GRAVITY
    samples, size = round(options.duration_s * options.rate_hz), max(1, round(chunk_s * options.rate_hz))
    for start in range(0, samples, size):
        number = min(size, samples - start)
        true = motion(scenario, options.length, first=start, samples=number, period=period)
        robot = slider_crank(options, true)
        readings = true.channels + sigma * in_plane.standard_normal(true.channels.shape)
        vertical = upward + sigma * across.standard_normal((number, len(robot.sensors)))
        vectors = np.concatenate([readings.reshape(number, -1, 2), vertical[:, :, None]], axis=2)
        accel = {sensor.name: vectors[:, k] for k, sensor in enumerate(robot.sensors)}
        stamps = np.round(np.arange(start, start + number) * (1e9 / options.rate_hz)).astype(np.int64)
        recording = Recording(stamps, {}, accel, period=np.full(number, period))
        w_a, w_b, th_ab = true.state.T
        yield SimulatedRobot(robot, recording, (JOINT,), -th_ab[:, None], (w_b - w_a)[:, None])


def slider_crank(options: CrankOptions, true: CrankMotion) -> Robot:
    """The robot of a scenario. Without noise its sensors keep the scenario's figure: no filter can do with none."""
    scenario = SCENARIOS[options.scenario]
    length = (scenario.lengths or (options.length,))[0]
    density = (options.noise or 1.0) * scenario.sigma * math.sqrt(2.0 * PERIOD)
    sensors = [
        Sensor(f"{letter}{k}", link, (begin + x, y, 0.0), gyro=False, accel_noise=density)
        for letter, link, begin, places in (
            ("a", LINKS[0], length, true.positions_a),
            ("b", LINKS[1], 0.0, true.positions_b),
        )
        for k, (x, y) in enumerate(places.tolist(), 1)
    ]
    joint = Joint(JOINT, *LINKS, ((0.0, 0.0, 1.0),), continuous=True, origin=(length, 0.0, 0.0))
    return Robot(LINKS, (joint,), tuple(sensors), name="slider_crank")
