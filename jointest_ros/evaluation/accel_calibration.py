"""Fits matrix and offset of an accelerometer to still poses: Appendix IV of Woods & Vikas, and what it leaves open.

Model        a = S v + o in the sensor frame, v the mean reading of a pose, a = g u, u the direction that points up.
Full         linear least squares of the 12 unknowns (S, o): every row has the design matrix [v^T 1] (N, 4), so that
             four affinely independent poses are needed, not any four different ones: +x, -x, +y, -y will not do.
Planar       poses in one plane, such as all seven of the paper, have rank 9 of 12: what is fitted across the plane
             would be noise. Then the 2x2 block of S and the two offsets in that plane are fitted, the rest stays.
Norm         no known directions: |S v + o| = g with a symmetric S, 9 unknowns. A rotation of the sensor cannot be seen.
Rank         of the directions, not of the readings: noise alone makes a planar set of readings look like a full one.
Uncertainty  by the larger of the standard errors of the means and of the residuals: a fixture is no better than its
             angles, and with no pose to spare there are no residuals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from jointest_ros.core.errors import CalibrationError, counted
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.robot import STANDARD_GRAVITY, Sensor
from jointest_ros.evaluation.measures import rms_length

LEAST_EXTENT = 0.1  # singular value over sqrt(N): 0.58 for the six axes; below it, errors of a pose grow tenfold
LEAST_EXTENT_NORM = 0.05  # the same of |S v + o|, whose columns are products of directions
WORST_RESIDUAL = 0.1  # g, rms: six degrees of tilt; more is no sensor error but a wrong direction
WORST_CONDITION = 30.0  # of the readings: twice what the least extent of the directions allows
_UNKNOWNS_NORM = 9
_LEAST_GAIN = 0.5  # of an axis, as a share of the usual one: S = 0 makes all poses equally long as well
_NOTHING = 1e-6  # of the largest: digits of a rotation
_COLUMNS = ("S_{}x", "S_{}y", "S_{}z", "o_{}")


@dataclass(frozen=True)
class AccelFit:
    """A fitted accelerometer and how well it fits N poses, in the sensor frame.

    Attributes:
        model: "full", "planar" or "norm".
        matrix, offset: S (3, 3) and o (3,), m/s^2.
        matrix_std, offset_std: their standard deviations; NaN: not fitted, as configured.
        rank, unknowns: rank of the equations of the full model, of 12; of `norm` 9 of 9.
        condition: largest over smallest singular value of the equations that were solved.
        spare: equations less unknowns; with 0 the residuals are 0 and say nothing.
        undetermined: names of the unknowns that the poses do not tell.
        residual, before: (N, 3) m/s^2, S v + o less the true specific force, fitted and as configured: what the model
            can tell of it, in the plane or along the reading.
    """

    model: str
    matrix: FloatArray
    offset: FloatArray
    matrix_std: FloatArray
    offset_std: FloatArray
    rank: int
    unknowns: int
    condition: float
    spare: int
    undetermined: tuple[str, ...]
    residual: FloatArray
    before: FloatArray


def fit_directions(
    readings: FloatArray, errors: FloatArray, up: FloatArray, sensor: Sensor, gravity: float = STANDARD_GRAVITY
) -> AccelFit:
    """Fit to poses of known directions.

    Args:
        readings: (N, 3) mean readings, uncalibrated, in whatever unit.
        errors: (N, 3) their standard errors, same unit.
        up: (N, 3) unit vectors in the sensor frame that point up.
        sensor: what is not fitted is taken from its calibration.

    Raises:
        CalibrationError: too few poses, poses too much alike, or directions that do not fit the readings.
    """
    number = len(up)
    if not number:
        raise CalibrationError("in no pose an axis of the link points up; is the mounting right?")
    _, extents, right = np.linalg.svd(np.column_stack([up, np.ones(number)]) / math.sqrt(number))
    told = np.zeros(4, dtype=bool)
    told[: len(extents)] = extents > LEAST_EXTENT
    if told.all():
        fit = _full(readings, errors, up * gravity, sensor)
    else:
        untold = np.abs(right[~told]).max(axis=0) > 0.3
        names = tuple(_COLUMNS[k].format(row) for row in "xyz" for k in np.flatnonzero(untold))
        _, across, axes = np.linalg.svd(up / math.sqrt(number))
        if told.sum() < 3 or across[-1] > LEAST_EXTENT:
            raise CalibrationError(
                f"{number} pose{'' if number == 1 else 's'} of rank {3 * told.sum()} of 12; hold it still with each of "
                "+-x, +-y, +-z up, or for a joint of one axis at least with four directions across that axis"
            )
        fit = _planar(readings, errors, up * gravity, axes, sensor, names)
    left = rms_length(fit.residual) / gravity
    if left > WORST_RESIDUAL or fit.condition > WORST_CONDITION:
        why = f"residual {left:.2f} g" if left > WORST_RESIDUAL else "the readings differ less than the directions"
        raise CalibrationError(
            f"the poses do not fit: {why}; are the directions right and in this order, and is the mounting?"
        )
    return fit


def fit_norm(readings: FloatArray, errors: FloatArray, sensor: Sensor, gravity: float = STANDARD_GRAVITY) -> AccelFit:
    """Fit to N >= 9 poses of unknown directions; the other arguments as for `fit_directions`.

    Raises:
        CalibrationError: too few poses, poses too much alike, or no ellipsoid fits them.
    """
    number, size = len(readings), float(np.median(np.linalg.norm(readings, axis=1))) if len(readings) else 0.0
    if number < _UNKNOWNS_NORM or size == 0.0:
        raise CalibrationError(
            f"{counted(number, 'still pose')}; without known directions {_UNKNOWNS_NORM} are needed, as different "
            "as possible"
        )
    upper, v = np.triu_indices(3), readings / size

    def calibrated(p: FloatArray) -> FloatArray:
        return np.asarray(v @ _symmetric(p) + p[6:])

    def jacobian(p: FloatArray) -> FloatArray:
        a = calibrated(p)
        unit = a / np.linalg.norm(a, axis=1)[:, None]
        products = unit[:, :, None] * v[:, None, :]
        both = products + products.transpose(0, 2, 1)
        return np.column_stack([both[:, upper[0], upper[1]] * np.where(upper[0] == upper[1], 0.5, 1.0), unit])

    def residuals(p: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(calibrated(p), axis=1) - 1.0)

    start = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    extents = np.linalg.svd(jacobian(start), compute_uv=False) / math.sqrt(number)
    rank = int((extents > LEAST_EXTENT_NORM).sum())
    if rank < _UNKNOWNS_NORM:
        raise CalibrationError(
            f"{counted(number, 'pose')} of rank {rank} of {_UNKNOWNS_NORM}; without known directions poses between the "
            "axes are needed too: hold it still in many different ways"
        )
    p = least_squares(residuals, start, jac=jacobian, x_scale=1.0).x
    residual = _too_long(calibrated(p), 1.0)
    gains = np.linalg.eigvalsh(_symmetric(p))
    if rms_length(residual) > WORST_RESIDUAL or gains[0] < _LEAST_GAIN:
        raise CalibrationError("no matrix and offset make all poses equally long; did it stand still?")
    noise = _noise(errors / size, residual, number - _UNKNOWNS_NORM)
    std = noise * np.sqrt(np.diag(np.linalg.inv(jacobian(p).T @ jacobian(p))))
    return AccelFit(
        "norm",
        _symmetric(p) * gravity / size,
        p[6:] * gravity,
        _symmetric(std) * gravity / size,
        std[6:] * gravity,
        rank,
        _UNKNOWNS_NORM,
        float(extents[0] / extents[-1]),
        number - _UNKNOWNS_NORM,
        (),
        gravity * residual,
        _too_long(_calibrated(readings, sensor), gravity),
    )


def _full(readings: FloatArray, errors: FloatArray, true: FloatArray, sensor: Sensor) -> AccelFit:
    """y = pinv(V) A, row by row; readings in units of their own size, so that the columns are alike."""
    size = rms_length(readings)
    solution, std, condition, residual = _least_squares(readings / size, errors / size, true)
    return AccelFit(
        "full",
        solution[:, :3] / size,
        solution[:, 3],
        std[:, :3] / size,
        std[:, 3],
        12,
        12,
        condition,
        3 * len(readings) - 12,
        (),
        residual,
        _calibrated(readings, sensor) - true,
    )


def _planar(
    readings: FloatArray,
    errors: FloatArray,
    true: FloatArray,
    axes: FloatArray,
    sensor: Sensor,
    undetermined: tuple[str, ...],
) -> AccelFit:
    """In `axes` (3, 3), rows: two in the plane, one across."""
    size = rms_length(readings)
    matrix = axes @ np.array(sensor.accel_matrix) @ axes.T
    offset = axes @ np.array(sensor.accel_offset)
    v, a = readings @ axes.T, true @ axes.T
    in_plane = a[:, :2] - np.outer(v[:, 2], matrix[:2, 2])
    solution, std, condition, residual = _least_squares(v[:, :2] / size, errors / size, in_plane)
    matrix[:2, :2], offset[:2] = solution[:, :2] / size, solution[:, 2]
    variance = np.zeros((3, 3))
    variance[:2, :2] = (std[:, :2] / size) ** 2
    squares = axes**2
    matrix_std, offset_std = np.sqrt(squares.T @ variance @ squares), np.sqrt(squares.T[:, :2] @ std[:, 2] ** 2)
    return AccelFit(
        "planar",
        axes.T @ matrix @ axes,
        axes.T @ offset,
        np.where(matrix_std > _NOTHING * matrix_std.max(), matrix_std, np.nan),
        np.where(offset_std > _NOTHING * offset_std.max(), offset_std, np.nan),
        9,
        12,
        condition,
        2 * len(readings) - 6,
        undetermined,
        residual @ axes[:2],
        (_calibrated(readings, sensor) - true) @ axes[:2].T @ axes[:2],
    )


def _least_squares(
    v: FloatArray, errors: FloatArray, true: FloatArray
) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Solution (m, k + 1) of [v 1] y = true, its standard deviations, condition, and residual (N, m).

    `v` (N, k), of length about 1; `errors` (N, 3), its standard errors; `true` (N, m).
    """
    number, columns = len(v), v.shape[1] + 1
    design = np.column_stack([v, np.ones(number)])
    solution = np.linalg.lstsq(design, true, rcond=None)[0]
    residual = design @ solution - true
    gain = float(np.linalg.norm(true) / np.linalg.norm(v))
    noise = _noise(errors * gain, residual, true.shape[1] * (number - columns))
    std = noise * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    alike: FloatArray = np.tile(std, (true.shape[1], 1))
    return np.asarray(solution.T), alike, float(np.linalg.cond(design)), np.asarray(residual)


def _calibrated(readings: FloatArray, sensor: Sensor) -> FloatArray:
    """(N, 3) m/s^2, of uncalibrated readings."""
    return np.asarray(readings @ np.array(sensor.accel_matrix).T + np.array(sensor.accel_offset))


def _too_long(a: FloatArray, gravity: float) -> FloatArray:
    """By how much the vectors (N, 3) are longer than `gravity`, along each."""
    length = np.linalg.norm(a, axis=1)[:, None]
    return np.asarray(a * (1.0 - gravity / length))


def _noise(errors: FloatArray, residual: FloatArray, spare: int) -> float:
    """Standard deviation of a component of a mean reading."""
    scatter = float(np.sum(residual**2)) / spare if spare else 0.0
    return math.sqrt(max(float(np.mean(errors**2)), scatter))


def _symmetric(p: FloatArray) -> FloatArray:
    """(3, 3) of its upper triangle, the first six of `p`."""
    return np.array([[p[0], p[1], p[2]], [p[1], p[3], p[4]], [p[2], p[4], p[5]]])
