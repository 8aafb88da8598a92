"""The KCKF with its settled gain, by arrays: hours at 1 kHz in seconds. For Hall angles of constant noise.

Once the covariance P stands still, the gain is K = P H^T / sigma^2 (P after the correction), and the filter is

    x(k) = F x(k-1) + G u(k),  F = (1 - K H) A,  G = [(1 - K H) B, K],  u = [rates, Hall angles],

with x, A, B, H of the reduced filter (core/kckf/coupled_filter.py): x = [angles, biases], A and B of (9).
"""

from __future__ import annotations

import math

import numpy as np

from jointest_ros.core.frame import FloatArray, Recording
from jointest_ros.core.kckf.hall_bank import HallBank
from jointest_ros.core.kckf.kckf import Kckf
from jointest_ros.core.kckf.kf import Kf
from jointest_ros.core.kckf.linkage import Linkage
from jointest_ros.core.kckf.linkage_rates import GyroDifferences
from jointest_ros.core.robot import Robot

STANDS_STILL = 1e-4  # largest relative change of an element of P from one stretch to the next


class LinkageInputs:
    """What a `CoupledFilter` of Hall angles takes, from recordings.

    Attributes:
        linkage: as given.
        coordinate: (h,) index of the angle that each Hall sensor measures.
        hall: the sensors in that order.
        axes: (m, 3) of the angles.
    """

    def __init__(self, robot: Robot, linkage: Linkage) -> None:
        self._order = [index for own in linkage.hall for index in own]
        self._differences = GyroDifferences(linkage)
        self.coordinate = np.array([k for k, own in enumerate(linkage.hall) for _ in own], dtype=np.int64)
        self.linkage = linkage
        self.axes = np.array(linkage.axes)
        self.hall = HallBank([robot.hall[index] for index in self._order])

    def of(self, recording: Recording) -> tuple[FloatArray, FloatArray]:
        """(T, m) rates, rad/s, and (T, h) Hall angles, rad."""
        assert recording.hall is not None
        return self._differences.of_recording(recording), self.hall.angles(recording.hall[:, self._order])


class SettlingKckf:
    """`kckf` with constant Hall noise: frame by frame until its covariance stands still, then by arrays.

    Frames are complete and `dt` s apart.

    Attributes:
        by_frame: number of frames that the estimator itself has filtered.
    """

    def __init__(self, estimator: Kckf, dt: float) -> None:
        self._estimator, self._dt = estimator, dt
        self._inputs = LinkageInputs(estimator.robot, estimator.linkage)
        self._x: FloatArray = np.empty(0)
        self._covariance: FloatArray | None = None
        self._steady: tuple[FloatArray, FloatArray] | None = None  # F, G
        self.by_frame = 0

    def torso(self, recording: Recording) -> FloatArray:
        """(T, 3) rad of the next stretch of frames: sums of the angles (14)."""
        if self._steady is not None:
            transition, gain = self._steady
            states = scan(transition, self._x, np.hstack(self._inputs.of(recording)) @ gain.T)
            self._x = states[-1]
            return states[:, : len(self._estimator.joints)] @ self._inputs.axes
        torso = self._estimator.run(recording).torso
        assert torso is not None  # a filter of a chain has one
        self.by_frame += len(recording)
        inner = self._estimator.get_state()["bank"]["filter"]
        before, self._covariance = self._covariance, np.array(inner["covariance"])
        if before is not None and np.allclose(self._covariance, before, rtol=STANDS_STILL, atol=0.0):
            self._x, self._steady = np.array(inner["x"]), self._steady_form(self._covariance)
        return torso

    def _steady_form(self, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        m, dt = len(self._estimator.joints), self._dt
        rows = np.zeros((len(self._inputs.coordinate), 2 * m))
        rows[range(len(rows)), self._inputs.coordinate] = 1.0
        gain = covariance @ rows.T / self._estimator.params.hall_sigma**2
        kept = np.eye(2 * m) - gain @ rows
        transition = np.block([[np.eye(m), -dt * np.eye(m)], [np.zeros((m, m)), np.eye(m)]])
        return kept @ transition, np.hstack([kept[:, :m] * dt, gain])


class IntegratedTorso:
    """Torso of `kf` (additive), which nothing corrects: the first stretch by the estimator, then (10) as a sum."""

    def __init__(self, estimator: Kf, dt: float) -> None:
        self._estimator, self._dt = estimator, dt
        self._torso: FloatArray | None = None

    def torso(self, recording: Recording) -> FloatArray:
        """(T, 3) rad of the next stretch of frames, complete and `dt` s apart; gyros mounted as their links."""
        if self._torso is None:
            torso = self._estimator.run(recording).torso
            assert torso is not None  # a filter of a chain has one
        else:
            first, *_, last = (gyro.name for gyro in self._estimator.linkage.gyros)
            torso = self._torso + np.cumsum((recording.gyro[last] - recording.gyro[first]) * self._dt, axis=0)
        self._torso = torso[-1]
        return torso


def scan(transition: FloatArray, start: FloatArray, driven: FloatArray) -> FloatArray:
    """x(k) = F x(k-1) + driven(k) for all rows k (T, n), x(-1) = start.

    Blocks of sqrt(T) rows side by side, each from zero; then what each inherits from the one before.
    """
    rows, n = driven.shape
    length = math.isqrt(rows - 1) + 1
    x = np.zeros((-(-rows // length), length, n))
    x.reshape(-1, n)[:rows] = driven
    powers = [transition]
    for k in range(1, length):
        x[:, k] += x[:, k - 1] @ transition.T
        powers.append(powers[-1] @ transition)
    inheritance, before = np.array(powers), start
    for block in x:
        block += inheritance @ before
        before = block[-1]
    return x.reshape(-1, n)[:rows]
