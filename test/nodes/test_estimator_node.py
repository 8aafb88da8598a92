"""An estimator node: names, parameters, services, diagnostics, and its life from construction to destruction."""

from __future__ import annotations

import gc
import re
import threading
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from ros_bench import Bench, values
from std_msgs.msg import Float64MultiArray
from without_ros import assert_same, estimate, make, simulated, stamp

from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import Series
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.nodes import diagnostics, estimator_node, services
from jointest_ros.nodes.estimator_node import EstimatorNode, NodeParams
from jointest_ros.nodes.parameters import tunable
from jointest_ros.nodes.sim_hardware_node import SimHardwareNode

JOINTS = ("finger_mcp", "finger_pip", "finger_dip")
STILL = simulated(scenario="still", rate_hz=100.0, duration_s=2.0)
MOVING = simulated(scenario="PC", rate_hz=100.0, duration_s=5.0, zero_pose_s=2.0)


# ----------------------------------------------------------------- names


def test_namespaces(bench: Bench, finger_config: Path) -> None:
    """Two estimators in namespaces of their own share one stream of sensors."""
    states = {name: bench.listen(f"{name}/joint_states") for name in ("first", "second")}
    chosen: dict[str, dict[str, Any]] = {"first": {"kp": 1}, "second": {"formulation": "relative", "kp": 0.5}}
    nodes = [
        bench.estimator(finger_config, namespace=name, sensor_namespace=f"{bench.namespace}/", **chosen[name])
        for name in states
    ]
    bench.send(nodes[0], MOVING)
    for name, received in states.items():
        expected = estimate(MOVING, finger_config, **chosen[name])
        bench.until(lambda received=received: len(received) >= 500, "500 states")
        assert_same(received, expected)
    assert states["first"][-1].position != states["second"][-1].position


@pytest.mark.parametrize(
    ("sensor_namespace", "topic"),
    [("", "{own}/imu/palm"), ("/", "/imu/palm"), ("left", "/left/imu/palm"), ("/left/hand/", "/left/hand/imu/palm")],
)
def test_sensor_namespace(bench: Bench, finger_config: Path, sensor_namespace: str, topic: str) -> None:
    node = bench.estimator(finger_config, sensor_namespace=sensor_namespace)
    assert topic.format(own=bench.namespace) in [subscription.topic_name for subscription in node.subscriptions]


# ----------------------------------------------------------------- parameters


def test_parameters_are_described(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config, kp=2)
    names = [*NodeParams.__dataclass_fields__, *PcfParams.__dataclass_fields__]
    for descriptor in node.describe_parameters(names):
        assert descriptor.description
        assert descriptor.additional_constraints
        assert descriptor.read_only == (descriptor.name not in tunable(PcfParams) | {"output_rate_hz"})
    described = dict(zip(names, node.describe_parameters(names), strict=True))
    assert "[1/s]" in described["kp"].description
    assert described["kp"].additional_constraints == "0 to 100 1/s"
    assert described["formulation"].additional_constraints == "one of hinge, relative, absolute"
    assert described["zero_at_start"].additional_constraints == "true or false"


def test_parameters_have_the_values_of_the_configuration(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config, kp=2)
    assert node.get_parameter("zero_at_start").value is True  # in the file; the default is false
    assert node.estimator.params == make(finger_config, kp=2.0)[0].params
    assert node.estimator.params.kp == 2.0


def set_parameters(bench: Bench, node: EstimatorNode, **values_: Any) -> list[tuple[bool, str]]:
    """Whether each was taken, and the reason where not: as `ros2 param set` does it."""
    changes = [Parameter(name, value=value).to_parameter_msg() for name, value in values_.items()]
    request = SetParameters.Request(parameters=changes)
    response = bench.call(SetParameters, f"{node.get_fully_qualified_name()}/set_parameters", request)
    return [(result.successful, result.reason) for result in response.results]


def test_what_shapes_the_estimator_cannot_be_set_while_it_runs(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config)
    estimator = node.estimator
    ((taken, reason),) = set_parameters(bench, node, formulation="relative")
    assert not taken
    assert "read-only" in reason
    assert node.estimator is estimator
    assert node.get_parameter("formulation").value == estimator.params.formulation == "hinge"


def test_gains_change_while_it_runs_and_the_state_stays(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config, formulation="relative")
    states = bench.listen("joint_states")
    first, second = MOVING[: len(MOVING) // 2], MOVING[len(MOVING) // 2 :]
    bench.send(node, first)
    assert set_parameters(bench, node, kp=3, floor_deg=0.5) == [(True, ""), (True, "")]
    assert node.get_parameter("kp").value == 3
    bench.send(node, second)

    before, intake = make(finger_config, formulation="relative")
    after, _ = make(finger_config, formulation="relative", kp=3.0, floor_deg=0.5)
    expected = [before.update(frame) for topic, data in first for frame in intake.handlers[topic](data, 0)]
    after.set_state(before.get_state())
    expected += [after.update(frame) for topic, data in second for frame in intake.handlers[topic](data, 0)]
    bench.until(lambda: len(states) >= len(expected), f"{len(expected)} states")
    assert_same(states, (Series.from_estimates(expected, len(after.joints)), after.joints))


# estimator -> (configuration, simulation, what can be tuned, what cannot)
KINDS: dict[str, tuple[str, str, dict[str, float], dict[str, Any]]] = {
    "pcf": ("finger.yaml", "finger", {"accel_weight": 0.5}, {"lever_arms": True}),
    "gyro": ("exoshell.yaml", "exoshell", {"gap_rate_dps": 90.0}, {"kinematics": "additive"}),
    "hall": ("exoshell.yaml", "exoshell", {"gap_rate_dps": 90.0}, {"sensor": 1}),
    "kf": ("exoshell.yaml", "exoshell", {"hall_sigma_deg": 2.0}, {"hall_noise": "constant"}),
    "kckf": ("exoshell.yaml", "exoshell", {"initial_angle_deg": 20.0}, {"hall_offset": True}),
    "accel_analytical": ("two_link_accel.yaml", "two_link_arm", {}, {"window": 5}),
    "accel_ekf": ("two_link_accel.yaml", "two_link_arm", {"snap_density": 2e5}, {"model": "paper"}),
    "accel_ukf": ("two_link_accel.yaml", "two_link_arm", {"alpha": 0.9}, {"depth": 5}),
}


@pytest.mark.parametrize("name", ESTIMATORS)
def test_every_estimator_is_tuned_while_it_runs(name: str, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers with a fraction change and the state stays; what shapes the state is refused with the reason."""
    monkeypatch.setattr(diagnostics, "PERIOD", 0.1)
    source, rig, tuning, structure = KINDS[name]
    path = Path(__file__).resolve().parents[2] / "config" / source
    messages = simulated(rig, rate_hz=100.0, duration_s=2.0)
    node = bench.estimator(path, name)
    bench.send(node, messages[: len(messages) // 2])
    before, state = node.estimator, node.estimator.get_state()
    ((taken, reason),) = set_parameters(bench, node, **structure)
    assert not taken
    assert "read-only" in reason
    assert node.estimator is before

    assert set(tuning) <= tunable(ESTIMATORS[name].Params)
    assert bool(tuning) == bool(tunable(ESTIMATORS[name].Params))
    assert all(taken for taken, _ in set_parameters(bench, node, **tuning))
    for parameter, value in tuning.items():
        assert getattr(node.estimator.params, parameter) == value
    again = node.estimator.get_state()
    assert repr(again) == repr(state)  # NaN are equal in their text
    count = node.estimates
    reports = bench.diagnostics(node)
    bench.send(node, messages[len(messages) // 2 :])
    assert node.estimates > count
    report = reports.next()  # of the estimator that is in force now
    assert {f"joint {joint}" for joint in node.estimator.joints} <= set(report)


@pytest.mark.parametrize(
    ("value", "reason"), [(-1.0, "kp: -1.0 is not allowed; give 0 to 100 1/s"), ("a", "kp: 'a' is not allowed")]
)
def test_a_gain_that_is_not_allowed_is_refused_while_it_runs(
    bench: Bench, finger_config: Path, value: Any, reason: str
) -> None:
    node = bench.estimator(finger_config)
    estimator = node.estimator
    ((taken, told),) = set_parameters(bench, node, kp=value)
    assert not taken
    assert reason in told
    assert node.estimator is estimator
    assert node.get_parameter("kp").value == 1.0


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"config": ""}, "config: '' is not allowed; give the path of a configuration"),
        ({"config": "nowhere.yaml"}, "nowhere.yaml: no such configuration file"),
        ({"kp": -1}, "kp: -1 is not allowed; give 0 to 100 1/s"),
        ({"kp": "text"}, "kp: 'text' is not allowed"),
        ({"kp": float("nan")}, "kp: nan is not allowed"),
        ({"kp": [1.0, 2.0]}, "kp: [1.0, 2.0] is not allowed"),
        ({"kp": {}}, "kp: {} is not allowed"),
        ({"kpp": 1.0}, "kpp: unknown parameter; did you mean 'kp'?"),
        ({"formulation": "foo"}, "formulation: 'foo' is not allowed; give one of hinge, relative, absolute"),
        ({"zero_at_start": 1}, "zero_at_start: 1 is not allowed; give true or false"),
        ({"depth": 0}, "depth: 0 is not allowed"),
        ({"reliability": "some"}, "reliability: 'some' is not allowed"),
        ({"sensor_namespace": "left hand"}, "'/left hand/imu/palm': Invalid topic name"),
    ],
)
def test_bad_parameters(bench: Bench, finger_config: Path, parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError) as raised:
        bench.estimator(**{"path": finger_config, **parameters}) if "config" not in parameters else EstimatorNode(
            "pcf", context=bench.context, **parameters
        )
    assert str(raised.value).startswith(message)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(("name", "words"), [("pfc", "did you mean 'pcf'?"), ("a b", "give one of pcf, gyro")])
def test_an_estimator_that_does_not_exist(bench: Bench, finger_config: Path, name: str, words: str) -> None:
    with pytest.raises(ConfigurationError, match=f"^estimator: '{name}' is not known; {re.escape(words)}"):
        EstimatorNode(name, context=bench.context, config=finger_config)


# ----------------------------------------------------------------- services


def test_calibration_while_still(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config, still_start=0.0)
    bench.send(node, STILL)
    assert not node.estimator.calibrated
    assert bench.trigger(node, "calibrate_gyro_bias") == (True, "done")
    assert node.estimator.calibrated
    assert bench.trigger(node, "calibrate_zero") == (True, "done")


def test_calibration_is_refused_while_moving(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config)
    bench.send(node, MOVING)
    before = node.estimator.get_state()
    for service in ("calibrate_gyro_bias", "calibrate_zero"):
        success, message = bench.trigger(node, service)
        assert not success
        assert "moves" in message
    assert node.estimator.get_state() == before


def test_calibration_is_refused_without_data(
    bench: Bench, finger_config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = bench.estimator(finger_config)
    success, message = bench.trigger(node, "calibrate_zero")
    assert not success
    assert "no data" in message
    bench.send(node, STILL)
    monkeypatch.setattr(services, "NO_DATA", 0.0)  # since then it may have moved
    assert not bench.trigger(node, "calibrate_zero")[0]


def test_reset(bench: Bench, finger_config: Path) -> None:
    """After it the estimator is as new, and starts from the next frame."""
    states = bench.listen()
    node = bench.estimator(finger_config)
    bench.send(node, STILL)
    assert node.estimator.calibrated
    assert bench.trigger(node, "reset") == (True, "started afresh")
    assert not node.estimator.calibrated
    bench.until(lambda: len(states) == 200)
    states.clear()
    later = [(topic, data) for topic, data in simulated(rate_hz=100.0, duration_s=4.0, zero_pose_s=3.0)[len(STILL) :]]
    bench.send(node, later)
    bench.until(lambda: len(states) == 200)
    assert node.estimator.calibrated


# ----------------------------------------------------------------- outputs


def test_covariance_and_biases_are_made_for_subscribers(
    bench: Bench, finger_config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[list[str]] = []
    original = estimator_node.labelled_array

    def count(labels: list[str], data: list[float]) -> Float64MultiArray:
        made.append(labels)
        return original(labels, data)

    monkeypatch.setattr(estimator_node, "labelled_array", count)
    node = bench.estimator(finger_config)
    bench.send(node, MOVING[:400])
    assert not made
    covariances = bench.listen("joint_covariance", Float64MultiArray)
    biases = bench.listen("biases", Float64MultiArray)
    bench.until(lambda: node.count_subscribers("biases") and node.count_subscribers("joint_covariance"))
    bench.send(node, MOVING[400:800])
    bench.until(lambda: len(covariances) >= 100 and len(biases) >= 100, "100 of each")
    assert len(made) == 200
    last = covariances[-1]
    assert [(dim.label, dim.size) for dim in last.layout.dim] == [(joint, 3) for joint in JOINTS]
    np.testing.assert_array_equal(np.reshape(last.data, (3, 3)), node.estimator.covariance())
    assert [dim.label for dim in biases[-1].layout.dim] == list(node.estimator.biases())
    assert list(biases[-1].data) == list(node.estimator.biases().values())


def test_stamps_are_of_the_sensors(bench: Bench, finger_config: Path) -> None:
    states = bench.listen()
    bench.send(bench.estimator(finger_config), STILL)
    bench.until(lambda: len(states) == 200)
    assert [stamp(state) for state in states] == [1_000_000_000 + k * 10_000_000 for k in range(200)]


def test_diagnostics(bench: Bench, finger_config: Path) -> None:
    node = bench.estimator(finger_config)
    reports, logs = bench.diagnostics(node), bench.log(node)
    inputs = [f"input {bench.namespace}/imu/{name}" for name in ("palm", "proximal", "middle", "distal")]

    report = reports.next()
    assert list(report) == ["estimator", *inputs, *(f"joint {joint}" for joint in JOINTS), "IMU pairs"]
    estimator = report.pop("estimator")
    assert estimator.level == DiagnosticStatus.WARN
    assert estimator.message.startswith("not ready: ")
    assert {status.message for status in report.values()} == {"never received: no publisher", "no estimate yet"}
    assert {status.level for status in report.values()} == {DiagnosticStatus.STALE}
    bench.until(lambda: any(log.msg.startswith("no messages on ") and inputs[0][6:] in log.msg for log in logs))

    bench.send(node, STILL)
    report = reports.until(
        lambda report: all(
            {"messages": "200", "used": "200"}.items() <= values(report[name]).items() for name in inputs
        )
    )
    assert {status.level for status in report.values()} == {DiagnosticStatus.OK}
    assert report[inputs[0]].message.endswith(" messages/s")
    joint = values(report["joint finger_pip"])
    assert joint["gyro bias calibrated"] == "yes"
    assert 0.0 < float(joint["standard deviation (deg)"]) < 1.0
    bench.until(lambda: any(log.msg.startswith("messages on ") for log in logs))

    report = reports.next()  # nothing came since the last one
    assert report.pop("estimator").level == DiagnosticStatus.WARN
    assert {status.level for status in report.values()} == {DiagnosticStatus.STALE}
    assert {status.message for status in report.values()} == {"no messages: no publisher", "no new estimate"}


# ----------------------------------------------------------------- life


@pytest.mark.parametrize("executor", ["events", "single"])
def test_nodes_come_and_go(executor: str, make_bench: Any, finger_config: Path) -> None:
    """Several in one executor, again and again: no thread stays, nobody warns, and each works as the first."""
    bench = make_bench(executor)
    states = bench.listen()
    threads = threading.active_count()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(3):
            states.clear()
            node = bench.estimator(finger_config)
            other = bench.estimator(finger_config, namespace="other", formulation="absolute")
            hardware = bench.hardware(source="finger", rate_hz=100.0, duration_s=0.5, speed=50.0)
            bench.until(lambda hardware=hardware: hardware.finished, "the end")
            bench.until(lambda: len(states) == 50, "50 states")
            assert other.estimates == 0  # in a namespace without sensors
            for one in (hardware, other, node):
                bench.remove(one)
            bench.until(lambda: not bench.probe.count_publishers("joint_states"), "the end of the publishers")
        gc.collect()
    assert threading.active_count() == threads


def test_names_of_attributes_are_not_those_of_rclpy(bench: Bench, finger_config: Path, finger_bag: Path) -> None:
    """A subclass of Node that overwrites an attribute of Node breaks it in ways that show late."""
    plain = Node("plain", context=bench.context)
    taken = set(vars(plain)) | {name for name in dir(Node) if not name.startswith("__")}
    for node in (bench.estimator(finger_config), bench.hardware(bag=str(finger_bag))):
        own = {name for kind in (EstimatorNode, SimHardwareNode) for name in vars(kind) if not name.startswith("__")}
        own |= set(vars(node)) - set(vars(plain))
        assert own & taken == {"destroy_node"}
    plain.destroy_node()


def test_an_input_that_is_an_output_is_refused(bench: Bench, finger_config: Path, tmp_path: Path) -> None:
    text = finger_config.read_text(encoding="utf-8")
    path = tmp_path / "finger.yaml"
    path.write_text(text.replace("  palm: {position", "  palm: {topic: joint_states, position"), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"/joint_states: published by this node itself; give another topic$"):
        bench.estimator(path)


def test_an_input_that_the_process_has_with_another_type_is_refused(bench: Bench, finger_config: Path) -> None:
    bench.probe.create_publisher(Float64MultiArray, "imu/palm", 10)
    with pytest.raises(ConfigurationError, match=r"/imu/palm: not to be had as sensor_msgs/msg/Imu"):
        bench.estimator(finger_config)
