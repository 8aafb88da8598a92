"""The page of one recording: what it says first, then its sections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from jointest_ros.core.timing import GAP
from jointest_ros.evaluation import panels as of
from jointest_ros.evaluation.panels import Panel
from jointest_ros.evaluation.report import figures, markup, tables
from jointest_ros.evaluation.report.changes import Changes
from jointest_ros.evaluation.report.consistency import PROBABILITY, courses, nis_course, within_two_sigma
from jointest_ros.evaluation.report.content import Evaluation, Origin
from jointest_ros.evaluation.report.figures import Figure
from jointest_ros.evaluation.report.inputs import deliveries
from jointest_ros.evaluation.report.summary import overall, statements
from jointest_ros.evaluation.report.tables import Within

_READING = (
    "Drag to zoom, shift and drag to pan, double-click to go back; all time axes move together. "
    "A click in a legend hides an estimator, a double-click shows it alone."
)


class Page:
    """Sections and the figures in them, of one recording.

    Args:
        evaluation: with its frames and innovations.
        changes: since an earlier evaluation, where asked for.
    """

    def __init__(self, evaluation: Evaluation, origin: Origin, changes: Changes | None = None) -> None:
        self.evaluation, self.origin, self.changes = evaluation, origin, changes
        self.estimators: dict[str, Any] = evaluation.document["estimators"]
        self.colours = {name: number for number, name in enumerate(self.estimators)}
        self.joints = of.joint_panels(
            evaluation.series, evaluation.joints, evaluation.truth, evaluation.skip_s, evaluation.continuous
        )
        velocities = of.joint_panels(
            evaluation.series, evaluation.joints, evaluation.truth, evaluation.skip_s, of="velocity"
        )
        given = [_without(panel, self.estimators, "velocities") for panel in velocities]  # peers give none
        self.velocities = [panel for panel in given if panel.curves]
        self.torso = of.torso_panels(evaluation.series, evaluation.chains, evaluation.truth, evaluation.skip_s)
        self.inclinations = of.inclination_panels(evaluation.series, evaluation.truth, evaluation.skip_s)
        one = evaluation
        self.nees = courses(one.series, one.joints, one.truth, one.skip_s, one.continuous)
        self.nis = {
            name: course
            for name, values in one.innovations.items()
            if (course := nis_course(values, one.zero, one.skip_s))
        }
        self.deliveries = deliveries(evaluation.recording) if evaluation.recording is not None else {}
        shown = [*self.joints, *self.velocities]
        lines = sum(1 + 3 * len(panel.curves) for panel in shown) + len(self.deliveries)
        lines += sum(len(panel.curves) for panel in (*self.torso, *self.inclinations))
        self.parts = figures.stretches(lines)
        self.figures: dict[str, Figure] = {}

    def html(self, library: str) -> str:
        """The page; `library`: source of plotly.js."""
        bodies = [
            ("comparison", "Estimators", self._comparison(), True),
            ("changes", "Changes", tables.changes(self.changes) if self.changes else "", True),
            ("joints", "Joint angles", self._joints(), True),
            ("velocities", "Joint velocities", self._velocities(), True),
            ("torso", "Torso", self._torso(), True),
            ("orientation", "Inclination", self._orientation(), True),
            ("consistency", "Consistency", self._consistency(), True),
            ("input", "Input", self._input(), True),
            ("configuration", "Configuration and versions", self._configuration(), False),
        ]
        present = [one for one in bodies if one[2]]
        links = "".join(f'<a href="#{name}">{escape(title)}</a>' for name, title, _, _ in present)
        sections = "".join(markup.section(name, title, body, open_=open_) for name, title, body, open_ in present)
        name = self.evaluation.document["bag"]
        body = f"{self._head()}<nav>{links}</nav><main>{sections}</main>"
        return markup.page(f"{name}: joint angle errors", body, self.figures, self.evaluation.document, library)

    # ---------------------------------------------------------------- first screen

    def _head(self) -> str:
        document, evaluation = self.evaluation.document, self.evaluation
        after = f", judged after {evaluation.skip_s:g} s" if evaluation.skip_s else ""
        moving = ", while it moves" if document["settings"]["moving"] else ""
        facts = f"{document['duration_s']:.1f} s{after}{moving} · {self.origin.date}"
        cards = "".join(
            f'<div class="card {card.level}"><h3>{escape(card.title)}</h3><strong>{escape(card.figure)}</strong>'
            f"<p>{escape(card.text)}</p></div>"
            for card in statements(document, evaluation.warnings, evaluation.damage)
        )
        damage = markup.paragraph(f"{evaluation.damage}; the figures are of what came before", "bad")
        return (
            f"<header><h1>{escape(document['bag'])}</h1><p>{escape(facts)}</p>"
            f'{damage if evaluation.damage else ""}<div class="cards">{cards}</div>'
            f'<p class="hint">{_READING}</p>'
            "<noscript><p>The plots need JavaScript; as pictures they lie beside this page.</p></noscript></header>"
        )

    # ---------------------------------------------------------------- sections

    def _comparison(self) -> str:
        bars: dict[str, dict[str, float]] = {}
        for name, figures_of in self.estimators.items():
            whole = overall(figures_of)
            if whole is None:
                continue
            key = "joints" if figures_of["joints"] else "orientation"
            parts = {part: one if key == "joints" else one["inclination"] for part, one in figures_of[key].items()}
            judged = {part: one["rmse_deg"] for part, one in parts.items() if one["samples"]}
            bars[name] = {"all": whole.rmse_deg, **judged} if len(judged) > 1 else judged
        text = tables.estimators(self.estimators)
        if bars:
            self.figures["comparison-bars"] = figures.comparison_figure(bars, self.colours)
            text = (
                markup.plot(
                    "comparison-bars",
                    "Root mean square of the error",
                    "Estimate minus truth in degrees; nothing is fitted or removed first, so a constant offset counts. "
                    "Lower is better.",
                )
                + text
            )
        if self.evaluation.headings:
            cells = ", ".join(f"{name} {heading}" for name, heading in self.evaluation.headings.items())
            text += markup.paragraph(f"Heading of the peers, the better of two ways each: {cells}.", "hint")
        return text

    def _joints(self) -> str:
        if not self.joints:
            return ""
        within: Within = {
            (name, panel.name): within_two_sigma(curve.error, curve.spread)
            for panel in self.joints
            for name, curve in panel.curves.items()
            if curve.spread is not None
        }
        plots = {panel.name: f"angle-{panel.name}" for panel in self.joints}
        parts = [tables.errors(self.estimators, "joints", within, plots), self._thinning()]
        for panel in self.joints:
            parts.append(
                self._plot(
                    f"angle-{panel.name}",
                    panel.name,
                    figures.joint_figure(panel, self.colours, self.parts),
                    "Above: the angle in degrees beside the truth (grey). Below: estimate minus truth, and the band of "
                    "±2 reported standard deviations, which should hold 95 % of it.",
                )
            )
            parts.append(
                self._plot(
                    f"distribution-{panel.name}",
                    f"{panel.name}: distribution of the error",
                    figures.distribution_figure(panel.curves, self.colours),
                    "Left: how often which error occurs, in bins of each estimator's own width; a hump beside zero "
                    "is an offset. Right: share of the samples whose error is at most so large.",
                )
            )
        return "".join(parts)

    def _velocities(self) -> str:
        if not self.velocities:
            return ""
        plots = {panel.name: f"velocity-{panel.name}" for panel in self.velocities}
        parts = [tables.errors(self.estimators, "velocities", plots=plots)]
        for panel in self.velocities:
            figure = figures.joint_figure(panel, self.colours, self.parts, "deg/s")
            text = "Above: the velocity in degrees per second beside the truth (grey). Below: estimate minus truth."
            parts.append(self._plot(f"velocity-{panel.name}", panel.name, figure, text))
        return "".join(parts)

    def _torso(self) -> str:
        if not self.torso:
            return ""
        text = (
            "Last link of the chain in the first, in degrees: components of the rotation vector (or sums of angles), "
            "and the angle between the estimated and the true orientation (geodesic)."
        )
        figure = figures.error_figure(self.torso, self.colours, self.parts)
        table = tables.errors(self.estimators, "torso")
        return table + self._plot("torso-errors", "Error of the torso", figure, text)

    def _orientation(self) -> str:
        if not self.inclinations:
            return ""
        parts = [tables.errors(self.estimators, "inclination")]
        if any("heading" in one for table in self.estimators.values() for one in table["orientation"].values()):
            parts.append(tables.errors(self.estimators, "heading"))
        for panel in self.inclinations:
            figure = figures.error_figure([panel], self.colours, self.parts)
            text = "Angle between the estimated and the true vertical, in degrees."
            parts.append(self._plot(f"orientation-{panel.name}", panel.name, figure, text))
            figure = figures.distribution_figure(panel.curves, self.colours)
            text = "Left: how often which error occurs. Right: share of the samples whose error is at most so large."
            parts.append(self._plot(f"distribution-{panel.name}", f"{panel.name}: distribution", figure, text))
        return "".join(parts)

    def _consistency(self) -> str:
        one, nees, nis = self.evaluation, self.nees, self.nis
        if not nis and not nees:
            return ""
        parts = [tables.consistency(self.estimators, nis, nees, one.innovations)]
        bounds = f"dashed: where a consistent estimator is with {100 * PROBABILITY:.0f} %"
        if nees:
            text = (
                "Squared error of the angles over the stated variance, mean of a stretch of time (no unit); "
                f"{bounds}, for one sample, since successive errors are alike. Above: it states too small a variance."
            )
            figure = figures.course_figure(nees, self.colours, "NEES")
            parts.append(self._plot("nees", "NEES: is the error as large as stated?", figure, text))
        if nis:
            text = (
                "Squared innovations over their stated variance, mean of a stretch of time (no unit); "
                f"{bounds}, if innovations are independent. Above: sensors contradict the estimate more than stated."
            )
            figure = figures.course_figure(nis, self.colours, "NIS")
            parts.append(self._plot("nis", "NIS: do the sensors agree with the estimate?", figure, text))
        values = {name: found.values for name, found in one.innovations.items() if len(found.values)}
        if values:
            figure = figures.innovation_figure(values, self.colours)
            text = (
                "Innovations of the whole recording over their standard deviations (no unit), beside the normal "
                "distribution: wider means too small a stated variance, beside the middle an offset."
            )
            parts.append(self._plot("innovations", "Normalised innovations", figure, text))
        return "".join(parts)

    def _input(self) -> str:
        one = self.evaluation
        parts = [tables.topics(one.document["input"])]
        if one.warnings:
            parts.append("<ul>" + "".join(f"<li>{escape(text)}</li>" for text in one.warnings) + "</ul>")
        if self.deliveries:
            parts.append(tables.deliveries(self.deliveries, one.saturated))
            figure = figures.interval_figure(self.deliveries, one.zero, self.parts)
            text = (
                "Time from a sample to the next one of the same sensor, in milliseconds, by the stamps of the frames; "
                f"a gap is longer than {GAP:g} times the median."
            )
            parts.append(self._plot("intervals", "Intervals between samples", figure, text))
        return "".join(parts)

    def _configuration(self) -> str:
        document = self.evaluation.document
        parts = [tables.settings(document["settings"], document["versions"], self.origin)]
        parts += [f"<h3>{escape(name)}</h3><pre>{escape(text)}</pre>" for name, text in self.origin.files]
        return "".join(parts)

    # ---------------------------------------------------------------- helpers

    def _plot(self, name: str, title: str, figure: Figure, text: str) -> str:
        self.figures[name] = figure
        return markup.plot(name, title, text)

    def _thinning(self) -> str:
        longest = max(len(panel.truth[0]) for panel in self.joints if panel.truth is not None)
        if longest <= 2 * self.parts:
            return ""
        seconds = float(np.ptp(self.evaluation.truth.stamps)) * 1e-9 / self.parts
        return markup.paragraph(
            f"Lines over time show the lowest and the highest sample of every {seconds:.2g} s, so that no spike is "
            "lost; every sample is in the CSV files beside this page.",
            "hint",
        )


def _without(panel: Panel, estimators: Mapping[str, Any], table: str) -> Panel:
    """Only the curves of estimators that have figures of this joint in a table."""
    curves = {name: curve for name, curve in panel.curves.items() if panel.name in estimators[name][table]}
    return Panel(panel.name, curves, panel.truth)


def index(title: str, rows: Sequence[tuple[str, str, Mapping[str, Any]]], origin: Origin, failed: Sequence[str]) -> str:
    """The page over several recordings.

    Args:
        rows: (address of its page, findings and damage as text, document) of each.
        failed: why others could not be evaluated.
    """
    body = f"<header><h1>{escape(title)}</h1><p>{escape(origin.date)}</p></header><main>{tables.recordings(rows)}"
    if failed:
        body += "<ul>" + "".join(f'<li class="bad">{escape(text)}</li>' for text in failed) + "</ul>"
    return markup.page(title, body + "</main>", {}, [document for *_, document in rows], "")
