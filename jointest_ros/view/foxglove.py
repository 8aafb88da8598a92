"""A Foxglove layout for a robot: its shape beside the truth, every joint angle beside the truth, spread, diagnostics.

The format is that of Foxglove's exported layouts. The only function in its message paths is `@sqrt`, which Lichtblick,
its open-source relative, knows as well; therefore angles are in rad.
"""

from __future__ import annotations

import json
from typing import Any

from jointest_ros.core.robot import Robot
from jointest_ros.view.plan import TRUTH
from jointest_ros.view.urdf import root_link

_ESTIMATE, _TRUE = "#4e98e2", "#f5774d"
_SERIES = ("#4e98e2", "#f5774d", "#f7df71", "#5cd6a9", "#c14fe0", "#9e9e9e", "#ff6aa2", "#7ac36a", "#8d6e63")
_COLUMN = 4  # plots of joints one below the other


def foxglove_layout(robot: Robot, estimator: str, torso: bool) -> str:
    """The text of the layout, for `ros2 launch` without a namespace.

    Args:
        robot: whose joints are plotted.
        estimator: whose estimates they are.
        torso: it publishes torso_angle.

    Raises:
        ConfigurationError: the links are no single tree.
    """
    names = robot.coordinates
    panels: dict[str, Any] = {"3D!robot": _three_d(root_link(robot), estimator)}
    columns = []
    for number, name in enumerate(names):
        sources = (("estimate", _ESTIMATE, f"/{estimator}"), ("truth", _TRUE, "/ground_truth"))
        series = [_series(f"{of}/joint_states.position[{number}]", label, c) for label, c, of in sources]
        panels[f"Plot!{name}"] = _plot(f"{name}, rad", series)
    for start in range(0, len(names), _COLUMN):
        columns.append(_split("column", [f"Plot!{name}" for name in names[start : start + _COLUMN]]))
    spread = [
        # the variances are the diagonal of the matrix
        _series(f"/{estimator}/joint_covariance.data[{number * (len(names) + 1)}].@sqrt", name, _colour(number), False)
        for number, name in enumerate(names)
    ]
    panels["Plot!deviation"] = _plot("standard deviation, rad", spread)
    below = ["Plot!deviation"]
    if torso:
        angle = [
            _series(f"{of}/torso_angle.vector.{axis}", f"{axis}{label}", _colour(number))
            for of, label, first in ((f"/{estimator}", "", 0), ("/ground_truth", ", truth", 3))
            for number, axis in enumerate("xyz", first)
        ]
        panels["Plot!torso"] = _plot("torso, rad", angle)
        below.append("Plot!torso")
    panels["DiagnosticSummary!all"] = {
        "minLevel": 0,
        "pinnedIds": [],
        "hardwareIdFilter": "",
        "topicToRender": "/diagnostics",
        "sortByLevel": True,
    }
    below.append("DiagnosticSummary!all")
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", [_split("column", ["3D!robot", _split("row", below)], 60), *columns], 45),
    }
    return json.dumps(layout, indent=2) + "\n"


def _three_d(root: str, estimator: str) -> dict[str, Any]:
    grid = {"layerId": "foxglove.Grid", "label": "Grid, 10 cm", "size": 1, "divisions": 10, "frameId": root}
    models = {
        "estimate": (f"/{estimator}/robot_description", "", 1.0),
        "truth": ("/ground_truth/robot_description", TRUTH, 0.35),
    }
    layers = {"grid": _layer("grid", 1, **grid)}
    for order, (name, (topic, prefix, opacity)) in enumerate(models.items(), 2):
        source = {"sourceType": "topic", "topic": topic, "framePrefix": prefix, "opacity": opacity}
        layers[name] = _layer(name, order, layerId="foxglove.Urdf", label=name, displayMode="visual", **source)
    camera = {
        "perspective": True,
        "distance": 0.8,
        "phi": 60,
        "thetaOffset": 45,
        "targetOffset": [0.1, 0, 0.05],
        "target": [0, 0, 0],
        "targetOrientation": [0, 0, 0, 1],
        "fovy": 45,
        "near": 0.01,
        "far": 100,
    }
    return {
        "cameraState": camera,
        "followMode": "follow-pose",
        "followTf": root,
        "scene": {"transforms": {"axisScale": 0.1, "showLabel": False}},
        "transforms": {},
        "topics": {},
        "layers": layers,
    }


def _layer(name: str, order: int, **settings: Any) -> dict[str, Any]:
    return {"instanceId": name, "visible": True, "frameLocked": True, "order": order, **settings}


def _plot(title: str, series: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": title,
        "paths": series,
        "xAxisVal": "timestamp",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "isSynced": True,
        "sidebarDimension": 240,
        "followingViewWidth": 20,
    }


def _series(path: str, label: str, color: str, stamped: bool = True) -> dict[str, Any]:
    return {
        "value": path,
        "label": label,
        "color": color,
        "enabled": True,
        "showLine": True,
        # an array has no header
        "timestampMethod": "headerStamp" if stamped else "receiveTime",
    }


def _colour(number: int) -> str:
    return _SERIES[number % len(_SERIES)]


def _split(direction: str, parts: list[Any], percentage: float | None = None) -> Any:
    """Parts beside or below one another, of equal size unless the first gets a percentage."""
    first, *others = parts
    if not others:
        return first
    return {
        "direction": direction,
        "splitPercentage": percentage or 100.0 / len(parts),
        "first": first,
        "second": _split(direction, others),
    }
