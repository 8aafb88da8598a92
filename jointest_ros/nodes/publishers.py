"""Who publishes an input topic, and whether this node can hear them: DDS drops what does not match without a word."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

_NAMED = 3  # topics at most


class InputTopic:
    """The publishers of one topic that a node subscribes to.

    Args:
        name: in ROS.
        msgtype: as bags write it.
        reliable: the node asks for reliable delivery.
        expected: at most so many publishers: sensors that share the topic may have one each.
    """

    def __init__(self, node: Node, name: str, msgtype: str, reliable: bool, expected: int) -> None:
        self.name, self._node = name, node
        self._msgtype, self._reliable, self._expected = msgtype, reliable, expected
        self.publishers: list[str] = []  # nodes, as of the newest look
        self.unheard = ""  # why nothing can arrive from some of them
        self.surplus = ""  # there are too many
        self.elsewhere = ""  # topics that may be meant, where there is none

    def look(self) -> None:
        """At the graph as it is now."""
        found = self._node.get_publishers_info_by_topic(self.name)
        self.publishers = sorted(map(_name, found))
        reasons = set()
        for one in found:
            name = _name(one)
            if one.topic_type != self._msgtype:
                reasons.add(f"{name} publishes {one.topic_type} there, this node takes {self._msgtype}")
            elif self._reliable and one.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT:
                reasons.add(
                    f"QoS of {name}: its reliability is best_effort, this node asks for reliable; "
                    "start it with reliability:=best_effort, or let the publisher be reliable"
                )
        self.unheard = "; ".join(sorted(reasons))
        self.elsewhere = "" if found else comes_on(self._node, self._msgtype)
        self.surplus = ""
        if len(found) > self._expected:
            self.surplus = (
                f"{len(found)} publishers, whose samples mix: {', '.join(self.publishers)}; leave {self._expected} "
                "(one that was killed counts for up to 20 s)"
            )


def comes_on(node: Node, msgtype: str) -> str:
    """The topics of a type that are published and that the node does not take, to be put behind a message, or ""."""
    taken = {one.topic_name for one in node.subscriptions}
    names = [
        name
        for name, types in node.get_topic_names_and_types()
        if msgtype in types and name not in taken and node.count_publishers(name)
    ]
    if not names:
        return ""
    more = ", ..." if len(names) > _NAMED else ""
    return f"; {msgtype} comes on {', '.join(sorted(names)[:_NAMED])}{more}"


def _name(publisher: TopicEndpointInfo) -> str:
    return f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
