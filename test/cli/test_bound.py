"""`jointest bound` as a user meets it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Jointest = Callable[..., Any]

ARM = """
robot:
  links: [upper, lower]
  joints:
    elbow: {parent: upper, child: lower, axis: y, origin: [0.3, 0, 0]}
sensor_defaults: {gyro: false, accel_noise_ug: 400}
sensors:
  upper_near: {link: upper, position: [0.2525, 0, 0.01]}
  upper_far: {link: upper, position: [0.125, 0, 0]}
  lower_near: {link: lower, position: [0.0475, 0.02, 0]}
  lower_far: {link: lower, position: [0.175, 0, 0]}
"""
STILL, SLOW, FAST, BOTH = "still", "45 deg 0.25 Hz", "30 deg 2 Hz", "45 deg 0.25 Hz, parent 45 deg 0.2 Hz"


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """Two links with two accelerometers each."""
    path = tmp_path / "arm.yaml"
    path.write_text(ARM, encoding="utf-8")
    return path


def elbow(jointest: Jointest, *arguments: object) -> dict[str, Any]:
    """The JSON of the joint, its motions by name."""
    result = jointest("bound", *arguments, "--json", "-")
    assert result.code == 0 and not result.err
    document = json.loads(result.out)
    assert document["schema"] == 1
    joint: dict[str, Any] = document["joints"]["elbow"]
    given = "--up" in arguments  # otherwise with gravity, then without
    motions = {one["motion"]: one for one in joint["motions"] if given or one["gravity"]}
    return joint | {"motions": motions}


def test_it_prints_errors_with_units_and_better_places(jointest: Jointest, arm: Path) -> None:
    result = jointest("bound", arm)
    assert result.code == 0 and not result.err
    assert all(
        text in result.out for text in ("elbow", "deg/s", "m/s²", "smoother", "biases", "best position", "% less")
    )


def test_the_figures_are_in_the_order_of_what_is_known(jointest: Jointest, arm: Path) -> None:
    joint = elbow(jointest, arm)
    assert list(joint["motions"]) == [STILL, SLOW, FAST, BOTH]
    for motion in joint["motions"].values():
        assert motion["smoothed_deg"] < motion["angle_deg"] < min(motion["one_sample_deg"], motion["with_biases_deg"])
        assert motion["best_places_angle_deg"] < motion["angle_deg"]
    # at rest 20 mg of one sensor are 1.15 deg of inclination
    assert 0.5 < joint["motions"][STILL]["with_biases_deg"] < 2.0


def test_without_gravity_a_joint_that_rests_is_not_observable(jointest: Jointest, arm: Path) -> None:
    motions = elbow(jointest, arm, "--up", "0,2,0")["motions"]
    told = {name: motion["angle_deg"] is not None for name, motion in motions.items()}
    assert told == {STILL: False, SLOW: False, FAST: False, BOTH: True}
    both = json.loads(jointest("bound", arm, "--json", "-").out)["joints"]["elbow"]["motions"]
    assert both[4:] == list(motions.values()) and {one["gravity"] for one in both[:4]} == {9.80665}


def test_gravity_counts_as_far_as_it_lies_across_the_axis(jointest: Jointest, arm: Path) -> None:
    still = elbow(jointest, arm, "--up", "0,1,1", "--motion", "0,0")["motions"][STILL]
    whole = elbow(jointest, arm, "--up", "0,0,1", "--motion", "0,0")["motions"][STILL]
    assert still["gravity"] == pytest.approx(9.80665 / 2.0**0.5)
    assert still["one_sample_deg"] == pytest.approx(2.0**0.5 * whole["one_sample_deg"], rel=0.01)


def test_noise_and_rate_count_as_they_should(jointest: Jointest, arm: Path) -> None:
    slow = elbow(jointest, arm, "--motion", "0,0")
    fast = elbow(jointest, arm, "--motion", "0,0", "--rate", "400")
    assert fast["noise"] == pytest.approx(2.0 * slow["noise"])
    # the same density of noise tells the same in the same time
    assert fast["motions"][STILL]["smoothed_deg"] == pytest.approx(slow["motions"][STILL]["smoothed_deg"], rel=0.05)
    assert fast["motions"][STILL]["one_sample_deg"] == pytest.approx(
        2.0 * slow["motions"][STILL]["one_sample_deg"], rel=0.05
    )


def test_the_best_places_are_the_ends_of_the_given_links(jointest: Jointest, arm: Path) -> None:
    joint = elbow(jointest, arm, "--link-length", "upper=0.3", "--link-length", "lower=0.5", "--motion", "45,0.25")
    places = joint["best_places"]
    assert places["lower_near"] == pytest.approx([0.0, 0.02, 0.0])  # what is across the plane of motion stays
    assert places["lower_far"] == pytest.approx([0.5, 0.0, 0.0])
    assert places["upper_near"] == pytest.approx([0.3, 0.0, 0.0])
    assert places["upper_far"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert joint["motions"][SLOW]["best_places_angle_deg"] < 0.8 * joint["motions"][SLOW]["angle_deg"]


def test_the_advice_is_true_of_the_configuration_that_follows_it(jointest: Jointest, arm: Path) -> None:
    before = elbow(jointest, arm, "--bias-mg", 0)
    assert before["motions"][SLOW]["with_biases_deg"] is None
    text = ARM
    for name, place in before["best_places"].items():
        start = text.index("position:", text.index(f"  {name}:"))
        text = text[:start] + f"position: {place}}}" + text[text.index("\n", start) :]
    arm.write_text(text, encoding="utf-8")
    after = elbow(jointest, arm)
    for name, motion in before["motions"].items():
        assert after["motions"][name]["angle_deg"] == pytest.approx(motion["best_places_angle_deg"])
        assert after["motions"][name]["best_places_angle_deg"] == pytest.approx(motion["best_places_angle_deg"])


def test_plot_and_file_of_figures(jointest: Jointest, arm: Path, tmp_path: Path) -> None:
    picture, figures = tmp_path / "bound.png", tmp_path / "bound.json"
    result = jointest("bound", arm, "--plot", picture, "--json", figures)
    assert result.code == 0 and str(figures) in result.out and str(picture) in result.err
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert json.loads(figures.read_text(encoding="utf-8"))["joints"]["elbow"]


def test_a_robot_without_arrays_is_told_so(jointest: Jointest, finger_config: Path) -> None:
    assert "fewer than two accelerometers" in jointest("bound", finger_config).refusal()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--rate", "1"), "--rate: 1 "),
        (("--rate", "nan"), "--rate: nan"),
        (("--bias-mg", "-1"), "--bias-mg: -1"),
        (("--motion", "45"), "--motion: '45'"),
        (("--motion", "45,inf"), "--motion: '45,inf'"),
        (("--motion", "45,40"), "frequency: 40 "),
        (("--up", "0,0,0"), "--up: '0,0,0'"),
        (("--up", "up"), "--up: 'up'"),
        (("--link-length", "hand=0.2"), "'hand' is no link; give one of upper, lower"),
        (("--link-length", "lower=long"), "'lower=long'"),
        (("--link-length", "lower=0"), "--link-length: lower: 0 "),
        (("--plot", "bound.txt"), "'.txt' is not allowed"),
    ],
)
def test_bad_options_are_refused_in_one_line(
    jointest: Jointest, arm: Path, arguments: tuple[str, str], named: str
) -> None:
    assert named in jointest("bound", arm, *arguments).refusal()


def test_a_sensor_without_noise_and_a_missing_file_are_refused(jointest: Jointest, arm: Path, tmp_path: Path) -> None:
    arm.write_text(ARM.replace("ug: 400", "ug: 0"), encoding="utf-8")
    assert "accel_noise_ug is 0" in jointest("bound", arm).refusal()
    assert "no such configuration" in jointest("bound", tmp_path / "none.yaml").refusal()


def test_a_plot_without_a_curve_is_refused(jointest: Jointest, arm: Path, tmp_path: Path) -> None:
    result = jointest("bound", arm, "--up", "0,1,0", "--motion", "0,0", "--plot", tmp_path / "none.png")
    assert "nothing to draw" in result.refusal()
