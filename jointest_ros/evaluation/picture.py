"""Pictures as files: written with one clear error, and the grid that the calibrations draw into."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from jointest_ros.core.errors import JointestError

_COLUMNS = 4
_WIDTH = 4.2  # inches, of a column

Draw = Callable[[Any], None]  # into axes


class PlotError(JointestError):
    """A picture cannot be made; the text says why."""


def save(figure: Any, path: Path) -> None:
    """Write a figure; the suffix of `path` says which format. Raises PlotError when it cannot be written."""
    try:
        figure.savefig(path)
    except OSError as error:
        raise PlotError(f"{path}: cannot be written: {error.strerror}") from None


def save_pairs(
    path: Path, title: str, pairs: Sequence[tuple[Draw, Draw]], height: float, ratios: tuple[int, int] = (3, 2)
) -> None:
    """Write a picture of two plots, one above the other, for each of several things side by side.

    Args:
        height: of a pair, inches; `ratios`: of its two plots.

    Raises:
        PlotError: it cannot be written.
    """
    from matplotlib.figure import Figure  # takes longer to load than many a command to run

    columns = min(_COLUMNS, len(pairs))
    rows = math.ceil(len(pairs) / columns)
    figure = Figure(figsize=(_WIDTH * columns, height * rows), dpi=100, layout="constrained")
    figure.suptitle(title)
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=ratios * rows)
    for number, pair in enumerate(pairs):
        row, column = divmod(number, columns)
        for below, draw in enumerate(pair):
            draw(figure.add_subplot(grid[2 * row + below, column]))
    save(figure, path)
