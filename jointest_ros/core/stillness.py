"""Finds when the robot stands still, and averages the sensors while it does: gyro bias and zero pose come from there."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from jointest_ros.core.frame import FloatArray, Frame, Vec3

_CONSISTENT = 4.0  # standard errors that the mean of a window may differ from the mean before it


@dataclass
class Stillness:
    """Judges windows of frames; a window is still when every listed sensor is.

    Still means: gyro and accelerometer scatter less than the thresholds, the mean rate could be a bias, and gyro and
    accelerometer means agree with those of the still windows before (so slow motion is no bias, however smooth it is).
    The first window alone cannot tell a constant slow turn about the vertical from a bias of the same size.

    Attributes:
        gyro_std: largest standard deviation of a gyro axis in a still window, rad/s.
        accel_std: the same of an accelerometer axis, m/s^2.
        gyro_bias: largest mean rate of an axis that may be a bias, rad/s.
        window: length of a window, s.
    """

    sensors: tuple[str, ...]
    gyro_std: float
    accel_std: float
    gyro_bias: float
    window: float = 0.5
    duration: float = 0.0  # s, still without interruption until the newest window
    gyro_mean: dict[str, FloatArray] = field(default_factory=dict)  # (3,) rad/s over `duration`
    accel_mean: dict[str, FloatArray] = field(default_factory=dict)  # (3,) m/s^2 over `duration`
    _frames: list[Frame] = field(default_factory=list)

    def update(self, frame: Frame) -> bool | None:
        """Add a frame. True or False at the end of a window: it was still or not; None in between."""
        if frame.reset:
            self.clear()
        self._frames.append(frame)
        span = (frame.stamp - self._frames[0].stamp) * 1e-9
        if span < self.window:
            return None
        still = self._judge(span)
        self._frames = [frame]
        return still

    def means(self) -> tuple[dict[str, Vec3], dict[str, Vec3]]:
        """(gyro rad/s, accelerometer m/s^2) by sensor, over the present still phase."""
        return tuple(  # type: ignore[return-value]
            {sensor: tuple(mean.tolist()) for sensor, mean in table.items()}
            for table in (self.gyro_mean, self.accel_mean)
        )

    def clear(self) -> None:
        """Forget everything."""
        self._frames = []
        self._moved()

    def _moved(self) -> None:
        self.duration = 0.0
        self.gyro_mean.clear()
        self.accel_mean.clear()

    def _judge(self, span: float) -> bool:
        means: list[tuple[str, FloatArray, FloatArray]] = []
        for sensor in self.sensors:
            gyro = np.array([f.gyro[sensor] for f in self._frames if sensor in f.gyro])
            accel = np.array([f.accel[sensor] for f in self._frames if sensor in f.accel])
            if len(gyro) < 5 or len(accel) < 5:
                self._moved()
                return False
            gyro_std, accel_std = gyro.std(axis=0), accel.std(axis=0)
            gyro_mean, accel_mean = gyro.mean(axis=0), accel.mean(axis=0)
            still = (gyro_std < self.gyro_std).all() and (accel_std < self.accel_std).all()
            still = still and (abs(gyro_mean) < self.gyro_bias).all()
            if still and sensor in self.gyro_mean:
                scatter = _CONSISTENT * gyro_std / np.sqrt(len(gyro)) + 0.02 * self.gyro_std
                still = (abs(gyro_mean - self.gyro_mean[sensor]) < scatter).all()
                scatter = _CONSISTENT * accel_std / np.sqrt(len(accel)) + 0.02 * self.accel_std
                still = still and (abs(accel_mean - self.accel_mean[sensor]) < scatter).all()
            if not still:
                self._moved()
                return False
            means.append((sensor, gyro_mean, accel_mean))
        share = span / (self.duration + span)
        for sensor, gyro_mean, accel_mean in means:
            for table, mean in ((self.gyro_mean, gyro_mean), (self.accel_mean, accel_mean)):
                table[sensor] = table[sensor] + share * (mean - table[sensor]) if sensor in table else mean
        self.duration += span
        return True
