"""Magnetometers in an inspection: every unit and every exchange of axes is named, and what is sound raises no alarm."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jointest_ros import config
from jointest_ros.bags.convert_broad import convert_broad
from jointest_ros.bags.matching import match, match_fields
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.survey import survey
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import Sensor
from jointest_ros.evaluation.inspection.findings import Finding
from jointest_ros.evaluation.inspection.magnetometers import field_findings
from jointest_ros.evaluation.inspection.recording import Setup, inspect
from jointest_ros.evaluation.inspection.sensors import SensorReport, take
from jointest_ros.evaluation.inspection.stream import Stream

EARTH = np.array([20e-6, 0.0, -44e-6])  # tesla
RATE, SECONDS = 100.0, 20.0
PROPER = [
    np.eye(3)[list(order)] * signs
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1, -1), repeat=3)
]


def turning() -> tuple[SensorReport, FloatArray]:
    """(a sensor that is turned about all axes, (T, 3) the field in its frame, tesla, with noise)."""
    random = np.random.default_rng(5)
    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    angles = np.column_stack([np.sin(2.0 * np.pi * rate * time + rate) for rate in (0.23, 0.31, 0.17)])
    orientation = Rotation.from_euler("xyz", angles * [1.2, 1.0, 1.5])
    steps = (orientation[:-1].inv() * orientation[1:]).as_rotvec() * RATE
    gyro = np.vstack([steps[:1], steps]) + 0.002 * random.standard_normal((len(time), 3))
    accel = orientation.inv().apply([0.0, 0.0, 9.80665]) + 0.02 * random.standard_normal((len(time), 3))
    stamps = np.asarray(np.round(time * 1e9), dtype=np.int64)
    report = take("imu", Stream("/imu", "imu", stamps, stamps, gyro, accel), Sensor("imu", "link"), [])
    assert report is not None
    return report, orientation.inv().apply(EARTH) + 0.3e-6 * random.standard_normal((len(time), 3))


REPORT, FIELD = turning()


def told(field: FloatArray, report: SensorReport | None = REPORT) -> list[Finding]:
    stamps = REPORT.stream.stamps
    stream = Stream("/mag", "imu", stamps, stamps, np.full_like(field, np.nan), field)
    return list(field_findings({"imu": stream}, {} if report is None else {"imu": report}))


def alarms(found: list[Finding]) -> list[tuple[str, str]]:
    return [(one.level, one.kind) for one in found if one.level != "ok"]


def test_a_sound_magnetometer() -> None:
    found = told(FIELD)
    assert [(one.level, one.kind) for one in found] == [("ok", "mag_strength"), ("ok", "mag_polarity")]
    assert alarms(told(FIELD, report=None)) == []


@pytest.mark.parametrize(("unit", "factor"), [("gauss", 1e-4), ("milligauss", 1e-7), ("uT", 1e-6), ("nT", 1e-9)])
def test_units(unit: str, factor: float) -> None:
    found = told(FIELD / factor)
    assert alarms(found) == [("wrong", "mag_units")]
    assert f"in {unit}, not in tesla" in found[0].text and f"multiply by {factor:g}" in found[0].action


@pytest.mark.parametrize("axes", PROPER, ids=str)
def test_exchanged_and_reversed_axes(axes: FloatArray) -> None:
    """All but the identity; and but its negative: a field of the other sign turns in the same way."""
    expected = [] if abs(np.trace(axes)) == 3 else [("wrong", "mag_polarity")]
    assert alarms(told(FIELD @ axes.T)) == expected


def test_the_axes_are_named() -> None:
    (found,) = [one for one in told(FIELD * [1.0, 1.0, -1.0]) if one.level == "wrong"]
    assert "its x is -x, its y is -y; or its z is -z" in found.text
    cyclic = FIELD[:, [1, 2, 0]]
    (found,) = [one for one in told(cyclic) if one.level == "wrong"]
    assert "its x is y, its y is z, its z is x;" in found.text


def test_hard_iron() -> None:
    found = told(FIELD + np.array([30e-6, -20e-6, 10e-6]))
    assert alarms(found) == [("look", "mag_offset")]  # and it does not hide that the axes are right
    assert "an offset of [30, -20, 10] uT" in found[0].text


def test_a_field_that_differs_from_place_to_place() -> None:
    strength = 1.0 + 0.3 * np.sin(np.arange(len(FIELD)) / RATE)
    assert ("look", "mag_strength") in alarms(told(FIELD * strength[:, None]))


def test_a_magnet_close_by() -> None:
    assert alarms(told(FIELD * 4.0)) == [("look", "mag_strength")]


def test_frozen_absent_and_not_finite() -> None:
    assert alarms(told(np.tile(FIELD[0], (len(FIELD), 1)))) == [("wrong", "mag_frozen")]
    assert alarms(told(np.full_like(FIELD, np.nan))) == [("look", "mag_finite"), ("look", "mag_rate")]
    holes = FIELD.copy()
    holes[::10] = np.nan
    assert alarms(told(holes)) == [("look", "mag_finite")]


@pytest.mark.parametrize("trial", ["02_undisturbed_slow_rotation_B", "16_undisturbed_fast_translation_B"])
def test_recorded_magnetometers_are_sound(trial: str, shared_data: Path, tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    convert_broad(shared_data / "broad" / f"{trial}.hdf5", tmp_path / "bag")
    file = tmp_path / "broad.yaml"
    file.write_text("robot: {links: [imu]}\nsensors: {imu: {mag: true}}\n", encoding="utf-8")
    robot = config.load(file).robot
    with BagReader(tmp_path / "bag") as reader:
        seen = survey(reader)
    streams, _ = match(seen, robot, "")
    done = inspect(streams, Setup(robot), seen.span, seen.truth, fields=match_fields(seen, robot, ""))
    mags = [(one.level, one.kind) for one in done.findings if one.kind.startswith("mag")]
    assert mags == [("ok", "mag_strength"), ("ok", "mag_polarity")]
