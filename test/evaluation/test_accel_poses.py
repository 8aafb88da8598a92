"""Which phases of a recording are still poses, and which direction is up in them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from jointest_ros.core.errors import CalibrationError
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import Sensor
from jointest_ros.core.rotation import exp
from jointest_ros.evaluation.accel_poses import (
    AXES,
    Pose,
    StillPhases,
    axes_up,
    find_poses,
    in_sensor_frame,
    name_of,
    read_directions,
)

G = 9.81
SIGMA = 0.03  # m/s^2


class Course:
    """What an accelerometer reads while its link is turned about z, from one angle (deg) to the next."""

    def __init__(self, rate: float = 100.0) -> None:
        self.rate, self.angles = rate, [0.0]

    def hold(self, seconds: float) -> Course:
        return self.turn(self.angles[-1], seconds)

    def turn(self, angle: float, seconds: float) -> Course:
        self.angles += np.linspace(self.angles[-1], angle, round(seconds * self.rate) + 1)[1:].tolist()
        return self

    def read(self, sigma: float = SIGMA, seed: int = 0) -> tuple[FloatArray, FloatArray]:
        """Stamps (T,) ns and readings (T, 3)."""
        angles = np.radians(self.angles)
        up = np.column_stack([np.sin(angles), np.cos(angles), np.zeros(len(angles))])
        noise = sigma * np.random.default_rng(seed).standard_normal(up.shape)
        return np.round(np.arange(len(angles)) * 1e9 / self.rate).astype(np.int64), G * up + noise


def spans(phases: StillPhases) -> list[tuple[float, float]]:
    return [(round(pose.start, 1), round(pose.stop, 1)) for pose in phases.poses]


STEPS = Course().hold(3.0).turn(90.0, 1.0).hold(2.6).turn(180.0, 0.5).hold(4.0)


def test_poses_are_found_with_their_means_and_standard_errors() -> None:
    stamps, rows = STEPS.read()
    phases = find_poses(stamps + 5_000_000_000, {"a": rows}, 1.0)
    assert spans(phases) == [(0.0, 2.8), (4.2, 6.4), (7.4, 11.1)]
    assert (phases.short, phases.drifting) == (0, 0)
    for pose, up in zip(phases.poses, ("+y", "+x", "-y"), strict=True):
        number = (pose.stop - pose.start) * 100.0
        error = SIGMA / math.sqrt(number)
        np.testing.assert_allclose(pose.mean["a"], G * np.array(AXES[up]), atol=4.0 * error)
        assert 0.3 * error < pose.error["a"].min() <= pose.error["a"].max() < 2.0 * error


@pytest.mark.parametrize("factor", [1.0 / G, 1000.0 / G, 1e-6])
def test_units_do_not_matter(factor: float) -> None:
    stamps, rows = STEPS.read()
    assert spans(find_poses(stamps, {"a": factor * rows}, 1.0)) == spans(find_poses(stamps, {"a": rows}, 1.0))


@pytest.mark.parametrize(("rate", "sigma"), [(25.0, 0.014), (100.0, 0.028), (1000.0, 0.088), (1000.0, 0.12)])
def test_rate_and_noise_do_not_matter(rate: float, sigma: float) -> None:
    course = Course(rate).hold(3.0).turn(90.0, 1.0).hold(3.0)
    stamps, rows = course.read(sigma)
    phases = find_poses(stamps, {"a": rows}, 1.0)
    assert [round(pose.start) for pose in phases.poses] == [0, 4]


def test_a_phase_is_still_when_every_sensor_is() -> None:
    stamps, rows = STEPS.read()
    _, other = Course().hold(5.0).turn(70.0, 1.0).hold(5.1).read(seed=1)
    phases = find_poses(stamps, {"a": rows, "b": other[: len(rows)]}, 0.4)
    assert spans(phases) == [(0.0, 2.8), (4.2, 4.8), (7.4, 11.1)]
    assert spans(find_poses(stamps, {"a": rows, "b": other[: len(rows)]}, 1.0)) == [(0.0, 2.8), (7.4, 11.1)]
    assert find_poses(stamps, {"a": rows, "b": other[: len(rows)]}, 1.0).short == 2  # before and after b turns


def test_a_bump_does_not_make_two_poses() -> None:
    stamps, rows = STEPS.read()
    rows[150:155] += 8.0
    phases = find_poses(stamps, {"a": rows}, 1.0)
    assert spans(phases) == [(0.0, 2.8), (4.2, 6.4), (7.4, 11.1)]
    np.testing.assert_allclose(phases.poses[0].mean["a"], [0.0, G, 0.0], atol=0.02)


@pytest.mark.parametrize("speed", [0.6, 2.0, 20.0])
def test_slow_motion_is_no_pose(speed: float) -> None:
    """Of many degrees; deg/s."""
    stamps, rows = Course().turn(60.0, 60.0 / speed).read()
    assert find_poses(stamps, {"a": rows}, 1.0).poses == []


def test_settling_is_left_out() -> None:
    stamps, rows = Course().hold(3.0).turn(90.0, 1.0).turn(93.0, 0.8).hold(4.0).read()
    (_, pose) = find_poses(stamps, {"a": rows}, 1.0).poses
    np.testing.assert_allclose(
        pose.mean["a"], [G * math.sin(math.radians(93.0)), G * math.cos(math.radians(93.0)), 0.0], atol=0.02
    )


def test_holes_and_missing_samples() -> None:
    stamps, rows = STEPS.read()
    rows[::7] = np.nan
    assert len(find_poses(stamps, {"a": rows}, 1.0).poses) == 3
    kept = np.ones(len(stamps), dtype=bool)
    kept[100:160] = False  # nobody knows what happened meanwhile; before and after it is the same pose
    phases = find_poses(stamps[kept], {"a": rows[kept]}, 1.0)
    assert len(phases.poses) == 3


@pytest.mark.parametrize("number", [0, 1, 15])
def test_next_to_nothing_has_no_poses(number: int) -> None:
    stamps, rows = STEPS.read()
    assert str(find_poses(stamps[:number], {"a": rows[:number]}, 1.0)) == "0 still phases"


def test_a_sensor_without_any_reading_or_with_zeros_only() -> None:
    stamps, rows = STEPS.read()
    assert find_poses(stamps, {"a": rows, "b": np.full(rows.shape, np.nan)}, 1.0).poses == []
    assert len(find_poses(stamps, {"a": rows, "b": np.zeros(rows.shape)}, 1.0).poses) == 3


def test_what_it_says() -> None:
    assert str(StillPhases([], 0, 0)) == "0 still phases"
    pose = Pose(1.23, 4.0, {}, {})
    assert str(StillPhases([pose], 2, 1)) == "1 still phase (at 1.2 s), 2 too short, 1 drifting"


# ---------------------------------------------------------------- directions


def test_directions_as_text() -> None:
    assert read_directions("+x, -z,?,0/3/4") == [(1.0, 0.0, 0.0), (0.0, 0.0, -1.0), None, (0.0, 0.6, 0.8)]
    assert ",".join(map(name_of, read_directions("+x,-z,?,0/3/4"))) == "+x,-z,?,0/0.6/0.8"


@pytest.mark.parametrize("text", ["x", "", "+x,", "1/2", "0/0/0", "nan/0/1", "+x;-x"])
def test_what_is_no_direction_is_refused(text: str) -> None:
    with pytest.raises(CalibrationError, match=r"is no direction; give \+x, -x, \+y"):
        read_directions(text)


def pose_of(**means: Sequence[float]) -> Pose:
    return Pose(7.0, 9.0, {name: np.array(mean) for name, mean in means.items()}, {})


def test_the_axis_of_the_link_is_found_through_the_mounting() -> None:
    turned = Sensor("b", "link", mounting=exp((0.0, 0.0, math.pi / 2.0)))
    found = axes_up([pose_of(a=(0.1, 0.2, -9.7), b=(9.8, 0.3, 0.1))], [turned], math.radians(20.0))
    assert found == [AXES["+y"]]
    np.testing.assert_allclose(in_sensor_frame([AXES["+y"]], turned), [[1.0, 0.0, 0.0]], atol=1e-12)


def test_outside_of_the_cone_no_axis_is_up() -> None:
    lower, upper = ((G * math.sin(a), 0.0, G * math.cos(a)) for a in np.radians([19.0, 21.0]))
    found = axes_up([pose_of(a=lower), pose_of(a=upper)], [Sensor("a", "link")], math.radians(20.0))
    assert found == [AXES["+z"], None]


def test_sensors_of_a_link_must_agree() -> None:
    sensors = [Sensor("a", "link"), Sensor("b", "link")]
    with pytest.raises(CalibrationError, match=r"^at 7.0 s \+z points up by 'a', \+y by 'b' of the same link; is a mo"):
        axes_up([pose_of(a=(0.0, 0.0, G), b=(0.0, G, 0.0))], sensors, math.radians(20.0))
