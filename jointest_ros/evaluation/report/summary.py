"""What a report says first: which estimator is nearest to the truth, whether it knows how near, is the input sound."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from jointest_ros.core.errors import counted
from jointest_ros.evaluation.peers import PREFIX

Level = Literal["good", "attention", "bad", "plain"]

CONSISTENT = (0.5, 2.0)  # NEES; of one recording it scatters, since its errors are the same one for a while
REFUSED = 0.01  # share of the messages of a topic that are refused; from here on it is said
COVERED = 0.99  # share of the truth samples; from here on it is not said


@dataclass(frozen=True)
class Overall:
    """One estimator over everything of one kind that it was judged in.

    Attributes:
        kind: "joint angles" or "inclination".
        rmse_deg, std_deg: root of the mean square over all samples.
        max_abs_deg: largest.
        worst: joint or sensor of the largest rmse.
        coverage: share of the truth samples that are matched.
        judged: the joints or sensors with samples.
    """

    kind: str
    rmse_deg: float
    std_deg: float
    max_abs_deg: float
    worst: str
    coverage: float
    judged: frozenset[str]


@dataclass(frozen=True)
class Statement:
    """One card of the summary."""

    title: str
    level: Level
    figure: str
    text: str


def overall(figures: Mapping[str, Any]) -> Overall | None:
    """Of the figures of one estimator: its joint angles, or inclinations where it has no joints; None without any."""
    tables: dict[str, Mapping[str, Any]] = {
        "joint angles": figures["joints"],
        "inclination": {name: table["inclination"] for name, table in figures["orientation"].items()},
    }
    for kind, table in tables.items():
        judged = {name: one for name, one in table.items() if one["samples"]}
        if not judged:
            continue
        count = sum(one["samples"] for one in judged.values())

        def pooled(key: str, judged: Mapping[str, Any] = judged, count: int = count) -> float:
            return math.sqrt(sum(one["samples"] * one[key] ** 2 for one in judged.values()) / count)

        expected = sum(one["samples"] / one["coverage"] for one in judged.values())
        return Overall(
            kind,
            pooled("rmse_deg"),
            pooled("std_deg"),
            max(one["max_abs_deg"] for one in judged.values()),
            max(judged, key=lambda name: judged[name]["rmse_deg"]),
            count / expected * len(judged) / len(table),
            frozenset(judged),
        )
    return None


def ranking(estimators: Mapping[str, Any]) -> list[tuple[str, Overall]]:
    """Estimators that were judged: those of most joints first, of equally many the smallest rmse first."""
    judged = {name: found for name, figures in estimators.items() if (found := overall(figures))}
    return sorted(judged.items(), key=lambda item: (-len(item[1].judged), item[1].rmse_deg))


def statements(document: Mapping[str, Any], findings: list[str], damage: str) -> list[Statement]:
    """The cards, most important first. A document without any figure has none of accuracy."""
    estimators = document["estimators"]
    ranked = ranking(estimators)
    found = []
    if ranked:
        name, best = ranked[0]
        found.append(_accuracy(ranked))
        own = next((own for own, _ in ranked if not own.startswith(PREFIX)), name)
        found.append(_consistency(own, estimators[own]))
        if best.coverage < COVERED:
            text = f"of the truth samples have an estimate of {name}; the others are not in its error"
            found.append(Statement("Coverage", "attention", f"{100.0 * best.coverage:.1f} %", text))
    found.append(_input(document["input"], findings, damage))
    return found


def _accuracy(ranked: list[tuple[str, Overall]]) -> Statement:
    name, best = ranked[0]
    text = f"{name}: rms error of {best.kind}"
    if len(best.judged) > 1:
        text += f", {len(best.judged)} in all, {best.worst} the worst"
    text += f"; largest {best.max_abs_deg:.3g}°"
    if best.std_deg < 0.9 * best.rmse_deg:
        text += f"; without its mean {best.std_deg:.3g}°"
    peers = [one for one in ranked if one[1].judged == best.judged and one[0] != name]
    if peers:
        text += f". Next: {peers[0][0]} with {peers[0][1].rmse_deg:.3g}°"
    return Statement("Smallest error", "plain", f"{best.rmse_deg:.3g}°", text)


def _consistency(name: str, figures: Mapping[str, Any]) -> Statement:
    nees = figures["nees"]
    if nees is None:
        return Statement("Consistency", "plain", "-", f"{name} states no variance that could be judged")
    factor = math.sqrt(nees)
    shown = f"NEES {_rounded(nees, 3)}"
    if nees > CONSISTENT[1]:
        text = f"{name} is surer than it may be: its errors are {_rounded(factor, 2)} times what it states"
        return Statement("Consistency", "attention", shown, text)
    if nees < CONSISTENT[0]:
        text = f"{name} is better than it states: its errors are {_rounded(factor, 2)} times the stated ones"
        return Statement("Consistency", "attention", shown, text)
    low, high = CONSISTENT
    text = f"the errors of {name} are as large as it states (a NEES of {low:g} to {high:g} counts as that)"
    return Statement("Consistency", "good", shown, text)


def _rounded(value: float, digits: int) -> str:
    """To so many digits, but all before the point: no exponent however large."""
    return f"{value:.{digits}g}" if value < 10.0**digits - 0.5 else f"{value:.0f}"


def _input(inputs: Mapping[str, Any], findings: list[str], damage: str) -> Statement:
    messages = sum(topic["messages"] for topic in inputs.values())
    used = sum(topic["used"] for topic in inputs.values())
    share = f"{100.0 * used / messages:.4g} %" if messages else "none"
    spoilt = [topic for topic, one in inputs.items() if sum(one["refused"].values()) > REFUSED * one["messages"]]
    if damage:
        return Statement("Input", "bad", share, "of the messages are used; the recording is damaged, see below")
    text = f"of {messages} messages in {len(inputs)} topics are used"
    if spoilt:
        text += f"; many are refused of {', '.join(spoilt)}"
    if findings:
        text += f"; {counted(len(findings), 'finding')}, see below"
    else:
        text += "; nothing else was found"
    return Statement("Input", "attention" if spoilt or findings or not messages else "good", share, text)
