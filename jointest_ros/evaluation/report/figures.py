"""The plots of a report, as page.js hands them to plotly.js: plain dicts.

A figure: `traces` of plotly.js, in which `c` stands for a colour (number of the estimator, or "truth" or "muted") and
`band` for a line whose mirror image below zero bounds an area with it; `layout` without colours; `time`: its x axis is
the time, which all such figures share; `errors`: the axis whose range follows the errors that are shown. Traces that
come later cover those before: the estimators come in reverse order.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation.panels import Curve, Panel, line
from jointest_ros.evaluation.report.consistency import Course
from jointest_ros.evaluation.report.inputs import Delivery

Figure = dict[str, Any]
Colours = Mapping[str, int]  # estimator -> number

_POINTS = 200_000  # in all lines of a page: a few megabytes
_FEWEST, _MOST = 200, 4000  # stretches of a line
_BINS = 60
_DIGITS = 4  # of the range of an axis that its numbers are written with: finer than a screen
_LEVEL = 12  # bars with figures side by side; of more the figures stand upright, or they touch
_ROW, _ONE_ROW, _EDGE = 190, 250, 95  # pixels: a row of several, the only row, title and axis


def stretches(lines: int) -> int:
    """By how many stretches of time each of so many lines is drawn."""
    return int(np.clip(_POINTS // (2 * max(lines, 1)), _FEWEST, _MOST))


def joint_figure(panel: Panel, colours: Colours, parts: int, unit: str = "deg") -> Figure:
    """Angle over error with its band, or only the error where there is no truth to draw."""
    traces: list[dict[str, Any]] = []
    rows = ["error, " + unit] if panel.truth is None else [f"angle, {unit}", f"error, {unit}"]
    if unit != "deg" and len(rows) == 2:
        rows[0] = f"velocity, {unit}"
    low = "y2" if len(rows) == 2 else "y"
    if panel.truth is not None:
        traces.append(_line(panel.truth[0], panel.truth[1], parts, "truth", "truth", width=3))
    curves = list(panel.curves.items())[::-1]
    for name, curve in curves:
        if curve.estimate is not None and panel.truth is not None:
            traces.append(_line(curve.seconds, curve.estimate, parts, name, colours[name]))
    for name, curve in curves:
        legend = curve.estimate is None or panel.truth is None
        traces.append(_line(curve.seconds, curve.error, parts, name, colours[name], y=low, legend=legend))
        if curve.spread is not None:
            band = _line(curve.seconds, curve.spread, parts, name, colours[name], y=low, legend=False, width=1)
            traces.append({**band, "band": True, "hovertemplate": "±2 std %{y:.3g}"})
    return _figure(traces, rows, hover=f"%{{y:.3f}} {unit}") | {"errors": low.replace("y", "yaxis")}


def error_figure(panels: Sequence[Panel], colours: Colours, parts: int) -> Figure:
    """Errors of several things, one below the other."""
    traces, shown = [], set()
    for number, panel in enumerate(panels):
        for name, curve in reversed(list(panel.curves.items())):
            y = "y" if number == 0 else f"y{number + 1}"
            legend = name not in shown
            traces.append(_line(curve.seconds, curve.error, parts, name, colours[name], y=y, legend=legend))
            shown.add(name)
    return _figure(traces, [f"{panel.name}, deg" for panel in panels], hover="%{y:.3f} deg")


def distribution_figure(curves: Mapping[str, Curve], colours: Colours) -> Figure:
    """Histogram of the error beside the share of samples whose error is at most so large."""
    traces: list[dict[str, Any]] = []
    smallest = min(float(np.quantile(np.abs(curve.error), 0.01)) for curve in curves.values())
    percent = np.concatenate([np.arange(1.0, 99.0, 1.0), np.linspace(99.0, 100.0, 11)])
    for name, curve in reversed(list(curves.items())):
        share, edges = np.histogram(
            curve.error, _BINS, (np.quantile(curve.error, 0.001), np.quantile(curve.error, 0.999))
        )
        size = np.maximum(np.quantile(np.abs(curve.error), percent / 100.0), 1e-6)
        common = _named(name, colours[name]) | {"type": "scatter", "mode": "lines"}
        bins = {
            "x": _numbers(0.5 * (edges[1:] + edges[:-1])),
            "y": _numbers(100.0 * share / len(curve.error)),
            "area": True,
        }
        traces.append({**common, **bins, "line": {"shape": "hvh", "width": 1.5}, "hovertemplate": "%{x:.3g} deg"})
        steps = {"x": [float(f"{value:.4g}") for value in size], "y": _numbers(percent), "xaxis": "x2", "yaxis": "y2"}
        hover = "%{y:.1f} % are within %{x:.3g} deg"
        traces.append({**common, **steps, "showlegend": False, "line": {"width": 2}, "hovertemplate": hover})
    layout = {
        "height": 300,
        "hovermode": "closest",
        "xaxis": {"title": {"text": "error, deg"}, "domain": [0.0, 0.46]},
        "yaxis": {"title": {"text": f"samples in one of {_BINS} bins, %"}, "rangemode": "tozero"},
        "xaxis2": {
            "title": {"text": "size of the error, deg"},
            "domain": [0.54, 1.0],
            "anchor": "y2",
            **_decades(smallest),
        },
        "yaxis2": {"title": {"text": "samples within it, %"}, "range": [0, 101], "anchor": "x2"},
    }
    return {"traces": traces, "layout": layout, "time": False}


def _decades(smallest: float) -> dict[str, Any]:
    """A logarithmic axis with few labels, the fewer the more decades there are."""
    first = math.floor(math.log10(max(smallest, 1e-6)))
    marks = [mark * 10.0**power for power in range(first, 4) for mark in ((1,) if first < -3 else (1, 3))]
    return {"type": "log", "tickvals": marks, "ticktext": [f"{mark:g}" for mark in marks]}


def comparison_figure(bars: Mapping[str, Mapping[str, float]], colours: Colours, unit: str = "deg") -> Figure:
    """Bars: estimator -> joint -> rms error."""
    places = list(dict.fromkeys(joint for one in bars.values() for joint in one))
    labelled = len(places) * len(bars) <= 40
    upright = len(bars) > 1 and len(places) * len(bars) > _LEVEL
    traces = [
        {
            "type": "bar",
            **_named(name, colours[name]),
            "x": list(one),
            "y": [float(f"{value:.4g}") for value in one.values()],
            "text": [f"{value:.3g}" for value in one.values()] if labelled else None,
            "textposition": "outside",
            "textangle": -90 if upright else 0,
            "cliponaxis": False,
            "hovertemplate": f"%{{x}}: %{{y:.4g}} {unit}",
        }
        for name, one in bars.items()
    ]
    layout = {
        "height": 320,
        "barmode": "group",
        "legend": {"orientation": "h", "x": 0, "y": 1.12 if upright else 1, "yanchor": "bottom"},
        "bargap": 0.25 if len(places) * len(bars) > 8 else 0.6,
        "hovermode": "closest",
        "xaxis": {"type": "category", "categoryorder": "array", "categoryarray": places},
        "yaxis": {"title": {"text": f"rms error, {unit}"}, "rangemode": "tozero"},
    }
    return {"traces": traces, "layout": layout, "time": False}


def course_figure(courses: Mapping[str, Course], colours: Colours, what: str) -> Figure:
    """NIS or NEES over time, each with its bounds."""
    traces: list[dict[str, Any]] = []
    for name, course in reversed(list(courses.items())):
        common = {"type": "scatter", "mode": "lines", "x": _numbers(course.seconds, 3), **_named(name, colours[name])}
        ratio = _significant(course.ratio)
        traces.append({**common, "y": ratio, "line": {"width": 1.5}, "hovertemplate": f"{what} %{{y:.3g}}"})
        for bound in (course.low, course.high):
            traces.append(
                {**common, "y": _significant(bound), "showlegend": False, "hoverinfo": "skip"}
                | {"line": {"width": 1, "dash": "dash"}}
            )
    layout = {
        "height": _ONE_ROW + _EDGE - 40,
        "xaxis": {"title": {"text": "time, s"}},
        "yaxis": {"title": {"text": f"{what} (1 is right)"}, "type": "log"},
    }
    return {"traces": traces, "layout": layout, "time": True}


def innovation_figure(values: Mapping[str, FloatArray], colours: Colours) -> Figure:
    """Histograms of normalised innovations beside the standard normal density."""
    edges = np.linspace(-5.0, 5.0, 61)
    middles = 0.5 * (edges[1:] + edges[:-1])
    width = edges[1] - edges[0]
    normal = 100.0 * width * np.exp(-0.5 * middles**2) / math.sqrt(2.0 * math.pi)
    shape = {"type": "scatter", "mode": "lines", "x": _numbers(middles)}
    traces: list[dict[str, Any]] = [
        {**shape, **_named("normal, as it should be", "truth"), "y": _numbers(normal), "line": {"width": 3}}
    ]
    for name, one in reversed(list(values.items())):
        share = 100.0 * np.histogram(np.clip(one, -4.99, 4.99), edges)[0] / len(one)
        traces.append(
            {**shape, **_named(name, colours[name]), "y": _numbers(share), "area": True}
            | {"line": {"shape": "hvh", "width": 1.5}}
        )
    layout = {
        "height": 300,
        "hovermode": "closest",
        "xaxis": {"title": {"text": "innovation over its standard deviation (the outermost bins hold all beyond)"}},
        "yaxis": {"title": {"text": "share, %"}, "rangemode": "tozero"},
    }
    return {"traces": traces, "layout": layout, "time": False}


def interval_figure(deliveries: Mapping[str, Delivery], zero: int, parts: int) -> Figure:
    """Intervals between the samples of each sensor over time."""
    traces = []
    for number, (sensor, delivery) in enumerate(deliveries.items()):
        stamps, intervals = delivery.intervals()
        forward = intervals > 0.0
        if forward.any():
            seconds = np.asarray((stamps[forward] - zero) * 1e-9)
            order = np.argsort(seconds, kind="stable")  # a looping bag
            traces.append(_line(seconds[order], intervals[forward][order], parts, sensor, number))
    return _figure(traces, ["interval, ms"], hover="%{y:.2f} ms")


def _line(
    seconds: FloatArray,
    values: FloatArray,
    parts: int,
    name: str,
    colour: int | str,
    *,
    y: str = "y",
    legend: bool = True,
    width: float = 1.5,
) -> dict[str, Any]:
    x, heights = line(seconds, values, parts)
    return {
        "type": "scatter",
        "mode": "lines",
        **_named(name, colour),
        "showlegend": legend,
        "x": _numbers(x, 3),
        "y": _significant(heights),
        "yaxis": y,
        "line": {"width": width},
    }


def _named(name: str, colour: int | str) -> dict[str, Any]:
    """What stands for an estimator in a trace; in the legend the truth comes first, then their order."""
    rank = 1 + colour if isinstance(colour, int) else 0
    return {"name": name, "legendgroup": name, "legendrank": rank, "c": colour}


def _figure(traces: list[dict[str, Any]], rows: Collection[str], *, hover: str = "") -> Figure:
    """Rows of plots over one time axis."""
    count = len(rows)
    layout: dict[str, Any] = {"height": (_ROW * count if count > 1 else _ONE_ROW) + _EDGE}
    gap = 0.06 if count > 1 else 0.0
    height = (1.0 - gap * (count - 1)) / count
    for number, title in enumerate(rows):
        top = 1.0 - number * (height + gap)
        axis = {"title": {"text": title}, "domain": [round(max(top - height, 0.0), 4), round(top, 4)]}
        layout[f"yaxis{number + 1 if number else ''}"] = axis
    layout["xaxis"] = {"title": {"text": "time, s"}, "anchor": f"y{count}" if count > 1 else "y"}
    for trace in traces:
        trace.setdefault("hovertemplate", hover)
    return {"traces": traces, "layout": layout, "time": True}


def _numbers(values: FloatArray, decimals: int | None = None) -> list[float | None]:
    """Rounded to what can be seen; NaN as None."""
    if decimals is None:
        finite = np.abs(values[np.isfinite(values)])
        largest = float(finite.max()) if len(finite) else 0.0
        decimals = _DIGITS - math.floor(math.log10(largest)) if largest > 0.0 else 0
    return [None if value != value else value for value in np.round(values, decimals).tolist()]


def _significant(values: FloatArray) -> list[float | None]:
    """As `_numbers`, but small ones beside large ones keep three digits."""
    small = np.abs(values[np.isfinite(values) & (values != 0.0)])
    if not len(small):
        return _numbers(values)
    decimals = int(np.clip(3 - math.floor(math.log10(float(np.median(small)))), 0, 9))
    return _numbers(values, decimals)
