"""The SROS2 policy allows each node what it really has, and nothing that it has not."""

from __future__ import annotations

import re
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from ros_bench import Bench
from sensor_msgs.msg import JointState
from without_ros import write_bag

from jointest_ros.bags.cdr import BOOL, FLOAT32_MULTIARRAY, IMU, JOINT_STATE, MAGNETIC_FIELD, QUATERNION_STAMPED
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.nodes.recorder import ALSO, Recorder, Wanted

PROJECT = Path(__file__).resolve().parents[2]
POLICY = PROJECT / "sros2" / "policy.xml"
INCLUDE = "{http://www.w3.org/2001/XInclude}include"

Access = tuple[str, str]  # ("publish", "/joint_states"), ("reply", "/pcf_node/reset"), ...

# A robot that has all that any estimator takes: gyro, accelerometer and magnetometer, Hall sensors, a torso.
ROBOT = """
robot:
  links: [upper, lower]
  joints: {elbow: {parent: upper, child: lower, axis: z, origin: [0.3, 0, 0]}}
sensor_defaults: {mag: true}
sensors:
  a: {link: upper, position: [0.25, 0, 0]}
  b: {link: upper, position: [0.02, 0, 0]}
  c: {link: lower, position: [0.04, 0, 0]}
  d: {link: lower, position: [0.27, 0, 0]}
hall_defaults: {curve: {a_deg: 0.07, b: 2.87, c_deg: 2.22e5, d: 8.43}, hall_range: [0.2, 1.8], noise_v: 0.02}
hall: [{joint: elbow, mirrored: false}]
"""


def expanded(element: Element, folder: Path) -> Element:
    """With the children of what it includes in the place of each inclusion, as xpointer(/profile/*) asks for."""
    whole = Element(element.tag, element.attrib)
    whole.text = element.text
    for child in element:
        if child.tag == INCLUDE:
            assert child.get("xpointer") == "xpointer(/profile/*)"
            included = ElementTree.parse(folder / child.get("href", "")).getroot()
            assert included.tag == "profile"
            whole.extend(expanded(included, folder))
        else:
            whole.append(expanded(child, folder))
    return whole


def profiles(policy: Element) -> dict[str, Element]:
    """Enclave -> the profile of its node."""
    return {
        enclave.attrib["path"]: profile for enclave in policy.iter("enclave") for profile in enclave.iter("profile")
    }


SHIPPED = expanded(ElementTree.parse(POLICY).getroot(), POLICY.parent)


def allowed(profile: Element, node: str, namespace: str) -> Iterator[Access]:
    """What a profile allows to its node, were that called `node` and its topics in `namespace`."""
    for rules in profile:
        for attribute in rules.attrib:
            for rule in rules:
                name = rule.text or ""
                if name.startswith("~/"):
                    name = f"{node}{name[1:]}"
                yield attribute, name if name.startswith("/") else f"{namespace}/{name}"


def present(bench: Bench, node: Node) -> set[Access]:
    """What a node really has."""
    named = {
        "publish": bench.probe.get_publisher_names_and_types_by_node,
        "subscribe": bench.probe.get_subscriber_names_and_types_by_node,
        "reply": bench.probe.get_service_names_and_types_by_node,
        "request": bench.probe.get_client_names_and_types_by_node,
    }
    where = node.get_name(), node.get_namespace()
    return {(what, name) for what, names_of in named.items() for name, _ in names_of(*where)}


def check(bench: Bench, node: Node, profile: Element) -> None:
    """Each interface of the node is allowed, and each rule of the profile is of use to it."""
    assert profile.attrib["node"] == node.get_name()
    rules = set(allowed(profile, node.get_fully_qualified_name(), bench.namespace))
    has = present(bench, node)
    matches = {(rule, access) for rule in rules for access in has if rule[0] == access[0] and fits(access[1], rule[1])}
    missing, useless = sorted(has - {access for _, access in matches}), sorted(rules - {rule for rule, _ in matches})
    assert not missing, "the node has what the policy does not allow"
    assert not useless, "the policy allows what the node does not have"


def fits(name: str, pattern: str) -> bool:
    """By fnmatch, in which * stands for slashes too: so DDS security compares."""
    return fnmatchcase(name, pattern)


# ------------------------------------------------------------------ the file

# element -> (attributes it must have, attributes it may have, children); of the schema of version 0.2.0
RULES = {"topics": ("publish", "subscribe"), "services": ("request", "reply")}
SCHEMA: dict[str, tuple[set[str], set[str], set[str]]] = {
    "policy": ({"version"}, set(), {"enclaves"}),
    "enclaves": (set(), set(), {"enclave"}),
    "enclave": ({"path"}, set(), {"profiles"}),
    "profiles": (set(), set(), {"profile"}),
    "profile": ({"ns", "node"}, set(), set(RULES)),
    "topics": (set(), set(RULES["topics"]), {"topic"}),
    "services": (set(), set(RULES["services"]), {"service"}),
    "topic": (set(), set(), set()),
    "service": (set(), set(), set()),
}


def check_schema(policy: Element) -> None:
    """By the rules of the SROS2 schema, and by how `ros2 security create_permission` makes DDS names of these."""
    assert policy.tag == "policy"
    assert policy.attrib == {"version": "0.2.0"}
    for element in policy.iter():
        must, may, children = SCHEMA[element.tag]
        assert must <= set(element.attrib) <= must | may, element.attrib
        assert {child.tag for child in element} <= children
        assert bool(len(element)) == bool(children), element.tag
        if element.tag in RULES:
            assert element.attrib
            assert set(element.attrib.values()) == {"ALLOW"}
        if not children:
            assert re.fullmatch(r"(~?/)?[a-z_]+(/[a-z_]+)*(/\*)?", element.text or ""), element.text
    paths = [enclave.attrib["path"] for enclave in policy.iter("enclave")]
    assert all(re.fullmatch(r"(/[a-z_]+)+", path) for path in paths)
    assert len(paths) == len(set(paths))


def test_the_policy_obeys_the_schema() -> None:
    check_schema(SHIPPED)


def test_each_node_has_an_enclave_of_its_own() -> None:
    nodes = [*(f"{name}_node" for name in ESTIMATORS), "sim_hardware_node"]
    assert {path: profile.attrib for path, profile in profiles(SHIPPED).items()} == {
        f"/jointest/{node}": {"ns": "/", "node": node} for node in nodes
    }


# ------------------------------------------------------------------ the nodes


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_estimator_nodes(bench: Bench, estimator: str, tmp_path: Path) -> None:
    robot = tmp_path / "robot.yaml"
    robot.write_text(ROBOT, encoding="utf-8")
    node = bench.estimator(robot, estimator, use_sim_time=True)
    check(bench, node, profiles(SHIPPED)[f"/jointest/{estimator}_node"])


def test_sim_hardware_node(bench: Bench, tmp_path: Path) -> None:
    types = {
        "/imu/a": IMU,
        "/mag/a": MAGNETIC_FIELD,
        "/hall_voltages": FLOAT32_MULTIARRAY,
        "/ground_truth/joint_states": JOINT_STATE,
        "/ground_truth/imu_orientation": QUATERNION_STAMPED,
        "/ground_truth/movement": BOOL,
    }
    bag = write_bag(tmp_path / "bag", types, [(topic, 0, b"") for topic in types])
    node = bench.hardware(bag=str(bag), paused=True, clock=True, use_sim_time=True)
    check(bench, node, profiles(SHIPPED)["/jointest/sim_hardware_node"])


# ------------------------------------------------------------------ the document


def documented() -> Element:
    """The enclave that docs/security.md gives for the recorder, as a policy."""
    text = (PROJECT / "docs" / "security.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"<!-- [^>]* the recorder -->\n```xml\n(.*?)```", text, flags=re.DOTALL)
    head = '<policy version="0.2.0" xmlns:xi="http://www.w3.org/2001/XInclude"><enclaves>'
    return expanded(ElementTree.fromstring(f"{head}{block}</enclaves></policy>"), POLICY.parent)


def test_the_recorder_and_what_the_document_says_of_it(bench: Bench, tmp_path: Path) -> None:
    policy = documented()
    check_schema(policy)
    outputs = {"joint_states": JointState, "torso_angle": Vector3Stamped, "torso_orientation": QuaternionStamped}
    for topic, kind in {**outputs, "ground_truth/joint_states": JointState, "/diagnostics": DiagnosticArray}.items():
        bench.probe.create_publisher(kind, topic, 10)
    inputs = {"imu/a": IMU, "mag/a": MAGNETIC_FIELD, "hall_voltages": FLOAT32_MULTIARRAY}
    wanted = Wanted({f"{bench.namespace}/{topic}": msgtype for topic, msgtype in inputs.items()}, also=tuple(ALSO))
    recorder = bench.add(Recorder(tmp_path / "run", wanted, context=bench.context))
    recorder.set_parameters([Parameter("use_sim_time", value=True)])
    try:
        recorder.discover()
        assert len(recorder.received) == 8
        check(bench, recorder, profiles(policy)["/jointest/recorder"])
    finally:
        recorder.close()
