"""Public recordings turned into bags: the numbers in the bag are those of the file."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import loadmat, savemat

from jointest_ros.bags import cdr
from jointest_ros.bags.conversion import ConversionSummary
from jointest_ros.bags.convert import FORMATS
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.typestore import typestore
from jointest_ros.bags.writer import StorageName

SONG = ["all_time", "all_encoder", *(f"all_{f}_{n}_{a}" for f in ("gyro", "accel") for n in (1, 2) for a in "xyz")]
ORIENTATION = "/ground_truth/imu_orientation"


def song_table(rows: int = 5) -> dict[str, Any]:
    table = {name: np.arange(rows)[:, None] + 100.0 * number for number, name in enumerate(SONG)}
    table["all_time"] = 60.004 + 0.01 * np.minimum(np.arange(rows), rows - 2)[:, None]  # the last stamp is repeated
    return table


def write_broad(path: Path, **changes: Any) -> Path:
    quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (6, 1))
    quaternions[2] = np.nan
    quaternions[5] = [0.1, 0.2, 0.3, 0.4]
    columns = {
        "imu_gyr": np.arange(18.0).reshape(6, 3),
        "imu_acc": np.arange(18.0).reshape(6, 3) + 100.0,
        "imu_mag": np.arange(18.0).reshape(6, 3) + 20.0,
        "opt_quat": quaternions,
        "movement": np.array([False, False, True, True, True, False]),
    } | changes
    with h5py.File(path, "w") as file:
        for name, column in columns.items():
            if column is not None:
                file[name] = column
        file.attrs["sampling_rate"] = 2000.0 / 7.0
    return path


def contents(bag: Path, topic: str) -> list[tuple[int, bytes]]:
    with BagReader(bag) as reader:
        return [(time, data) for _, time, data in reader.messages([topic])]


def refusal(name: str, src: Path, destination: Path) -> str:
    with pytest.raises(BagError) as raised:
        FORMATS[name].function(src, destination)
    assert not destination.exists()
    assert "\n" not in str(raised.value)
    return str(raised.value)


def test_song(storage: StorageName, tmp_path: Path) -> None:
    savemat(tmp_path / "raw.mat", song_table())
    reports: list[tuple[int, int]] = []
    summary = FORMATS["song"].function(
        tmp_path / "raw.mat", tmp_path / "run", storage, lambda done, total: reports.append((done, total))
    )
    topics = ["/imu/imu_1", "/imu/imu_2", "/ground_truth/joint_states"]
    assert summary == ConversionSummary(tmp_path / "run", 30_000_000 * 1e-9, dict.fromkeys(topics, 5))
    assert reports == [(5, 5)]
    stamps = [60_004_000_000, 60_014_000_000, 60_024_000_000, 60_034_000_000, 60_034_000_000]
    for number, first_gyro, first_accel in ((1, 200.0, 800.0), (2, 500.0, 1100.0)):
        messages = contents(tmp_path / "run", f"/imu/imu_{number}")
        assert [time for time, _ in messages] == stamps
        stamp, frame_id, gyro, accel = cdr.decode_imu(messages[1][1])
        assert (stamp, frame_id) == (stamps[1], f"imu_{number}")
        assert gyro == pytest.approx([math.radians(first_gyro + 1.0 + 100.0 * axis) for axis in range(3)], rel=1e-15)
        assert accel == pytest.approx([9.80665 * (first_accel + 1.0 + 100.0 * axis) for axis in range(3)], rel=1e-15)
    truth = [cdr.decode_joint_state(data) for _, data in contents(tmp_path / "run", topics[2])]
    assert truth == [(s, ("shaft",), (math.radians(100.0 + k),), ()) for k, s in enumerate(stamps)]


def test_song_as_published(shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / "song" / "raw_roll_medium.mat"
    summary = FORMATS["song"].function(source, tmp_path / "run")
    table = loadmat(source, squeeze_me=True)
    assert set(summary.messages.values()) == {149_788}
    assert summary.duration_s == pytest.approx(1521.293 - 21.389)
    with BagReader(tmp_path / "run") as bag:
        assert bag.start_ns == 21_389_000_000
        assert bag.topics["/imu/imu_1"] == cdr.IMU
        gyro, accel, stamps = [], [], []
        for _, time, data in bag.messages(["/imu/imu_2"]):
            stamp, _, w, f = cdr.decode_imu(data)
            assert stamp == time
            stamps.append(stamp)
            gyro.append(w)
            accel.append(f)
    np.testing.assert_allclose(np.array(stamps) * 1e-9, table["all_time"], atol=1e-9)
    assert np.count_nonzero(np.diff(stamps) == 0) == 211, "repeated stamps are kept"
    np.testing.assert_allclose(np.degrees(gyro)[:, 0], table["all_gyro_2_x"], rtol=1e-14)
    np.testing.assert_allclose(np.array(accel)[:, 2] / 9.80665, table["all_accel_2_z"], rtol=1e-14)
    truth = [cdr.decode_joint_state(data)[2][0] for _, data in contents(tmp_path / "run", "/ground_truth/joint_states")]
    np.testing.assert_allclose(np.degrees(truth), table["all_encoder"], rtol=1e-14, atol=1e-12)


def test_broad(storage: StorageName, tmp_path: Path) -> None:
    summary = FORMATS["broad"].function(write_broad(tmp_path / "trial.hdf5"), tmp_path / "run", storage)
    assert summary.messages == {
        "/imu/imu": 6,
        "/mag/imu": 6,
        ORIENTATION: 5,
        "/ground_truth/movement": 3,
    }
    assert summary.notes == ("1 rows have no optical orientation; their ground truth is left out",)
    stamps = [0, 3_500_000, 7_000_000, 10_500_000, 14_000_000, 17_500_000]
    imu = [cdr.decode_imu(data) for _, data in contents(tmp_path / "run", "/imu/imu")]
    assert imu[1] == (stamps[1], "imu", (3.0, 4.0, 5.0), (103.0, 104.0, 105.0))
    mag = [cdr.decode_magnetic_field(data) for _, data in contents(tmp_path / "run", "/mag/imu")]
    assert mag[1][:2] == (stamps[1], "imu")
    assert mag[1][2] == pytest.approx((23e-6, 24e-6, 25e-6))
    truth = [cdr.decode_quaternion_stamped(data) for _, data in contents(tmp_path / "run", ORIENTATION)]
    assert [stamp for stamp, _, _ in truth] == stamps[:2] + stamps[3:]
    assert truth[-1] == (stamps[5], "imu", (0.2, 0.3, 0.4, 0.1))
    movement = [
        (time, typestore().deserialize_cdr(data, cdr.BOOL).data)  # type: ignore[attr-defined]
        for time, data in contents(tmp_path / "run", "/ground_truth/movement")
    ]
    assert movement == [(stamps[0], False), (stamps[2], True), (stamps[5], False)]


def test_broad_as_published(shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / "broad" / "07_undisturbed_fast_rotation_B.hdf5"
    summary = FORMATS["broad"].function(source, tmp_path / "run")
    with h5py.File(source) as file:
        accel, mag, quaternion = file["imu_acc"][...], file["imu_mag"][...], file["opt_quat"][...]
    assert summary.messages["/imu/imu"] == len(accel) == 52_518
    assert summary.duration_s == pytest.approx(52_517 * 0.0035)
    tracked = ~np.isnan(quaternion).any(axis=1)
    assert summary.messages[ORIENTATION] == tracked.sum()
    read = [cdr.decode_imu(data)[3] for _, data in contents(tmp_path / "run", "/imu/imu")]
    np.testing.assert_array_equal(read, accel)
    read = [cdr.decode_magnetic_field(data)[2] for _, data in contents(tmp_path / "run", "/mag/imu")]
    np.testing.assert_allclose(np.array(read) * 1e6, mag, rtol=1e-14)
    truth = [cdr.decode_quaternion_stamped(data)[2] for _, data in contents(tmp_path / "run", ORIENTATION)]
    np.testing.assert_array_equal(np.roll(truth, 1, axis=1), quaternion[tracked])


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_no_such_recording(name: str, tmp_path: Path) -> None:
    assert "no such file" in refusal(name, tmp_path / "nothing", tmp_path / "run")
    assert "not a file" in refusal(name, tmp_path, tmp_path / "run")
    for content in (b"", b"just a text", bytes(300), b"\xff" * 3000):
        (tmp_path / "text").write_bytes(content)
        assert f"{tmp_path / 'text'}: not a" in refusal(name, tmp_path / "text", tmp_path / "run")


def test_song_files_that_lack_something(tmp_path: Path) -> None:
    source, run = tmp_path / "raw.mat", tmp_path / "run"
    savemat(source, {"x": 1.0})
    assert "all_time, all_encoder, all_gyro_1_x missing" in refusal("song", source, run)
    savemat(source, song_table() | {"all_encoder": np.zeros((4, 1))})
    assert "different lengths" in refusal("song", source, run)
    savemat(source, song_table() | {"all_encoder": "a text"})
    assert "not a raw recording" in refusal("song", source, run)
    savemat(source, song_table() | {"all_time": np.full((5, 1), np.nan)})
    assert "all_time" in refusal("song", source, run)
    savemat(source, dict.fromkeys(SONG, np.zeros((0, 1))))
    assert "empty" in refusal("song", source, run)


@pytest.mark.parametrize(
    "changes",
    [
        {"imu_mag": None},
        {"opt_quat": np.zeros((6, 3))},
        {"imu_gyr": np.zeros((5, 3))},
        {"movement": np.zeros(0, dtype=bool)},
        {"imu_acc": np.array(["text"] * 6, dtype="S")},
    ],
)
def test_broad_files_that_lack_something(changes: dict[str, Any], tmp_path: Path) -> None:
    text = refusal("broad", write_broad(tmp_path / "trial.hdf5", **changes), tmp_path / "run")
    assert "not a trial of the set 'broad'" in text


def test_broad_without_h5py(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = write_broad(tmp_path / "trial.hdf5")
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert "pip install 'jointest_ros[convert]'" in refusal("broad", source, tmp_path / "run")


def test_existing_destinations(tmp_path: Path) -> None:
    savemat(tmp_path / "raw.mat", song_table())
    FORMATS["song"].function(tmp_path / "raw.mat", tmp_path / "run")
    with pytest.raises(BagError, match="exists already"):
        FORMATS["song"].function(tmp_path / "raw.mat", tmp_path / "run")
    FORMATS["song"].function(tmp_path / "raw.mat", tmp_path / "run", overwrite=True)
