"""The figures of the specification of the PCF, section 4, item 4, with axes identified from a recording.

The hinge filter after 15 s, root mean square over joints and seeds, with mountings that are not known at all before:
the axes come from `calibrate axis`'s fit to the PC recording, the zero pose from its still start.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from finger_windows import error_deg, means_of, true_axis, unmounted

from jointest_ros.core.frame import FloatArray, Series
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.robot import Robot
from jointest_ros.evaluation.axis_calibration import fit_axes
from jointest_ros.evaluation.axis_fit import AxisFit
from jointest_ros.evaluation.joint_pairs import hinge_pairs
from jointest_ros.evaluation.mounting_fit import SeenAxis, aligned
from jointest_ros.sim.finger import simulate
from jointest_ros.sim.hand import HandRecording

SEEDS = range(2)


def identified(recorded: HandRecording) -> tuple[Robot, list[AxisFit]]:
    """The robot with mountings by the identified axes alone."""
    robot, means = unmounted(recorded.robot), means_of(recorded.recording)
    fits = [fit_axes(means, pair) for pair in hinge_pairs(robot)[0]]
    sensors = []
    for sensor in robot.sensors:
        seen = [SeenAxis(a.axis, f.pair.axis, a.std) for f in fits for a in f.axes if a.sensor == sensor.name]
        sensors.append(replace(sensor, mounting=aligned(sensor.mounting, seen)[0]))
    return replace(robot, sensors=tuple(sensors)), fits


def squared_errors(recorded: HandRecording, series: Series) -> FloatArray:
    """Mean square by joint after 15 s, deg^2."""
    late = series.stamps > 15_000_000_000
    return np.mean(np.degrees(series.position - recorded.truth_position)[late] ** 2, axis=0)


def uncalibrated(recorded: HandRecording, robot: Robot) -> Series:
    """Only the zero pose is taken, at the end of the still start."""
    estimator, plain = Pcf(robot, PcfParams(still_start=0.0)), recorded.recording
    resting = int(np.searchsorted(plain.stamps, 10_000_000_000))
    before = estimator.run(plain.part(0, resting))
    estimator.calibrate_zero()
    return Series.concatenate([before, estimator.run(plain.part(resting, len(plain)))])


@pytest.fixture(scope="module")
def figures() -> dict[str, float]:
    """Largest error of an axis, deg, and the errors of the joints, deg rms."""
    axes, calibrated, not_calibrated = [], [], []
    for seed in SEEDS:
        recorded = simulate("PC", seed=seed, mounting="mounted")
        robot, fits = identified(recorded)
        axes += [error_deg(a, true_axis(recorded.robot, a.sensor, n)) for n, fit in enumerate(fits) for a in fit.axes]
        series = Pcf(robot, PcfParams(zero_at_start=True)).run(recorded.recording)
        calibrated.append(squared_errors(recorded, series))
        not_calibrated.append(squared_errors(recorded, uncalibrated(recorded, robot)))
    return {
        "axis": max(axes),
        "calibrated": math.sqrt(np.mean(calibrated)),
        "not calibrated": math.sqrt(np.mean(not_calibrated)),
    }


@pytest.mark.parametrize(("figure", "bound"), [("axis", 0.09), ("calibrated", 0.10), ("not calibrated", 0.20)])
def test_hinge_with_identified_axes(figures: dict[str, float], figure: str, bound: float) -> None:
    print(f"{figure}: {figures[figure]:.4f} deg")
    assert figures[figure] <= bound
