"""What a part of `jointest bench` takes and gives. The command line shows it and writes it."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from jointest_ros.core.errors import JointestError
from jointest_ros.core.params import Params, param
from jointest_ros.evaluation.jobs import Workers
from jointest_ros.reproduction.result import Report, ResultTable

# a part needs the latter two as well
__all__ = ["SCHEMA", "BenchError", "Options", "PartResult", "Report", "ResultTable", "Run", "document", "machine"]

SCHEMA = 1


class BenchError(JointestError):
    """A benchmark was asked for that there is not, or cannot be run here."""


@dataclass(frozen=True)
class Options(Params):
    """What can be chosen."""

    quick: bool = param(False, "short runs, for a first look: the figures scatter more")
    hours: float = param(2.0, "simulated time of soak", unit="h", low=0.01, high=1000.0)


@dataclass(frozen=True)
class PartResult:
    """What one part measured.

    Attributes:
        tables: figures at full precision; a column is a name with its unit (`step_us`), as it stands in the JSON.
        conditions: under which they were measured, and what the columns mean, a sentence each.
        failures: what must not be and was found, a line each. A budget that is missed is none.
    """

    tables: tuple[ResultTable, ...]
    conditions: tuple[str, ...]
    failures: tuple[str, ...] = ()

    def document(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "conditions": list(self.conditions),
            "failures": list(self.failures),
            "tables": [table.document() for table in self.tables],
        }


Run = Callable[[Options, Report], PartResult]  # report: (steps done, of how many)


def machine() -> dict[str, Any]:
    """What figures of time depend on."""
    return {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "cpus": Workers().processes,
        "platform": platform.platform(terse=True),
    }


def document(parts: dict[str, PartResult], options: Options) -> dict[str, Any]:
    """All that was measured, for JSON: a stable interface; numbers that are not finite are null."""
    figures = {name: result.document() for name, result in parts.items()}
    return {"schema": SCHEMA, "quick": options.quick, "machine": machine(), "parts": figures}
