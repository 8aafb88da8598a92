"""Peers: what goes around them with a stand-in whose orientations are exact, and the packages where installed."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

from jointest_ros.core.frame import FloatArray, Recording, Series
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.robot import Robot, Sensor
from jointest_ros.core.rotation import between
from jointest_ros.evaluation import peers
from jointest_ros.evaluation.peers import PEERS, PeerError, PeerRun, judge, run, still_start
from jointest_ros.evaluation.truth import Truth
from jointest_ros.sim.finger import JOINTS, simulate
from jointest_ros.sim.hand import HandRecording

PACKAGES = {"vqf": "vqf", "imufusion": "imufusion", "mahony": "ahrs", "madgwick": "ahrs"}
CALIBRATED = PcfParams(zero_at_start=True)


@pytest.fixture(scope="module")
def hand() -> HandRecording:
    return simulate("PC", rate_hz=200.0, duration_s=14.0, zero_pose_s=6.0, mounting="mounted", seed=5)


def truth_of(hand: HandRecording) -> Truth:
    columns = dict(zip(hand.joint_names, hand.truth_position.T, strict=True))
    stamps = hand.recording.stamps
    return Truth(stamps, columns, orientation={name: (stamps, q) for name, q in hand.orientation.items()})


def installed(peer: str) -> str:
    pytest.importorskip(PACKAGES[peer])
    return peer


@pytest.mark.parametrize("peer", list(PEERS))
def test_a_peer_is_near_the_truth(peer: str, hand: HandRecording) -> None:
    """Its frame conventions are understood: every angle and the vertical of every IMU, the palm turning about all axes.

    Rough bounds: that it works, not how well.
    """
    found = run(installed(peer), hand.robot, hand.recording, CALIBRATED)
    table, series, heading = judge(found, truth_of(hand), 8.0, ())
    assert found.joints == JOINTS and heading in peers.HEADINGS
    for joint in JOINTS:
        assert table["joints"][joint]["coverage"] == 1.0
        assert table["joints"][joint]["rmse_deg"] < 1.5
    for sensor in hand.orientation:
        assert table["orientation"][sensor]["inclination"]["rmse_deg"] < 1.5
    assert (table["velocities"], table["nis"], table["nees"]) == ({}, None, None)
    assert table["ns_per_frame"] > 0.0 and table["frames"] == len(hand.recording) == len(series)


def test_a_missing_package_is_one_line_that_says_what_to_install(
    hand: HandRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(name: str) -> None:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(importlib, "import_module", nothing)
    for refused in (peers.check_installed, lambda: run("vqf", hand.robot, hand.recording, CALIBRATED)):
        with pytest.raises(PeerError, match=r"vqf is not installed: pip install 'jointest_ros\[peers\]'$"):
            refused()


# ------------------------------------------------------------- around a peer that is exact


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> list[tuple[FloatArray, float]]:
    """A peer named `exact` that takes the accelerometers for the vertical; gyros and period that it got."""
    seen: list[tuple[FloatArray, float]] = []

    def exact(gyro: FloatArray, accel: FloatArray, period: float) -> FloatArray:
        seen.append((gyro, period))
        return np.array([between(tuple(row), (0.0, 0.0, 1.0)) for row in accel])

    monkeypatch.setitem(PEERS, "exact", exact)
    return seen


@pytest.fixture(scope="module")
def clean() -> HandRecording:
    options = {"noise": False, "bias": False, "lever_arm": False}
    return simulate("PC", rate_hz=100.0, duration_s=6.0, zero_pose_s=3.0, mounting="mounted", seed=2, **options)


def angles(found: PeerRun) -> FloatArray:
    return np.degrees(found.series["projected"].position)


def test_angles_need_no_heading(stand_in: object, clean: HandRecording) -> None:
    """The stand-in has none; mountings and zero pose are those of the robot."""
    error = angles(run("exact", clean.robot, clean.recording, CALIBRATED)) - np.degrees(clean.truth_position)
    assert np.abs(error).max() < 1e-6


def test_gyros_get_the_calibration_and_the_increments_of_the_stamps(
    stand_in: list[tuple[FloatArray, float]], clean: HandRecording
) -> None:
    plain = clean.recording
    jitter = np.random.default_rng(3).uniform(-3e6, 3e6, len(plain)).astype(np.int64)
    bias = np.array([0.02, -0.01, 0.03])
    gyro = {name: table + bias for name, table in plain.gyro.items()}
    recording = Recording(plain.stamps + jitter, gyro, plain.accel, period=plain.period)
    run("exact", clean.robot, recording, CALIBRATED)
    got, period = stand_in[0]
    intervals = np.diff(recording.stamps) * 1e-9
    expected = plain.gyro["palm"][1:] * intervals[:, None]
    np.testing.assert_allclose((got * period)[1:], expected, atol=1e-7)
    assert period == pytest.approx(0.01, rel=0.01)


def test_without_a_still_start_there_is_no_calibration(clean: HandRecording) -> None:
    moving = clean.recording.part(400, 600)
    assert still_start(clean.robot, moving, CALIBRATED) is None
    assert still_start(clean.robot, clean.recording, PcfParams(still_start=0.0)) is None
    start = still_start(clean.robot, clean.recording, CALIBRATED)
    assert start is not None and set(start.gyro) == set(clean.recording.gyro)


def test_missing_samples_are_missing_angles(stand_in: list[tuple[FloatArray, float]], clean: HandRecording) -> None:
    plain = clean.recording
    gyro = {name: table.copy() for name, table in plain.gyro.items()}
    gyro["middle"][400:420] = np.nan
    recording = Recording(plain.stamps, gyro, plain.accel, period=plain.period)
    found = angles(run("exact", clean.robot, recording, CALIBRATED))
    assert np.isnan(found[400:420, 1:]).all()
    assert np.isfinite(np.delete(found, np.r_[400:420], axis=0)).all() and np.isfinite(found[:, 0]).all()
    assert [len(rates) for rates, _ in stand_in] == [600, 600, 580, 600]


def test_a_reset_of_the_clock_starts_a_peer_afresh(
    stand_in: list[tuple[FloatArray, float]], clean: HandRecording
) -> None:
    plain = clean.recording
    reset = np.zeros(len(plain), dtype=bool)
    reset[[0, 350]] = True
    run("exact", clean.robot, Recording(plain.stamps, plain.gyro, plain.accel, reset=reset), None)
    assert [len(rates) for rates, _ in stand_in] == [350, 250] * 4


def test_the_better_heading_is_judged(clean: HandRecording) -> None:
    stamps, position = clean.recording.stamps, clean.truth_position
    unknown, status = np.full(position.shape, np.nan), np.zeros(position.shape, dtype=np.int64)
    wrong = position + np.random.default_rng(4).normal(0.0, 0.1, position.shape)
    series = {
        name: Series(stamps, values, unknown, unknown, status)
        for name, values in (("projected", wrong), ("tracked", position + 0.01))
    }
    table, chosen, heading = judge(PeerRun(series, JOINTS, 5.0), truth_of(clean), 0.0, ())
    assert (heading, chosen) == ("tracked", series["tracked"])
    assert table["joints"]["finger_mcp"]["bias_deg"] == pytest.approx(np.degrees(0.01))


def test_a_robot_without_imus_is_refused() -> None:
    robot = Robot(("one",), (), (Sensor("gyro", "one", accel=False),))
    recording = Recording(np.arange(3), {"gyro": np.zeros((3, 3))}, {})
    with pytest.raises(PeerError, match="need an IMU with gyro and accelerometer"):
        run("vqf", robot, recording, None)
