"""Magnetometers: what they make observable, and that a disturbed one has no influence until it is sound again."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from jointest_ros.core.frame import FloatArray, Recording, Series, Status
from jointest_ros.core.pcf.field import LEARN, QUIET, FieldWatch
from jointest_ros.core.pcf.params import FORMULATIONS, PcfParams
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.core.pcf.settings import Field
from jointest_ros.sim.finger import simulate
from jointest_ros.sim.hand import HandRecording
from jointest_ros.sim.imu import EARTH_FIELD

RATE = 100.0
ZERO_POSE = 5.0  # s
VERTICAL, TURNING = ("PA", 90.0), ("PC", 0.0)  # scenario, elevation of the axes, deg


@pytest.fixture(scope="module", params=[VERTICAL, TURNING], ids=["vertical axes", "turning palm"])
def hand(request: pytest.FixtureRequest) -> HandRecording:
    scenario, elevation = request.param
    options = {"rate_hz": RATE, "duration_s": 30.0, "zero_pose_s": ZERO_POSE, "mounting": "mounted", "mag": True}
    return simulate(scenario, elevation_deg=elevation, seed=3, **options)


@pytest.fixture(scope="module")
def vertical() -> HandRecording:
    options = {"rate_hz": RATE, "duration_s": 30.0, "zero_pose_s": ZERO_POSE, "mounting": "mounted", "mag": True}
    return simulate("PA", elevation_deg=90.0, seed=4, **options)


def estimate(hand: HandRecording, recording: Recording | None = None, **params: object) -> Series:
    settings = {"zero_at_start": True, "mag_weight": 1.0, **params}
    return Pcf(hand.robot, PcfParams(**settings)).run(recording or hand.recording)


def error_deg(hand: HandRecording, series: Series, start: float = 8.0, stop: float = 1e9) -> FloatArray:
    """rms by joint."""
    time = series.stamps * 1e-9
    kept = (time > start) & (time < stop)
    return np.sqrt(np.mean(np.degrees(series.position - hand.truth_position)[kept] ** 2, axis=0))


def flagged(series: Series, flag: Status, start: float, stop: float) -> FloatArray:
    """Share of the frames between two times, by joint."""
    time = series.stamps * 1e-9
    return np.mean((series.status[(time > start) & (time < stop)] & flag) > 0, axis=0)


def with_fields(recording: Recording, sensor: str, rows: slice, change: FloatArray | float) -> Recording:
    """A copy in which something is added (tesla) to the field of one sensor."""
    mag = {name: table.copy() for name, table in recording.mag.items()}
    mag[sensor][rows] += change
    return replace(recording, mag=mag)


# ------------------------------------------------------------- what they are good for


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_the_field_makes_turns_about_gravity_observable(formulation: str, vertical: HandRecording) -> None:
    without = estimate(vertical, formulation=formulation, mag_weight=0.0)
    with_mag = estimate(vertical, formulation=formulation)
    assert flagged(without, Status.UNOBSERVABLE, 8.0, 30.0).min() == 1.0
    assert flagged(with_mag, Status.UNOBSERVABLE, 8.0, 30.0).max() == 0.0
    assert with_mag.variance[-1].max() < without.variance[-1].min()


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_wrong_gyro_bias_is_found_about_gravity(formulation: str, vertical: HandRecording) -> None:
    """.3 deg/s appear on one sensor after the start: they are integrated to 7 deg unless the field corrects them."""
    recording = vertical.recording
    gyro = {name: table.copy() for name, table in recording.gyro.items()}
    gyro["proximal"][600:] += np.radians(0.3) * np.array([1.0, 0.0, 0.0])
    drifting = replace(recording, gyro=gyro)
    without = estimate(vertical, drifting, formulation=formulation, mag_weight=0.0)
    with_mag = estimate(vertical, drifting, formulation=formulation, ki=0.2, calibrated_bias_std_dps=0.3)
    assert error_deg(vertical, without, 25.0)[0] > 4.0
    assert error_deg(vertical, with_mag, 25.0)[0] < 1.5


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_undisturbed_fields_are_used_and_do_no_harm(formulation: str, hand: HandRecording) -> None:
    series = estimate(hand, formulation=formulation)
    assert not (series.status & Status.DISTURBED).any()
    assert error_deg(hand, series).max() < (2.0 if formulation == "absolute" else 0.5)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_without_weight_the_field_has_no_influence(formulation: str, hand: HandRecording) -> None:
    spoilt = with_fields(hand.recording, "middle", slice(None), 1e-4)
    one = estimate(hand, formulation=formulation, mag_weight=0.0)
    other = estimate(hand, spoilt, formulation=formulation, mag_weight=0.0)
    np.testing.assert_array_equal(one.position, other.position)
    np.testing.assert_array_equal(one.status, other.status)


# ------------------------------------------------------------- disturbances

MAGNET = np.array([30e-6, -20e-6, 40e-6])  # tesla: a screwdriver


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_disturbance_is_flagged_where_it_matters_and_ends_by_itself(formulation: str, hand: HandRecording) -> None:
    disturbed = with_fields(hand.recording, "middle", slice(1200, 1700), MAGNET)
    series = estimate(hand, disturbed, formulation=formulation)
    np.testing.assert_array_equal(flagged(series, Status.DISTURBED, 0.0, 11.99), 0.0)
    np.testing.assert_array_equal(flagged(series, Status.DISTURBED, 12.5, 17.0), [0.0, 1.0, 1.0])
    np.testing.assert_array_equal(flagged(series, Status.DISTURBED, 17.0 + QUIET + 1.5, 30.0), 0.0)
    harmless = error_deg(hand, estimate(hand, formulation=formulation))
    assert (error_deg(hand, series) < harmless + 0.5).all()


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_unnoticed_the_same_disturbance_would_matter(formulation: str, vertical: HandRecording) -> None:
    disturbed = with_fields(vertical.recording, "middle", slice(1200, 1700), MAGNET)
    trusting = {"mag_norm_tolerance": 100.0, "mag_dip_tolerance_deg": 180.0}
    series = estimate(vertical, disturbed, formulation=formulation, **trusting)
    assert not (series.status & Status.DISTURBED).any()
    assert error_deg(vertical, series, 12.0, 20.0)[1:].max() > 3.0


def test_during_a_long_disturbance_turns_about_gravity_are_unobservable_again(vertical: HandRecording) -> None:
    for formulation in FORMULATIONS:
        disturbed = with_fields(vertical.recording, "palm", slice(1200, 2000), MAGNET)
        series = estimate(vertical, disturbed, formulation=formulation)
        np.testing.assert_array_equal(flagged(series, Status.UNOBSERVABLE, 15.0, 20.0), [1.0, 0.0, 0.0])
        np.testing.assert_array_equal(flagged(series, Status.UNOBSERVABLE, 24.0, 30.0), 0.0)


def test_a_field_of_the_right_norm_from_elsewhere_is_disturbed(vertical: HandRecording) -> None:
    """Only the dip tells."""
    plain = vertical.recording
    mag = {name: table.copy() for name, table in plain.mag.items()}
    mag["distal"][1200:1700] *= -1.0
    series = estimate(vertical, replace(plain, mag=mag))
    np.testing.assert_array_equal(flagged(series, Status.DISTURBED, 13.0, 17.0), [0.0, 0.0, 1.0])
    unnoticed = estimate(vertical, replace(plain, mag=mag), mag_dip_tolerance_deg=180.0)
    assert error_deg(vertical, series)[2] < 0.1 * error_deg(vertical, unnoticed)[2]


def test_one_magnetometer_in_the_configured_field_and_one_beside_a_motor(vertical: HandRecording) -> None:
    """Learnt at rest, a constant disturbance is the reference; a configured one knows better."""
    disturbed = with_fields(vertical.recording, "palm", slice(None), MAGNET)
    x, _, z = EARTH_FIELD
    reference = {"mag_norm_ut": 1e6 * np.hypot(x, z), "mag_dip_deg": np.degrees(np.arctan2(-z, x))}
    learnt = estimate(vertical, disturbed)
    configured = estimate(vertical, disturbed, **reference)
    assert not (learnt.status & Status.DISTURBED).any()
    np.testing.assert_array_equal(flagged(configured, Status.DISTURBED, 0.5, 30.0), [1.0, 0.0, 0.0])
    assert not (estimate(vertical, **reference).status & Status.DISTURBED).any()


# ------------------------------------------------------------- the watch by itself

REST = ((0.0, 0.0, 0.0), (0.0, 0.0, 9.81), (20e-6, 0.0, -44e-6))  # gyro, accelerometer, field
STRONG = ((0.0, 0.0, 0.0), (0.0, 0.0, 9.81), (30e-6, 0.0, -66e-6))


def feed(watch: FieldWatch, seconds: float, sample: tuple, start: float) -> list[bool]:
    stamps = np.round((start + np.arange(0.0, seconds, 0.01)) * 1e9).astype(np.int64)
    return [watch.sound(stamp, *sample) for stamp in stamps.tolist()]


def watch() -> FieldWatch:
    return FieldWatch(Field(norm_tolerance=0.1, dip_tolerance=np.radians(10.0)))


def test_reference_is_what_was_measured_at_rest() -> None:
    one = watch()
    moving = ((1.0, 0.0, 0.0), *STRONG[1:])
    assert all(feed(one, 1.0, moving, 0.0)) and np.isnan(one.reference_norm)
    assert not all(feed(one, LEARN + 1.0, REST, 1.0)[:2]) or one.reference_norm > 0.0
    assert one.reference_norm == pytest.approx(48.33e-6, rel=1e-3)
    assert np.degrees(np.arcsin(one.reference_sine)) == pytest.approx(65.6, abs=0.1)
    feed(one, 10.0, STRONG, 10.0)
    assert one.reference_norm == pytest.approx(48.33e-6, rel=1e-3)


def test_recovery_takes_a_while_of_quiet() -> None:
    one = watch()
    assert all(feed(one, 3.0, REST, 0.0))
    assert not feed(one, 2.0, STRONG, 3.0)[-1]
    again = feed(one, 3.0, REST, 5.0)
    first = again.index(True) * 0.01
    assert QUIET <= first < QUIET + 1.5 and all(again[again.index(True) :])


def test_a_restored_watch_continues_identically() -> None:
    one, other = watch(), watch()
    for sample, start in ((REST, 0.0), (STRONG, 3.0)):
        feed(one, 3.0, sample, start)
        other.set_state(json.loads(json.dumps(one.get_state())))
        assert feed(one, 1.0, REST, start + 3.0) == feed(other, 1.0, REST, start + 3.0)
        assert one.get_state() == other.get_state()
    fresh = watch()
    fresh.set_state(json.loads(json.dumps(watch().get_state())))
    assert fresh.get_state() == watch().get_state()


def test_no_field_at_all_is_disturbed_and_no_error() -> None:
    one = watch()
    feed(one, 3.0, REST, 0.0)
    assert not feed(one, 3.0, (*REST[:2], (0.0, 0.0, 0.0)), 3.0)[-1]
    assert isinstance(one.sound(7_000_000_000, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), REST[2]), bool)
