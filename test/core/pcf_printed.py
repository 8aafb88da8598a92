"""Algorithms 1 and 2 of Santaera et al. 2015 with 3x3 matrices, step by step as printed, for tests only.

`Printed` names the places where the paper is wrong (section 1 of the specification): each can be taken as printed, all
others are right. With none of them this is an implementation of its own to hold the production code against.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointest_ros.core.frame import FloatArray

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Printed:
    """What is taken as printed."""

    reference: bool = False  # (2): a = R^T g0, gravity points down
    integral: bool = False  # step 8: Ki / dt
    error: bool = False  # (19): a1 x R12^T a2
    rate: bool = False  # (18): W2 - W1
    euler: bool = False  # step 11: R + R w dt
    projection: bool = False  # (15): eigenvectors


def skew(v: FloatArray) -> FloatArray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rotation_matrix(v: FloatArray) -> FloatArray:
    """exp([v]x) by Rodrigues' formula."""
    angle = float(np.linalg.norm(v))
    if angle == 0.0:
        return np.eye(3)
    k = skew(v / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k)


def project(matrix: FloatArray, eigenvectors: bool = False) -> FloatArray:
    """The rotation nearest to `matrix`, (15), from its singular vectors or from its eigenvectors as the text says."""
    if eigenvectors:
        u, v = np.linalg.eigh(matrix @ matrix.T)[1], np.linalg.eigh(matrix.T @ matrix)[1]
    else:
        u, _, vt = np.linalg.svd(matrix)
        v = vt.T
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ v.T)]) @ v.T)


def unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v))


class PrintedFilter:
    """Algorithm 2; with B1 = {world}, W1 = 0 and a1 = `reference` it is Algorithm 1."""

    def __init__(self, rotation: FloatArray, kp: float, ki: float, printed: Printed | None = None) -> None:
        self.rotation = rotation
        self.integral = np.zeros(3)
        self.kp, self.ki = kp, ki
        self.printed = printed or Printed()

    @property
    def reference(self) -> FloatArray:
        """v_a*, the gravity vector in the world."""
        return -UP if self.printed.reference else UP

    def step(self, dt: float, w1: FloatArray, w2: FloatArray, a1: FloatArray, a2: FloatArray) -> None:
        printed, r = self.printed, self.rotation
        a1, a2 = unit(a1), unit(a2)
        error = np.cross(a1, r.T @ a2) if printed.error else np.cross(a2, r.T @ a1)
        self.integral = self.integral + self.ki * (1.0 / dt if printed.integral else dt) * error
        rate = w2 - (w1 if printed.rate else r.T @ w1) + self.kp * error + self.integral
        if printed.euler:
            self.rotation = project(r + r @ skew(rate) * dt, printed.projection)
        else:
            self.rotation = r @ rotation_matrix(rate * dt)

    def step_single(self, dt: float, gyro: FloatArray, accel: FloatArray) -> None:
        self.step(dt, np.zeros(3), gyro, self.reference, accel)


def twist(matrix: FloatArray, axis: FloatArray) -> float:
    """Component of the rotation vector about `axis`, rad."""
    vector = 0.5 * np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    sine, cosine = float(np.linalg.norm(vector)), 0.5 * (np.trace(matrix) - 1.0)
    return 0.0 if sine == 0.0 else float(np.arctan2(sine, cosine) / sine * (vector @ axis))


def roll(matrix: FloatArray) -> float:
    """psi of (22), (24) with atan2."""
    return float(np.arctan2(matrix[2, 1], matrix[2, 2]))
