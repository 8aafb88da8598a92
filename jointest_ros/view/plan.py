"""What `ros2 launch jointest_ros <robot>.launch.py` starts, as plain data: `description` hands it to ROS.

Each estimator has a namespace of its own, so that no two write to one topic. The first of them moves the robot that is
drawn; where the truth is known, a second one, paler, stands beside it, in frames with the prefix `truth/`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jointest_ros import config, resources
from jointest_ros.config import Configuration
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.params import Params, param, reject_unknown
from jointest_ros.sim.scenarios import OWN, OWN_OPTIONS, SCENARIOS
from jointest_ros.view.urdf import robot_urdf, root_link

PACKAGE = "jointest_ros"
ROBOT = "robot"  # as source: a real one
TRUTH = "truth/"  # before the frames of the robot as it truly is
_DRAWN_HZ = 50.0


@dataclass(frozen=True)
class LaunchArguments(Params):
    """The arguments of every launch file; a file has defaults of its own for some."""

    config: str = param("", "path of the robot's configuration (YAML)")
    estimators: str = param(
        "",
        "names, separated by commas, each in a namespace of its own; the first one moves the robot in the view; "
        "empty: the first in the configuration; all: every one in the configuration",
    )
    source: str = param(
        ROBOT,
        "robot: nothing is started, the topics come from a real one; config: the robot of the configuration is "
        "simulated; else the rig that is simulated",
        choices=(ROBOT, *SCENARIOS, OWN),
    )
    bag: str = param("", "path of a recording to play instead of the source")
    scenario: str = param("", "motion of the simulated rig; empty: its usual one")
    rate_hz: float = param(100.0, "of the simulated sensors", unit="Hz")
    seed: int = param(0, "of the simulated noise")
    speed: float = param(1.0, "of simulation and recording, factor of real time")
    loop: bool = param(True, "simulation and recording start again at their end")
    clock: bool = param(True, "simulation and recording publish /clock, and all nodes go by it")
    namespace: str = param("", "of everything that is started, /tf included")
    sensor_namespace: str = param("", "of the sensors' topics, within `namespace`")
    truth: bool = param(True, "draw the true angles of simulation or recording beside the estimate")
    truth_offset: str = param("0.3 0 0", "where they are drawn, x y z in the frame of the root link, m")
    rviz: bool = param(True, "start RViz")
    foxglove: bool = param(False, "start foxglove_bridge (port 8765); open foxglove/*.json as the layout")

    @classmethod
    def from_text(cls, values: Mapping[str, str]) -> LaunchArguments:
        """From what `ros2 launch` passes: texts. Raises ConfigurationError."""
        kinds = {spec.name: type(spec.default) for spec in dataclasses.fields(cls)}
        return cls.from_mapping({name: _value(kinds.get(name, str), text) for name, text in values.items()})


def _value(kind: type, text: str) -> Any:
    if kind is bool:
        return {"true": True, "false": False}.get(text.lower(), text)
    try:
        return kind(text)
    except ValueError:
        return text  # to be refused with the reason


# launch file -> the defaults that are its own; a path is that of a file of this package
ROBOTS: dict[str, dict[str, str]] = {
    "exoshell": {"config": "config/exoshell.yaml", "source": "exoshell", "scenario": "clipped"},
    "finger": {
        "config": "config/finger.yaml",
        "source": "finger",
        "scenario": "PC",
        "truth_offset": "0.08 0 0",
    },
    "robot": {},
    "softhand_gripper": {
        "config": "config/softhand_gripper.yaml",
        "source": "gripper",
        "scenario": "palm",
        "truth_offset": "0.15 0 0",
    },
    "song_pitch": {"config": "config/song_pitch.yaml"},
    "song_roll": {"config": "config/song_roll.yaml"},
    "two_link_accel": {
        "config": "config/two_link_accel.yaml",
        "source": "two_link_arm",
        "scenario": "slow_periodic",
        "truth_offset": "0 0 0.2",
    },
}


def defaults(robot: str) -> dict[str, str]:
    """The defaults of all arguments of one launch file, as texts. Raises ConfigurationError: a file is missing."""
    own = dict(ROBOTS[robot])
    if "config" in own:
        own["config"] = str(resources.find(own["config"]))
    usual = dataclasses.asdict(LaunchArguments())
    texts = {name: str(value).lower() if isinstance(value, bool) else str(value) for name, value in usual.items()}
    return {**texts, **own}


@dataclass(frozen=True)
class Process:
    """One node to start.

    Attributes:
        package, executable: where it is.
        name, namespace: of the node; the namespace is absolute.
        parameters: of the node.
        remappings: absolute name -> absolute name.
        arguments: of the command line, before those of ROS.
    """

    package: str
    executable: str
    name: str
    namespace: str
    parameters: Mapping[str, bool | int | float | str] = field(default_factory=dict)
    remappings: Mapping[str, str] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()


def processes(arguments: LaunchArguments) -> list[Process]:
    """Everything to start.

    Raises:
        ConfigurationError: in an argument or in the configuration.
    """
    if not arguments.config:
        raise ConfigurationError("config: '' is not allowed; give the path of a configuration: config:=robot.yaml")
    path = _path(arguments.config)
    configuration = config.load(path)
    names = _estimators(arguments.estimators, configuration)
    space = joined("/", arguments.namespace)
    sensors = joined(space, arguments.sensor_namespace)
    played = bool(arguments.bag) or arguments.source != ROBOT
    clock = {"use_sim_time": True} if played and arguments.clock else {}
    view = _View(configuration, space, clock)

    started = []
    if played:
        # a recording has the namespace of its topics in their names
        started.append(_hardware(arguments, space if arguments.bag else sensors, len(names), clock))
    for name in names:
        parameters: dict[str, Any] = {"config": path, "sensor_namespace": sensors, **clock}
        package = ESTIMATORS[name].__module__.partition(".")[0]
        started.append(Process(package, f"{name}_node", f"{name}_node", joined(space, name), parameters))
    started.append(view.robot(joined(space, names[0])))
    truth = joined(sensors, "ground_truth")
    if played and arguments.truth:
        started += [view.robot(truth, TRUTH), view.link_of_truth(arguments.truth_offset)]
    if arguments.rviz:
        started.append(view.rviz(joined(space, names[0]), truth))
    if arguments.foxglove:
        started.append(Process("foxglove_bridge", "foxglove_bridge", "foxglove_bridge", space, clock))
    return started


def joined(namespace: str, name: str) -> str:
    """The absolute name of `name` in an absolute namespace."""
    return "/" + "/".join(part for part in f"{namespace}/{name}".split("/") if part)


def _path(text: str) -> str:
    return str(Path(text).expanduser().absolute())


def _estimators(text: str, configuration: Configuration) -> list[str]:
    given = [name.strip() for name in text.split(",") if name.strip()]
    sections = list(configuration.estimators)
    names = sections if given == ["all"] else given or sections[:1]
    if not names:
        raise ConfigurationError("estimators: the configuration has none; give names: estimators:=pcf")
    reject_unknown(names, ESTIMATORS, "estimators", "estimator")
    return list(dict.fromkeys(names))


def _hardware(arguments: LaunchArguments, namespace: str, estimators: int, clock: Mapping[str, Any]) -> Process:
    parameters: dict[str, Any]
    if arguments.bag:
        parameters = {"source": "bag", "bag": _path(arguments.bag)}
    else:
        options: dict[str, Any] = {"rate_hz": arguments.rate_hz, "seed": arguments.seed}
        if arguments.scenario:
            options["scenario"] = arguments.scenario
        parameters = {"source": arguments.source, **options}
        if arguments.source == OWN:
            OWN_OPTIONS.from_mapping(options)
            parameters["config"] = _path(arguments.config)
        else:
            SCENARIOS[arguments.source].options.from_mapping(options)
    parameters |= {"speed": arguments.speed, "loop": arguments.loop, "clock": bool(clock)}
    # each estimator hears the recording from its first message on
    parameters |= {"wait_for_subscribers": estimators, **clock}
    return Process(PACKAGE, "sim_hardware_node", "sim_hardware_node", namespace, parameters)


@dataclass(frozen=True)
class _View:
    """The processes that draw."""

    configuration: Configuration
    space: str
    clock: Mapping[str, Any]

    def robot(self, namespace: str, prefix: str = "") -> Process:
        """Frames from the joint states of a namespace, and the shape of the robot beside them."""
        parameters = {
            "robot_description": robot_urdf(self.configuration.robot),
            "frame_prefix": prefix,
            "publish_frequency": _DRAWN_HZ,
            **self.clock,
        }
        name = "robot_state_publisher"
        return Process(name, name, name, namespace, parameters, self._transforms())

    def link_of_truth(self, offset: str) -> Process:
        """The fixed transform from the robot to its true twin."""
        try:
            x, y, z = (str(float(number)) for number in offset.split())
        except ValueError:
            raise ConfigurationError(f"truth_offset: '{offset}' is not allowed; give x y z, m") from None
        root = root_link(self.configuration.robot)
        where = ("--x", x, "--y", y, "--z", z, "--frame-id", root, "--child-frame-id", TRUTH + root)
        executable = "static_transform_publisher"
        return Process("tf2_ros", executable, "truth_offset", self.space, self.clock, self._transforms(), where)

    def rviz(self, estimate: str, truth: str) -> Process:
        """RViz, whose view names the topics as they are without namespaces."""
        remappings = {
            "/robot_description": joined(estimate, "robot_description"),
            "/ground_truth/robot_description": joined(truth, "robot_description"),
            **self._transforms(),
        }
        view = str(resources.find("rviz/jointest.rviz"))
        where = ("-d", view, "-f", root_link(self.configuration.robot))
        return Process("rviz2", "rviz2", "rviz2", self.space, self.clock, remappings, where)

    def _transforms(self) -> dict[str, str]:
        """Two robots in namespaces of their own may have links of the same names."""
        if self.space == "/":
            return {}
        return {topic: joined(self.space, topic) for topic in ("/tf", "/tf_static")}
