"""The view of RViz and the layouts of Foxglove against the topics, frames and joints that there are."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from jointest_ros import config
from jointest_ros.view.plan import ROBOTS, TRUTH, LaunchArguments, defaults, processes

PROJECT = Path(__file__).resolve().parents[2]
SHIPPED = sorted(file.stem for file in (PROJECT / "foxglove").glob("*.json"))
RVIZ_CLASSES = re.compile(
    r"rviz_common/(Displays|Views|Time)|rviz_default_plugins/"
    r"(Grid|RobotModel|TF|Interact|MoveCamera|Select|FocusCamera|Measure|Orbit)"
)


def leaves(layout: Any) -> Iterator[str]:
    """The panels in the tree of a Foxglove layout."""
    if isinstance(layout, str):
        yield layout
    else:
        assert layout["direction"] in ("row", "column") and 0 < layout["splitPercentage"] < 100
        yield from leaves(layout["first"])
        yield from leaves(layout["second"])


def values(tree: Any, key: str) -> Iterator[Any]:
    """All values of a key, wherever it stands."""
    if isinstance(tree, dict):
        yield from (value for name, value in tree.items() if name == key)
        tree = list(tree.values())
    if isinstance(tree, list):
        for one in tree:
            yield from values(one, key)


def test_there_is_a_layout_for_every_robot() -> None:
    assert set(SHIPPED) == set(ROBOTS) - {"robot"}


@pytest.mark.parametrize("name", SHIPPED)
def test_layouts_show_what_the_launch_file_publishes(name: str) -> None:
    layout = json.loads((PROJECT / "foxglove" / f"{name}.json").read_text(encoding="utf-8"))
    assert Counter(leaves(layout["layout"])) == Counter(list(layout["configById"]))  # each panel once

    robot = config.load(PROJECT / "config" / f"{name}.yaml").robot
    started = processes(LaunchArguments.from_text(defaults(name)))
    spaces = {one.namespace for one in started if one.executable.endswith("_node")} | {"/ground_truth"}
    count = len(robot.coordinates)
    paths = [path for plot in values(layout, "paths") for path in plot]
    positions = [re.fullmatch(r"(/\w+)/joint_states\.position\[(\d+)\]", path["value"]) for path in paths]
    shown = Counter(int(match[2]) for match in positions if match and match[1] in spaces)
    assert shown == {number: 2 for number in range(count)}  # estimate and truth of each joint
    variances = [re.fullmatch(r"(/\w+)/joint_covariance\.data\[(\d+)\]\.@sqrt", path["value"]) for path in paths]
    diagonal = [int(match[2]) for match in variances if match and match[1] in spaces]
    assert [divmod(index, count) for index in diagonal] == [(number, number) for number in range(count)]
    torso = [path for path in paths if re.fullmatch(r"/(kckf|ground_truth)/torso_angle\.vector\.[xyz]", path["value"])]
    assert len(torso) == (6 if name == "exoshell" else 0)
    assert len(paths) == 3 * count + len(torso)

    models = {
        one.namespace: str(one.parameters["frame_prefix"]) for one in started if one.package.startswith("robot_s")
    }
    (layers,) = values(layout, "layers")
    drawn = {layer["topic"]: layer["framePrefix"] for layer in layers.values() if layer["layerId"] == "foxglove.Urdf"}
    assert drawn.items() >= {f"{space}/robot_description": prefix for space, prefix in models.items()}.items()
    assert list(values(layout, "followTf")) == [robot.links[0]]


def test_the_view_of_rviz_names_plugins_of_rviz_and_what_the_launch_files_remap() -> None:
    view = yaml.safe_load((PROJECT / "rviz" / "jointest.rviz").read_text(encoding="utf-8"))
    assert all(RVIZ_CLASSES.fullmatch(name) for name in values(view, "Class") if name)
    models = [one for one in view["Visualization Manager"]["Displays"] if one["Class"].endswith("/RobotModel")]
    rviz = processes(LaunchArguments.from_text(defaults("finger")))[-1]
    assert {one["Description Topic"]["Value"] for one in models} == set(rviz.remappings)
    # RViz puts "/" between prefix and name
    assert [one["TF Prefix"] for one in models] == ["", TRUTH.rstrip("/")]
