"""The frame assembler, one rule of its policy after the other. Stamps in these tests are given in milliseconds."""

from __future__ import annotations

import math
import random
import statistics
from collections.abc import Iterable

import numpy as np
import pytest

from jointest_ros.core.assembler import FrameAssembler
from jointest_ros.core.frame import Frame, Vec3
from jointest_ros.core.robot import Sensor
from jointest_ros.core.timing import Timing

MS = 1_000_000
UP = (0.0, 0.0, 9.81)
NAN, INF = math.nan, math.inf


def make(names: str = "ab", **timing: float) -> FrameAssembler:
    return FrameAssembler([Sensor(name, "link") for name in names], Timing(**timing))


def rate(stamp: float) -> Vec3:
    """A gyro sample that tells which stamp it had."""
    return (stamp % 997.0, 0.0, 0.0)


def add(assembler: FrameAssembler, sensor: str, stamp: float) -> list[Frame]:
    return assembler.add_imu(sensor, round(stamp * MS), rate(stamp), UP)


def feed(assembler: FrameAssembler, samples: Iterable[tuple[str, float]]) -> list[Frame]:
    return [frame for sensor, stamp in samples for frame in add(assembler, sensor, stamp)]


def ticks(names: str, stamps: Iterable[float], offsets: Iterable[float] = (0.0,) * 9) -> list[tuple[str, float]]:
    return [(name, stamp + offset) for stamp in stamps for name, offset in zip(names, offsets, strict=False)]


def shape(frames: Iterable[Frame]) -> list[tuple[float, str]]:
    """Stamp in ms and sensors of each frame."""
    return [(frame.stamp / MS, "".join(sorted(frame.accel))) for frame in frames]


def started(names: str = "ab", period: float = 10.0, **timing: float) -> FrameAssembler:
    """An assembler that has seen 40 complete frames at 0, 10, .. 390 ms."""
    assembler = make(names, **timing)
    feed(assembler, ticks(names, [k * period for k in range(40)]))
    return assembler


# -------------------------------------------------------------------- frames


def test_a_complete_frame_goes_out_with_its_last_sample() -> None:
    assembler = make("abc")
    assert add(assembler, "b", 10.0) == []
    assert add(assembler, "a", 10.0) == []
    (frame,) = add(assembler, "c", 10.0)
    assert frame.stamp == 10 * MS
    assert frame.gyro == dict.fromkeys("abc", rate(10.0)) and frame.accel == dict.fromkeys("abc", UP)
    assert not frame.reset and frame.hall is None and math.isnan(frame.period)


def test_only_fields_in_use_are_kept() -> None:
    assembler = FrameAssembler([Sensor("a", "l", gyro=False), Sensor("b", "l", accel=False), Sensor("c", "l")])
    assembler.add_imu("a", 0, (NAN, NAN, NAN), UP)
    assembler.add_imu("b", 0, rate(1.0), (INF, NAN, 0.0))
    (frame,) = assembler.add_imu("c", 0, rate(1.0), UP)
    assert (set(frame.gyro), set(frame.accel)) == ({"b", "c"}, {"a", "c"})


def test_the_scale_of_a_gyro_is_applied_to_that_sensor() -> None:
    assembler = FrameAssembler([Sensor("a", "a", gyro_scale=(1.5, 0.5, 2.0)), Sensor("b", "b")])
    assembler.add_imu("a", 0, (1.0, 2.0, 3.0), (0.0, 0.0, 9.0))
    (frame,) = assembler.add_imu("b", 0, (1.0, 2.0, 3.0), (0.0, 0.0, 9.0))
    assert frame.gyro == {"a": (1.5, 1.0, 6.0), "b": (1.0, 2.0, 3.0)}
    assert frame.accel["a"] == (0.0, 0.0, 9.0)


def test_sensor_without_gyro_and_accelerometer_is_not_waited_for() -> None:
    assembler = FrameAssembler([Sensor("a", "l"), Sensor("compass", "l", gyro=False, accel=False, mag=True)])
    assert shape(add(assembler, "a", 1.0)) == [(1.0, "a")]


def test_period_is_that_of_the_stream_once_it_is_known() -> None:
    assembler = make()
    frames = feed(assembler, ticks("ab", [0.0, 10.2, 20.0, 29.9, 40.0, 50.1, 60.0]))
    assert [math.isnan(frame.period) for frame in frames[:3]] == [True] * 3
    assert frames[-1].period == pytest.approx(0.0100, abs=2e-4)


def test_lost_samples_do_not_change_the_period() -> None:
    assembler = started()
    kept = [k * 10.0 for k in range(40, 400) if k % 3]
    assert feed(assembler, ticks("ab", kept))[-1].period == pytest.approx(0.010)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_jitter_of_the_stamps_does_not_change_the_period(share: float) -> None:
    """+-30 % of a period, and half of the samples lost."""
    generator = random.Random(1)
    assembler = started()
    stamps = [k * 10.0 + generator.uniform(-3.0, 3.0) for k in range(41, 2000) if generator.random() >= share]
    frames = feed(assembler, ticks("ab", stamps))
    assert statistics.median(frame.period for frame in frames[200:]) == pytest.approx(0.010, rel=0.08)


@pytest.mark.parametrize("first", ["a", "b"])
def test_a_lost_sample_makes_one_partial_frame(first: str) -> None:
    assembler = started()
    second = "b" if first == "a" else "a"
    samples = [(first, 400.0), (second, 400.0), (first, 410.0), (first, 420.0), (second, 420.0)]
    frames = feed(assembler, samples)
    assert shape(frames) == [(400.0, "ab"), (410.0, first), (420.0, "ab")]
    assert assembler.partial == 1


def test_a_sample_that_is_still_to_come_is_waited_for() -> None:
    """One topic runs ahead by less than max_wait: nothing is split, nothing is lost."""
    assembler = started()
    assert feed(assembler, [("a", 400.0), ("a", 410.0), ("a", 420.0)]) == []
    assert shape(feed(assembler, [("b", 400.0), ("b", 410.0), ("b", 420.0)])) == [
        (400.0, "ab"),
        (410.0, "ab"),
        (420.0, "ab"),
    ]


def test_a_stream_that_runs_ahead_by_max_wait_waits_no_longer() -> None:
    assembler = started(max_wait=0.025)
    assert feed(assembler, [("a", 400.0), ("a", 410.0), ("a", 420.0)]) == []
    assert shape(add(assembler, "a", 430.0)) == [(400.0, "a")]
    assert add(assembler, "b", 400.0) == []
    assert assembler.sources["b"].refused == {"late": 1}


def test_stamp_is_that_of_the_earliest_sample_in_whatever_order_they_come() -> None:
    for order in ("abc", "cba", "bca"):
        assembler = started("abc")
        offsets = {"a": 0.0, "b": 1.5, "c": 3.0}
        frames = feed(assembler, [(name, 400.0 + offsets[name]) for name in order])
        assert shape(frames) == [(400.0, "abc")]


@pytest.mark.parametrize("offset", [0.3, 1.0, 4.0, 4.9])
def test_unsynchronised_sensors_pair_within_half_a_period(offset: float) -> None:
    assembler = make()
    frames = feed(assembler, ticks("ab", [k * 10.0 for k in range(40)], (0.0, offset)))
    assert shape(frames[-20:]) == [(k * 10.0, "ab") for k in range(20, 40)]
    assert frames[-1].period == pytest.approx(0.010)


def test_unsynchronised_sensors_out_of_order() -> None:
    """b lags in stamps by 4 ms, and its topic by two samples."""
    assembler = started()
    samples = [("a", 400.0), ("a", 410.0)]
    for k in range(40, 60):
        samples += [("b", k * 10.0 + 4.0), ("a", (k + 2) * 10.0)]
    assert shape(feed(assembler, samples)) == [(k * 10.0, "ab") for k in range(40, 60)]


def test_sync_tolerance_narrows_what_makes_one_frame() -> None:
    assembler = started(sync_tolerance=0.001)
    assert shape(feed(assembler, [("a", 400.0), ("b", 401.0)])) == [(400.0, "ab")]
    frames = feed(assembler, [("a", 410.0), ("b", 411.1)]) + assembler.flush()
    assert shape(frames) == [(410.0, "a"), (411.1, "b")]


def test_a_tolerance_wider_than_half_a_period_shifts_nothing() -> None:
    """b loses one sample: its next one must not be taken for the lost one, nor all that follow."""
    assembler = started(sync_tolerance=0.5)
    samples = [("a", 400.0)] + [(name, 410.0 + 10.0 * k) for k in range(10) for name in "ba"]
    frames = feed(assembler, samples)
    assert shape(frames) == [(400.0, "a")] + [(410.0 + 10.0 * k, "ab") for k in range(10)]
    assert all(frame.gyro[name] == rate(frame.stamp / MS) for frame in frames for name in frame.gyro)


# -------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("stamp", "cause"),
    [(390.0, "repeated stamp"), (380.0, "older stamp"), (0.0, "older stamp"), (-600.0, "older stamp")],
)
def test_repeated_and_older_stamps_are_refused(stamp: float, cause: str) -> None:
    assembler = started()
    assert add(assembler, "a", stamp) == []
    assert assembler.sources["a"].refused == {cause: 1}
    assert shape(feed(assembler, ticks("ab", [400.0]))) == [(400.0, "ab")]


@pytest.mark.parametrize(
    ("gyro", "accel", "cause"),
    [
        ((NAN, 0.0, 0.0), UP, "not finite"),
        ((0.0, INF, 0.0), UP, "not finite"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, -INF), "not finite"),
        ((0.0, 0.0, 0.0), (INF, -INF, 0.0), "not finite"),
        ((0.0, 2e3, 0.0), UP, "implausible"),
        ((0.0, 0.0, 0.0), (0.0, 2e5, 0.0), "implausible"),
        ((0.0, 0.0, 0.0), (1e308, 1e308, 0.0), "implausible"),
    ],
)
def test_values_that_cannot_be_are_refused(gyro: Vec3, accel: Vec3, cause: str) -> None:
    assembler = started()
    assert assembler.add_imu("a", 400 * MS, gyro, accel) == []
    assert assembler.sources["a"].refused == {cause: 1}
    # the same sample, sent again in order, is welcome
    assert shape(feed(assembler, ticks("ab", [400.0]))) == [(400.0, "ab")]


# -------------------------------------------------------------------- odd stamps, gaps, jumps


@pytest.mark.parametrize("odd", [700.0, 5_000.0, 1e9, -700.0 - 1_000.0, -1e9])
def test_a_single_odd_stamp_is_refused(odd: float) -> None:
    assembler = started()
    assert add(assembler, "a", odd) == []
    frames = feed(assembler, ticks("ab", [400.0, 410.0]))
    assert shape(frames) == [(400.0, "ab"), (410.0, "ab")]
    assert assembler.sources["a"].refused == {"odd stamp": 1}
    assert not any(frame.reset for frame in frames) and not assembler.resets and not assembler.gaps


def test_odd_stamps_of_one_sensor_do_not_confirm_each_other_when_they_differ() -> None:
    assembler = started()
    for odd in (5_000.0, 9_000.0, 2_000.0):
        assert add(assembler, "a", odd) == []
    assert shape(feed(assembler, ticks("ab", [400.0]))) == [(400.0, "ab")]
    assert assembler.sources["a"].refused == {"odd stamp": 3}


def test_a_repeated_odd_stamp_confirms_nothing() -> None:
    assembler = started()
    feed(assembler, [("a", 5_000.0)] * 3)
    assert not assembler.resets
    assert assembler.sources["a"].refused == {"repeated stamp": 2}


@pytest.mark.parametrize("pause", [300.0, 900.0])
def test_a_gap_is_confirmed_and_bridged_without_reset(pause: float) -> None:
    assembler = started()
    frames = feed(assembler, ticks("ab", [390.0 + pause, 400.0 + pause]))
    assert shape(frames) == [(390.0 + pause, "ab"), (400.0 + pause, "ab")]
    assert not any(frame.reset for frame in frames)
    assert (assembler.gaps, assembler.resets) == (1, 0)
    assert not sum(source.refused.total() for source in assembler.sources.values())


@pytest.mark.parametrize("names", ["a", "ab", "abc"])
@pytest.mark.parametrize("jump", [1_500.0, 1e8, -1_100.0, -1e8])
def test_a_confirmed_jump_resets_once(names: str, jump: float) -> None:
    assembler = started(names)
    add(assembler, "a", 400.0)  # something is left unfinished
    frames = feed(assembler, ticks(names, [410.0 + jump, 420.0 + jump, 430.0 + jump]))
    after = [frame for frame in frames if frame.stamp != 400 * MS]
    assert shape(after) == [(410.0 + jump, names), (420.0 + jump, names), (430.0 + jump, names)]
    assert [frame.reset for frame in after] == [True, False, False]
    assert assembler.resets == 1
    assert not sum(source.refused.total() for source in assembler.sources.values())


def test_a_looped_recording_resets_at_every_turn() -> None:
    assembler = make()
    frames = [frame for _ in range(3) for frame in feed(assembler, ticks("ab", [k * 10.0 for k in range(200)]))]
    assert [k for k, frame in enumerate(frames) if frame.reset] == [200, 400]
    assert len(frames) == 600


def test_a_small_step_back_is_refused_until_the_clock_catches_up() -> None:
    assembler = started()
    frames = feed(assembler, ticks("ab", [k * 10.0 for k in range(20, 60)]))
    assert shape(frames) == [(k * 10.0, "ab") for k in range(40, 60)]
    assert assembler.sources["a"].refused == {"older stamp": 19, "repeated stamp": 1}


def test_one_sensor_with_a_wrong_clock_does_not_disturb_the_others() -> None:
    assembler = started("abc")
    frames = feed(assembler, [(name, k * 10.0 + 1e6 * (name == "c")) for k in range(40, 100) for name in "abc"])
    assert [sensors for _, sensors in shape(frames)] == ["ab"] * len(frames)
    assert len(frames) >= 55 and not assembler.resets
    # not one of them confirms the one before, because an ordinary stamp lies in between; the last one is still held
    assert assembler.sources["c"].refused["odd stamp"] == 59


def test_unconfirmed_at_the_end_is_refused() -> None:
    assembler = started()
    add(assembler, "b", 5_000.0)
    assert assembler.flush() == []
    assert assembler.sources["b"].refused == {"odd stamp": 1}


# -------------------------------------------------------------------- silent and slow sensors


def test_a_sensor_that_falls_silent_delays_only_what_may_still_come() -> None:
    assembler = started()
    delays = []
    for k in range(40, 100):
        frames = add(assembler, "a", k * 10.0)
        delays += [k * 10.0 - stamp for stamp, _ in shape(frames)]
    assert max(delays) == pytest.approx(40.0)  # the first ones: three periods, and the sample that shows it
    assert delays[-40:] == [0.0] * 40
    assert assembler.partial == 60


@pytest.mark.parametrize("order", ["ab", "ba"])
def test_a_silent_sensor_that_returns_is_waited_for_again(order: str) -> None:
    """Whatever the order of arrival; at most its first sample is lost."""
    assembler = started()
    feed(assembler, ticks("a", [k * 10.0 for k in range(40, 100)]))
    frames = feed(assembler, ticks(order, [k * 10.0 for k in range(100, 120)]))
    assert shape(frames[-19:]) == [(k * 10.0, "ab") for k in range(101, 120)]
    assert assembler.sources["b"].refused.total() <= 1


def test_a_sensor_that_never_delivers_delays_nothing_for_long() -> None:
    assembler = make("abz")
    lags = []
    for k in range(60):
        for name in "ab":
            lags += [k * 10.0 - stamp for stamp, _ in shape(add(assembler, name, k * 10.0))]
    assert max(lags) <= 40.0
    assert lags[-50:] == [0.0] * 50
    assert assembler.frames == 60


def test_the_others_pair_after_the_fastest_sensor_has_died() -> None:
    """a and b, 100 Hz and 4 ms apart, were paired within half a millisecond while c delivered at 1 kHz."""
    assembler = make("abc")
    feed(assembler, sorted(ticks("ab", range(0, 1000, 10), (0.0, 4.0)) + ticks("c", range(1000)), key=lambda s: s[1]))
    frames = feed(assembler, ticks("ab", range(1000, 3000, 10), (0.0, 4.0)))
    assert shape(frames)[-100:] == [(float(k), "ab") for k in range(2000, 3000, 10)]


@pytest.mark.parametrize("order", ["ab", "ba"])
@pytest.mark.parametrize("every", [2, 5, 10])
def test_a_slower_sensor_is_waited_for_when_it_is_due(order: str, every: int) -> None:
    assembler = make()
    frames = []
    for k in range(600):
        for name in order:
            if name == "a" or k % every == 0:
                frames += add(assembler, name, k * 10.0)
    found = shape(frames)[-300:]
    assert [sensors for _, sensors in found] == ["ab" if stamp % (every * 10.0) == 0.0 else "a" for stamp, _ in found]
    assert not assembler.sources["b"].refused.total() or every > 2


def test_a_slower_sensor_does_not_delay_the_frames_between_its_samples() -> None:
    assembler = make()
    lags = []
    for k in range(600):
        for name in "ab" if k % 10 == 0 else "a":
            lags += [k - stamp / 10.0 for stamp, _ in shape(add(assembler, name, k * 10.0))]
    assert sum(lag == 0.0 for lag in lags[-300:]) > 200


# -------------------------------------------------------------------- magnetometers, delay, flush


def compass() -> FrameAssembler:
    return FrameAssembler([Sensor("a", "l", mag=True), Sensor("b", "l")])


def test_magnetometer_goes_once_with_the_next_frame() -> None:
    assembler = compass()
    assembler.add_mag("a", 9 * MS, (1e-5, 0.0, 0.0))
    frames = feed(assembler, ticks("ab", [10.0, 20.0]))
    assert [frame.mag for frame in frames] == [{"a": (1e-5, 0.0, 0.0)}, {}]
    assert (assembler.mag_sources["a"].received, assembler.mag_sources["a"].used) == (1, 1)


@pytest.mark.parametrize(
    ("stamp", "field", "cause"),
    [
        (20.0, (1e-5, 0.0, 0.0), "repeated stamp"),
        (15.0, (1e-5, 0.0, 0.0), "older stamp"),
        (30.0, (NAN, 0.0, 0.0), "not finite"),
        (30.0, (0.0, 2.0, 0.0), "implausible"),
    ],
)
def test_magnetometer_refusals(stamp: float, field: Vec3, cause: str) -> None:
    assembler = compass()
    assembler.add_mag("a", 20 * MS, (1e-5, 0.0, 0.0))
    assembler.add_mag("a", round(stamp * MS), field)
    assert assembler.mag_sources["a"].refused == {cause: 1}


def test_magnetometer_far_from_the_frame_or_overtaken_is_unpaired() -> None:
    assembler = compass()
    assembler.add_mag("a", -500 * MS, (1e-5, 0.0, 0.0))
    (frame,) = feed(assembler, ticks("ab", [10.0]))
    assert not frame.mag
    assembler.add_mag("a", 11 * MS, (1e-5, 0.0, 0.0))
    assembler.add_mag("a", 12 * MS, (2e-5, 0.0, 0.0))
    (frame,) = feed(assembler, ticks("ab", [20.0]))
    assert frame.mag == {"a": (2e-5, 0.0, 0.0)}
    assembler.add_mag("a", 13 * MS, (1e-5, 0.0, 0.0))
    assembler.flush()
    assert assembler.mag_sources["a"].refused == {"unpaired": 3}


def test_delay_of_a_sensor_is_taken_off_its_stamps() -> None:
    assembler = FrameAssembler([Sensor("a", "l", delay=0.003), Sensor("b", "l")])
    assert shape(feed(assembler, [("a", 13.0), ("b", 10.0)])) == [(10.0, "ab")]


def test_flush_emits_what_waits() -> None:
    assembler = started("abc")
    feed(assembler, [("a", 400.0), ("b", 400.0), ("a", 410.0)])
    assert shape(assembler.flush()) == [(400.0, "ab"), (410.0, "a")]
    assert assembler.flush() == []


# ---------------------------------------------------------------- two publishers


def mixed_stream(phase_ms: int, until: int = 2000) -> FrameAssembler:
    """Between 500 and 1000 ms another robot sends too, `phase_ms` after every sample."""
    assembler = FrameAssembler([Sensor("a", "one"), Sensor("b", "two")], hall_width=1)
    generator = np.random.default_rng(phase_ms)
    for time in range(0, until, 10):
        for sensor in ("a", "b"):
            x, y, z = (0.5 * math.sin(0.005 * time) + generator.normal(0.0, 0.01, 3)).tolist()
            assembler.add_imu(sensor, time * MS, (x, y, z), (0.0, x, 9.81 + y), time * MS)
        assembler.add_hall((1.0,), time * MS)
        if 500 <= time < 1000:
            x, y, z = (-0.7 + generator.normal(0.0, 0.01, 3)).tolist()
            assembler.add_imu("a", (time + phase_ms) * MS, (x, y, z), (0.0, 3.0 + x, 9.0 + y), (time + phase_ms) * MS)
    return assembler


@pytest.mark.parametrize("phase_ms", [1, 3, 5, 8])
def test_two_publishers_of_one_imu_are_both_refused_while_there_are_two(phase_ms: int) -> None:
    assembler = mixed_stream(phase_ms)
    assembler.flush()
    refused = assembler.sources["a"].refused
    assert set(refused) <= {"two publishers", "late"}
    assert 75 < refused["two publishers"] < 110  # of 100 that came meanwhile; it takes some to tell, and some to forget
    assert assembler.sources["a"].used > 135  # of the 150 good ones before and after
    assert not assembler.sources["b"].refused
    assert 35 < assembler.hall_source.refused["two publishers"] <= 55
    assert assembler.sources["a"].period == 10 * MS
    for source in (*assembler.sources.values(), assembler.hall_source):
        assert source.received == source.used + source.refused.total()


def test_a_sensor_that_begins_to_send_twice_as_often_is_used() -> None:
    assembler = FrameAssembler([Sensor("a", "one")])
    generator = np.random.default_rng(0)
    for time in (*range(0, 1000, 10), *range(1000, 4000, 5)):
        x, y, z = generator.normal(0.0, 0.5, 3).tolist()
        assembler.add_imu("a", time * MS, (x, y, z), (0.0, x, 9.81))
    assembler.flush()
    assert assembler.sources["a"].used == 700
    assert assembler.sources["a"].period == 5 * MS


def test_a_sensor_that_vibrates_at_half_its_rate_is_used() -> None:
    assembler = FrameAssembler([Sensor("a", "one")])
    for k in range(500):
        assembler.add_imu("a", k * 10 * MS, (0.1 * k, 0.0, (-1.0) ** k), (0.0, 5.0 * (-1.0) ** k, 9.81))
    assembler.flush()
    assert assembler.sources["a"].used == 500
