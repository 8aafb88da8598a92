"""Pictures: what is drawn is what was estimated, however long, and no state is left in matplotlib."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from jointest_ros.core.frame import Series, Status
from jointest_ros.evaluation import plots
from jointest_ros.evaluation.panels import Curve, Panel, line, panels
from jointest_ros.evaluation.picture import PlotError
from jointest_ros.evaluation.truth import Truth

PERIOD = 10_000_000  # ns
HINGE = {"pcf": ("hinge",)}


def series(position: np.ndarray, status: int = 0, first: int = 0) -> Series:
    """Estimates of joints, columns of `position`, with a standard deviation of .1 rad."""
    stamps = (first + np.arange(len(position), dtype=np.int64)) * PERIOD
    shape = position.shape
    return Series(stamps, position, np.zeros(shape), np.full(shape, 0.01), np.full(shape, status, dtype=np.int64))


def truth_of(**positions: np.ndarray) -> Truth:
    count = len(next(iter(positions.values())))
    return Truth(np.arange(count, dtype=np.int64) * PERIOD, positions, {})


# -------------------------------------------------------------------- panels


def test_a_panel_holds_truth_estimate_error_and_band_in_degrees() -> None:
    position = np.linspace(0.0, 1.0, 50)
    (panel,) = panels({"pcf": series(position[:, None] + 0.2)}, HINGE, truth_of(hinge=position), 0.1)
    assert panel.name == "hinge"
    assert panel.truth is not None
    assert panel.truth[0] == pytest.approx(np.arange(10, 50) * 0.01)
    assert panel.truth[1] == pytest.approx(np.degrees(position[10:]))
    curve = panel.curves["pcf"]
    assert curve.seconds == pytest.approx(panel.truth[0])
    assert curve.estimate == pytest.approx(np.degrees(position[10:] + 0.2))
    assert curve.error == pytest.approx(np.full(40, math.degrees(0.2)))
    assert curve.spread == pytest.approx(np.full(40, 2.0 * math.degrees(0.1)))


def test_several_estimators_share_a_panel_and_may_have_joints_of_their_own() -> None:
    position = np.zeros(20)
    estimates = {"a": series(np.zeros((20, 2))), "b": series(np.zeros((20, 1))), "c": series(np.zeros((20, 1)))}
    joints = {"a": ("one", "two"), "b": ("two",), "c": ("three",)}
    found = panels(estimates, joints, truth_of(one=position, two=position, four=position))
    assert {panel.name: list(panel.curves) for panel in found} == {"one": ["a"], "two": ["a", "b"]}


def test_what_is_not_judged_is_not_drawn() -> None:
    position = np.zeros(20)
    hidden = series(position[:, None], int(Status.STALE))
    elsewhere = series(position[:, None], first=10_000)
    for one in (hidden, elsewhere, series(np.empty((0, 1)))):
        assert panels({"pcf": one}, HINGE, truth_of(hinge=position)) == []


def test_the_error_of_a_continuous_joint_is_wrapped() -> None:
    position = np.full(5, math.radians(179.0))
    (panel,) = panels({"pcf": series(-position[:, None])}, HINGE, truth_of(hinge=position), continuous={"hinge"})
    assert panel.curves["pcf"].error == pytest.approx(np.full(5, 2.0))


def test_the_inclination_of_a_sensor_has_an_error_only() -> None:
    stamps = np.arange(5, dtype=np.int64) * PERIOD
    up = np.array([[0.0, 0.0, 0.0, 1.0]] * 5)
    estimate = series(np.empty((5, 0)))
    estimate.orientation["imu"] = up
    found = panels({"pcf": estimate}, {"pcf": ()}, Truth(orientation={"imu": (stamps, up), "no": (stamps, up)}))
    (panel,) = found
    assert (panel.name, panel.truth) == ("inclination of imu", None)
    assert panel.curves["pcf"].error == pytest.approx(np.zeros(5), abs=1e-6)
    assert panel.curves["pcf"].spread is None


# -------------------------------------------------------------------- lines


def test_a_short_line_is_drawn_as_it_is() -> None:
    seconds, values = np.arange(2000) * 0.01, np.random.default_rng(1).normal(size=2000)
    drawn = line(seconds, values)
    assert np.array_equal(drawn[0], seconds)
    assert np.array_equal(drawn[1], values)


def test_a_long_line_keeps_every_peak_and_its_places() -> None:
    seconds = np.arange(150_000) * 0.01
    values = np.sin(seconds)
    values[[77_777, 3]] = 50.0, -50.0
    drawn, heights = line(seconds, values)
    assert len(drawn) < 4000
    assert (heights.max(), heights.min()) == (50.0, -50.0)
    assert drawn[heights.argmax()] == 777.77
    assert (np.diff(drawn) > 0.0).all()
    assert drawn[-1] == pytest.approx(seconds[-1], abs=1.0)
    assert np.array_equal(heights, values[np.round(drawn * 100).astype(int)])  # samples, not what lies between


@pytest.mark.parametrize("count", [100, 100_000])
def test_a_line_is_interrupted_where_samples_are_missing(count: int) -> None:
    seconds = np.concatenate([np.arange(count) * 0.01, np.arange(count) * 0.01 + count * 0.02])
    drawn, heights = line(seconds, np.ones(2 * count))
    (gap,) = np.flatnonzero(np.isnan(heights))
    assert np.isnan(drawn[gap])
    assert drawn[gap - 1] < count * 0.01 <= count * 0.02 <= drawn[gap + 1] + 0.01 * count / 700


def test_lines_of_one_sample_and_of_repeated_stamps() -> None:
    one = line(np.array([1.0]), np.array([2.0]))
    assert [array.tolist() for array in one] == [[1.0], [2.0]]
    same = line(np.array([1.0, 1.0]), np.array([2.0, 3.0]))
    assert same[1].tolist() == [2.0, 3.0]


# -------------------------------------------------------------------- files


def panel(count: int = 50, names: tuple[str, ...] = ("pcf",)) -> Panel:
    seconds = np.arange(count) * 0.01
    curve = Curve(seconds, np.sin(seconds), np.cos(seconds), np.ones(count))
    return Panel("hinge", dict.fromkeys(names, curve), (seconds, np.cos(seconds)))


def test_the_picture_says_what_it_shows(tmp_path: Path) -> None:
    plots.draw(tmp_path / "run.svg", "run: 12.0 s", [panel(names=("pcf", "kckf")), Panel("tilt", panel().curves)])
    drawn = (tmp_path / "run.svg").read_text(encoding="utf-8")
    rms = np.sqrt(np.mean(np.sin(np.arange(50) * 0.01) ** 2))
    for label in ("run: 12.0 s", "hinge", "tilt", "truth", "angle, deg", "error, deg", "time, s", "±2 reported std"):
        assert f"<!-- {label} -->" in drawn
    assert f"<!-- rms: pcf {rms:.3f} deg, kckf {rms:.3f} deg -->" in drawn
    assert drawn.count(f"<!-- pcf: rms {rms:.3f}, std ") == 2
    assert drawn.count(f"<!-- kckf: rms {rms:.3f}, std ") == 1


@pytest.mark.parametrize("count", [1, 7])
def test_any_number_of_panels_and_samples(count: int, tmp_path: Path) -> None:
    plots.draw(tmp_path / "run.png", "many", [panel(count)] * count)
    assert (tmp_path / "run.png").stat().st_size > 1000


def test_a_flat_line_without_error(tmp_path: Path) -> None:
    nothing = np.zeros(10)
    plots.draw(tmp_path / "run.png", "flat", [Panel("flat", {"pcf": Curve(np.arange(10.0), nothing)})])
    assert (tmp_path / "run.png").exists()


def test_pictures_that_cannot_be_drawn(tmp_path: Path) -> None:
    for path, shown, expected in (
        (tmp_path / "run.bmp", [panel()], "the suffix '.bmp' is not allowed; give one of .png, .svg, .pdf"),
        (tmp_path / "run", [panel()], "the suffix '' is not allowed"),
        (tmp_path / "run.png", [], "nothing to draw"),
        (tmp_path / "absent/run.png", [panel()], "cannot be written: No such file"),
    ):
        with pytest.raises(PlotError, match=expected) as raised:
            plots.draw(path, "title", shown)
        assert str(raised.value).startswith(f"{path}: ")
        assert not path.exists()


def test_matplotlib_is_left_as_it_was(tmp_path: Path) -> None:
    """In a process of its own: no pyplot, no display, no changed settings."""
    program = f"""
import sys, matplotlib
def settings():  # but the backend, which is chosen when it is looked at
    return {{key: matplotlib.rcParams[key] for key in matplotlib.rcParams if key != "backend"}}
before = settings()
import numpy as np
from pathlib import Path
from jointest_ros.evaluation import plots
from jointest_ros.evaluation.panels import Curve, Panel
curve = Curve(np.arange(9.0), np.arange(9.0))
plots.draw(Path({str(tmp_path / "run.png")!r}), "title", [Panel("one", {{"pcf": curve}})])
assert "matplotlib.pyplot" not in sys.modules
assert settings() == before
"""
    project = Path(__file__).resolve().parents[2]
    subprocess.run([sys.executable, "-W", "ignore", "-c", program], cwd=project, check=True, timeout=60)
    assert (tmp_path / "run.png").exists()
