"""Trials of the exoshell, simulated or from a file, and every sensor and filter of the KCKF paper on them."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jointest_ros.core.errors import counted
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import FloatArray, Recording
from jointest_ros.core.kckf.fusion import FusionParams
from jointest_ros.core.kckf.gyro import Gyro, GyroParams
from jointest_ros.core.kckf.hall import Hall, HallParams
from jointest_ros.core.kckf.kckf import PAPER, Kckf, KckfParams
from jointest_ros.core.kckf.kf import Kf
from jointest_ros.core.robot import Robot
from jointest_ros.core.torso import torsos_of
from jointest_ros.reproduction.result import Cell, ReproductionError, ResultTable
from jointest_ros.sim import exoshell

RATE_HZ = 100.0
PAPER_KF = FusionParams(noise="paper", hall_noise="constant", kinematics="additive")
STANDARD_KF = "standard KF"
PAPER_KCKF, OURS, OURS_OFFSET = "KCKF, paper's preset", "KCKF, our defaults", "KCKF, hall_offset"
COLORS = {
    "gyro": "#56b4e9",
    "Hall 1": "#e69f00",
    "Hall 2": "#f0e442",
    "Hall fused": "#999999",
    STANDARD_KF: "#d55e00",
    PAPER_KCKF: "#cc79a7",
    OURS: "#0072b2",
    OURS_OFFSET: "#009e73",
}  # Okabe and Ito 2008


@dataclass(frozen=True)
class Trial:
    """One trial with its truth; rows belong to the stamps of the recording.

    Attributes:
        angles: (T, 4) rad.
        torso, orientation: (T, 3) rad and (T, 4) quaternion x, y, z, w; of the sums of the angles where the scenario is
            additive.
    """

    robot: Robot
    recording: Recording
    angles: FloatArray
    torso: FloatArray
    orientation: FloatArray


def simulated(scenario: str, duration_s: float, seed: int) -> Trial:
    """One trial of a scenario, at 100 Hz."""
    made = exoshell.simulate(scenario, rate_hz=RATE_HZ, duration_s=duration_s, seed=seed)
    return Trial(made.robot, made.recording, made.truth_position, made.truth_torso, made.truth_torso_orientation)


def from_file(path: Path, scenario: str) -> Trial:
    """A trial with the sensors of an additive scenario out of a NumPy file.

    The file holds `t` s (T,), `theta` deg (T, 4), `gyro` deg/s (T - 1, 5, 3) with row k over [t_k, t_k+1], and
    `hall_V` V (T, 4, 2).

    Raises:
        ReproductionError: there is no such file, or it holds something else.
    """
    try:
        with np.load(path) as file:
            t, theta, gyro, volts = (np.asarray(file[key], dtype=float) for key in ("t", "theta", "gyro", "hall_V"))
    except OSError as error:
        raise ReproductionError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ReproductionError(f"{path}: not a trial of the exoshell: {error}") from None
    length = len(t) if t.ndim == 1 else 0
    wanted = {"theta": (length, 4), "gyro": (length - 1, 5, 3), "hall_V": (length, 4, 2)}
    for (name, shape), array in zip(wanted.items(), (theta, gyro, volts), strict=True):
        if length < 2 or array.shape != shape:
            raise ReproductionError(f"{path}: {name} has the shape {array.shape}; {shape} belongs to t {t.shape}")
    rates = np.radians(np.concatenate([np.full((1, 5, 3), np.nan), gyro]))  # stamped at the end of its interval
    recording = Recording(
        np.round(t * 1e9).astype(np.int64),
        {name: rates[:, number] for number, name in enumerate(exoshell.GYROS)},
        {},
        hall=volts.reshape(length, 8),
        period=np.full(length, float(np.median(np.diff(t)))),
    )
    robot, angles = exoshell.exoshell(scenario), np.radians(theta)
    axes = [joint.axes[0] for joint in robot.joints]
    return Trial(robot, recording, angles, *torsos_of(axes, angles, composed=False))


def methods(kinematics: str) -> dict[str, Callable[[Robot], Estimator]]:
    """The columns of the paper's Table 1 and ours; `kinematics` of those that are not the paper's."""
    halls = {
        name: HallParams(sensor=number, kinematics=kinematics)
        for number, name in ((1, "Hall 1"), (2, "Hall 2"), (0, "Hall fused"))
    }
    return {
        "gyro": lambda robot: Gyro(robot, GyroParams(kinematics=kinematics)),
        **{name: lambda robot, params=params: Hall(robot, params) for name, params in halls.items()},  # type: ignore[misc]
        STANDARD_KF: lambda robot: Kf(robot, PAPER_KF),
        PAPER_KCKF: lambda robot: Kckf(robot, PAPER),
        OURS: lambda robot: Kckf(robot, KckfParams(kinematics=kinematics)),
        OURS_OFFSET: lambda robot: Kckf(robot, KckfParams(kinematics=kinematics, hall_offset=True)),
    }


def beside(
    title: str,
    columns: Sequence[str],
    paper: Mapping[str, Sequence[Cell]],
    ours: Mapping[str, Sequence[Cell]],
) -> ResultTable:
    """Rows of the paper and ours under each other, by method; a method may be missing in either."""
    rows: list[tuple[Cell, ...]] = []
    for method in ours:
        if method in paper:
            rows.append((method, "paper", *paper[method]))
        rows.append((method, "ours", *ours[method]))
    return ResultTable(title, ("method", "of", *columns), rows)


def trials_text(count: int, duration_s: float, seed: int) -> str:
    """The condition on simulated trials."""
    seeds = f"seed {seed}" if count == 1 else f"seeds {seed} to {seed + count - 1}, means of their figures"
    return f"{counted(count, 'simulated trial')} of {duration_s:g} s at {RATE_HZ:g} Hz, {seeds}."
