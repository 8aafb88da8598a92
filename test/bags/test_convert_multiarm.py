"""Semi-synthetic recordings: readings computed on the real double pendulum."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from jointest_ros import config
from jointest_ros.bags import cdr
from jointest_ros.bags.convert import FORMATS
from jointest_ros.bags.convert_multiarm import SEMI_SYNTHETIC, convert_multiarm
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.typestore import typestore
from jointest_ros.bags.writer import StorageName
from jointest_ros.core.accel.array import array_matrices, joint_arrays
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import FloatArray
from jointest_ros.sim.pendulum import LENGTHS, smooth

CONFIG = Path(__file__).resolve().parents[2] / "config" / "multiarm.yaml"
TRUTH = "/ground_truth/joint_states"
SENSORS = [f"/imu/arm_{arm}_{end}" for arm in (1, 2) for end in ("upper", "lower")]
DOUBLE = "multiarm/DoublePendulumDataForParameterEstimation.mat"


def cells(pieces: list[FloatArray]) -> Any:
    table = np.empty(len(pieces), dtype=object)
    table[:] = pieces
    return table


def contents(rows: int = 1200, **changes: Any) -> dict[str, Any]:
    """A swing in three pieces of the form of the published file."""
    time = 1e-3 * np.arange(rows)
    swing = np.array([np.pi + 0.8 * np.sin(6.0 * time), np.pi + 1.1 * np.sin(9.0 * time)])
    rates = np.array([4.8 * np.cos(6.0 * time), 9.9 * np.cos(9.0 * time)])
    y = np.split(np.vstack([swing, rates]), [rows // 3, 2 * rows // 3], axis=1)
    t = np.split(time[:, None], [rows // 3, 2 * rows // 3])
    return {"Y_id": cells(y[:2]), "Y_vad": cells(y[2:]), "Time_id": cells(t[:2]), "Time_vad": cells(t[2:])} | changes


def read(bag: Path) -> tuple[dict[str, FloatArray], FloatArray, FloatArray]:
    """Accelerations (T, 3) by topic, stamps (T,) and position of the joint (T,)."""
    accel: dict[str, list[Any]] = {topic: [] for topic in SENSORS}
    stamps, position = [], []
    with BagReader(bag) as reader:
        for topic, _, data in reader.messages():
            if topic == TRUTH:
                stamp, names, (angle,), _ = cdr.decode_joint_state(data)
                assert names == ("elbow",)
                stamps.append(stamp)
                position.append(angle)
            else:
                accel[topic].append(cdr.decode_imu(data)[3])
    return {topic: np.array(rows) for topic, rows in accel.items()}, np.array(stamps), np.array(position)


def analytical(accel: dict[str, FloatArray]) -> FloatArray:
    """Equation (12) of the paper, with the configuration that is shipped."""
    (arrays,) = joint_arrays(config.load(CONFIG).robot)
    channels = arrays.channels(np.stack([accel[f"/{sensor.topic}"] for sensor in arrays.sensors], axis=1))
    (_, f_a), (_, f_b) = (array_matrices(array.positions) for array in (arrays.parent, arrays.child))
    a, b = channels[:, :4] @ f_a.T, channels[:, 4:] @ f_b.T
    return np.arctan2(a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1], (a * b).sum(axis=1))


def wrapped(angle: FloatArray) -> FloatArray:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def test_a_swing(storage: StorageName, tmp_path: Path) -> None:
    savemat(tmp_path / "swing.mat", contents())
    reports: list[tuple[int, int]] = []
    summary = convert_multiarm(
        tmp_path / "swing.mat",
        tmp_path / "run",
        storage,
        lambda done, total: reports.append((done, total)),
        sensor="ideal",
        calibration="exact",
    )
    assert summary.messages == dict.fromkeys([*SENSORS, TRUTH], 1200)
    assert summary.duration_s == pytest.approx(1.199)
    assert summary.notes[0] == SEMI_SYNTHETIC and "within 0.000" in summary.notes[1]
    assert reports
    accel, stamps, position = read(tmp_path / "run")
    np.testing.assert_array_equal(np.diff(stamps), 10**6)
    time = 1e-3 * np.arange(1200)
    np.testing.assert_allclose(position, 1.1 * np.sin(9.0 * time) - 0.8 * np.sin(6.0 * time), atol=1e-5)
    np.testing.assert_allclose(analytical(accel), position, atol=1e-9)


def test_what_is_not_measured_is_marked(tmp_path: Path) -> None:
    """An Imu message without angular velocity: NaN, and a covariance that begins with -1; the bag says what it is."""
    savemat(tmp_path / "swing.mat", contents())
    convert_multiarm(tmp_path / "swing.mat", tmp_path / "run", rate_hz=100.0)
    with BagReader(tmp_path / "run") as reader:
        assert reader.counts == dict.fromkeys([*SENSORS, TRUTH], 120)
        _, _, data = next(iter(reader.messages([SENSORS[0]])))
    message: Any = typestore().deserialize_cdr(data, cdr.IMU)
    assert np.isnan([message.angular_velocity.x, message.angular_velocity.y, message.angular_velocity.z]).all()
    assert message.angular_velocity_covariance[0] == message.orientation_covariance[0] == -1.0
    assert message.linear_acceleration_covariance[0] > 0.0
    assert SEMI_SYNTHETIC in (tmp_path / "run" / "metadata.yaml").read_text(encoding="utf-8").replace("\n      ", " ")
    assert "semi-synthetic" in FORMATS["multiarm"].description


def test_the_real_pendulum(shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / DOUBLE
    options = {"rate_hz": 250.0, "sensor": "ideal", "calibration": "exact"}
    summary = convert_multiarm(source, tmp_path / "exact", "sqlite3", **options)
    table = loadmat(source, squeeze_me=True)
    theta = np.hstack([*table["Y_id"], *table["Y_vad"]])[:2, ::4]
    accel, _, position = read(tmp_path / "exact")
    assert summary.duration_s == pytest.approx(80.0)
    assert len(position) == theta.shape[1] == 20001
    off = np.degrees(position - (theta[1] - theta[0]))
    assert off.std() < 0.004 and np.abs(off).max() < 0.04
    np.testing.assert_allclose(wrapped(analytical(accel) - position), 0.0, atol=1e-9)
    convert_multiarm(source, tmp_path / "noisy", "sqlite3", rate_hz=100.0)
    noisy, _, position = read(tmp_path / "noisy")
    error = np.degrees(wrapped(analytical(noisy) - position))
    assert 0.05 < np.median(np.abs(error)) < 3.0


def test_the_equation_of_motion_confirms_angles_and_length(shared_data: Path) -> None:
    """Of arm 2: alpha_2 = p (L (sin d w_1^2 - cos d alpha_1) + g sin th_2) + k (w_1 - w_2), d = th_1 - th_2."""
    table = loadmat(shared_data / DOUBLE, squeeze_me=True)
    motion = smooth(np.hstack([*table["Y_id"], *table["Y_vad"]])[:2].T, 1e-3)
    time = np.arange(0.1, 79.9, 2e-3)
    (th_1, th_2), (w_1, w_2), (al_1, al_2) = (motion(time, order).T for order in range(3))
    d = th_1 - th_2
    design = np.column_stack([-(np.cos(d) * al_1 - np.sin(d) * w_1**2), np.sin(th_2), w_1 - w_2])
    fit, *_ = np.linalg.lstsq(design, al_2, rcond=None)
    assert 1.0 - np.var(al_2 - design @ fit) / np.var(al_2) > 0.999
    assert 9.81 * fit[0] / fit[1] == pytest.approx(LENGTHS[0], rel=0.01)  # upward is 0: gravity drives away from it


def test_files_that_lack_something(tmp_path: Path, shared_data: Path) -> None:
    source, run = tmp_path / "swing.mat", tmp_path / "run"

    def refusal(**changes: Any) -> str:
        savemat(source, contents(**changes))
        with pytest.raises(BagError) as raised:
            convert_multiarm(source, run)
        assert not run.exists() and "\n" not in str(raised.value)
        return str(raised.value)

    savemat(source, {"x": 1.0})
    with pytest.raises(BagError, match="Y_id, Y_vad, Time_id missing"):
        convert_multiarm(source, run)
    assert "not a recording of the double pendulum" in refusal(Y_vad=cells([np.zeros((6, 400))]))
    assert "not a recording of the double pendulum" in refusal(Y_vad=cells([np.zeros((4, 300))]))
    assert "not a recording of the double pendulum" in refusal(Y_vad="text")
    assert "not a recording of the double pendulum" in refusal(rows=60)
    assert "not consecutive" in refusal(Time_vad=cells([1e-3 * np.arange(900, 1300)[:, None]]))
    assert "not consecutive" in refusal(Y_vad=cells([np.full((4, 400), np.nan)]))
    triple = shared_data / "multiarm/TriplePendulumDataForParameterEstimation.mat"
    with pytest.raises(BagError, match=r"\(6, 40001\) values .* 4 rows"):
        convert_multiarm(triple, run)


def test_options_that_are_not_allowed(tmp_path: Path) -> None:
    savemat(tmp_path / "swing.mat", contents())
    for options, expected in (
        ({"sensor": "mpu"}, "sensor: 'mpu' is not allowed; give one of ideal, adxl345"),
        ({"rate_hz": 5000.0}, "rate_hz: 5000.0 is not allowed; give 100 to 1000 Hz"),
        ({"segment": 3}, "segment: unknown key"),
    ):
        with pytest.raises(ConfigurationError, match=expected):
            convert_multiarm(tmp_path / "swing.mat", tmp_path / "run", **options)
    assert not (tmp_path / "run").exists()
