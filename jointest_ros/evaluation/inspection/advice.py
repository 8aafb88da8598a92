"""Settings that suit a recording better than the configured ones, as far as the recording shows it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.robot import STANDARD_GRAVITY, Robot, Sensor
from jointest_ros.evaluation.inspection.findings import Advice
from jointest_ros.evaluation.inspection.quality import Rest
from jointest_ros.evaluation.measures import rms

_NOISIER = 2.0  # times the configured figure: less is within what data sheets leave open
_SHAKEN = 0.05  # of g, rms of the norm about g while the robot moves
_ACCEL_TIME = 1.0  # s
_LEVERS = 0.003  # of g, rms of the acceleration of a sensor by the turning of its link


def noise_advice(sensors: Sequence[Sensor], rests: Mapping[str, Rest | None]) -> Iterator[Advice]:
    """Noise figures of sensors that are noisier at rest than configured.

    One that is quieter keeps its figure: at rest there is neither vibration nor scale error.
    """
    for key, unit, what in (
        ("gyro_noise_dps", 180.0 / math.pi, "gyro"),
        ("accel_noise_ug", 1e6 / STANDARD_GRAVITY, "accel"),
    ):
        figure = f"{what}_noise"  # of a sensor as configured, and of what it reads at rest
        noisier = {}
        for sensor in sensors:
            rest = rests.get(sensor.name)
            if rest is None or not getattr(sensor, what):
                continue
            if getattr(rest, figure) > _NOISIER * getattr(sensor, figure):
                noisier[sensor.name] = unit * getattr(rest, figure)
        if not noisier:
            continue
        using = [sensor for sensor in sensors if getattr(sensor, what)]
        alike = len(noisier) == len(using) and max(noisier.values()) < _NOISIER * min(noisier.values())
        if alike:
            value = float(np.median(list(noisier.values())))
            before = unit * getattr(using[0], figure)
            reason = (
                f"at rest the sensors have {min(noisier.values()):.3g} to {max(noisier.values()):.3g}, not {before:.3g}"
            )
            yield Advice(f"sensor_defaults.{key}", _short(value), reason)
            continue
        for name, value in noisier.items():
            before = unit * getattr(next(s for s in sensors if s.name == name), figure)
            yield Advice(f"sensors.{name}.{key}", _short(value), f"at rest it has {value:.3g}, not {before:.3g}")


def _short(value: float) -> str:
    """Two digits, without an exponent."""
    return f"{float(f'{value:.2g}'):g}"


def shaking(accel: FloatArray) -> float:
    """rms of the norm of an accelerometer about its median, as a share of g. `accel`: (K, 3) window means, m/s^2."""
    norm = np.linalg.norm(accel[np.isfinite(accel).all(axis=1)], axis=1)
    return rms(norm - np.median(norm)) / STANDARD_GRAVITY if len(norm) else 0.0


def pcf_advice(
    robot: Robot, params: PcfParams, shaken: Mapping[str, float], places_given: bool, rates: Mapping[str, float]
) -> Iterator[Advice]:
    """Settings of pcf.

    Args:
        shaken: `shaking` by sensor.
        places_given: positions of the sensors and origins of the joints stand in the configuration.
        rates: rms of the rate by sensor, rad/s.
    """
    levers = {
        sensor.name: rates.get(sensor.name, 0.0) ** 2 * math.hypot(*sensor.position) / STANDARD_GRAVITY
        for sensor in robot.sensors
    }
    possible = robot.joints and places_given and params.formulation != "absolute" and not params.lever_arms
    if possible and max(levers.values(), default=0.0) > _LEVERS:
        name = max(levers, key=lambda sensor: levers[sensor])
        much = f"{levers[name]:.3f} g (rms)"
        reason = f"the turning of its link would accelerate '{name}' by {much} at the configured position"
        yield Advice("estimators.pcf.lever_arms", "true", reason)
    most = max(shaken.values(), default=0.0)
    if most > _SHAKEN and params.formulation != "hinge" and not params.accel_time:
        name = max(shaken, key=lambda sensor: shaken[sensor])
        reason = f"'{name}' is accelerated by {most:.2f} g (rms) besides gravity, back and forth"
        yield Advice("estimators.pcf.accel_time", f"{_ACCEL_TIME:g}", reason)
