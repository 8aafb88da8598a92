"""What the simulated hardware plays: the timed messages of a recording or of a simulation."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Protocol

from jointest_ros import config
from jointest_ros.bags import synthetic
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.reader import BagReader
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.nodes.messages import CLASSES, SENSORS
from jointest_ros.sim.scenarios import OWN, SCENARIOS, Source, own
from jointest_ros.sim.simulated import SimulatedRobot, SimulationOptions

_TRUTH = "ground_truth/"
_SAMPLES = 100  # simulated at a time: some ms in which nothing is sent


class Playback(Protocol):
    """Attributes: `topics`, relative topic -> message type; `description`, one line."""

    topics: dict[str, str]
    description: str

    def messages(self) -> Iterator[synthetic.Message]:
        """All messages from the start, in the order of their times; a BagError at the end of a damaged recording."""
        ...

    def close(self) -> None:
        """Free what it holds."""
        ...


class BagPlayback:
    """The sensor and ground truth topics of a recording. Raises BagError."""

    def __init__(self, path: str) -> None:
        with ExitStack() as stack:
            self._reader = stack.enter_context(BagReader(path))
            chosen = {
                topic: msgtype
                for topic, msgtype in self._reader.topics.items()
                if msgtype in SENSORS or (_TRUTH in topic and msgtype in CLASSES)
            }
            if not any(msgtype in SENSORS for msgtype in chosen.values()):
                raise BagError(f"{path}: no sensor topics to play; it has: {', '.join(self._reader.topics)}")
            self._names = {topic: topic.lstrip("/") for topic in chosen}
            self.topics = {self._names[topic]: msgtype for topic, msgtype in chosen.items()}
            self.description = f"{path}, {self._reader.duration_s:.1f} s"
            if self._reader.damage:
                self.description += f", damaged: {self._reader.damage}"
            self._stack = stack.pop_all()

    def messages(self) -> Iterator[synthetic.Message]:
        for topic, time, data in self._reader.messages(tuple(self._names)):
            yield time, self._names[topic], data

    def close(self) -> None:
        self._stack.close()


@dataclass
class SimulatedPlayback:
    """A simulation, made while it is played."""

    source: Source
    options: SimulationOptions

    def __post_init__(self) -> None:
        self.topics = synthetic.topics(next(self._stretches()).robot)
        what = f"{self.source.name} {getattr(self.options, 'scenario', '')}".rstrip()
        self.description = f"{what} at {self.options.rate_hz:g} Hz, seed {self.options.seed}"

    def messages(self) -> Iterator[synthetic.Message]:
        return synthetic.messages(self._stretches())

    def _stretches(self) -> Iterator[SimulatedRobot]:
        return self.source.stretches(self.options, _SAMPLES / self.options.rate_hz)

    def close(self) -> None:
        pass


def open_bag(path: str, configuration: str = "") -> BagPlayback:
    """The recording of the parameter `bag`. Raises ConfigurationError where it is not given."""
    if not path:
        other = f", or simulate the robot of {configuration}: -p source:={OWN}" if configuration else ""
        raise ConfigurationError(
            f"bag: '' is not allowed with source bag; give the path of a recording: -p bag:=PATH{other}"
        )
    return BagPlayback(path)


def simulated(name: str, path: str) -> Source | None:
    """The source of that name, or None where it is a recording; `path`: of the configuration of one's own robot.

    Raises:
        ConfigurationError: in the configuration, or there is none.
    """
    if name != OWN:
        return SCENARIOS.get(name)
    if not path:
        raise ConfigurationError(
            f"config: '' is not allowed with source {OWN}; give the path of a configuration: -p config:=YAML"
        )
    return own(config.load(path).robot)


def sources() -> tuple[str, ...]:
    """What the parameter `source` may be."""
    return ("bag", *SCENARIOS, OWN)
