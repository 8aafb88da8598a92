"""Readings of the paper's model from the channels of a joint, with whatever sensors a sample has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jointest_ros.core.accel.array import JointArrays
from jointest_ros.core.accel.paper.model import PaperModel, PaperNoise, link_noise, link_reading
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import FloatArray

_LEAST_VARIANCE = 1e-8  # (m/s^2)^2, where somebody states that a sensor has no noise


class Reader:
    """Turns channels into readings; a sensor that is missing leaves its link to the others."""

    def __init__(self, arrays: JointArrays) -> None:
        self._places = arrays.parent.positions, arrays.child.positions
        self._all: NDArray[np.bool_] = np.ones(len(arrays.sensors), dtype=bool)
        self._variances: FloatArray | None = None
        self._models: dict[bytes, PaperModel | None] = {}
        self._whole: PaperModel | None = None

    def model(self, variances: FloatArray) -> PaperModel | None:
        """With all sensors; `variances` (C), (m/s^2)^2: the same object as long as nothing changes."""
        if variances is not self._variances:
            self._variances = variances
            self._models.clear()
            self._whole = self._model_of(self._all)
        return self._whole

    def read(self, channels: FloatArray, variances: FloatArray) -> tuple[list[float], PaperNoise] | None:
        """(reading, its noise); None where the sensors of a link are too few.

        Args:
            channels: (C) m/s^2; NaN: missing.
            variances: see `model`.
        """
        model = self.model(variances)
        if model is not None:
            reading = (model.reading @ channels).tolist()
            if reading[0] == reading[0]:  # anything that is missing makes all of it NaN
                return reading, model.noise
        present = np.asarray(np.isfinite(channels).reshape(-1, 2).all(axis=1))
        model = self._model_of(present)
        if model is None:
            return None
        reading = (model.reading @ np.where(np.repeat(present, 2), channels, 0.0)).tolist()
        return reading, model.noise

    def _model_of(self, present: NDArray[np.bool_]) -> PaperModel | None:
        key = present.tobytes()
        if key not in self._models:
            self._models[key] = self._make(present)
        return self._models[key]

    def _make(self, present: NDArray[np.bool_]) -> PaperModel | None:
        assert self._variances is not None
        variances = np.maximum(self._variances, _LEAST_VARIANCE)
        matrix = np.zeros((8, len(variances)))
        covariances, first = [], 0
        for row, places in zip((0, 4), self._places, strict=True):
            here = np.zeros(len(present), dtype=bool)
            here[first : first + len(places)] = True
            here &= present
            first += len(places)
            if here.sum() < 2:
                return None
            columns = np.repeat(here, 2)
            try:
                reading = link_reading(places[here[first - len(places) : first]])
            except ConfigurationError:  # what is left coincides
                return None
            matrix[row : row + 4, columns] = reading
            covariances.append(link_noise(reading, variances[columns]))
        return PaperModel(matrix, PaperNoise.of(*covariances))
