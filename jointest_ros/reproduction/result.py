"""What a reproduction of a paper's table or figure takes and gives. The command line prints and writes it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from jointest_ros.core.errors import JointestError
from jointest_ros.core.params import Params, param
from jointest_ros.evaluation.jobs import HERE, Workers

if TYPE_CHECKING:  # takes a third of a second, and every command reads this file
    from matplotlib.figure import Figure

Report = Callable[[int, int], None]  # (steps done, of how many)
Cell = str | float | int | None
SHORTEST_S = 10.0


class ReproductionError(JointestError):
    """A reproduction was asked for that there is not, or with what it cannot use."""


@dataclass(frozen=True)
class Options(Params):
    """What can be chosen; `Reproduction.uses` tells which of them count.

    Raises:
        ConfigurationError: a value that is not allowed.
    """

    seed: int = param(0, "of every random number: the same seed gives the same figures", low=0)
    runs: int = param(0, "number of simulated trials; 0: each reproduction's own", low=0, high=100000)
    duration_s: float = param(
        0.0, "length of a simulated trial; 0: each reproduction's own", unit="s", low=0.0, high=86400.0
    )
    data: str = param("", "file of a fixed trial (.npz) in place of the simulated ones")

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0.0 < self.duration_s < SHORTEST_S:
            raise ReproductionError(
                f"duration_s: {self.duration_s:g} is not allowed; give {SHORTEST_S:g} s or more, or 0 for the default"
            )


@dataclass(frozen=True)
class ResultTable:
    """Figures at full precision, with the format in which a terminal shows its numbers."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[Cell, ...]]
    number_format: str = ".2f"

    def text(self, cell: Cell) -> str:
        """One cell as a terminal shows it."""
        if not isinstance(cell, float):
            return "" if cell is None else str(cell)
        text = format(cell, self.number_format)
        return text.removeprefix("-") if not float(text) else text

    def document(self) -> dict[str, Any]:
        """For JSON: each row by column; numbers that are not finite are null."""
        rows = [
            {
                column: None if isinstance(cell, float) and not math.isfinite(cell) else cell
                for column, cell in zip(self.columns, row, strict=True)
            }
            for row in self.rows
        ]
        return {"title": self.title, "rows": rows}


@dataclass(frozen=True)
class Result:
    """One reproduction.

    Attributes:
        conditions: under which the figures were computed, a sentence each.
        remarks: how to read them beside the paper's.
        draw: draws the plot into an empty figure of `size` inches.
    """

    conditions: tuple[str, ...]
    tables: tuple[ResultTable, ...]
    draw: Callable[[Figure], None]
    remarks: tuple[str, ...] = ()
    size: tuple[float, float] = (9.0, 5.0)

    def document(self) -> dict[str, Any]:
        """For JSON."""
        tables = [table.document() for table in self.tables]
        return {"conditions": list(self.conditions), "remarks": list(self.remarks), "tables": tables}


class Compute(Protocol):
    """`Reproduction.run`."""

    def __call__(self, report: Report, options: Options, workers: Workers = HERE) -> Result: ...


@dataclass(frozen=True)
class Reproduction:
    """One entry of the catalogue.

    Attributes:
        name: as the user gives it: method, then table or figure.
        description: one line.
        run: computes it; reports its progress. Its trials run on the workers that it is given, or here.
        uses: the fields of `Options` that have a meaning for it.
    """

    name: str
    description: str
    run: Compute
    uses: tuple[str, ...] = ()
