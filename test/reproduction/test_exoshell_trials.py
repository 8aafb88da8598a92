"""Trials out of files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jointest_ros.reproduction import exoshell_trials, kckf_table1
from jointest_ros.reproduction.result import Options, ReproductionError, Result
from jointest_ros.sim.exoshell import GYROS


def save(path: Path, trial: exoshell_trials.Trial, **changes: np.ndarray) -> Path:
    """Write a trial in the format of the fixed inputs."""
    gyro = np.stack([trial.recording.gyro[name] for name in GYROS], axis=1)[1:]
    assert trial.recording.hall is not None
    arrays = {
        "t": trial.recording.stamps * 1e-9,
        "theta": np.degrees(trial.angles),
        "gyro": np.degrees(gyro),
        "hall_V": trial.recording.hall.reshape(-1, 4, 2),
    }
    np.savez(path, **(arrays | changes))
    return path


def test_a_saved_trial_comes_back(tmp_path: Path) -> None:
    trial = exoshell_trials.simulated("table1", 2.0, seed=1)
    again = exoshell_trials.from_file(save(tmp_path / "trial.npz", trial), "table1")
    assert again.robot == trial.robot
    np.testing.assert_array_equal(again.recording.stamps, trial.recording.stamps)
    np.testing.assert_array_equal(again.recording.hall, trial.recording.hall)
    for name in GYROS:
        assert np.isnan(again.recording.gyro[name][0]).all()  # the file has no gyro before the first Hall sample
        np.testing.assert_allclose(again.recording.gyro[name][1:], trial.recording.gyro[name][1:], atol=1e-12)
    np.testing.assert_allclose(again.torso, trial.torso, atol=1e-12)


def test_what_is_no_trial_is_refused_in_one_line(tmp_path: Path) -> None:
    trial = exoshell_trials.simulated("table1", 1.0, seed=1)
    text = tmp_path / "text.npz"
    text.write_text("t, theta")
    other = tmp_path / "other.npz"
    np.savez(other, t=np.arange(3.0))
    shape = save(tmp_path / "shape.npz", trial, theta=np.zeros((100, 3)))
    for path, reason in (
        (tmp_path / "none.npz", "cannot be read: No such file"),
        (tmp_path, "cannot be read"),
        (text, "not a trial of the exoshell"),
        (other, "theta"),
        (shape, r"theta has the shape \(100, 3\); \(100, 4\)"),
    ):
        with pytest.raises(ReproductionError, match=reason) as caught:
            exoshell_trials.from_file(path, "table1")
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def rows(result: Result) -> dict[tuple[object, object], tuple[float, ...]]:
    """(method, paper or ours) -> six figures."""
    return {(row[0], row[1]): tuple(map(float, row[2:])) for row in result.tables[0].rows if None not in row}  # type: ignore[arg-type]


def test_the_fixed_input_gives_the_figures_of_the_specification(shared_data: Path) -> None:
    file = shared_data / "exoshell" / "table1_like.npz"
    table = rows(kckf_table1.run(lambda done, total: None, Options(data=str(file))))
    preset = table[exoshell_trials.PAPER_KCKF, "ours"]
    assert all(5.0 <= preset[joint] <= 6.5 for joint in (0, 1, 3)) and abs(preset[2] - 3.4) < 0.1
    assert max(table[exoshell_trials.OURS, "ours"][:4]) <= 1.4
    offset = table[exoshell_trials.OURS_OFFSET, "ours"]
    assert max(offset[:4]) <= 0.15 and max(offset[4:]) <= 0.2
    for name in ("gyro", "Hall 1", "Hall 2"):  # the scenario is made after these columns
        for figure, printed in zip(table[name, "ours"], kckf_table1.PAPER[name], strict=True):
            assert printed is None or abs(figure / printed - 1.0) < 0.15, name
