"""The tables of a report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any
from urllib.parse import quote

import numpy as np

from jointest_ros.core.input_quality import gyro_of
from jointest_ros.evaluation.report.changes import Changes
from jointest_ros.evaluation.report.consistency import PROBABILITY, Course, Innovations
from jointest_ros.evaluation.report.content import Origin
from jointest_ros.evaluation.report.inputs import Delivery
from jointest_ros.evaluation.report.kinds import FIGURES, KINDS, rows_of
from jointest_ros.evaluation.report.markup import Cell, Link, Row, paragraph, table
from jointest_ros.evaluation.report.summary import overall, ranking

Within = Mapping[tuple[str, str], float]  # (estimator, joint) -> share


def errors(
    estimators: Mapping[str, Any],
    kind: str,
    within: Within | None = None,
    plots: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Error figures of one of `KINDS`.

    Args:
        within: share of the errors within two reported standard deviations.
        plots: joint -> place of its plot, to which its rows lead.
    """
    tables = {name: rows_of(figures, kind) for name, figures in estimators.items()}
    smallest: dict[str, float] = {}
    for one in tables.values():
        for part, figures in one.items():
            if figures["rmse_deg"] is not None:
                smallest[part] = min(smallest.get(part, np.inf), figures["rmse_deg"])
    several = sum(map(bool, tables.values())) > 1

    def rows() -> Iterator[Row]:
        for name, one in tables.items():
            for part, figures in one.items():
                best = several and figures["rmse_deg"] == smallest.get(part)
                cells = [Cell(_three(figures[key]), best and key == "rmse_deg") for key in FIGURES]
                shares = [Cell(_percent(within.get((name, part))))] if within is not None else []
                place = Link(part, f"#{quote(plots[part])}") if part in plots else part
                yield [name, place, *cells, *shares, Cell(str(figures["samples"])), Cell(_percent(figures["coverage"]))]

    band = ["in ±2 std (95 %)"] if within is not None else []
    headings = ["estimator", "of", *FIGURES.values(), *band, "samples", "matched"]
    return table(headings, rows(), KINDS[kind], f"errors-{kind}")


def estimators(figures: Mapping[str, Any]) -> str:
    """One row an estimator, the best first."""
    rows: list[Row] = []
    for name, whole in ranking(figures):
        one = figures[name]
        cost = one["ns_per_frame"]
        rows.append(
            [
                name,
                whole.kind,
                *(Cell(_three(value)) for value in (whole.rmse_deg, whole.std_deg, whole.max_abs_deg)),
                whole.worst,
                Cell(_percent(whole.coverage)),
                Cell(_two(one["nis"])),
                Cell(_two(one["nees"])),
                Cell("-" if cost is None else f"{cost * 1e-3:.1f}"),
            ]
        )
    headings = ["estimator", "of", "rmse", "std", "max", "worst", "matched", "NIS", "NEES", "us a frame"]
    caption = "all together, deg; NIS and NEES: 1 is right, more: too small a variance"
    text = table(headings, rows, caption, "estimators")
    silent = [name for name, one in figures.items() if overall(one) is None]
    return text + (paragraph(f"No estimate matches the truth: {', '.join(silent)}.", "hint") if silent else "")


def consistency(
    figures: Mapping[str, Any],
    nis: Mapping[str, Course],
    nees: Mapping[str, Course],
    innovations: Mapping[str, Innovations],
) -> str:
    """One row an estimator that states variances."""
    rows: list[Row] = []
    for name, one in figures.items():
        if name not in nis and name not in nees:
            continue
        values = innovations[name].values if name in innovations else np.empty(0)
        beyond = float(np.mean(np.abs(values) > 2.0)) if len(values) else None
        cells = [
            Cell(_two(one["nees"])),
            Cell(_percent(nees[name].inside if name in nees else None)),
            Cell(_two(one["nis"])),
            Cell(_percent(nis[name].inside if name in nis else None)),
            Cell("-" if beyond is None else f"{float(np.mean(values)):.2f}"),
            Cell(_percent(beyond)),
        ]
        rows.append([name, *cells])
    share = f"{100 * PROBABILITY:.0f} %"
    headings = [
        "estimator",
        "NEES",
        f"within its {share} bounds",
        "NIS",
        f"within its {share} bounds",
        "mean innovation (0)",
        "innovations beyond 2 std (5 %)",
    ]
    return table(headings, rows, "consistency: in brackets what is right; NIS and NEES of 1 are", "consistency-table")


def topics(inputs: Mapping[str, Any]) -> str:
    """Messages received, used and refused by topic."""
    rows: list[Row] = []
    for topic, counts in inputs.items():
        refused = ", ".join(f"{n} {cause}" for cause, n in sorted(counts["refused"].items()))
        rows.append([topic, Cell(str(counts["messages"])), Cell(str(counts["used"])), refused or "none"])
    return table(["topic", "received", "used", "refused"], rows, "messages", "topics")


def deliveries(found: Mapping[str, Delivery], saturated: Mapping[str, int]) -> str:
    """Rate and gaps by sensor."""
    rows: list[Row] = []
    for sensor, one in found.items():
        known = one.rate_hz == one.rate_hz
        rows.append(
            [
                sensor,
                Cell(str(len(one.stamps))),
                Cell(f"{one.rate_hz:.2f}" if known else "-"),
                Cell(f"{1e3 * one.jitter_s:.3f}" if known else "-"),
                Cell(str(one.gaps)),
                Cell(f"{1e3 * one.longest_s:.1f}"),
                Cell(_percent(one.missing)),
                *(Cell(str(saturated[what]) if what in saturated else "-") for what in (sensor, gyro_of(sensor))),
            ]
        )
    headings = ["sensor", "samples", "rate, Hz", "jitter, ms", "gaps", "longest, ms", "missing"]
    headings += ["saturated", "gyro saturated"]
    caption = "samples by sensor; saturated: of accelerometers and gyros whose full scale is configured"
    return table(headings, rows, caption, "sensors")


def settings(chosen: Mapping[str, Any], versions: Mapping[str, str], origin: Origin) -> str:
    """Command, versions, and the parameters of every estimator, defaults included."""
    rows: list[Row] = [["command", origin.command], ["date", origin.date]]
    rows += [[name, version] for name, version in versions.items()]
    text = table(["what", "value"], rows, "this evaluation", "versions")
    parameters: list[Row] = [
        [name, key, Cell(str(value))] for name, values in chosen["estimators"].items() for key, value in values.items()
    ]
    return text + table(["estimator", "parameter", "value"], parameters, "parameters, defaults included", "parameters")


def changes(found: Changes) -> str:
    """Old and new rms errors."""
    rows: list[Row] = []
    for one in found.rows:
        numbers = [Cell(_three(one.old)), Cell(_three(one.new)), Cell(one.difference())]
        rows.append([one.estimator, one.kind, one.part, *numbers, one.verdict])
    headings = ["estimator", "of", "", "old rmse", "new rmse", "difference", ""]
    caption = f"since {found.source}; within {found.tolerance:g} % counts as the same"
    notes = "".join(paragraph(text, "hint") for text in found.notes)
    return table(headings, rows, caption, "changes-table") + notes


def recordings(rows: Sequence[tuple[str, str, Mapping[str, Any]]]) -> str:
    """One row a recording and estimator, as in `page.index`."""
    lines: list[Row] = []
    for address, remark, document in rows:
        for number, (name, whole) in enumerate(ranking(document["estimators"])):
            first: Row = ["", ""] if number else [Link(document["bag"], address), Cell(f"{document['duration_s']:.1f}")]
            errors_of = [Cell(_three(value)) for value in (whole.rmse_deg, whole.std_deg, whole.max_abs_deg)]
            nees = document["estimators"][name]["nees"]
            last = "" if number else remark
            lines.append([*first, name, *errors_of, Cell(_percent(whole.coverage)), Cell(_two(nees)), last])
    headings = ["recording", "s", "estimator", "rmse", "std", "max", "matched", "NEES", "input"]
    return table(headings, lines, "errors in degrees over all joints; the best estimator first", "recordings")


def _three(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _two(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100.0 * share:.1f} %"
