"""The forms by arrays against the estimators frame by frame."""

from __future__ import annotations

import numpy as np
import pytest

from jointest_ros.core.kckf.kckf import Kckf, KckfParams
from jointest_ros.core.kckf.kf import Kf
from jointest_ros.reproduction.exoshell_trials import PAPER_KF
from jointest_ros.reproduction.kckf_drift import KCKFS
from jointest_ros.reproduction.kckf_steady import IntegratedTorso, SettlingKckf, scan
from jointest_ros.sim import exoshell


@pytest.mark.parametrize("rows", [1, 2, 99, 100, 101])
def test_scan_is_the_recursion(rows: int) -> None:
    generator = np.random.default_rng(rows)
    transition = 0.3 * generator.standard_normal((3, 3))
    start, driven = generator.standard_normal(3), generator.standard_normal((rows, 3))
    x, expected = start, []
    for row in driven:
        x = transition @ x + row
        expected.append(x)
    np.testing.assert_allclose(scan(transition, start, driven), expected, atol=1e-12)


@pytest.fixture(scope="module")
def drift() -> exoshell.ExoshellRecording:
    """Long enough for either noise to settle."""
    return exoshell.simulate("drift", rate_hz=100.0, duration_s=240.0, seed=3)


@pytest.mark.parametrize("params", KCKFS.values(), ids=["paper", "physical"])
def test_the_steady_form_equals_the_estimator(drift: exoshell.ExoshellRecording, params: KckfParams) -> None:
    steady = SettlingKckf(Kckf(drift.robot, params), 0.01)
    by_arrays = np.concatenate([steady.torso(part) for part in drift.recording.parts(1000)])
    assert steady.by_frame < len(drift.recording)  # otherwise this would compare the estimator with itself
    by_frame = Kckf(drift.robot, params).run(drift.recording).torso
    assert by_frame is not None
    assert np.degrees(np.abs(by_arrays - by_frame).max()) < 1e-5


def test_noise_in_volts_is_constant_noise_where_the_sensor_is_linear(drift: exoshell.ExoshellRecording) -> None:
    part = drift.recording.part(0, 3000)
    volts = Kckf(drift.robot, KckfParams(kinematics="additive")).run(part)
    angles = Kckf(drift.robot, KckfParams(kinematics="additive", hall_noise="constant")).run(part)
    assert np.degrees(np.abs(volts.position - angles.position).max()) < 1e-6


def test_the_integrated_torso_is_that_of_kf(drift: exoshell.ExoshellRecording) -> None:
    integrated = IntegratedTorso(Kf(drift.robot, PAPER_KF), 0.01)
    part = drift.recording.part(0, 3000)
    by_arrays = np.concatenate([integrated.torso(piece) for piece in part.parts(1000)])
    by_frame = Kf(drift.robot, PAPER_KF).run(part).torso
    np.testing.assert_allclose(np.degrees(by_arrays), np.degrees(by_frame), atol=1e-9)
