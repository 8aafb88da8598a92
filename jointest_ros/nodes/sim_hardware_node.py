"""`ros2 run jointest_ros sim_hardware_node`: publishes what the hardware would, from a recording or a simulation.

Stamps are those of the recording or the model. When it falls behind, it sends every message that is due.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import SetBool

from jointest_ros.bags.cdr_encode import encode_clock
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.synthetic import Message
from jointest_ros.core.errors import ConfigurationError, counted
from jointest_ros.core.params import Params, param
from jointest_ros.nodes.messages import CLASSES, SENSORS
from jointest_ros.nodes.parameters import ProcessParams, check_names, construction, declare, overrides
from jointest_ros.nodes.playback import Playback, SimulatedPlayback, open_bag, simulated, sources
from jointest_ros.nodes.spin import main as run
from jointest_ros.sim.scenarios import OWN, OWN_OPTIONS, SCENARIOS

_SETTLED = 0.5  # s without a new subscriber: by then each knows of our topics too, else it misses the first messages
_LINGER = 0.3  # s that the publishers stay after the last message: what nobody has read yet goes with them
_MOST_AT_ONCE = 100  # messages in one callback: others in the same executor get their turn, and receivers keep up


@dataclass(frozen=True)
class PlayParams(ProcessParams):
    """What is played and how; what is simulated has options of its own besides (rate_hz, scenario, seed, ...)."""

    source: str = param(
        "bag", "a recording; or what to simulate: a rig, or the robot of a configuration", choices=sources()
    )
    bag: str = param("", "path of the recording, for source bag")
    config: str = param("", f"path of the configuration, for source {OWN}")
    speed: float = param(1.0, "factor of real time", low=0.01, high=1000.0)
    loop: bool = param(False, "start again at the end (the stamps jump back)")
    paused: bool = param(False, "start paused; the service ~/pause goes on")
    clock: bool = param(False, "publish /clock, for nodes with use_sim_time")
    wait_for_subscribers: int = param(
        1, "wait until some sensor topic has so many subscribers, and no more come; 0: start at once", low=0
    )


class SimHardwareNode(Node):
    """The node of the module text.

    Attributes:
        sent: messages published so far.
        finished: all was published and it does not loop.

    Raises:
        ConfigurationError: in a parameter. BagError: the recording cannot be played.
    """

    def __init__(
        self,
        *,
        node_name: str = "sim_hardware_node",
        namespace: str | None = None,
        context: Context | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__(node_name, namespace=namespace, context=context, parameter_overrides=overrides(parameters))
        self.sent = 0
        self.finished = False
        self._playback: Playback | None = None
        with construction(self):
            self._build()

    def _build(self) -> None:
        self.params = declare(self, PlayParams)
        source = simulated(self.params.source, self.params.config)
        if source and self.params.bag:
            raise ConfigurationError(
                f"bag: '{self.params.bag}' is not allowed with source {self.params.source}; leave either out"
            )
        check_names(self, PlayParams, *([source.options] if source else []))
        self._playback = (
            SimulatedPlayback(source, declare(self, source.options))
            if source
            else open_bag(self.params.bag, self.params.config)
        )
        best_effort, reliable = (
            QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1000, reliability=reliability)
            for reliability in (ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE)
        )
        self._publishers_of = {
            topic: self.create_publisher(CLASSES[msgtype], topic, best_effort if msgtype in SENSORS else reliable)
            for topic, msgtype in self._playback.topics.items()
        }
        self._sensors = [self._publishers_of[t] for t, msgtype in self._playback.topics.items() if msgtype in SENSORS]
        self._send: dict[str, Callable[[bytes], None]] = {
            topic: publisher.publish for topic, publisher in self._publishers_of.items()
        }
        self._clock_publisher = self.create_publisher(ClockMessage, "/clock", 10) if self.params.clock else None
        self.create_service(SetBool, "~/pause", self._pause)
        self._paused = self.params.paused
        self._waiting = self.params.wait_for_subscribers > 0
        self._subscribers: list[int] = []  # of the sensor topics
        self._settled = 0.0  # monotonic s, since when these are the numbers
        self._messages: Iterator[Message] = self._playback.messages()
        self._next = next(self._messages, None)
        self._origin: tuple[float, int] | None = None  # monotonic s and message time ns that belong together
        self._sent_at = 0.0  # monotonic s, of the latest message
        # not by the node's clock: with use_sim_time that is the one it publishes itself
        self._timer = self.create_timer(0.001, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(f"{self._playback.description}: {', '.join(self._playback.topics)}")
        if self._waiting:
            self.get_logger().info(f"waiting for {self.params.wait_for_subscribers} subscriber(s)")

    def _pause(self, request: Any, response: Any) -> Any:
        self._paused = request.data
        self._origin = None
        response.success, response.message = True, "paused" if self._paused else "playing"
        return response

    def _tick(self) -> None:
        if self._paused or self.finished:
            return
        now = time.monotonic()
        if self._waiting and not self._has_subscribers(now):
            return
        self._waiting = False
        if self._next is None:
            self._end(now)
            return
        if self._origin is None:
            self._origin = now, self._next[0]
        start, first = self._origin
        due = first + round((now - start) * self.params.speed * 1e9)
        stamp = self._send_due(due)
        if stamp is not None:
            self._sent_at = now
            if self._clock_publisher is not None:
                self._clock_publisher.publish(encode_clock(stamp))

    def _has_subscribers(self, now: float) -> bool:
        counts = [publisher.get_subscription_count() for publisher in self._sensors]
        if counts != self._subscribers:
            self._subscribers, self._settled = counts, now
        return max(counts) >= self.params.wait_for_subscribers and now - self._settled >= _SETTLED

    def _send_due(self, due: int) -> int | None:
        """Publish what is due at message time `due`, ns; the time of the last, or None where nothing was."""
        stamp, count = None, 0
        try:
            while self._next is not None and self._next[0] <= due and count < _MOST_AT_ONCE:
                stamp, topic, data = self._next
                self._send[topic](data)
                count += 1
                self._next = next(self._messages, None)
        except BagError as error:
            self.get_logger().error(str(error))
            self._next = None
        self.sent += count
        return stamp

    def _end(self, now: float) -> None:
        if self.params.loop and self.sent and self._playback is not None:
            self._messages = self._playback.messages()
            self._next, self._origin = next(self._messages, None), None
        elif now - self._sent_at >= _LINGER:
            self.finished = True
            self.get_logger().info(f"finished: {counted(self.sent, 'message')}")

    def destroy_node(self) -> None:
        """Free the recording and the node."""
        if self._playback is not None:
            self._playback.close()
            self._playback = None
        super().destroy_node()


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable."""
    sections: dict[str, type[Params]] = {"parameters": PlayParams}
    sections |= {f"parameters with source:={rig.name}": rig.options for rig in SCENARIOS.values()}
    sections |= {f"parameters with source:={OWN}": OWN_OPTIONS}
    return run(SimHardwareNode, "sim_hardware_node", __doc__, sections, args)


if __name__ == "__main__":
    raise SystemExit(main())
