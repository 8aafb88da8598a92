"""What the estimators on gyros and Hall sensors share: time, inputs, torso, and the loop over a recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from jointest_ros.core.errors import ConfigurationError, counted
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, FloatArray, Frame, Quat, Recording, Series, Status, Vec3
from jointest_ros.core.kckf.hall_watch import HallWatch
from jointest_ros.core.kckf.joint_bank import JointBank
from jointest_ros.core.kckf.linkage import Linkage
from jointest_ros.core.kckf.linkage_rates import GyroDifferences, LinkRates
from jointest_ros.core.learned import Learned, fingerprint
from jointest_ros.core.params import Params
from jointest_ros.core.robot import Robot
from jointest_ros.core.saturated_gyros import SaturatedGyros
from jointest_ros.core.timing import Timing
from jointest_ros.core.torso import GyroTorso, TorsoChain, torso_of, torsos_of

_DISTURBED = int(Status.DISTURBED)
KINEMATICS = ("composed", "additive")
KINEMATICS_TEXT = (
    "composed: rotations of the joints in succession, torso as rotation vector; additive (the paper's): sums of angles "
    "about the same axis"
)
GAP_RATE_TEXT = "standard deviation of the joint rate that a gap longer than max_gap hides"


class LinkageEstimator(Estimator):
    """Base of `gyro`, `kf` and `kckf`, which make the bank.

    Args:
        composed: rotations instead of sums.
        by_links: the bank takes the rates of the links, not those of the joints.
        gyro_torso: the torso comes from the gyros, not from the joints.
        gap_rate_dps: standard deviation of a rate that nobody measured.
    """

    unobservable = "no Hall reading holds it: gyro only"
    fuses_hall: ClassVar[bool] = True

    def __init__(
        self,
        robot: Robot,
        params: Params,
        timing: Timing | None,
        linkage: Linkage,
        composed: bool,
        by_links: bool,
        gyro_torso: bool,
        gap_rate_dps: float,
    ) -> None:
        super().__init__(robot, params, timing)
        self.linkage = linkage
        self.joints = linkage.names
        self._composed, self._by_links = composed, by_links
        self._differences, self._link_rates = GyroDifferences(linkage), LinkRates(linkage.gyros)
        self._gyro_torso = GyroTorso(composed) if gyro_torso and linkage.serial else None
        self._end_rates = LinkRates((linkage.gyros[0], linkage.gyros[-1]))
        self._watch = HallWatch(robot, linkage) if self.fuses_hall else None
        self._saturation = _saturation(linkage, math.radians(gap_rate_dps))
        self._bank: JointBank
        self.reset()

    def _make_bank(self) -> JointBank:
        raise NotImplementedError

    def reset(self) -> None:
        """Forget everything of this run."""
        self._bank = self._make_bank()
        self._restart_beside()
        self._start_warm()

    def _start_warm(self) -> None:
        """Start from the biases of an earlier run."""
        known = self._learned_before(self._bank.biases())
        if known is not None:
            self._bank.start_from(known.biases)

    def learned(self) -> Learned | None:
        """Gyro biases and Hall offsets; None before the first frame."""
        return None if self._last is None else Learned(fingerprint(self.robot), self._bank.learned())

    # ------------------------------------------------------------- online

    def update(self, frame: Frame) -> Estimate:
        """Predict with the frame's gyros, then correct with its Hall voltages."""
        return self._update(frame, [k for k, (gyros, _) in enumerate(self._saturation) if gyros.any(frame.gyro)])

    def _update(self, frame: Frame, saturated: Sequence[int]) -> Estimate:
        """`update`; `saturated`: numbers in `_saturation`, by the gyros as they were read."""
        if frame.reset:
            self._restart()
        if frame.hall is not None:
            check_voltages(self.robot, len(frame.hall))
        dt, gap = self._elapsed(frame.stamp, frame.period)
        inputs = self._link_rates.of_frame(frame.gyro) if self._by_links else self._differences.of_frame(frame.gyro)
        bank = self._bank
        self._step(dt, gap, inputs, frame.hall, saturated)
        torso: Vec3 | None = None
        orientation: Quat | None = None
        if self._gyro_torso is not None:
            self._gyro_torso.step(dt, *self._end_rates.of_frame(frame.gyro))
            torso, orientation = self._gyro_torso.angle, self._gyro_torso.orientation
        elif self.linkage.serial:
            torso, orientation = torso_of(self.linkage.axes, bank.angles, self._composed)
        return Estimate(
            frame.stamp,
            tuple(bank.angles),
            tuple(bank.velocities),
            tuple(bank.variances),
            tuple(bank.status),
            torso,
            orientation,
        )

    def _step(
        self, dt: float, gap: float, inputs: Sequence[Any], hall: Sequence[float] | None, saturated: Sequence[int]
    ) -> None:
        """The bank's step, with Hall readings that are not frozen; a joint that has gone astray starts afresh."""
        bank, watch = self._bank, self._watch
        if watch is not None:
            hall = watch.trusted(dt, hall, bank.angles, bank.velocities)
            for number in watch.astray(dt, hall, bank.angles):
                bank.forget(number)
        for k, (gyros, coordinates) in enumerate(self._saturation):
            if k not in saturated:
                gyros.time = 0.0
                continue
            variance = gyros.spread(dt)
            for number in coordinates:
                bank.spread(number, variance)
        bank.step(dt, gap, inputs, hall)
        if watch is not None:
            for number in watch.frozen:
                bank.status[number] |= _DISTURBED
        for k in saturated:
            for number in self._saturation[k][1]:
                bank.status[number] |= _DISTURBED

    def _restart(self) -> None:
        self._bank.restart()
        self._restart_beside()

    def _restart_beside(self) -> None:
        """All but the bank."""
        if self._watch is not None:
            self._watch.restart()
        for gyros, _ in self._saturation:
            gyros.time = 0.0
        self._last: int | None = None
        if self._gyro_torso is not None:
            self._gyro_torso.restart()

    def _elapsed(self, stamp: int, period: float) -> tuple[float, float]:
        """(s since the last frame, s of it that lie before the interval of this frame's gyro sample)."""
        last, self._last = self._last, stamp
        if last is None:
            return 0.0, 0.0
        dt = (stamp - last) * 1e-9
        if period == period:
            return dt, dt - period if dt > 1.5 * period else 0.0
        return dt, dt if dt > self.timing.max_gap else 0.0

    # ------------------------------------------------------------- by arrays

    def run(self, recording: Recording) -> Series:
        """Estimates of a stretch of frames; rates and torso by arrays. Equals `update` in a loop."""
        if recording.hall is not None:
            check_voltages(self.robot, recording.hall.shape[1])
        parts = [self._run(part, self._saturated_rows(part)) for part in recording.parts()]
        return Series.concatenate(parts or [self._run(recording, [])])

    def _saturated_rows(self, recording: Recording) -> list[list[int]]:
        """Which gyros, by their number in `_saturation`, of every row."""
        rows: list[list[int]] = [[] for _ in range(len(recording))]
        for k, (gyros, _) in enumerate(self._saturation):
            for row in np.flatnonzero(gyros.rows(recording.gyro, len(recording))).tolist():
                rows[row].append(k)
        return rows

    def _run(self, recording: Recording, saturated: Sequence[Sequence[int]]) -> Series:
        length, m = len(recording), len(self.joints)
        bank, gyro_torso = self._bank, self._gyro_torso
        inputs: Sequence[Any]
        if self._by_links:
            inputs = self._link_rates.of_recording(recording)
        else:
            inputs = self._differences.of_recording(recording).tolist()
        ends = self._end_rates.of_recording(recording) if gyro_torso is not None else []
        hall = self._hall_rows(recording)
        period = [math.nan] * length if recording.period is None else recording.period.tolist()
        restarts = set() if recording.reset is None else set(np.flatnonzero(recording.reset).tolist())
        position, velocity, variance, status, torso, orientation = [], [], [], [], [], []
        for k, stamp in enumerate(recording.stamps.tolist()):
            if k in restarts:
                self._restart()
            dt, gap = self._elapsed(stamp, period[k])
            self._step(dt, gap, inputs[k], hall[k], saturated[k])
            position.append(bank.angles)
            velocity.append(bank.velocities)
            variance.append(bank.variances)
            status.append(bank.status)
            if gyro_torso is not None:
                gyro_torso.step(dt, *ends[k])
                torso.append(gyro_torso.angle)
                orientation.append(gyro_torso.orientation)
        series = Series(
            recording.stamps,
            np.array(position, dtype=float).reshape(length, m),
            np.array(velocity, dtype=float).reshape(length, m),
            np.array(variance, dtype=float).reshape(length, m),
            np.array(status, dtype=np.int64).reshape(length, m),
        )
        if gyro_torso is not None:
            series.torso = np.array(torso, dtype=float).reshape(length, 3)
            series.torso_orientation = np.array(orientation, dtype=float).reshape(length, 4)
        elif self.linkage.serial:
            series.torso, series.torso_orientation = torsos_of(self.linkage.axes, series.position, self._composed)
        return series

    def _hall_rows(self, recording: Recording) -> list[list[float] | None]:
        voltages = recording.hall
        if voltages is None:
            return [None] * len(recording)
        present: Any = np.isfinite(voltages).any(axis=1)
        return [row if there else None for row, there in zip(voltages.tolist(), present, strict=True)]

    # ------------------------------------------------------------- state

    def get_state(self) -> dict[str, Any]:
        """The whole state as plain numbers, lists and dicts."""
        torso = None if self._gyro_torso is None else self._gyro_torso.get_state()
        watch = None if self._watch is None else self._watch.get_state()
        saturated = [gyros.time for gyros, _ in self._saturation]
        state = {"last": self._last, "bank": self._bank.get_state(), "torso": torso, "watch": watch}
        return state | {"saturated": saturated}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue identically from what `get_state` returned."""
        self._last = state["last"]
        for (gyros, _), time in zip(self._saturation, state["saturated"], strict=True):
            gyros.time = time
        self._bank.set_state(state["bank"])
        if self._watch is not None:
            self._watch.set_state(state["watch"])
        if self._gyro_torso is not None:
            self._gyro_torso.set_state(state["torso"])

    def covariance(self) -> FloatArray:
        """Covariance of the latest joint positions, (m, m), rad^2."""
        return self._bank.covariance()

    def biases(self) -> dict[str, float]:
        """Latest biases: `<coordinate>.gyro` or `<sensor>.x`, `.y`, `.z` in rad/s, `<coordinate>.hall_1` in V."""
        return self._bank.biases()

    @property
    def torso(self) -> TorsoChain | None:
        """The chain, where the joints are in series."""
        linkage = self.linkage
        return TorsoChain(linkage.links[0], linkage.names, linkage.axes, self._composed) if linkage.serial else None

    def innovations(self) -> list[float]:
        """Normalised innovations of the newest frame in the order of `Robot.hall`; NaN: not used."""
        return self._bank.innovations()

    def innovation_joints(self) -> tuple[str, ...]:
        """See `Estimator`."""
        return tuple([hall.joint for hall in self.robot.hall])

    def gated(self) -> list[int]:
        """Hall readings since the start that were refused because of their voltage, in the order of `Robot.hall`."""
        return self._bank.gated()


def _saturation(linkage: Linkage, gap_rate: float) -> list[tuple[SaturatedGyros, list[int]]]:
    """The gyros of every joint whose full scale is known, with its coordinates."""
    found = []
    for joint in range(len(linkage.joints)):
        coordinates = [number for number, one in enumerate(linkage.joint_of) if one == joint]
        gyros = SaturatedGyros([linkage.gyros[end] for end in linkage.ends[coordinates[0]]], gap_rate)
        if gyros:
            found.append((gyros, coordinates))
    return found


def check_voltages(robot: Robot, count: int) -> None:
    """Raise ConfigurationError unless `count` voltages are what the robot's Hall sensors give."""
    if count != len(robot.hall):
        sensors = counted(len(robot.hall), "Hall sensor")
        raise ConfigurationError(f"hall voltages: {count} in a frame; the robot has {sensors}")
