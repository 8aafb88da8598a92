"""Closed-form derivatives against finite differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jointest_ros.core.frame import FloatArray
from jointest_ros.sim.motion import LinkMotion, Signal, raised_cosine, sine, smoothstep

STEP = 1e-3
FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])  # 8th order
SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])


def difference(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted sums over nine neighbouring rows; four rows are lost at either end."""
    return sum(w * values[i : len(values) - 8 + i] for i, w in enumerate(weights))


SIGNALS = {
    "smoothstep": lambda t: smoothstep(t, 2.0),
    "sine": lambda t: sine(t, 1.7),
    "raised cosine": lambda t: raised_cosine(t, 0.9),
    "product": lambda t: smoothstep(t, 2.0) * sine(t, 1.7) * 0.3,
}


@pytest.mark.parametrize("make", SIGNALS.values(), ids=SIGNALS)
def test_derivatives_of_signals(make: Callable[[FloatArray], Signal]) -> None:
    for start, end in ((-1.0, -0.01), (0.01, 1.99), (2.01, 4.0)):  # between the jumps of the smoothstep's acceleration
        signal = make(np.arange(start, end, STEP))
        np.testing.assert_allclose(signal.rate[4:-4], difference(signal.value, FIRST) / STEP, atol=1e-10)
        np.testing.assert_allclose(signal.acceleration[4:-4], difference(signal.value, SECOND) / STEP**2, atol=1e-7)


def test_smoothstep_ends() -> None:
    ends = smoothstep(np.array([-1.0, 0.0, 1.0, 2.0, 9.0]), 2.0)
    assert ends.value.tolist() == [0.0, 0.0, 0.5, 1.0, 1.0]
    assert ends.rate.tolist() == [0.0, 0.0, 0.75, 0.0, 0.0]


def test_two_revolutes_about_different_axes() -> None:
    """Positions of a point on the last link, differentiated, give what the recursion gives in closed form."""
    time = np.arange(0.0, 1.0, STEP)
    first, second = sine(time, 1.1) * 0.8, raised_cosine(time, 1.7) * 1.3
    base = LinkMotion.translating(np.zeros((len(time), 3)))
    middle = base.child((0.0, 0.0, 1.0), first)
    end = middle.child((0.6, 0.8, 0.0), second, position=(0.3, -0.1, 0.2))
    point = (0.05, 0.4, -0.2)

    turn_1 = Rotation.from_rotvec(first.value[:, None] * [0.0, 0.0, 1.0])
    turn_2 = Rotation.from_rotvec(second.value[:, None] * [0.6, 0.8, 0.0])
    position = turn_1.apply(np.array([0.3, -0.1, 0.2]) + turn_2.apply(point))
    world = end.orientation.apply(end.acceleration_at(point))
    np.testing.assert_allclose(world[4:-4], difference(position, SECOND) / STEP**2, atol=1e-7)

    matrices = end.orientation.as_matrix()
    skew = np.swapaxes(matrices[4:-4], 1, 2) @ (difference(matrices, FIRST) / STEP)
    np.testing.assert_allclose(end.rate[4:-4], skew[:, [2, 0, 1], [1, 2, 0]], atol=1e-10)
    np.testing.assert_allclose(end.rate_derivative[4:-4], difference(end.rate, FIRST) / STEP, atol=1e-9)
