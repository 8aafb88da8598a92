"""Orientation filters of others over the frames that our estimators get: vqf, imufusion, ahrs (the extra `peers`).

Each gives the orientation of every IMU without magnetometers, with its own default settings; `peer_angles` makes angles
of one-axis joints of them. What a peer gets that makes it comparable, and is to its advantage:

- the frames of the assembler (delays and accelerometer calibrations applied), the mountings and the axes of the robot;
- the increments of the stamps: its constant period is the mean one, and gyros are scaled by interval over period;
- the gyro biases and the zero pose of the still start, where `pcf` takes them, before its own estimate of the bias.

Never needed at run time: each package is imported when it is run.
"""

from __future__ import annotations

import importlib
import itertools
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from time import perf_counter_ns
from types import ModuleType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jointest_ros.core.errors import JointestError
from jointest_ros.core.frame import FloatArray, Recording, Series, Vec3
from jointest_ros.core.pcf.attitude import STILL, zero_rotation
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.robot import STANDARD_GRAVITY, Joint, Robot, Sensor
from jointest_ros.core.rotation import dot, log, rotate
from jointest_ros.evaluation.metrics import errors
from jointest_ros.evaluation.peer_angles import TRACKING_TIME, hinge_angles
from jointest_ros.evaluation.truth import Truth

PREFIX = "peer:"  # before the name of a peer, among the estimators
HEADINGS = {"projected": 0.0, "tracked": TRACKING_TIME}  # s, see peer_angles.py

_LONGEST = 20  # mean periods: a longer interval is a gap, in which nobody knows the rate

# gyro (T, 3) rad/s, accelerometer (T, 3) m/s^2, period s -> (T, 4) quaternions x, y, z, w, sensor to a world with z up
Orientations = Callable[[FloatArray, FloatArray, float], FloatArray]


class PeerError(JointestError):
    """The peers cannot be run."""


@dataclass(frozen=True)
class StillStart:
    """Means over the still phase at the start of a recording, by sensor: gyro rad/s, accelerometer m/s^2."""

    gyro: dict[str, Vec3]
    accel: dict[str, Vec3]


@dataclass(frozen=True)
class PeerRun:
    """What one peer gave.

    Attributes:
        series: by way of taking the heading (`HEADINGS`): angles of the one-axis joints, NaN where an IMU is missing.
        joints: columns of the series.
        ns_per_frame: what its own calls cost for all IMUs of a frame; joint angles are not in it.
    """

    series: dict[str, Series]
    joints: tuple[str, ...]
    ns_per_frame: float


def still_start(robot: Robot, recording: Recording, params: PcfParams) -> StillStart | None:
    """What `pcf` with these parameters would calibrate from; None where it would not."""
    found: StillStart | None = None
    if params.still_start <= 0.0:
        return None
    stillness = Pcf(robot, params).stillness
    for stop, still in stillness.run(recording):
        if still and stillness.duration >= params.still_start:
            found = StillStart(*stillness.means())
        elif not still and (found or recording.stamps[stop - 1] - recording.stamps[0] > 5_000_000_000):
            break
    return found


def run(name: str, robot: Robot, recording: Recording, params: PcfParams | None) -> PeerRun:
    """One peer over a recording.

    Args:
        name: one of `PEERS`.
        params: of `pcf` in the same configuration: whether and when it calibrates from a still start. None: never.

    Raises:
        PeerError: the package is not installed, or no sensor of the recording has gyro and accelerometer.
    """
    sensors = [sensor for sensor in robot.sensors if sensor.gyro and sensor.accel and sensor.name in recording.gyro]
    if not sensors:
        raise PeerError("the peers need an IMU with gyro and accelerometer; this robot has none in the recording")
    start = still_start(robot, recording, params) if params else None
    zero = start if params and params.zero_at_start else None
    orientation, spent = {}, 0
    for sensor in sensors:
        bias = np.array(start.gyro.get(sensor.name, STILL) if start else STILL)
        orientation[sensor.name], ns = _orientation(PEERS[name], recording, sensor.name, bias)
        spent += ns
    pairs = _hinges(robot, list(orientation))
    period = _period(recording.stamps)
    series = {}
    for heading, tracking_time in HEADINGS.items():
        columns = [
            _angle(joint, parent, child, orientation, zero, period, tracking_time) for joint, parent, child in pairs
        ]
        position = np.column_stack(columns) if columns else np.empty((len(recording), 0))
        unknown = np.full(position.shape, np.nan)
        status = np.zeros(position.shape, dtype=np.int64)
        series[heading] = Series(recording.stamps, position, unknown, unknown, status, orientation=orientation)
    joints = tuple(joint.name for joint, _, _ in pairs)
    return PeerRun(series, joints, spent / max(len(recording), 1))


def judge(
    found: PeerRun, truth: Truth, skip_s: float, continuous: Collection[str]
) -> tuple[dict[str, Any], Series, str]:
    """Errors as of an estimator, of the better way of taking the heading; its series and its name.

    The better one has the smaller standard deviation over all joints: the peer gets the benefit of the doubt.
    """
    choices = []
    for heading, series in found.series.items():
        table = errors(series, found.joints, truth, skip_s, continuous) | {"velocities": {}}
        spread = sum(figures["std_deg"] ** 2 for figures in table["joints"].values() if figures["samples"])
        choices.append((spread, table, series, heading))
    _, table, series, heading = min(choices, key=lambda choice: choice[0])
    return table | {"ns_per_frame": found.ns_per_frame, "frames": len(series)}, series, heading


def _period(stamps: Any) -> float:
    return float(stamps[-1] - stamps[0]) * 1e-9 / (len(stamps) - 1) if len(stamps) > 1 else 0.01


def _orientation(peer: Orientations, recording: Recording, sensor: str, bias: FloatArray) -> tuple[FloatArray, int]:
    """(T, 4), NaN where the sensor is missing, and the ns that the peer took. A reset of the clock starts it afresh."""
    found = np.full((len(recording), 4), np.nan)
    gyro, accel = recording.gyro[sensor], recording.accel[sensor]
    present: Any = np.isfinite(gyro).all(axis=1) & np.isfinite(accel).all(axis=1)
    resets = [] if recording.reset is None else np.flatnonzero(recording.reset).tolist()
    spent = 0
    for begin, end in itertools.pairwise((0, *(row for row in resets if row), len(recording))):
        rows = begin + np.flatnonzero(present[begin:end])
        if len(rows) < 2:
            continue
        period = _period(recording.stamps[rows])
        intervals = np.diff(recording.stamps[rows], prepend=recording.stamps[rows[0]] - round(period * 1e9)) * 1e-9
        scale = intervals / period
        scale[scale > _LONGEST] = 1.0
        rates, forces = np.ascontiguousarray((gyro[rows] - bias) * scale[:, None]), np.ascontiguousarray(accel[rows])
        before = perf_counter_ns()
        found[rows] = peer(rates, forces, period)
        spent += perf_counter_ns() - before
    return found, spent


def _hinges(robot: Robot, sensors: list[str]) -> list[tuple[Joint, Sensor, Sensor]]:
    """One-axis joints with an IMU on either side."""
    pairs = []
    for joint in robot.ordered_joints:
        ends = [[s for s in robot.sensors_on(link) if s.name in sensors] for link in (joint.parent, joint.child)]
        if len(joint.axes) == 1 and all(ends):
            pairs.append((joint, ends[0][0], ends[1][0]))
    return pairs


def _angle(
    joint: Joint,
    parent: Sensor,
    child: Sensor,
    orientation: dict[str, FloatArray],
    zero: StillStart | None,
    period: float,
    tracking_time: float,
) -> FloatArray:
    """(T,) rad, on the branch in the middle of the joint's range."""
    one, two = orientation[parent.name], orientation[child.name]
    angle = np.full(len(one), np.nan)
    known = np.isfinite(one).all(axis=1) & np.isfinite(two).all(axis=1)
    if not known.any():
        return angle
    link1 = Rotation.from_quat(one[known]) * Rotation.from_quat(parent.mounting).inv()
    link2 = Rotation.from_quat(two[known]) * Rotation.from_quat(child.mounting).inv()
    angle[known] = hinge_angles(link1, link2, joint.axes[0], period, tracking_time)
    if zero is not None:  # the same for all: what pcf takes as the zero pose
        forces = (rotate(sensor.mounting, zero.accel[sensor.name]) for sensor in (parent, child))
        angle -= dot(log(zero_rotation(joint.axes, *forces)), joint.axes[0])
    middle = sum(joint.limits[0]) / 2.0 if joint.limits else 0.0
    return np.asarray(middle + (angle - middle + math.pi) % (2.0 * math.pi) - math.pi)


# ------------------------------------------------------------- the peers


def _package(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise PeerError(f"the peer {name} is not installed: pip install 'jointest_ros[peers]'") from None


def _vqf(gyro: FloatArray, accel: FloatArray, period: float) -> FloatArray:
    """VQF (Laidig, Seel 2023), in its batch form, with rest and motion bias estimation."""
    quaternions = _package("vqf").VQF(period).updateBatch(gyro, accel)["quat6D"]
    return np.asarray(quaternions[:, [1, 2, 3, 0]])


def _imufusion(gyro: FloatArray, accel: FloatArray, period: float) -> FloatArray:
    """Fusion of x-io (Madgwick's revised filter), with its bias estimation at rest. It has no batch form."""
    imufusion = _package("imufusion")
    ahrs, settings = imufusion.Ahrs(), imufusion.AhrsSettings()
    bias, bias_settings = imufusion.Bias(), imufusion.BiasSettings()
    settings.sample_rate = bias_settings.sample_rate = 1.0 / period
    ahrs.set_settings(settings)
    bias.set_settings(bias_settings)
    found = np.empty((len(gyro), 4))
    for row, (rate, force) in enumerate(zip(np.degrees(gyro), accel / STANDARD_GRAVITY, strict=True)):
        ahrs.update_no_magnetometer(bias.update(rate), force)
        found[row] = ahrs.get_quaternion()
    return found[:, [1, 2, 3, 0]]


def _mahony(gyro: FloatArray, accel: FloatArray, period: float) -> FloatArray:
    """Mahony's filter of the package ahrs, of which Santaera's Algorithm 1 is a form; its integral learns the bias."""
    return _of_ahrs("Mahony", gyro, accel, period)


def _madgwick(gyro: FloatArray, accel: FloatArray, period: float) -> FloatArray:
    """Madgwick's first filter of the package ahrs; it has no bias estimation."""
    return _of_ahrs("Madgwick", gyro, accel, period)


def _of_ahrs(which: str, gyro: FloatArray, accel: FloatArray, period: float) -> FloatArray:
    _package("ahrs")
    kind = getattr(_package("ahrs.filters"), which)
    return np.asarray(kind(gyr=gyro, acc=accel, frequency=1.0 / period).Q[:, [1, 2, 3, 0]])


PEERS: dict[str, Orientations] = {
    "vqf": _vqf,
    "imufusion": _imufusion,
    "mahony": _mahony,
    "madgwick": _madgwick,
}


def check_installed() -> None:
    """Raise a `PeerError` that says what to install, unless all peers are there."""
    for package in ("vqf", "imufusion", "ahrs"):
        _package(package)
