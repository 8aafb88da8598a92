"""The one node behind all estimator executables: receives, calls the core, publishes. Nothing is computed here."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
from rclpy.context import Context
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.validate_topic_name import validate_topic_name
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from jointest_ros import config
from jointest_ros.bags.cdr_encode import encode_quaternion_stamped, encode_vector3_stamped
from jointest_ros.bags.intake import Handler, Intake
from jointest_ros.bags.output import JointStateOutput
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.errors import ConfigurationError, did_you_mean
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, Frame
from jointest_ros.core.params import Params, param
from jointest_ros.nodes import spin
from jointest_ros.nodes.arrival import arrivals
from jointest_ros.nodes.decimation import Decimation
from jointest_ros.nodes.diagnostics import Diagnostics
from jointest_ros.nodes.input_status import Input
from jointest_ros.nodes.messages import CLASSES, labelled_array
from jointest_ros.nodes.parameters import (
    ProcessParams,
    check_names,
    construction,
    declare,
    follow,
    overrides,
    tunable,
)
from jointest_ros.nodes.publishers import InputTopic
from jointest_ros.nodes.services import Services


@dataclass(frozen=True)
class NodeParams(ProcessParams):
    """What every estimator node has besides the parameters of its estimator."""

    config: str = param("", "path of the robot's configuration (YAML)")
    sensor_namespace: str = param("", "namespace of the input topics; empty: that of the node")
    reliability: str = param("best_effort", "QoS of the inputs", choices=("best_effort", "reliable"))
    depth: int = param(1000, "QoS history depth of the inputs", unit="messages", low=1, high=100000)
    output_rate_hz: float = param(
        0.0, "largest rate of all outputs, of which the stamps decide; 0: every frame", unit="Hz", low=0.0, high=1e5
    )
    calibration_file: str = param("", "path of the calibration file; empty: that of the configuration")
    warm_start: bool = param(True, "start from the biases and zero poses that ~/save_calibration wrote to that file")


class EstimatorNode(Node):
    """Runs one estimator on the topics of one robot.

    It works in any executor, several in one process; `destroy_node` ends it. Parameters are given on the command line
    (`--ros-args -p config:=...`) or as keywords: `EstimatorNode("pcf", config="config/finger.yaml", kp=2.0)`.

    Args:
        estimator: name of the estimator; the node is called `<estimator>_node` unless `node_name` is given.
        namespace: of the node.
        context: of ROS; the default one unless given.
        parameters: by name; those of `NodeParams` and of the estimator.

    Raises:
        ConfigurationError: in the configuration or a parameter.
    """

    def __init__(
        self,
        estimator: str,
        *,
        node_name: str | None = None,
        namespace: str | None = None,
        context: Context | None = None,
        **parameters: Any,
    ) -> None:
        kind = ESTIMATORS.get(estimator)
        if kind is None:
            which = did_you_mean(estimator, ESTIMATORS, f"give one of {', '.join(ESTIMATORS)}")
            raise ConfigurationError(f"estimator: '{estimator}' is not known; {which}")
        super().__init__(
            node_name or f"{estimator}_node",
            namespace=namespace,
            context=context,
            parameter_overrides=overrides(parameters),
        )
        with construction(self):
            self._build(kind)

    def _build(self, kind: Any) -> None:
        check_names(self, NodeParams, kind.Params)
        params = declare(self, NodeParams, tunable=tunable(NodeParams))
        if not params.config:
            raise ConfigurationError(
                "config: '' is not allowed; give the path of a configuration: -p config:=robot.yaml"
            )
        configuration = self._load(params)
        chosen = declare(self, kind.Params, configuration.estimators.get(kind.name), tunable(kind.Params))
        make = partial(kind, configuration.robot, timing=configuration.timing)
        try:
            self.estimator: Estimator = make(chosen)
        except ConfigurationError as error:
            raise ConfigurationError(f"{params.config}: {error}") from None
        follow(self, chosen, partial(self._retuned, make))
        self.intake = Intake(configuration.robot, configuration.timing)
        self._estimated = 0  # monotonic ns, when the latest estimate was made
        self._decimation: Decimation | None
        follow(self, params, self._limited)
        self._limited(params)()
        self._output = JointStateOutput(self.estimator.joints)
        self._publish_states = self.create_publisher(JointState, "joint_states", 1000).publish
        self._covariance = self.create_publisher(Float64MultiArray, "joint_covariance", 10)
        self._by_name = [(self.create_publisher(Float64MultiArray, "biases", 10), kind.biases)]
        if kind.link_velocities is not Estimator.link_velocities:
            velocities = self.create_publisher(Float64MultiArray, "link_velocities", 10)
            self._by_name.append((velocities, kind.link_velocities))
        self._torso_frame = self.estimator.torso.first if self.estimator.torso else ""
        if self._torso_frame:
            self._publish_angle = self.create_publisher(Vector3Stamped, "torso_angle", 1000).publish
            self._publish_orientation = self.create_publisher(QuaternionStamped, "torso_orientation", 1000).publish
        Services(self, self.intake, self._present, lambda: self._estimated, configuration)
        self._diagnostics = Diagnostics(self, self.intake, self._subscribe(params), self._present, configuration)
        self._log_calibration(configuration)
        self.get_logger().info(f"{kind.name}: {', '.join(self.estimator.joints)} from {', '.join(self.intake.topics)}")

    def _present(self) -> Estimator:
        return self.estimator

    def _load(self, params: NodeParams) -> config.Configuration:
        file = Path(params.calibration_file) if params.calibration_file else None
        configuration = config.load(params.config, file, tolerant=True)
        if params.warm_start:
            return configuration
        return replace(configuration, robot=replace(configuration.robot, learned={}))

    def _log_calibration(self, configuration: config.Configuration) -> None:
        file, damage, unfit = configuration.calibration_file, configuration.calibration_damage, self.estimator.unfit
        if damage:
            self.get_logger().error(f"calibration file ignored: {damage}")
        elif file is not None and not file.exists():
            self.get_logger().warning(f"{file}: no such calibration_file yet; what is in the configuration counts")
        learned = self.estimator.robot.learned.get(self.estimator.name)
        if unfit:
            self.get_logger().warning(unfit)
        elif learned is not None:
            zero = f", zero poses of {', '.join(learned.zero)}" if learned.zero else ""
            self.get_logger().info(f"warm start: biases {', '.join(learned.biases)}{zero}, saved {learned.saved}")

    def _subscribe(self, params: NodeParams) -> dict[str, Input]:
        """Topic as configured -> what is told of it."""
        reliable = params.reliability == "reliable"
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=params.depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        )
        prefix = re.sub("//+", "/", f"/{params.sensor_namespace}/") if params.sensor_namespace else ""
        # Diagnostics look at the graph: the handlers of QoS events would only cost wake-ups.
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        inputs = {}
        for topic, msgtype in self.intake.topics.items():
            name = topic if topic.startswith("/") else prefix + topic
            validate_topic_name(name)  # which says more than resolving does
            graph = InputTopic(self, self.resolve_topic_name(name), msgtype, reliable, len(self.intake.sources(topic)))
            if graph.name in {one.topic_name for one in self.publishers}:
                raise ConfigurationError(f"{graph.name}: published by this node itself; give another topic")
            inputs[topic] = Input(self.intake, topic, graph)
            callback = partial(self._receive, self.intake.handlers[topic], inputs[topic])
            try:
                self.create_subscription(CLASSES[msgtype], name, callback, qos, raw=True, event_callbacks=events)
            except rclpy_implementation.RCLError:  # its text is no help: "invalid allocator"
                raise ConfigurationError(
                    f"{graph.name}: not to be had as {msgtype}: this process has it with another type"
                ) from None
        return inputs

    # ------------------------------------------------------------- data

    @property
    def estimates(self) -> int:
        """How many it has made."""
        return self._diagnostics.estimates

    def _receive(self, handler: Handler, source: Input, data: bytes) -> None:
        source.arrived = arrival = arrivals.now()
        frames = handler(data, arrival)
        if not frames:
            arrivals.done()
            return
        received = self._estimated = arrivals.began
        for frame in frames:
            self._estimate(frame)
        self._diagnostics.latencies.append(arrivals.done() - received)

    def _estimate(self, frame: Frame) -> None:
        estimate = self.estimator.update(frame)
        diagnostics = self._diagnostics
        diagnostics.estimate = estimate
        diagnostics.estimates += 1
        if frame.stamp >= diagnostics.next_look or frame.reset:
            diagnostics.look(frame.stamp)
        if self._decimation is None or self._decimation.passes(frame.stamp, frame.period):
            self._publish(estimate)

    def _publish(self, estimate: Estimate) -> None:
        message = self._output.encode(estimate)
        if message is not None:
            self._publish_states(message)
        angle, orientation, frame = estimate.torso, estimate.torso_orientation, self._torso_frame
        if frame and angle and orientation and not self._output.hides(estimate):
            self._publish_angle(encode_vector3_stamped(estimate.stamp, frame, angle))
            self._publish_orientation(encode_quaternion_stamped(estimate.stamp, frame, orientation))
        if self._covariance.get_subscription_count():
            matrix = self.estimator.covariance().ravel().tolist()
            self._covariance.publish(labelled_array(list(self.estimator.joints), matrix))
        for publisher, values_of in self._by_name:
            if publisher.get_subscription_count():
                values = values_of(self.estimator)
                publisher.publish(labelled_array(list(values), list(values.values())))

    def _limited(self, params: NodeParams) -> Callable[[], None]:
        """What brings the rate of the outputs into force."""
        decimation = Decimation(params.output_rate_hz) if params.output_rate_hz else None
        return partial(setattr, self, "_decimation", decimation)

    def _retuned(self, make: Callable[[Any], Estimator], params: Any) -> Callable[[], None]:
        """The estimator with other parameters, which goes on where the present one is."""
        successor = make(params)

        def replace() -> None:
            successor.set_state(self.estimator.get_state())
            self.estimator = successor

        return replace


def run(estimator: str, text: str, args: list[str] | None) -> int:
    """Body of the executables; `text` is what `--help` says first. Returns the exit code."""
    heading = (
        f"parameters of the estimator; default: what section estimators.{estimator} of the configuration says, else"
    )
    sections: dict[str, type[Params]] = {"parameters": NodeParams, heading: ESTIMATORS[estimator].Params}
    return spin.main(partial(EstimatorNode, estimator), f"{estimator}_node", text, sections, args)
