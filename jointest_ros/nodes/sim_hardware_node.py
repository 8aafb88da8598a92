"""`ros2 run jointest_ros sim_hardware_node`: publishes what the hardware would, from a recording or a simulation.

Stamps are those of the recording or the model. When it falls behind, it sends every message that is due.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from jointest_ros.bags.cdr_encode import encode_clock
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.synthetic import Message
from jointest_ros.core.params import Params, param
from jointest_ros.nodes.messages import CLASSES
from jointest_ros.nodes.parameters import declare, overrides
from jointest_ros.nodes.playback import SENSORS, Playback, SimulatedPlayback, open_bag, sources
from jointest_ros.nodes.spin import main as run
from jointest_ros.sim.scenarios import SCENARIOS

_MOST_AT_ONCE = 500  # messages in one callback: others in the same executor get their turn


@dataclass(frozen=True)
class PlayParams(Params):
    """What is played and how; a simulated source has the options of its rig besides (rate_hz, scenario, seed, ...)."""

    source: str = param("bag", "a recording, or a rig to simulate", choices=sources())
    bag: str = param("", "path of the recording, for source bag")
    speed: float = param(1.0, "factor of real time", low=0.01, high=1000.0)
    loop: bool = param(False, "start again at the end (the stamps jump back)")
    paused: bool = param(False, "start paused; the service ~/pause goes on")
    clock: bool = param(False, "publish /clock, for nodes with use_sim_time")
    wait_for_subscribers: int = param(
        1, "wait until every sensor topic has so many subscribers; 0: start at once", low=0
    )
    executor: str = param(
        "events", "events: EventsExecutor; single: SingleThreadedExecutor", choices=("events", "single")
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
        try:
            self._build()
        except Exception:
            self.destroy_node()
            raise

    def _build(self) -> None:
        self.params = declare(self, PlayParams)
        if self.params.source == "bag":
            self._playback = open_bag(self.params.bag)
        else:
            rig = SCENARIOS[self.params.source]
            self._playback = SimulatedPlayback(rig, declare(self, rig.options))
        best_effort, reliable = (
            QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1000, reliability=reliability)
            for reliability in (ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE)
        )
        self._publishers_of = {
            topic: self.create_publisher(CLASSES[msgtype], topic, best_effort if msgtype in SENSORS else reliable)
            for topic, msgtype in self._playback.topics.items()
        }
        self._sensors = [self._publishers_of[t] for t, msgtype in self._playback.topics.items() if msgtype in SENSORS]
        self._send = {topic: publisher.publish for topic, publisher in self._publishers_of.items()}
        self._clock_publisher = self.create_publisher(Clock, "/clock", 10) if self.params.clock else None
        self.create_service(SetBool, "~/pause", self._pause)
        self._paused = self.params.paused
        self._waiting = self.params.wait_for_subscribers > 0
        self._messages: Iterator[Message] = self._playback.messages()
        self._next = next(self._messages, None)
        self._origin: tuple[float, int] | None = None  # monotonic s and message time ns that belong together
        self._timer = self.create_timer(0.001, self._tick)
        self.get_logger().info(f"{self._playback.description}: {', '.join(self._playback.topics)}")
        if self._waiting:
            self.get_logger().info(
                f"waiting for {self.params.wait_for_subscribers} subscriber(s) of every sensor topic"
            )

    def _pause(self, request: Any, response: Any) -> Any:
        self._paused = request.data
        self._origin = None
        response.success, response.message = True, "paused" if self._paused else "playing"
        return response

    def _tick(self) -> None:
        if self._paused or self.finished:
            return
        if self._waiting:
            wanted = self.params.wait_for_subscribers
            if any(publisher.get_subscription_count() < wanted for publisher in self._sensors):
                return
            self._waiting = False
        now = time.monotonic()
        if self._next is None:
            self._end()
            return
        if self._origin is None:
            self._origin = now, self._next[0]
        start, first = self._origin
        due = first + round((now - start) * self.params.speed * 1e9)
        stamp = self._send_due(due)
        if stamp is not None and self._clock_publisher is not None:
            self._clock_publisher.publish(encode_clock(stamp))

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

    def _end(self) -> None:
        if self.params.loop and self.sent and self._playback is not None:
            self._messages = self._playback.messages()
            self._next, self._origin = next(self._messages, None), None
            return
        self.finished = True
        self.get_logger().info(f"finished: {self.sent} messages")

    def destroy_node(self) -> None:
        """Free the recording and the node."""
        if self._playback is not None:
            self._playback.close()
            self._playback = None
        super().destroy_node()


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable."""
    return run(SimHardwareNode, "sim_hardware_node", args)
