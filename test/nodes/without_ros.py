"""What the nodes must give, by the same objects without ROS."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState

from jointest_ros import config
from jointest_ros.bags import offline, synthetic
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, Series, Status
from jointest_ros.sim.scenarios import SCENARIOS

_HIDDEN = Status.STARTING | Status.STALE

Message = tuple[str, bytes]  # topic, CDR bytes
Expected = tuple[Series, tuple[str, ...]]  # estimates, names of the joints


def simulated(source: str = "finger", **options: Any) -> list[Message]:
    """The sensor messages of a simulation, in the order of their stamps."""
    rig = SCENARIOS[source]
    messages = synthetic.messages(rig.stretches(rig.options(**options)))
    return [(topic, data) for _, topic, data in messages if not topic.startswith("ground_truth/")]


def write_simulation(path: Path, source: str, **options: Any) -> Path:
    """The recording of a simulation."""
    rig = SCENARIOS[source]
    chosen = rig.options(**options)
    with BagWriter(path) as writer:
        for topic, msgtype in synthetic.topics(next(rig.stretches(chosen)).robot).items():
            writer.add_topic(f"/{topic}", msgtype)
        for stamp, topic, data in synthetic.messages(rig.stretches(chosen)):
            writer.write(f"/{topic}", stamp, data)
    return path


def write_bag(path: Path, types: dict[str, str], messages: Iterable[tuple[str, int, bytes]]) -> Path:
    """A recording of these topics and messages."""
    with BagWriter(path) as writer:
        for topic, msgtype in types.items():
            writer.add_topic(topic, msgtype)
        for message in messages:
            writer.write(*message)
    return path


def make(path: Path, name: str = "pcf", **parameters: Any) -> tuple[Estimator, Intake]:
    """The estimator and the intake that a node has with this configuration."""
    configuration = config.load(path)
    kind = ESTIMATORS[name]
    section = configuration.estimators.get(name) or kind.Params()
    chosen = kind.Params.from_mapping({**vars(section), **parameters})
    return kind(configuration.robot, chosen, configuration.timing), Intake(configuration.robot, configuration.timing)


def evaluate(bag: Path, path: Path, name: str = "pcf") -> Expected:
    """What the offline evaluation of a recording gives, and the names of the joints."""
    estimator, intake = make(path, name)
    sink = offline.SeriesSink({name: estimator})
    with BagReader(bag) as reader:
        offline.run(reader, intake, {name: estimator}, sink)
    return sink.series(name), estimator.joints


def estimate(messages: Iterable[Message], path: Path, **parameters: Any) -> Expected:
    """What the messages give when they are handled one after the other, and the names of the joints."""
    estimator, intake = make(path, **parameters)
    estimates: list[Estimate] = []
    for topic, data in messages:
        estimates += map(estimator.update, intake.handlers[topic](data, 0))
    return Series.from_estimates(estimates, len(estimator.joints)), estimator.joints


def stamp(message: Any) -> int:
    """Stamp of a message, ns."""
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def shown(series: Series) -> int:
    """How many estimates have something to publish."""
    return int(((series.status & _HIDDEN) == 0).any(axis=1).sum())


def assert_same(states: list[JointState], expected: Expected) -> None:
    """The messages are the estimates, all of them, with the joints that have current data, to 1e-9 rad and rad/s."""
    series, joints = expected
    visible = (series.status & _HIDDEN) == 0
    rows = np.flatnonzero(visible.any(axis=1))
    assert [stamp(state) for state in states] == series.stamps[rows].tolist()
    for state, row in zip(states, rows, strict=True):
        columns = np.flatnonzero(visible[row])
        assert list(state.name) == [joints[column] for column in columns]
        np.testing.assert_allclose(state.position, series.position[row, columns], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(state.velocity, series.velocity[row, columns], rtol=0.0, atol=1e-9)
        assert len(state.effort) == 0
