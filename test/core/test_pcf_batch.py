"""`run` by arrays equals `update` in a loop, and a restored state continues identically."""

from __future__ import annotations

import json

import numpy as np
import pytest
from pcf_swing import X, Y, Z, lose, sway, swing, take

from jointest_ros.core.frame import Recording, Series
from jointest_ros.core.pcf.params import FORMULATIONS, PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.robot import Robot
from jointest_ros.sim.finger import simulate

MODES = [
    *({"formulation": formulation, "zero_at_start": True} for formulation in FORMULATIONS),
    *({"formulation": formulation, "still_start": 0.0} for formulation in FORMULATIONS),
    *({"formulation": formulation, "mag_weight": 0.5} for formulation in FORMULATIONS),
    *({"formulation": formulation, "accel_time": 1.0} for formulation in FORMULATIONS),
    {"formulation": "hinge", "lever_arms": True},
    {"formulation": "hinge", "lever_arms": True, "accel_time": 0.5, "mag_weight": 0.5},
]


@pytest.fixture(scope="module")
def damaged() -> tuple[Robot, Recording]:
    """A finger with everything that can happen: still start, losses, gaps, resets, a silent sensor, unknown periods."""
    recorded = simulate("PC", rate_hz=100.0, duration_s=24.0, zero_pose_s=4.0, seed=21, mag=True, mounting="mounted")
    recording, generator = recorded.recording, np.random.default_rng(22)
    samples = len(recording)
    for sensor in ("palm", "middle"):
        recording = lose(recording, generator.random(samples) < 0.05, (sensor,))
    recording = lose(recording, np.r_[1200:1260], ("distal",))
    for sensor in recording.mag:
        recording.mag[sensor][np.arange(samples) % 5 > 0] = np.nan
    recording.reset = np.zeros(samples, dtype=bool)
    recording.reset[[0, 1000, 1210, 1500, 1501]] = True
    recording.stamps[1500:] -= 20_000_000_000
    assert recording.period is not None
    recording.period[:5] = np.nan
    return recorded.robot, take(recording, np.r_[0:700, 703:1700, 1760:samples])


def by_update(estimator: Pcf, recording: Recording) -> Series:
    return Series.from_estimates([estimator.update(frame) for frame in recording.frames()], len(estimator.joints))


def same(one: Series, other: Series) -> None:
    for name in ("position", "velocity", "variance"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-9, atol=1e-9, err_msg=name)
    np.testing.assert_array_equal(one.status, other.status)
    np.testing.assert_array_equal(one.stamps, other.stamps)
    assert one.orientation.keys() == other.orientation.keys()
    for sensor, orientation in one.orientation.items():
        np.testing.assert_allclose(orientation, other.orientation[sensor], atol=1e-9)


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: "-".join(map(str, mode.values())))
@pytest.mark.parametrize("size", [1, 97, 777, 10_000])
def test_run_in_stretches_equals_the_loop(damaged: tuple[Robot, Recording], mode: dict[str, object], size: int) -> None:
    robot, recording = damaged
    if size == 1:
        recording = recording.part(0, 500)
    loop, arrays = Pcf(robot, PcfParams(**mode)), Pcf(robot, PcfParams(**mode))
    expected = by_update(loop, recording)
    found = Series.concatenate([arrays.run(part) for part in recording.parts(size)])
    same(found, expected)
    np.testing.assert_allclose(arrays.covariance(), loop.covariance(), rtol=1e-9)
    assert arrays.biases() == pytest.approx(loop.biases(), abs=1e-12)
    assert arrays.calibrated == loop.calibrated == (mode.get("still_start") != 0.0)


@pytest.mark.parametrize("axes", [(X, Y), (Z, Y, X), (Z, X, Z)])
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_joints_of_more_axes(formulation: str, axes: tuple[tuple[float, float, float], ...]) -> None:
    """With `hinge` they use `relative`."""
    amplitudes = np.array([0.5, 0.4, 0.6][: len(axes)])
    offsets = np.array([0.0, 0.9, 0.0][: len(axes)])
    robot, recording, truth = swing(
        lambda time: offsets + amplitudes * np.sin(np.outer(time, [1.1, 0.8, 1.3][: len(axes)])),
        axes,
        seconds=10.0,
        parent=sway,
        mag=True,
        seed=23,
    )
    params = PcfParams(formulation=formulation, still_start=0.0, mag_weight=1.0)
    loop, arrays = Pcf(robot, params), Pcf(robot, params)
    series = Series.concatenate([arrays.run(part) for part in recording.parts(333)])
    same(series, by_update(loop, recording))
    assert series.position.shape == (1000, len(axes)) and loop.joints == robot.coordinates
    if formulation == "absolute":  # starts at the heading that the field gives
        assert np.degrees(np.abs(series.position - truth))[300:].max() < 3.0


def test_an_empty_stretch() -> None:
    robot, recording, _ = swing(np.sin, seconds=1.0)
    for formulation in FORMULATIONS:
        estimator = Pcf(robot, PcfParams(formulation=formulation))
        assert estimator.run(recording.part(0, 0)).position.shape == (0, 1)
        before = estimator.run(recording.part(0, 50))
        assert len(estimator.run(recording.part(50, 50))) == 0
        assert len(before) == 50


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: "-".join(map(str, mode.values())))
@pytest.mark.parametrize("cut", [0, 1, 30, 160, 450, 1230, 1500])
def test_state_continues_identically_through_json(
    damaged: tuple[Robot, Recording], mode: dict[str, object], cut: int
) -> None:
    """Bit by bit, wherever the stream is cut: in the still start, while a sensor is silent, at a reset."""
    robot, recording = damaged
    whole, restored = Pcf(robot, PcfParams(**mode)), Pcf(robot, PcfParams(**mode))
    frames = list(recording.part(0, cut + 150).frames())
    for frame in frames[:cut]:
        whole.update(frame)
    restored.run(recording.part(100, 200))  # whatever it was before is forgotten
    restored.set_state(json.loads(json.dumps(whole.get_state())))
    assert restored.covariance().tolist() == whole.covariance().tolist()
    assert restored.biases() == whole.biases()
    for frame in frames[cut:]:
        assert restored.update(frame) == whole.update(frame)
    assert restored.get_state() == whole.get_state()


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_state_continues_in_run_as_well(damaged: tuple[Robot, Recording], formulation: str) -> None:
    robot, recording = damaged
    params = PcfParams(formulation=formulation, zero_at_start=True)
    whole, first, second = (Pcf(robot, params) for _ in range(3))
    expected = whole.run(recording)
    before = first.run(recording.part(0, 1111))
    second.set_state(json.loads(json.dumps(first.get_state())))
    same(Series.concatenate([before, second.run(recording.part(1111, len(recording)))]), expected)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_reset_estimator_gives_the_same_again(damaged: tuple[Robot, Recording], formulation: str) -> None:
    robot, recording = damaged
    estimator = Pcf(robot, PcfParams(formulation=formulation))
    first = estimator.run(recording)
    estimator.reset()
    same(estimator.run(recording), first)
