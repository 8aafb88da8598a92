"""Collects estimates as arrays that grow in place: memory is needed once, not again when parts are joined."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.frame import FloatArray, Series

_TABLES = ("position", "velocity", "variance", "status", "torso", "torso_orientation")


class SeriesBuffer:
    """Consecutive stretches of the estimates of one estimator, equal to `Series.concatenate` of them."""

    def __init__(self, joints: int) -> None:
        self._nothing = Series.from_estimates([], joints)
        self._stamps: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._tables: dict[str, NDArray[Any] | None] = {}  # None: a stretch did not have it
        self._orientation: dict[str, FloatArray] = {}

    def add(self, part: Series) -> None:
        """Take the next stretch."""
        before = len(self._stamps)
        _extend(self._stamps, part.stamps)
        for name in _TABLES:
            table = getattr(part, name)
            column = self._tables.setdefault(name, None if table is None else np.empty_like(table[:0]))
            if column is not None and table is not None:
                _extend(column, table)
            else:
                self._tables[name] = None
        for sensor in part.orientation.keys() - self._orientation.keys():
            self._orientation[sensor] = np.full((before, 4), np.nan)
        for sensor, rows in self._orientation.items():
            _extend(rows, part.orientation.get(sensor, np.full((len(part), 4), np.nan)))

    def series(self) -> Series:
        """All of it, in the arrays that `add` extends: when these are in use, nothing must be added any more."""
        if not self._tables:
            return self._nothing
        return Series(self._stamps, orientation=self._orientation, **self._tables)  # type: ignore[arg-type]


def _extend(column: NDArray[Any], rows: NDArray[Any]) -> None:
    """Append rows in place. A large block is moved by its address, not copied."""
    before = len(column)
    column.resize((before + len(rows), *column.shape[1:]), refcheck=False)
    column[before:] = rows
