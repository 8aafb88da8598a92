"""What one recording gave: all that tables, pictures and the report show of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from jointest_ros.core.frame import Recording, Series
from jointest_ros.core.torso import TorsoChain
from jointest_ros.evaluation.report.consistency import Innovations
from jointest_ros.evaluation.truth import Truth

SCHEMA = 1  # of the JSON


@dataclass(frozen=True)
class Evaluation:
    """What one recording gave.

    Attributes:
        document: what `jointest evaluate --json` writes.
        damage: why the recording could not be read to its end, or "".
        warnings: what a user should know, one line each.
        series: estimates by estimator.
        joints: columns of the series by estimator.
        chains: those estimators that give a torso -> its chain.
        truth: what they are compared with.
        skip_s, continuous: as in `metrics.errors`.
        headings: peer -> how its heading was taken.
        innovations: normalised innovations by estimator, where asked for and given.
        recording: the frames, where asked for.
        saturated: accelerometer (by sensor) or gyro (`gyro_of` it) of known full scale -> number of saturated samples.
    """

    document: dict[str, Any]
    damage: str
    warnings: list[str]
    series: dict[str, Series]
    joints: dict[str, tuple[str, ...]]
    chains: dict[str, TorsoChain]
    truth: Truth
    skip_s: float
    continuous: frozenset[str] = frozenset()
    headings: dict[str, str] = field(default_factory=dict)
    innovations: dict[str, Innovations] = field(default_factory=dict)
    recording: Recording | None = None
    saturated: dict[str, int] = field(default_factory=dict)

    @property
    def zero(self) -> int:
        """Stamp of the first truth sample, ns: time 0 of all plots."""
        firsts = [stamps[0] for stamps, _ in self.truth.orientation.values() if len(stamps)]
        return int(self.truth.stamps[0] if len(self.truth.stamps) else min(firsts, default=0))


@dataclass(frozen=True)
class Origin:
    """How a report came about, the same for all recordings of one call.

    Attributes:
        command: the command line.
        date: when, as text.
        files: (name, text) of the configuration, and of the calibration file where there is one.
    """

    command: str
    date: str
    files: tuple[tuple[str, str], ...]
