"""`jointest convert`: public recordings, and files that are none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from jointest_ros.bags.reader import BagReader

Jointest = Callable[..., Any]
TOPICS = {"/imu/imu_1", "/imu/imu_2", "/ground_truth/joint_states"}


@pytest.fixture
def song_file(tmp_path: Path) -> Path:
    """Two seconds in the format of the set `song`: the shaft stands still."""
    path, rows = tmp_path / "raw_tiny.mat", 200
    table = {
        name: np.zeros((rows, 1)) for name in ("all_encoder", *(f"all_gyro_{n}_{a}" for n in (1, 2) for a in "xyz"))
    }
    table |= {f"all_accel_{n}_{a}": np.full((rows, 1), float(a == "x")) for n in (1, 2) for a in "xyz"}
    table["all_time"] = 0.01 * np.arange(rows)[:, None]
    savemat(path, table)
    return path


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_song(storage: str, song_file: Path, jointest: Jointest, tmp_path: Path) -> None:
    bag = tmp_path / "tiny"
    result = jointest("convert", "song", song_file, "-o", bag, "--storage", storage)
    assert (result.code, result.err) == (0, "")
    assert result.out.splitlines()[0] == f"{bag}: 2.0 s"
    assert "  /imu/imu_1  200 messages" in result.out
    with BagReader(bag) as reader:
        assert reader.counts == dict.fromkeys(TOPICS, 200)


def test_what_it_makes_can_be_evaluated(song_file: Path, jointest: Jointest, tmp_path: Path) -> None:
    configuration = Path(__file__).resolve().parents[2] / "config" / "song_pitch.yaml"
    jointest("convert", "song", song_file, "-o", tmp_path / "tiny")
    result = jointest("evaluate", tmp_path / "tiny", "-c", configuration)
    assert (result.code, result.err) == (0, "")
    assert "shaft" in result.out


def test_an_existing_recording(song_file: Path, jointest: Jointest, tmp_path: Path) -> None:
    bag = tmp_path / "tiny"
    jointest("convert", "song", song_file, "-o", bag)
    assert f"{bag}: exists already" in jointest("convert", "song", song_file, "-o", bag).refusal()
    assert jointest("convert", "song", song_file, "-o", bag, "--overwrite").code == 0


@pytest.mark.parametrize("name", ["song", "broad", "multiarm"])
def test_files_of_another_kind(name: str, jointest: Jointest, tmp_path: Path) -> None:
    (tmp_path / "empty").touch()
    (tmp_path / "text").write_text("time,angle\n0,1\n", encoding="utf-8")
    (tmp_path / "binary").write_bytes(bytes(range(256)) * 100)
    savemat(tmp_path / "other.mat", {"x": np.arange(3)})
    for source in ("empty", "text", "binary", "other.mat", "absent", "."):
        text = jointest("convert", name, tmp_path / source, "-o", tmp_path / "out").refusal()
        assert text.startswith(f"{tmp_path / source}: ")
        assert not (tmp_path / "out").exists()


def test_real_recordings_of_the_wrong_format(shared_data: Path, jointest: Jointest, tmp_path: Path) -> None:
    pendulum = next((shared_data / "multiarm").glob("*.mat"))
    trial = next((shared_data / "broad").glob("*.hdf5"))
    for name, source in (("song", pendulum), ("song", trial), ("broad", pendulum)):
        text = jointest("convert", name, source, "-o", tmp_path / "out").refusal()
        assert text.startswith(f"{source}: not a ")


def test_help_names_the_formats(jointest: Jointest) -> None:
    text = jointest("convert", "--help").out
    assert "formats:\n  song     two MPU6050 and a shaft encoder" in text
    assert "\n  broad    one IMU" in text
    assert "\n  multiarm semi-synthetic: accelerometers computed on a real double pendulum" in text


def test_semi_synthetic_recordings_are_called_so(shared_data: Path, jointest: Jointest, tmp_path: Path) -> None:
    source = shared_data / "multiarm" / "DoublePendulumDataForParameterEstimation.mat"
    options = ("--sensor", "adxl345", "--rate", 100, "--seed", 2, "--calibration", "none", "--placement", "approximate")
    result = jointest("convert", "multiarm", source, "-o", tmp_path / "run", *options)
    assert (result.code, result.err) == (0, "")
    assert "  /imu/arm_2_lower  8001 messages" in result.out
    assert "  semi-synthetic: the motion is that of a real double pendulum (encoders)" in result.out
    text = jointest("convert", "multiarm", source, "-o", tmp_path / "again", "--sensor", "mpu6050").refusal()
    assert text == "sensor: 'mpu6050' is not allowed; give one of ideal, adxl345, adxl357, bno055"
