"""What holds for the frame assembler whatever is thrown at it."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Sequence

from hypothesis import given, settings
from hypothesis import strategies as st

from jointest_ros.core.assembler import FrameAssembler
from jointest_ros.core.assembler_inputs import Source
from jointest_ros.core.frame import Frame
from jointest_ros.core.robot import Sensor
from jointest_ros.core.timing import Timing

MS = 1_000_000
SENSORS = (Sensor("a", "l", mag=True), Sensor("b", "l"), Sensor("c", "l", gyro=False), Sensor("d", "l", accel=False))

# Mostly small steps forward, sometimes anything. A message: (input, step of stamp ns, step of arrival ns, value).
near = st.integers(-2 * MS, 12 * MS)
step = st.one_of(near, near, near, st.just(0), st.integers(-3_000 * MS, 3_000 * MS), st.integers(-(10**18), 10**18))
value = st.one_of(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats())
inputs = st.sampled_from(["a", "b", "c", "d", "a", "b", "c", "d", "mag", "hall"])
messages = st.lists(st.tuples(inputs, step, step, value), max_size=120)
timings = st.builds(
    Timing,
    sync_tolerance=st.sampled_from([0.0, 0.001, 0.02, 1.0]),
    max_wait=st.sampled_from([0.0, 0.005, 0.5, 10.0]),
    max_gap=st.sampled_from([0.001, 0.2, 5.0]),
    reset_jump=st.sampled_from([0.01, 1.0, 100.0]),
    hall_per_frame=st.booleans(),
)


def play(assembler: FrameAssembler, sequence: Sequence[tuple[str, int, int, float]]) -> list[Frame]:
    """Messages one after the other; stamps and arrivals add up over all inputs."""
    frames: list[Frame] = []
    stamp = arrival = 10**18
    for name, stamp_step, arrival_step, number in sequence:
        stamp, arrival = stamp + stamp_step, arrival + arrival_step
        if name == "hall":
            frames += assembler.add_hall((number, 1.0), arrival)
        elif name == "mag":
            assembler.add_mag("a", stamp, (number * 1e-5, 0.0, 0.0))
        else:
            frames += assembler.add_imu(name, stamp, (number, 0.0, 0.0), (0.0, number, 9.81), arrival)
    return frames


def unaccounted(source: Source) -> int:
    return source.received - source.used - source.refused.total()


@settings(max_examples=300)
@given(timings, messages)
def test_arbitrary_messages(timing: Timing, sequence: list[tuple[str, int, int, float]]) -> None:
    """Nothing raises; stamps rise between resets; values are finite; every message is accounted for."""
    assembler = FrameAssembler(SENSORS, timing, hall_width=2)
    frames = play(assembler, sequence)
    sources = [*assembler.sources.values(), *assembler.mag_sources.values(), assembler.hall_source]
    assert all(unaccounted(source) >= 0 for source in sources)
    frames += assembler.flush()
    assert all(unaccounted(source) == 0 for source in sources)
    assert all(before.stamp < after.stamp or after.reset for before, after in itertools.pairwise(frames))
    assert assembler.flush() == []

    assert assembler.frames == len(frames)
    assert assembler.resets >= sum(frame.reset for frame in frames)
    samples = {name: 0 for name in "abcd"}
    for frame in frames:
        for table in (frame.gyro, frame.accel, frame.mag):
            assert all(math.isfinite(component) for vector in table.values() for component in vector)
        assert not math.isinf(frame.period) and not frame.period <= 0.0
        assert set(frame.gyro) <= set("abd") and set(frame.accel) <= set("abc")
        for name in frame.gyro.keys() | frame.accel.keys():
            samples[name] += 1
    assert samples == {name: source.used for name, source in assembler.sources.items()}
    assert sum(frame.hall is not None for frame in frames) == assembler.hall_source.used
    assert sum(len(frame.mag) for frame in frames) == assembler.mag_sources["a"].used
    complete = sum(set(frame.gyro) | set(frame.accel) == set("abcd") for frame in frames)
    assert assembler.partial == len(frames) - complete


def merge(queues: dict[str, list[tuple[int, float]]], generator: random.Random, lead: float) -> list[tuple[str, int]]:
    """A random interleaving that keeps each queue's order; no queue runs ahead of another by more than `lead`."""
    left = {name: list(queue) for name, queue in queues.items()}
    merged = []
    while any(left.values()):
        oldest = min(queue[0][0] for queue in left.values() if queue)
        ready = [name for name, queue in left.items() if queue and queue[0][0] <= oldest + lead]
        name = generator.choice(ready)
        merged.append((name, left[name].pop(0)[0]))
    return merged


@settings(max_examples=150)
@given(
    seed=st.integers(0, 2**32),
    period=st.sampled_from([1.0, 5.0, 10.0]),
    spread=st.floats(0.0, 0.35),
    loss=st.sampled_from([0.0, 0.02, 0.2]),
)
def test_order_between_topics_changes_nothing(seed: int, period: float, spread: float, loss: float) -> None:
    """Sensors within `spread` periods (and .35 ms before the period is known) of each other, some samples lost."""
    generator = random.Random(seed)
    spread = min(spread * period, 0.35)
    offsets = {name: generator.uniform(0.0, spread) for name in "abcd"}
    queues = {
        name: [(round((k * period + offset) * MS), 0.0) for k in range(120) if k < 8 or generator.random() >= loss]
        for name, offset in offsets.items()
    }
    found = []
    for lead in (0.0, 0.9 * period, min(2.5 * period, 18.0)):  # less than max_wait, 20 ms before the period is known
        assembler = FrameAssembler(SENSORS)
        frames = []
        for name, stamp in merge(queues, generator, lead * MS):
            frames += assembler.add_imu(name, stamp, (stamp % 997 * 1e-3, 0.0, 0.0), (0.0, 0.0, 9.81))
        frames += assembler.flush()
        found.append([(frame.stamp, frame.gyro, frame.accel) for frame in frames])
        assert not sum(source.refused.total() for source in assembler.sources.values())
    assert found[0] == found[1] == found[2]
    # and what is together belongs together
    assert len(found[0]) == len({round(stamp / MS / period) for queue in queues.values() for stamp, _ in queue})


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32), order=st.permutations("abcd"))
def test_unsynchronised_sensors_pair_the_same_in_any_order(seed: int, order: list[str]) -> None:
    """Offsets of up to .45 periods; compared once the period is known."""
    generator = random.Random(seed)
    offsets = {name: generator.uniform(0.0, 4.5) for name in "abcd"}
    queues = {name: [(round((k * 10.0 + offsets[name]) * MS), 0.0) for k in range(100)] for name in order}
    assembler = FrameAssembler(SENSORS)
    frames = []
    for name, stamp in merge(queues, generator, 15.0 * MS):
        frames += assembler.add_imu(name, stamp, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81))
    frames += assembler.flush()
    late = [frame for frame in frames if frame.stamp >= 200 * MS]
    first = min(offsets.values())
    assert [frame.stamp for frame in late] == [round((k * 10.0 + first) * MS) for k in range(20, 100)]
    assert all(set(frame.gyro) | set(frame.accel) == set("abcd") for frame in late)
