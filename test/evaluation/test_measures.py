"""Root mean squares, and the angle between vectors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jointest_ros.core.rotation import about, rotate
from jointest_ros.evaluation.measures import angle_between, rms, rms_length, rmse_deg


def test_root_mean_squares() -> None:
    values = np.array([[3.0, 0.0, 4.0], [0.0, 0.0, 5.0]])
    assert rms(values) == pytest.approx(5.0 / math.sqrt(3.0))
    assert rms_length(values) == pytest.approx(5.0)


def test_errors_along_some_axes_in_degrees() -> None:
    error = np.radians([[[3.0], [4.0]], [[-3.0], [4.0]]])
    np.testing.assert_allclose(rmse_deg(error, axis=0), [[3.0], [4.0]])
    np.testing.assert_allclose(rmse_deg(error, axis=(0, 1)), [math.sqrt(12.5)])


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1.0, 0.5 * math.pi, 3.0, math.pi])
def test_the_angle_between_vectors_of_any_length(angle: float) -> None:
    """To the rounding of the angle itself, where an arccosine of the cosine would give 0."""
    turned = rotate(about((0.6, 0.0, 0.8), angle), (0.0, 1.0, 0.0))
    assert angle_between(np.array([0.0, 0.1, 0.0]), 20.0 * np.array(turned)) == pytest.approx(angle, abs=1e-15)
