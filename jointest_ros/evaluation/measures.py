"""Root mean squares, and the angle between vectors."""

from __future__ import annotations

import math

import numpy as np

from jointest_ros.core.frame import FloatArray


def rms(values: FloatArray) -> float:
    """Root mean square of all values, in their unit."""
    return float(np.sqrt(np.mean(values**2)))


def rms_length(vectors: FloatArray) -> float:
    """Root mean square length of vectors (N, 3), in their unit."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def rmse_deg(error: FloatArray, axis: int | tuple[int, ...]) -> FloatArray:
    """Root mean square of errors in rad over the axes `axis` of their array, in degrees."""
    return np.asarray(np.degrees(np.sqrt(np.mean(error**2, axis=axis))))


def angle_between(one: FloatArray, two: FloatArray) -> float:
    """Of two vectors (3,), rad, 0 to pi."""
    return math.atan2(float(np.linalg.norm(np.cross(one, two))), float(one @ two))
