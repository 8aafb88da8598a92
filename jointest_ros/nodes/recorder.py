"""Records topics into a rosbag2: what `jointest record` does."""

from __future__ import annotations

import importlib
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.validate_full_topic_name import validate_full_topic_name

from jointest_ros.bags.errors import BagError
from jointest_ros.bags.live_writer import LiveWriter
from jointest_ros.nodes.arrival import arrivals
from jointest_ros.nodes.messages import CLASSES, SENSORS
from jointest_ros.nodes.parameters import construction
from jointest_ros.nodes.publishers import comes_on
from jointest_ros.nodes.spin import ended_by_signals, init, made, make_executor

_DISCOVERY = 0.5  # s between looks at which topics there are
_WRITING = 0.2  # s between writing out what was received
_FLUSH = 1.0  # s, what a kill costs at most
_DEPTH = 10_000  # messages of a topic that may wait while the executor is busy
_TRUTH = "/ground_truth/"
_OUTPUTS = ("joint_states", "torso_angle", "torso_orientation")

# what --also names -> whether a topic belongs to it
ALSO: dict[str, Callable[[str], bool]] = {
    "outputs": lambda topic: topic.rpartition("/")[2] in _OUTPUTS and _TRUTH not in topic,
    "truth": lambda topic: _TRUTH in topic,
    "diagnostics": lambda topic: topic == "/diagnostics",
}


@dataclass(frozen=True)
class Wanted:
    """What is to be recorded.

    Attributes:
        inputs: absolute topic -> message type.
        topics: absolute names of others, whose type is known when they have a publisher.
        also: keys of `ALSO`.
    """

    inputs: Mapping[str, str]
    topics: Collection[str] = ()
    also: Collection[str] = ()

    def has(self, topic: str) -> bool:
        """Whether a topic that is not an input belongs to it."""
        return topic in self.topics or any(ALSO[name](topic) for name in self.also)


class Recorder(Node):
    """Takes the bytes of messages as they come; a thread of its own writes them, so that a slow disk stops nobody.

    The thread ends the recording when `until()` is true, in `close`, or when the disk is full.

    Attributes:
        received: messages by topic.
        problems: topics that cannot be recorded, a line each.
        failure: why the recording ended by itself.

    Raises:
        BagError: the target exists or cannot be written.
        ConfigurationError: a topic has a name that ROS does not allow.
    """

    def __init__(
        self,
        path: Path,
        wanted: Wanted,
        *,
        until: Callable[[], bool] = lambda: False,
        context: Context | None = None,
    ) -> None:
        super().__init__("recorder", context=context)
        self.received: dict[str, int] = {}
        self.problems: dict[str, str] = {}
        self.failure: BagError | None = None
        self._wanted, self._until = wanted, until
        self._queue: deque[tuple[str, int, bytes]] = deque()
        self._writing = threading.Lock()
        self._end = threading.Event()
        self._epoch = time.time_ns() - time.monotonic_ns()  # a clock that is set meanwhile changes no order
        with construction(self):
            for topic in wanted.topics:
                validate_full_topic_name(topic)
            self.writer = LiveWriter(path)
            try:
                for topic, msgtype in wanted.inputs.items():
                    self._add(topic, msgtype)
            except Exception:
                self.writer.discard()
                raise
        self._thread = threading.Thread(target=self._write_out)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether it still records."""
        return self._thread.is_alive()

    def close(self) -> None:
        """Complete the recording: what was received until now is in it."""
        self._end.set()
        self._thread.join()

    def silent(self, topic: str) -> str:
        """A line for a topic that brings nothing."""
        msgtype = self._wanted.inputs.get(topic)
        instead = comes_on(self, msgtype) if msgtype is not None and not self.count_publishers(topic) else ""
        return f"no messages yet on {topic}{instead}"

    # ------------------------------------------------------------- receiving

    def discover(self) -> None:
        """Listen to what is wanted and has come up since; to be called now and then."""
        for topic, types in self.get_topic_names_and_types():
            if topic in self.problems:
                continue
            if topic in self.received:
                if len(types) > 1:
                    self.problems[topic] = f"{topic} is of several types: {', '.join(types)}"
            elif self._wanted.has(topic):
                try:
                    self._add(topic, types[0])
                except BagError as error:
                    self.problems[topic] = str(error)

    def _add(self, topic: str, msgtype: str) -> None:
        kind = _class_of(topic, msgtype)
        with self._writing:
            self.writer.add_topic(topic, msgtype, msgtype in SENSORS)
        self.received[topic] = 0
        # best effort: it suits every publisher
        best_effort = ReliabilityPolicy.BEST_EFFORT
        qos = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=_DEPTH, reliability=best_effort)
        self.create_subscription(kind, topic, partial(self._take, topic), qos, raw=True)

    def _take(self, topic: str, data: bytes) -> None:
        self._queue.append((topic, self._epoch + arrivals.now(), data))
        self.received[topic] += 1
        arrivals.done()

    # ------------------------------------------------------------- writing

    def _write_out(self) -> None:
        try:
            ending, flushed = False, time.monotonic()
            while not ending:
                ending = self._end.wait(_WRITING) or self._until()
                with self._writing:
                    for _ in range(len(self._queue)):
                        self.writer.write(*self._queue.popleft())
                    if ending or time.monotonic() - flushed >= _FLUSH:
                        self.writer.flush()
                        flushed = time.monotonic()
        except BagError as error:
            self.failure = error
        try:
            with self._writing:
                self.writer.close()
        except BagError as error:
            self.failure = error


def _class_of(topic: str, msgtype: str) -> Any:
    """The ROS class of a message type. Raises BagError where there is none."""
    if msgtype in CLASSES:
        return CLASSES[msgtype]
    package, _, name = msgtype.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise BagError(f"{topic} cannot be recorded: its type {msgtype} is not installed here") from None


@dataclass(frozen=True)
class Progress:
    """How far a recording is: seconds since its first message, bytes in the file, messages/s of the last second."""

    seconds: float
    size: int
    rates: dict[str, float]


def record(
    path: Path,
    wanted: Wanted,
    duration: float,
    show: Callable[[Recorder, Progress], None],
    finish: Callable[[Recorder], int],
) -> int:
    """Record until SIGINT or SIGTERM, for `duration` seconds from the first message on (0: no end), or to a full disk.

    Args:
        show: called once a second.
        finish: called when the recording is complete; it gives the exit code. After a signal the process ends with it.

    Returns:
        What `finish` returned.

    Raises:
        BagError: the target exists or cannot be written. ConfigurationError: ROS cannot start.
    """
    code = 0
    with ended_by_signals(lambda: code) as signals:
        context = Context()
        init([], context)
        try:
            recorder = made(lambda: Recorder(path, wanted, until=lambda: bool(signals), context=context))
            try:
                executor = make_executor("events", context)
                executor.add_node(recorder)
                _spin(executor, recorder, duration, signals, show)
            finally:
                recorder.close()
                code = finish(recorder)
                recorder.destroy_node()
        finally:
            rclpy.try_shutdown(context=context)
    return code


def _spin(
    executor: Executor,
    recorder: Recorder,
    duration: float,
    signals: list[int],
    show: Callable[[Recorder, Progress], None],
) -> None:
    began, looked, shown, before = 0.0, 0.0, time.monotonic(), dict(recorder.received)
    while recorder.running and not signals:
        executor.spin_once(timeout_sec=0.1)
        now = time.monotonic()
        if now - looked >= _DISCOVERY:  # no timer of ROS: those of the EventsExecutor stall when a clock is set back
            looked = now
            recorder.discover()
            arrivals.done()
        if not began and any(recorder.received.values()):
            began = now
        if now - shown >= 1.0:
            rates = {topic: (n - before.get(topic, 0)) / (now - shown) for topic, n in recorder.received.items()}
            show(recorder, Progress(now - began if began else 0.0, recorder.writer.size, rates))
            shown, before = now, dict(recorder.received)
        if duration and began and now - began >= duration:
            break
