"""What a launch file starts, for which arguments."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from jointest_ros import config
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.sim.scenarios import SCENARIOS
from jointest_ros.view.plan import ROBOTS, LaunchArguments, Process, defaults, joined, processes

PROJECT = Path(__file__).resolve().parents[2]
SIMULATED = [name for name, own in ROBOTS.items() if "source" in own]


def plan(robot: str, **given: str) -> list[Process]:
    return processes(LaunchArguments.from_text({**defaults(robot), **given}))


def only(started: list[Process], executable: str) -> Process:
    (process,) = (one for one in started if one.executable == executable)
    return process


def estimators(started: list[Process]) -> list[Process]:
    return [one for one in started if one.package == "jointest_ros" and one.executable != "sim_hardware_node"]


def drawn(started: list[Process]) -> dict[str, Process]:
    """By prefix of the frames."""
    found = [one for one in started if one.package == "robot_state_publisher"]
    return {str(one.parameters["frame_prefix"]): one for one in found}


def test_there_is_a_launch_file_for_each_and_a_urdf_and_layout_of_the_same_name() -> None:
    names = {name: {file.name.split(".")[0] for file in (PROJECT / name).iterdir()} for name in ("launch", "urdf")}
    assert names["launch"] == set(ROBOTS)
    assert names["urdf"] == set(ROBOTS) - {"robot"}


@pytest.mark.parametrize("robot", [name for name in ROBOTS if name != "robot"])
@pytest.mark.parametrize("namespace", ["", "left/hand"])
def test_no_two_estimators_write_to_the_same_topic(robot: str, namespace: str) -> None:
    started = plan(robot, estimators="all", namespace=namespace)
    sections = list(config.load(PROJECT / "config" / f"{robot}.yaml").estimators)
    assert [one.executable for one in estimators(started)] == [f"{name}_node" for name in sections]
    space = joined("/", namespace)
    assert [one.namespace for one in estimators(started)] == [joined(space, name) for name in sections]
    # nor do they write to the topic of the truth, nor two nodes have the same name
    assert len({(one.namespace, one.name) for one in started}) == len(started)
    assert not {joined(space, "ground_truth"), space} & {one.namespace for one in estimators(started)}


@pytest.mark.parametrize("robot", SIMULATED)
def test_simulation_feeds_the_estimators_and_both_robots_that_are_drawn(robot: str) -> None:
    started = plan(robot, rate_hz="200", seed="3", speed="0.5", loop="false")
    hardware, estimator = started[0], estimators(started)[0]
    assert hardware.parameters["source"] == ROBOTS[robot]["source"]
    chosen = {"rate_hz": 200.0, "seed": 3, "speed": 0.5, "loop": False, "clock": True, "wait_for_subscribers": 1}
    assert chosen.items() <= hardware.parameters.items()
    assert estimator.parameters["sensor_namespace"] == hardware.namespace == "/"
    assert all(one.parameters["use_sim_time"] is True for one in started)
    # robot_state_publisher hears joint_states in its own namespace
    assert {prefix: one.namespace for prefix, one in drawn(started).items()} == {
        "": estimator.namespace,
        "truth/": "/ground_truth",
    }
    root = only(started, "static_transform_publisher").arguments[7]
    assert only(started, "static_transform_publisher").arguments[6:] == (
        "--frame-id",
        root,
        "--child-frame-id",
        f"truth/{root}",
    )
    assert only(started, "rviz2").arguments[2:] == ("-f", root)
    links = config.load(PROJECT / "config" / f"{robot}.yaml").robot.links
    assert all(
        f'<link name="{link}"' in str(one.parameters["robot_description"])
        for one in drawn(started).values()
        for link in links
    )


@pytest.mark.parametrize("robot", SIMULATED)
def test_usual_scenarios_are_allowed_and_described(robot: str) -> None:
    own = ROBOTS[robot]
    assert own["scenario"] in SCENARIOS[own["source"]].scenarios


def test_bag_is_played_instead_and_brings_the_namespace_of_its_topics() -> None:
    started = plan("finger", bag="bags/some", namespace="lab", sensor_namespace="hand")
    played = started[0].parameters
    assert (played["source"], played["bag"]) == ("bag", str(Path("bags/some").absolute()))
    assert not {"rate_hz", "scenario", "seed"} & set(played)
    assert started[0].namespace == "/lab"
    assert estimators(started)[0].parameters["sensor_namespace"] == "/lab/hand"
    assert drawn(started)["truth/"].namespace == "/lab/hand/ground_truth"


def test_with_a_real_robot_nothing_is_played_and_there_is_no_truth() -> None:
    started = plan("finger", source="robot")
    assert [one.executable for one in started] == ["pcf_node", "robot_state_publisher", "rviz2"]
    assert not any("use_sim_time" in one.parameters for one in started)


def test_views_are_chosen() -> None:
    assert not {"rviz2", "foxglove_bridge"} & {one.executable for one in plan("finger", rviz="false")}
    both = plan("finger", foxglove="true", truth="FALSE", clock="false")
    assert {"rviz2", "foxglove_bridge"} < {one.executable for one in both}
    assert list(drawn(both)) == [""]
    assert not any("use_sim_time" in one.parameters for one in both)


def test_own_configuration_needs_no_urdf(tmp_path: Path) -> None:
    own = tmp_path / "elbow.yaml"
    own.write_text(
        "robot: {links: [a, b], joints: {ab: {parent: a, child: b, axis: x}}}\nsensors: {a: {}, b: {}}\n"
        "estimators: {pcf: {}}\n",
        encoding="utf-8",
    )
    started = plan("robot", config=str(own))
    assert [one.executable for one in started] == ["pcf_node", "robot_state_publisher", "rviz2"]
    assert started[0].parameters["config"] == str(own)
    assert '<joint name="ab" type="continuous">' in str(started[1].parameters["robot_description"])


def test_own_robot_can_be_simulated() -> None:
    """Nothing but its configuration is needed: sensors, estimator, and the truth beside it."""
    own = PROJECT / "config" / "song_roll.yaml"
    started = plan("robot", config=str(own), source="config", rate_hz="200", seed="3")
    chosen = {"source": "config", "config": str(own), "rate_hz": 200.0, "seed": 3, "wait_for_subscribers": 1}
    assert chosen.items() <= started[0].parameters.items()
    assert "scenario" not in started[0].parameters
    assert all(one.parameters["use_sim_time"] is True for one in started)
    assert set(drawn(started)) == {"", "truth/"}


def test_robots_in_namespaces_have_transforms_of_their_own() -> None:
    started = plan("exoshell", namespace="/b/")
    frames = {"/tf": "/b/tf", "/tf_static": "/b/tf_static"}
    assert all(
        frames.items() <= one.remappings.items()
        for one in started
        if one.package in ("robot_state_publisher", "tf2_ros", "rviz2")
    )
    assert (
        only(started, "rviz2").remappings["/robot_description"] == f"{drawn(started)[''].namespace}/robot_description"
    )


@pytest.mark.parametrize(
    ("robot", "given", "message"),
    [
        ("robot", {}, r"config: '' is not allowed; give the path of a configuration"),
        ("finger", {"config": "nowhere.yaml"}, r"/.*nowhere.yaml: no such configuration file"),
        ("finger", {"estimators": "pcf, kcf"}, r"estimators.kcf: unknown estimator; did you mean 'kckf'\?"),
        ("finger", {"source": "elbow"}, r"source: 'elbow' is not allowed; give one of robot, finger"),
        ("finger", {"scenario": "PX"}, r"scenario: 'PX' is not allowed; give one of PA"),
        ("finger", {"source": "config"}, r"scenario: unknown key; allowed: "),
        ("finger", {"rate_hz": "5"}, r"rate_hz: 5.0 is not allowed; give 100 to 1000 Hz"),
        ("finger", {"seed": "one"}, r"seed: 'one' is not allowed; give a whole number, a number"),
        ("finger", {"rviz": "maybe"}, r"rviz: 'maybe' is not allowed; give true or false"),
        ("finger", {"truth_offset": "1 2"}, r"truth_offset: '1 2' is not allowed; give x y z, m"),
    ],
)
def test_mistakes_are_one_line(robot: str, given: dict[str, str], message: str) -> None:
    with pytest.raises(ConfigurationError, match=f"^{message}"):
        plan(robot, **given)


def test_every_argument_says_what_it_is_and_its_default_can_be_given_as_text() -> None:
    usual: dict[str, Any] = dataclasses.asdict(LaunchArguments())
    assert dataclasses.asdict(LaunchArguments.from_text(defaults("robot"))) == usual
    assert all(spec.metadata["description"] for spec in dataclasses.fields(LaunchArguments))
