"""The launch files: what they hand to ROS, by a stand-in for `launch`, and what the nodes that they name publish."""

from __future__ import annotations

import runpy
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from listener import Listener
from processes import Process, finish
from sensor_msgs.msg import JointState

from jointest_ros import config
from jointest_ros.view import plan
from jointest_ros.view.plan import LaunchArguments, defaults, joined

PROJECT = Path(__file__).resolve().parents[2]
LAUNCH_FILES = sorted((PROJECT / "launch").glob("*.launch.py"))

Launch = Callable[..., Process]


# ----------------------------------------------------------------- with a stand-in for `launch`


class _Node(SimpleNamespace):
    """Takes what the Node of launch_ros takes, as far as it is used."""

    def __init__(
        self,
        *,
        executable: str,
        package: str,
        name: str,
        namespace: str,
        parameters: list[dict[str, Any]] | None = None,
        remappings: list[tuple[str, str]] | None = None,
        arguments: list[str] | None = None,
        output: str = "log",
    ) -> None:
        assert output == "screen"
        super().__init__(executable=executable, package=package, name=name, namespace=namespace)
        self.parameters, self.remappings, self.arguments = parameters, remappings, arguments


class _Argument(SimpleNamespace):
    def __init__(self, name: str, *, default_value: str, description: str) -> None:
        super().__init__(name=name, default_value=default_value, description=description)


class _Function(SimpleNamespace):
    def __init__(self, *, function: Callable[[Any], list[_Node]]) -> None:
        super().__init__(function=function)


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules of the names that the launch files import."""
    contents: dict[str, dict[str, Any]] = {
        "launch": {"LaunchContext": SimpleNamespace, "LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": _Argument, "OpaqueFunction": _Function},
        "launch_ros": {},
        "launch_ros.actions": {"Node": _Node},
    }
    for name, attributes in contents.items():
        module = ModuleType(name)
        vars(module).update(attributes)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "jointest_ros.view.description", raising=False)


def started_by(file: Path, **given: str) -> tuple[list[_Argument], list[_Node]]:
    """The arguments that a launch file declares, and what it starts when some are given."""
    *arguments, function = runpy.run_path(str(file))["generate_launch_description"]()
    values = {one.name: one.default_value for one in arguments}
    return arguments, function.function(SimpleNamespace(launch_configurations={**values, **given}))


@pytest.mark.usefixtures("stand_in")
@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name.split(".")[0])
def test_launch_files_hand_the_plan_to_ros(file: Path) -> None:
    robot = file.name.removesuffix(".launch.py")
    given = {"config": str(PROJECT / "config" / "finger.yaml")} if robot == "robot" else {}
    arguments, nodes = started_by(file, **given)
    assert all(isinstance(one.default_value, str) and one.description for one in arguments)
    expected = plan.processes(LaunchArguments.from_text({**defaults(robot), **given}))
    found = [(one.package, one.executable, one.name, one.namespace) for one in nodes]
    assert found == [(one.package, one.executable, one.name, one.namespace) for one in expected]
    for one, process in zip(nodes, expected, strict=True):
        assert (one.parameters or [{}]) == [dict(process.parameters)]
        assert dict(one.remappings) == dict(process.remappings)
        assert one.arguments == list(process.arguments)


@pytest.mark.usefixtures("stand_in")
def test_a_namespace_that_an_including_launch_file_pushes_counts() -> None:
    _, nodes = started_by(PROJECT / "launch" / "exoshell.launch.py", ros_namespace="/lab", namespace="left")
    assert {one.namespace for one in nodes} == {"/lab/left", "/lab/left/kckf", "/lab/left/ground_truth"}


# ----------------------------------------------------------------- the nodes themselves


def command_line(process: plan.Process) -> list[str]:
    """As launch_ros starts it; parameters on the command line instead of in a file."""
    rules = ["-r", f"__node:={process.name}", "-r", f"__ns:={process.namespace}"]
    for name, value in process.parameters.items():
        rules += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
    for name, other in process.remappings.items():
        rules += ["-r", f"{name}:={other}"]
    return [*process.arguments, "--ros-args", *rules]


def test_estimates_and_truth_move_the_joints_that_are_drawn(launch: Launch, listener: Listener) -> None:
    """Three launch files at once, in namespaces: no topic has two publishers, and all is on time."""
    chosen = {"exoshell": ("kckf", "gyro"), "softhand_gripper": ("pcf",), "two_link_accel": ("accel_ekf",)}
    running: list[Process] = []
    heard: dict[str, dict[str, list[JointState]]] = {}
    drawn: dict[str, str] = {}
    for robot, estimators in chosen.items():
        given = {"estimators": ",".join(estimators), "namespace": robot, "loop": "false"}
        clock = {"clock": str(robot == "exoshell")}
        planned = plan.processes(LaunchArguments.from_text({**defaults(robot), **given, **clock}))
        topics = [f"/{robot}/{name}/joint_states" for name in (*estimators, "ground_truth")]
        heard[robot] = {topic: listener.hear(topic) for topic in topics}
        running += [launch(one.executable, *command_line(one)) for one in planned if one.package == "jointest_ros"]
        models = [one for one in planned if "robot_description" in one.parameters]
        assert [joined(one.namespace, "joint_states") for one in models] == [topics[0], topics[-1]]
        drawn[robot] = str(models[0].parameters["robot_description"])
    all_heard = [states for of_robot in heard.values() for states in of_robot.values()]
    listener.until(lambda: all(len(states) > 100 for states in all_heard), "estimates and truth")

    published = {name for name in listener.topics() if "joint_states" in name and listener.node.count_publishers(name)}
    assert published == {topic for of_robot in heard.values() for topic in of_robot}
    assert all(listener.node.count_publishers(topic) == 1 for topic in (*published, "/clock"))
    for robot, of_robot in heard.items():
        names = set(config.load(PROJECT / "config" / f"{robot}.yaml").robot.coordinates)
        assert all(set(states[-1].name) == names for states in of_robot.values())
        assert all(f'<joint name="{name}"' in drawn[robot] for name in names)
    for process in running:
        process.send_signal(signal.SIGINT)
    for done in map(finish, running):
        assert done.returncode == 0, done.stderr
