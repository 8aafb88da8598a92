"""Hall messages, which have no stamp, find their frames. Times in milliseconds; voltages tell the tick of a message."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable

import pytest

from jointest_ros.core.assembler import FrameAssembler
from jointest_ros.core.frame import Frame
from jointest_ros.core.robot import Sensor
from jointest_ros.core.timing import Timing

MS = 1_000_000
PERIOD = 10.0
Message = tuple[float, str, int]  # arrival, sensor or "hall", tick


def make(names: str = "ab", **timing: float) -> FrameAssembler:
    return FrameAssembler([Sensor(name, "link") for name in names], Timing(**timing), hall_width=2)


def play(assembler: FrameAssembler, messages: Iterable[Message]) -> list[Frame]:
    """In order of arrival. An IMU message of tick k is stamped k * 10 ms."""
    frames: list[Frame] = []
    for arrival, sensor, tick in messages:
        at = round(arrival * MS)
        if sensor == "hall":
            frames += assembler.add_hall((float(tick), math.nan), at)
        else:
            frames += assembler.add_imu(sensor, round(tick * PERIOD * MS), (0.0, 0.0, 0.0), (0.0, 0.0, 9.81), at)
    return frames


def stream(ticks: Iterable[int], hall_lag: float = 0.1, **lost: Iterable[int]) -> list[Message]:
    """All messages arrive 50 ms after their stamp, the Hall one `hall_lag` after the first IMU; `lost` by sensor."""
    lags = {"a": 50.0, "b": 50.05, "hall": 50.0 + hall_lag}
    return sorted(
        (tick * PERIOD + lag, sensor, tick)
        for tick in ticks
        for sensor, lag in lags.items()
        if tick not in lost.get(sensor, ())
    )


def pairs(frames: Iterable[Frame]) -> list[tuple[int, int | None]]:
    """(tick of the frame, tick of its Hall message)."""
    return [(round(f.stamp / MS / PERIOD), None if f.hall is None else round(f.hall[0])) for f in frames]


def matched(ticks: Iterable[int], *without: int) -> list[tuple[int, int | None]]:
    return [(tick, None if tick in without else tick) for tick in ticks]


@pytest.mark.parametrize("hall_lag", [-4.0, -1.0, -0.01, 0.0, 0.02, 0.04, 1.0, 4.0])
def test_pairs_in_either_order_of_arrival(hall_lag: float) -> None:
    assembler = make()
    frames = play(assembler, stream(range(100), hall_lag)) + assembler.flush()
    assert pairs(frames)[20:] == matched(range(20, 100))
    assert assembler.hall_source.used >= 90


@pytest.mark.parametrize("hall_lag", [-1.0, 0.02, 1.0])
@pytest.mark.parametrize("lost", [{50}, {50, 51}, {50, 52, 55}, set(range(40, 60))])
def test_lost_hall_messages_never_shift_the_later_ones(hall_lag: float, lost: set[int]) -> None:
    assembler = make()
    frames = play(assembler, stream(range(100), hall_lag, hall=lost)) + assembler.flush()
    assert pairs(frames)[20:] == matched(range(20, 100), *lost)


@pytest.mark.parametrize("hall_lag", [-1.0, 0.02, 1.0])
@pytest.mark.parametrize("lost", [{50}, {50, 51}, {50, 52, 55}, set(range(40, 60))])
def test_lost_imu_frames_never_shift_the_hall_messages(hall_lag: float, lost: set[int]) -> None:
    assembler = make()
    frames = play(assembler, stream(range(100), hall_lag, a=lost, b=lost)) + assembler.flush()
    assert pairs(frames)[20:] == matched(tick for tick in range(20, 100) if tick not in lost)
    assert assembler.hall_source.refused["unpaired"] >= len(lost)


@pytest.mark.parametrize("hall_lag", [-1.0, 1.0])
def test_one_lost_imu_leaves_the_pairing(hall_lag: float) -> None:
    assembler = make()
    frames = play(assembler, stream(range(100), hall_lag, b={50, 51, 70})) + assembler.flush()
    assert pairs(frames)[20:] == matched(range(20, 100))


@pytest.mark.parametrize("hall_lag", [-1.0, 0.1])
@pytest.mark.parametrize("late", [6.5, 7.0, 9.0, 23.0, 300.0])
def test_a_late_hall_message_shifts_nothing(late: float, hall_lag: float) -> None:
    """Its own frame gets it only if no other can be meant; else at most the one in whose time it arrives takes it."""
    assembler = make()
    messages = stream(range(100), hall_lag)
    messages = [(at + late if (name, tick) == ("hall", 50) else at, name, tick) for at, name, tick in messages]
    found = pairs(play(assembler, sorted(messages)) + assembler.flush())[20:]
    wrong = [(tick, hall) for tick, hall in found if hall != tick]
    if hall_lag > 0.0 and late < PERIOD - 0.5:  # they regularly follow, and the next frame has not begun
        assert not wrong
        assert assembler.hall_source.refused["unpaired"] == 0
        return
    assert wrong[0] == (50, None)
    assert len(wrong) <= 2
    assert all(hall in (50, None) and tick - 50 <= late / PERIOD + 1 for tick, hall in wrong)
    assert assembler.hall_source.refused["unpaired"] >= 1


@pytest.mark.parametrize("hall_lag", [0.02, 0.1, 3.0])
def test_a_frame_that_still_waits_for_an_imu_takes_no_message_of_the_next_one(hall_lag: float) -> None:
    assembler = make()
    frames = play(assembler, stream(range(100), hall_lag, b={60, 80, 81}, hall={60, 80, 81})) + assembler.flush()
    assert pairs(frames)[20:] == matched(range(20, 100), 60, 80, 81)


def test_of_two_messages_in_time_the_nearer_one_is_taken() -> None:
    assembler = make()
    play(assembler, stream(range(50)))
    messages = [(546.0, "hall", 49), (549.0, "hall", 50), (550.0, "a", 50), (550.0, "b", 50)]
    assert pairs(play(assembler, messages)) == [(50, 50)]


def test_random_losses_and_jitter_never_shift() -> None:
    generator = random.Random(3)
    for _ in range(20):
        messages = [
            (arrival + generator.uniform(-2.0, 2.0), sensor, tick)
            for arrival, sensor, tick in stream(range(200))
            if tick < 20 or generator.random() > 0.2
        ]
        assembler = make()
        found = pairs(play(assembler, sorted(messages)) + assembler.flush())
        assert all(hall in (tick, None) for tick, hall in found)
        assert sum(hall is not None for _, hall in found) > 100


def test_a_frame_waits_for_its_hall_message_no_longer_than_the_tolerance() -> None:
    assembler = make()
    play(assembler, stream(range(50)))
    assert play(assembler, [(550.0, "a", 50), (550.05, "b", 50)]) == []
    assert play(assembler, [(554.9, "hall", 50)])[0].hall is not None
    assert play(assembler, [(560.0, "a", 51), (560.05, "b", 51)]) == []
    (frame,) = play(assembler, [(565.1, "a", 52)])
    assert (frame.stamp, frame.hall) == (510 * MS, None)


def test_robot_whose_hall_topic_is_silent_still_gets_its_frames() -> None:
    assembler = make()
    frames = play(assembler, stream(range(50), hall=range(50)))
    assert pairs(frames) == matched(range(49), *range(49))


@pytest.mark.parametrize("order", [-1.0, 1.0])
@pytest.mark.parametrize("every", [2, 5])
def test_slower_hall_is_used_once_and_not_waited_for(order: float, every: int) -> None:
    assembler = make(hall_per_frame=False)
    skipped = [tick for tick in range(100) if tick % every]
    frames = play(assembler, stream(range(100), order, hall=skipped))
    used = [hall for _, hall in pairs(frames) if hall is not None]
    assert used == sorted(set(used)) and len(used) >= 100 // every - 1
    assert all(0 <= tick - hall <= 1 for tick, hall in pairs(frames) if hall is not None)
    assert len(frames) == 100  # nothing was held back for a Hall message


def test_of_several_new_readings_the_newest_is_used() -> None:
    assembler = make(hall_per_frame=False)
    messages = [(1.0, "hall", 1), (2.0, "hall", 2), (50.0, "a", 0), (50.0, "b", 0), (60.0, "a", 1), (60.0, "b", 1)]
    assert pairs(play(assembler, messages)) == [(0, 2), (1, None)]
    assert assembler.hall_source.refused == {"unpaired": 1}


@pytest.mark.parametrize(
    ("voltages", "cause"),
    [
        ((1.0,), "wrong length"),
        ((1.0, 2.0, 3.0), "wrong length"),
        ((), "wrong length"),
        ((math.inf, 1.0), "not finite"),
        ((1.0, -math.inf), "not finite"),
        ((1.0, 2e3), "implausible"),
    ],
)
def test_refused_messages(voltages: tuple[float, ...], cause: str) -> None:
    assembler = make()
    assert assembler.add_hall(voltages, 0) == []
    assert assembler.hall_source.refused == {cause: 1}
    assert assembler.hall_source.received == 1


def test_a_robot_without_hall_sensors_refuses_and_waits_for_none() -> None:
    assembler = FrameAssembler([Sensor("a", "l")])
    assert assembler.add_hall((1.0,), 0) == []
    assert len(assembler.add_imu("a", 0, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81), 5)) == 1


@pytest.mark.parametrize("jump", [-3.6e6, -2e3, 2e3, 3.6e6])
def test_pairing_survives_a_host_clock_that_is_set(jump: float) -> None:
    """Arrivals jump, the sensors' stamps do not."""
    assembler = make()
    messages = [(at + jump * (tick >= 50), name, tick) for at, name, tick in stream(range(100))]
    messages.sort(key=lambda message: (message[2] >= 50, message[0]))
    frames = play(assembler, messages) + assembler.flush()
    assert [tick for tick, _ in pairs(frames)] == list(range(100))
    assert pairs(frames)[52:] == matched(range(52, 100))


def test_pairing_survives_a_looped_recording() -> None:
    """Stamps and arrivals jump back together."""
    assembler = make()
    frames = play(assembler, stream(range(200))) + play(assembler, stream(range(200))) + assembler.flush()
    assert pairs(frames)[222:] == matched(range(22, 200))
    assert frames[200].reset


def test_waiting_messages_do_not_pile_up_while_the_imus_are_silent() -> None:
    assembler = make()
    play(assembler, stream(range(50)))
    play(assembler, stream(range(50, 5000), a=range(5000), b=range(5000)))
    waiting = assembler.hall_source.received - assembler.hall_source.used - assembler.hall_source.refused.total()
    assert waiting <= 25
