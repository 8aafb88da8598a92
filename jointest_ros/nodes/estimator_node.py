"""The one node behind all estimator executables: receives, calls the core, publishes. Nothing is computed here."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from jointest_ros import config
from jointest_ros.bags.cdr_encode import encode_quaternion_stamped, encode_vector3_stamped
from jointest_ros.bags.intake import Handler, Intake
from jointest_ros.bags.output import JointStateOutput
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.frame import Estimate, Frame
from jointest_ros.core.params import Params, param
from jointest_ros.nodes import spin
from jointest_ros.nodes.arrival import arrivals
from jointest_ros.nodes.diagnostics import Diagnostics
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

_NO_DATA = 1.0  # s without frames after which there is nothing to calibrate from


@dataclass(frozen=True)
class NodeParams(ProcessParams):
    """What every estimator node has besides the parameters of its estimator."""

    config: str = param("", "path of the robot's configuration (YAML)")
    sensor_namespace: str = param("", "namespace of the input topics; empty: that of the node")
    reliability: str = param("best_effort", "QoS of the inputs", choices=("best_effort", "reliable"))
    depth: int = param(1000, "QoS history depth of the inputs", unit="messages", low=1, high=100000)


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
        super().__init__(
            node_name or f"{estimator}_node",
            namespace=namespace,
            context=context,
            parameter_overrides=overrides(parameters),
        )
        with construction(self):
            self._build(ESTIMATORS[estimator])

    def _build(self, kind: Any) -> None:
        check_names(self, NodeParams, kind.Params)
        params = declare(self, NodeParams)
        if not params.config:
            raise ConfigurationError(
                "config: '' is not allowed; give the path of a configuration: -p config:=robot.yaml"
            )
        configuration = config.load(params.config)
        chosen = declare(self, kind.Params, configuration.estimators.get(kind.name), tunable(kind.Params))
        make = partial(kind, configuration.robot, timing=configuration.timing)
        try:
            self.estimator: Estimator = make(chosen)
        except ConfigurationError as error:
            raise ConfigurationError(f"{params.config}: {error}") from None
        follow(self, chosen, partial(self._retuned, make))
        self.intake = Intake(configuration.robot, configuration.timing)
        self.estimates = 0
        self._estimated = -math.inf  # monotonic s, when the latest estimate was made
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
        self._offer_services()
        topics = self._subscribe(params)
        self._diagnostics = Diagnostics(self, self.intake, topics, self.estimator)
        file = configuration.calibration_file
        if file is not None and not file.exists():
            self.get_logger().warning(f"{file}: no such calibration_file yet; what is in the configuration counts")
        self.get_logger().info(f"{kind.name}: {', '.join(self.estimator.joints)} from {', '.join(self.intake.topics)}")

    def _subscribe(self, params: NodeParams) -> dict[str, str]:
        """Topic as configured -> its name in ROS."""
        reliable = params.reliability == "reliable"
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=params.depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        )
        prefix = re.sub("//+", "/", f"/{params.sensor_namespace}/") if params.sensor_namespace else ""
        names = {}
        for topic, msgtype in self.intake.topics.items():
            callback = partial(self._receive, self.intake.handlers[topic])
            name = topic if topic.startswith("/") else prefix + topic
            names[topic] = self.create_subscription(CLASSES[msgtype], name, callback, qos, raw=True).topic_name
        return names

    # ------------------------------------------------------------- data

    def _receive(self, handler: Handler, data: bytes) -> None:
        for frame in handler(data, arrivals.now()):
            self._estimate(frame)
        arrivals.done()

    def _estimate(self, frame: Frame) -> None:
        estimate = self.estimator.update(frame)
        self.estimates += 1
        self._estimated = time.monotonic()
        self._diagnostics.estimate = estimate
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

    # ------------------------------------------------------------- services

    def _offer_services(self) -> None:
        self._serve("reset", self._reset, "started afresh")
        for name in ("calibrate_zero", "calibrate_gyro_bias"):
            if hasattr(self.estimator, name):
                self._serve(name, partial(self._calibrate, name), "done")

    def _reset(self) -> None:
        self.estimator.reset()

    def _calibrate(self, name: str) -> None:
        if time.monotonic() - self._estimated > _NO_DATA:
            raise CalibrationError("no data arrives: see /diagnostics for which topics are silent")
        getattr(self.estimator, name)()

    def _retuned(self, make: Callable[[Any], Estimator], params: Any) -> Callable[[], None]:
        """The estimator with other parameters, which goes on where the present one is."""
        successor = make(params)

        def replace() -> None:
            successor.set_state(self.estimator.get_state())
            self.estimator = successor

        return replace

    def _serve(self, name: str, action: Callable[[], None], done: str) -> None:
        def answer(_request: Any, response: Any) -> Any:
            try:
                action()
                response.success, response.message = True, done
            except CalibrationError as error:
                response.success, response.message = False, str(error)
            return response

        self.create_service(Trigger, f"~/{name}", answer)


def run(estimator: str, text: str, args: list[str] | None) -> int:
    """Body of the executables; `text` is what `--help` says first. Returns the exit code."""
    heading = (
        f"parameters of the estimator; default: what section estimators.{estimator} of the configuration says, else"
    )
    sections: dict[str, type[Params]] = {"parameters": NodeParams, heading: ESTIMATORS[estimator].Params}
    return spin.main(partial(EstimatorNode, estimator), f"{estimator}_node", text, sections, args)
