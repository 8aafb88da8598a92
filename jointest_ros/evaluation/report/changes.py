"""What changed since an earlier evaluation: the JSON of then beside that of now."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from jointest_ros.core.errors import JointestError
from jointest_ros.evaluation.report.content import SCHEMA
from jointest_ros.evaluation.report.kinds import KINDS, rows_of

TOLERANCE = 1.0  # percent of the old rmse: an evaluation repeats itself but for the last digits
SMALLEST_DEG = 0.001  # a smaller difference is none, whatever its percentage
COVERAGE = 0.01  # share of the truth samples: fewer matched ones make another figure of the error


class ChangesError(JointestError):
    """An earlier evaluation cannot be compared with."""


@dataclass(frozen=True)
class Change:
    """One rms error then and now, deg or deg/s; None: there is none.

    Attributes:
        kind: joints, velocities, torso, inclination or heading.
        part: joint, component or sensor.
        verdict: "worse", "better", "new", "gone", "worse: fewer matched", or "" when it is the same.
    """

    estimator: str
    kind: str
    part: str
    old: float | None
    new: float | None
    verdict: str

    @property
    def percent(self) -> float | None:
        """Difference in percent of the old one; None where there is no such figure."""
        return 100.0 * (self.new - self.old) / self.old if self.old and self.new is not None else None

    def difference(self) -> str:
        """As text."""
        if self.old is None or self.new is None:
            return "-"
        percent = "" if self.percent is None else f" ({self.percent:+.1f} %)"
        return f"{self.new - self.old:+.3f}{percent}"


@dataclass(frozen=True)
class Changes:
    """All changes of one recording.

    Attributes:
        source: the file of the earlier evaluation.
        tolerance: percent.
        notes: other settings, versions, recording: one line each.
    """

    source: str
    tolerance: float
    rows: tuple[Change, ...]
    notes: tuple[str, ...]

    @property
    def known(self) -> list[Change]:
        """What was evaluated then."""
        return [row for row in self.rows if row.old is not None]

    @property
    def worse(self) -> list[Change]:
        """What is worse than it was; what is gone of an estimator that was evaluated counts as well."""
        return [row for row in self.rows if row.verdict.startswith("worse") or row.verdict == "gone"]


def read(path: Path) -> list[dict[str, Any]]:
    """The documents of an earlier `evaluate --json`, or of the figures.json of a report.

    Raises:
        ChangesError: the file cannot be read or is something else.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"), parse_constant=_no_number)
    except OSError as error:
        raise ChangesError(f"--against: {path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise ChangesError(f"--against: {path}: not a JSON file; give what evaluate --json wrote") from None
    documents = found if isinstance(found, list) else [found]
    for document in documents:
        if not isinstance(document, dict) or document.get("schema") != SCHEMA:
            raise ChangesError(f"--against: {path}: not a JSON of evaluate with schema {SCHEMA}")
        try:
            for figures in document["estimators"].values():
                for _, one in _errors(figures):
                    0.0 + one["coverage"] + (one["rmse_deg"] or 0.0)
            PurePath(document["bag"])
            0.0 + document["duration_s"]
            for key in ("settings", "versions"):
                document.get(key, {}).items()
        except (KeyError, TypeError, AttributeError):
            raise ChangesError(f"--against: {path}: damaged: figures of evaluate --json are missing in it") from None
    return documents


def _no_number(text: str) -> float:
    """NaN and infinities are no JSON, and would make a comparison say that nothing changed."""
    raise ValueError(text)


def earlier(documents: Sequence[dict[str, Any]], bag: str, *, only: bool) -> dict[str, Any] | None:
    """The earlier evaluation of a recording: of the same path, else of the same name; None where there is none.

    `only`: it is the only recording now, so the only earlier one is meant, whatever its name.
    """
    for same in (lambda one: one == bag, lambda one: PurePath(one).name == PurePath(bag).name):
        found = [document for document in documents if same(document["bag"])]
        if len(found) == 1:
            return found[0]
    return documents[0] if only and len(documents) == 1 else None


def compare(old: Mapping[str, Any], new: Mapping[str, Any], source: str, tolerance: float = TOLERANCE) -> Changes:
    """What changed between two documents. Estimators that are not evaluated now are only noted."""
    rows = []
    for name, figures in new["estimators"].items():
        now = dict(_errors(figures))
        then = dict(_errors(old["estimators"][name])) if name in old["estimators"] else {}
        for key in dict.fromkeys([*then, *now]):
            before, after = then.get(key), now.get(key)
            old_rmse, new_rmse = (one["rmse_deg"] if one else None for one in (before, after))
            if old_rmse is None and new_rmse is None:
                continue
            rows.append(Change(name, *key, old_rmse, new_rmse, _verdict(before, after, tolerance)))
    return Changes(source, tolerance, tuple(rows), tuple(_notes(old, new)))


def _verdict(old: Mapping[str, Any] | None, new: Mapping[str, Any] | None, tolerance: float) -> str:
    if old is None or old["rmse_deg"] is None:
        return "new"
    if new is None or new["rmse_deg"] is None:
        return "gone"
    difference = new["rmse_deg"] - old["rmse_deg"]
    if abs(difference) > max(SMALLEST_DEG, 0.01 * tolerance * old["rmse_deg"]):
        return "worse" if difference > 0.0 else "better"
    return "worse: fewer matched" if new["coverage"] < old["coverage"] - COVERAGE else ""


def _errors(figures: Mapping[str, Any]) -> Iterator[tuple[tuple[str, str], Mapping[str, Any]]]:
    """((kind, part), figures) of all errors of one estimator. Raises KeyError, TypeError where they are none."""
    for kind in KINDS:
        for part, one in rows_of(figures, kind).items():
            one["rmse_deg"], one["coverage"]
            yield (kind, part), one


def _notes(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    if old["bag"] != new["bag"]:
        yield f"recording: {old['bag']} -> {new['bag']}"
    if abs(old["duration_s"] - new["duration_s"]) > 1e-3:
        yield f"duration: {old['duration_s']:.3f} s -> {new['duration_s']:.3f} s"
    if gone := [name for name in old["estimators"] if name not in new["estimators"]]:
        yield f"not evaluated now: {', '.join(gone)}"
    for key in ("settings", "versions"):
        if key not in old:
            yield f"{key}: the earlier evaluation does not tell"
            continue
        then, now = dict(_flat(old[key])), dict(_flat(new[key]))
        for name in dict.fromkeys([*then, *now]):
            if then.get(name) != now.get(name):
                yield f"{name}: {then.get(name, 'absent')} -> {now.get(name, 'absent')}"


def _flat(values: Any, before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value
