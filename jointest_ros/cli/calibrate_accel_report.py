"""What `jointest calibrate accel` says of its fits: warnings, tables, and the comment of the calibration file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike
from rich.table import Table

from jointest_ros.cli.tables import columns
from jointest_ros.core.errors import counted
from jointest_ros.evaluation.accel_calibration import AccelFit
from jointest_ros.evaluation.accel_plot import FittedAccel
from jointest_ros.evaluation.measures import rms_length

_LARGE_RESIDUAL = 0.02  # g
_FAR_FROM_UNITY = 0.15  # of a matrix


def advice(fitted: Sequence[FittedAccel], gravity: float) -> Iterator[str]:
    """What makes a fit doubtful, one line each."""
    for names, fit in _by_untold(fitted):
        yield (
            f"{names}: the poses lie in one plane (rank {fit.rank} of {fit.unknowns}; not told: "
            f"{', '.join(fit.undetermined)}); fitted is that plane, the rest stays as configured"
        )
    for one in fitted:
        left = rms_length(one.fit.residual)
        if left > _LARGE_RESIDUAL * gravity:
            yield f"{one.name}: the poses leave {1e3 * left / gravity:.0f} mg; were they aligned, and still?"
        if not one.fit.spare:
            yield f"{one.name}: no pose to spare, so that the residuals say nothing; record more of them"
        off = float(np.abs(one.fit.matrix - np.eye(3)).max())
        if off > _FAR_FROM_UNITY:
            yield (
                f"{one.name}: the matrix is far from unity (by {off:.2g}); if not for other units, is the mounting "
                "wrong, or the order of the poses?"
            )


def _by_untold(fitted: Sequence[FittedAccel]) -> Iterator[tuple[str, AccelFit]]:
    """The sensors whose poses do not tell everything, together where that is the same."""
    for undetermined in dict.fromkeys(one.fit.undetermined for one in fitted if one.fit.undetermined):
        same = [one for one in fitted if one.fit.undetermined == undetermined]
        yield ", ".join(one.name for one in same), same[0].fit


def heading(command: str, when: str, fitted: Sequence[FittedAccel], gravity: float) -> str:
    """The comment of the file: what it is, from where, and how well it fits."""
    lines = [
        f"Accelerometers by: {command}",
        f"Recording: {when}; gravity {gravity:g} m/s^2.",
        "Acceleration = matrix reading + offset, sensor frame, m/s^2. What the poses leave, rms:",
    ]
    for one in fitted:
        fit = one.fit
        before, after = (_mg(rms_length(residual), gravity) for residual in (fit.before, fit.residual))
        directions = "" if fit.model == "norm" else f": {','.join(one.poses)}"
        lines += [
            f"  {one.name}: {before} mg before, {after} mg after; {fit.model}, rank {fit.rank} of {fit.unknowns}",
            f"    {counted(len(one.poses), 'pose')}{directions}",
        ]
        if fit.undetermined:
            untold = ", ".join(fit.undetermined)
            lines.append(f"    not told by them, and as it was, with all else across their plane: {untold}")
    return "\n".join(lines)


def quality_table(fitted: Sequence[FittedAccel], gravity: float) -> Table:
    """How well the poses tell, and what they leave."""
    headings = ("poses\n", "rank\n", "condition\n", "before\nmg", "after\nmg", "worst pose\nmg")
    table = columns("calibrated accelerometers", ["sensor", "model"], headings)
    for one in fitted:
        fit = one.fit
        lengths = np.linalg.norm(fit.residual, axis=1)
        worst = int(np.argmax(lengths))
        table.add_row(
            one.name,
            fit.model,
            str(len(one.poses)),
            f"{fit.rank} of {fit.unknowns}",
            f"{fit.condition:.1f}",
            _mg(rms_length(fit.before), gravity),
            _mg(rms_length(fit.residual), gravity),
            f"{_mg(lengths[worst], gravity)} ({one.poses[worst]})",
        )
    return table


def parameter_table(fitted: Sequence[FittedAccel], gravity: float) -> Table:
    """Matrix and offset by rows, with the largest standard deviation of each row."""
    headings = ("matrix\nx", "\ny", "\nz", "\n±", "offset\nmg", "\n±")
    table = columns("acceleration = matrix reading + offset", ["sensor", ""], headings)
    for one in fitted:
        fit = one.fit
        for row, axis in enumerate("xyz"):
            cells = [f"{value:.5f}" for value in fit.matrix[row]]
            cells += [_std(fit.matrix_std[row], 5), _mg(fit.offset[row], gravity)]
            cells.append(_std(1e3 / gravity * fit.offset_std[row], 2))
            table.add_row("" if row else one.name, axis, *cells)
    return table


def _std(std: ArrayLike, digits: int) -> str:
    """The largest of those that were fitted."""
    known = [value for value in np.ravel(std).tolist() if math.isfinite(value)]
    return f"{max(known):.{digits}f}" if known else "kept"


def _mg(acceleration: float, gravity: float) -> str:
    return f"{1e3 * acceleration / gravity:.2f}"
