"""The KCKF of a chain whose coordinates share noise or states, with numpy.

The constraint phi = sum theta_i holds exactly when phi and its bias are left out and the noise of the joints is
correlated (see process_noise.py): this filter *is* the paper's 6n+6 filter, in 2n states for each axis.

State        x = [angle (m), bias (d), offset (h or 0)]: rad; rad/s; V, slow error of each Hall sensor.
             bias: d = m differences along the axes, or d = 3 g biases of the g gyros (see chain_motion.py).
Input        rate (m), rad/s.
Process      angle+ = angle + (rate - C bias) dt; C = 1, or the rows of the gyros; noise: see process_noise.py.
Measurement  volts: V = V(angle) + offset + noise; or angles: theta_h(V) = angle + noise of constant variance, (20).
             All readings of a frame in one update by the Cholesky factor L of the innovation covariance: with
             Y = L^-1 H P the correction is P -= Y^T Y, which keeps P symmetric in float32 and float64 alike.

While interval and readings stay the same, a filter of angles converges; then its gain is kept and only x is computed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, get_blas_funcs, get_lapack_funcs

from jointest_ros.core.frame import FloatArray
from jointest_ros.core.kckf.coordinate import LOOK_BACK, UNKNOWN
from jointest_ros.core.kckf.hall_bank import HallBank
from jointest_ros.core.kckf.hinge_filter import ITERATE_ABOVE, ITERATIONS, SETTLED
from jointest_ros.core.kckf.process_noise import ProcessNoise, increments

_CHECK_EVERY = 64  # steps between two looks whether the covariance has settled
_CONVERGED = 1e-13  # relative change of the covariance in one step


class CoupledFilter:
    """The filter of the module text, of one run or, with `x` of shape (runs, n), of many that share readings in time.

    Attributes:
        x: (..., n) state.
        covariance: (n, n) of it.
        m, d: numbers of angles and biases.

    Args:
        hall: sensors in the order of the readings.
        coordinate: (h,) index of the angle that each measures.
        start: standard deviations of angle, bias and offset (rad, rad/s, V).
        noise: of the m angles and biases.
        hall_sigma: constant standard deviation of a Hall angle, rad; 0: measure in volts.
        offset_walk: random walk of an offset, V/sqrt(s); None: no offset states.
    """

    def __init__(
        self,
        hall: HallBank,
        coordinate: NDArray[np.int64],
        noise: ProcessNoise,
        start: tuple[float, float, float],
        hall_sigma: float = 0.0,
        offset_walk: float | None = None,
        dtype: type = np.float64,
    ) -> None:
        self.hall, self._coordinate, self.noise, self._start, self._dtype = hall, coordinate, noise, start, dtype
        self.m = len(noise.white)
        self.d = self._biases()
        self._volts = not hall_sigma
        self._settles = not self._volts  # nothing in the covariance depends on the state
        variance = hall.variance if self._volts else np.full(len(coordinate), hall_sigma**2)
        self._hall_noise: FloatArray = np.diag(variance).astype(dtype)
        self._offset_walk = offset_walk
        (self._potrf,) = get_lapack_funcs(("potrf",), dtype=dtype)
        (self._trsm,) = get_blas_funcs(("trsm",), dtype=dtype)  # LAPACK's trtrs wakes all threads for any size
        self._interval = 0.0
        self.reset()

    # ------------------------------------------------------------- start

    def reset(self) -> None:
        """Forget everything."""
        angle, bias, offset = self._start
        offsets = len(self._coordinate) if self._offset_walk is not None else 0
        m, d = self.m, self.d
        self.x: FloatArray = np.zeros(m + d + offsets, dtype=self._dtype)
        self.covariance: FloatArray = np.zeros((len(self.x), len(self.x)), dtype=self._dtype)
        self.covariance[:m, :m] = angle**2 * self.noise.angle_prior
        self.covariance[m : m + d, m : m + d] = bias**2 * self._bias_prior()
        self.covariance[m + d :, m + d :] = offset**2 * np.eye(offsets)
        self._steep = True  # the curve may bend within the prior: readings are taken by Gauss and Newton's iteration
        self._remember()
        self._unsettle()

    def _biases(self) -> int:
        return self.m

    def _bias_prior(self) -> FloatArray:
        return self.noise.bias_prior

    def drift(self, bias: float, offset: float) -> FloatArray:
        """Covariance (k, k) of what biases and offsets change by when each gyro's changes by `bias` rad/s (1 sigma)."""
        offsets = len(self.x) - self.m - self.d
        return block_diag(2.0 * bias**2 * self._bias_prior(), offset**2 * np.eye(offsets))

    def restart(self) -> None:
        """Start the angles afresh; what was known of biases and offsets shortly before is kept."""
        self.look_back()
        m = self.m
        self.x[..., :m] = 0.0
        self.covariance[:m] = 0.0
        self.covariance[:, :m] = 0.0
        self.covariance[:m, :m] = self._start[0] ** 2 * self.noise.angle_prior
        self._steep = True
        self._unsettle()

    def _unsettle(self) -> None:
        self._key: tuple[float, bytes] = (0.0, b"")
        self._steps = 0  # with this interval and these readings
        self._settled: tuple[FloatArray, FloatArray] | None = None  # gain and whitening of the innovation
        self._whitened: FloatArray = np.empty((0, 1))
        self._used: NDArray[np.bool_] = np.zeros(len(self._coordinate), dtype=bool)

    def start_from(self, values: FloatArray, covariance: FloatArray) -> None:
        """Before the first step: prior (k), (k, k) of biases and offsets, in the units of the state."""
        m = self.m
        self.x[m:] = values
        self.covariance[m:, m:] = covariance
        self._remember()
        self._unsettle()

    def _remember(self) -> None:
        """What is known of biases and offsets is all that was known of late."""
        self._earlier = (self._slow_states(),) * 2  # two looks back, see `Coordinate`
        self._age = 0.0  # s since the newer one

    def _slow_states(self) -> tuple[FloatArray, FloatArray]:
        m = self.m
        return self.x[..., m:].copy(), self.covariance[m:, m:].copy()

    def look(self, dt: float) -> None:
        """Remember biases and offsets now and then; before a step of `dt` s with all gyros."""
        self._age += dt
        if self._age >= LOOK_BACK:
            self._earlier, self._age = (self._earlier[1], self._slow_states()), 0.0

    def look_back(self) -> None:
        """What was learned of biases and offsets of late is doubtful: take what was known before."""
        m = self.m
        self.x[..., m:], self.covariance[m:, m:] = self._earlier[0]
        self.covariance[:m, m:] = 0.0
        self.covariance[m:, :m] = 0.0
        self._unsettle()

    def spread(self, angle: int, variance: float) -> None:
        """An angle is less sure by so much, rad^2."""
        before = self.covariance[angle, angle]
        self.covariance[angle, angle] = max(before, min(before + variance, UNKNOWN))
        self._steep = True
        self._unsettle()

    # ------------------------------------------------------------- step

    def step(
        self,
        dt: float,
        rates: FloatArray,
        readings: FloatArray,
        used: NDArray[np.bool_],
        spread: FloatArray | None = None,
    ) -> None:
        """Predict over `dt` s (0: not at all), then correct.

        `rates`: (..., m) rad/s. `readings`: (..., h) V, or rad where Hall angles are measured; only `used` ones count.
        `spread`: (m,) rad^2, added variance of angles that were not measured.
        """
        before = None
        if self._settles:
            key = (dt, used.tobytes())
            if key != self._key or spread is not None:
                self._unsettle()
                self._key = key
            elif self._settled is not None:
                self._predict_state(dt, rates)
                self._correct_settled(readings, used)
                return
            self._steps += 1
            if self._steps % _CHECK_EVERY == 0:
                before = self.covariance.copy()
        if dt:
            self._predict_state(dt, rates)
            self._predict_covariance(dt, spread)
        self._used = used
        if not used.any():
            self._whitened = np.empty((0, 1))
            return
        self._correct(readings, used)
        if before is not None:
            self._settle(before)

    def _predict_state(self, dt: float, rates: FloatArray) -> None:
        m = self.m
        self.x[..., :m] += dt * (rates - self.x[..., m : m + self.d])

    def _predict_covariance(self, dt: float, spread: FloatArray | None) -> None:
        m, d = self.m, self.d
        if self._interval != dt:
            self._interval = dt
            noise = self.noise
            angle, cross, bias = increments(noise.paper, noise.white, noise.walk, dt)
            self._increment = np.zeros_like(self.covariance)
            self._increment[: m + d, : m + d] = np.block([[angle, cross], [cross.T, bias]])
            if self._offset_walk is not None:
                offsets = range(m + d, len(self.x))
                self._increment[offsets, offsets] = self._offset_walk**2 * dt
        p = self.covariance
        p[:m] -= dt * p[m : m + d]
        p[:, :m] -= dt * p[:, m : m + d]
        p += self._increment
        angles = p[:m, :m]  # the rest is symmetric to the last digit
        angles += angles.T
        angles *= 0.5
        self._spread(spread)

    def _spread(self, spread: FloatArray | None) -> None:
        if spread is not None:
            self.covariance[range(self.m), range(self.m)] += spread
            self._steep = True

    def _correct(self, readings: FloatArray, used: NDArray[np.bool_]) -> None:
        at, noise = self._coordinate, self._hall_noise
        some = not used.all()
        if some:
            at, noise, readings = at[used], noise[used][:, used], readings[..., used]
        p = self.covariance
        if not self._volts:
            crossed = p[:, at]
            self._apply(crossed, crossed[at] + noise, readings - self.x[..., at])
            return
        offsets = None
        if self._offset_walk is not None:
            offsets = self.m + self.d + np.flatnonzero(used)
        prior = point = self.x
        if self._steep:
            self._steep = bool((p.diagonal()[: self.m] > ITERATE_ABOVE).any())
        if self._steep:
            point = self._start_point(readings, used)
        for _ in range(ITERATIONS):
            expected, slope = self.hall.voltages(point[self._coordinate])
            if some:
                expected, slope = expected[used], slope[used]
            innovation = readings - expected
            if point is not prior:
                innovation -= slope * (prior[at] - point[at])
            crossed = p[:, at] * slope
            if offsets is not None:
                innovation -= prior[offsets]
                crossed += p[:, offsets]
            total = slope[:, None] * crossed[at]
            total += noise
            if offsets is not None:
                total += crossed[offsets]
            if point is prior:
                break
            before, point = point, prior + crossed @ np.linalg.solve(total, innovation)
            if np.abs(point[at] - before[at]).max() < SETTLED:
                break
        self._apply(crossed, total, innovation)

    def _start_point(self, readings: FloatArray, used: NDArray[np.bool_]) -> FloatArray:
        """The state at the angles that the readings stand for, where the filter does not know better."""
        at, m = self._coordinate[used], self.m
        volts = np.full(len(used), np.nan)
        volts[used] = readings
        if self._offset_walk is not None:
            volts -= self.x[m + self.d :]
        angles = self.hall.angles(volts)
        _, slope = self.hall.voltages(angles)
        weight = slope[used] ** 2 / self._hall_noise.diagonal()[used]
        weights, weighted = (np.bincount(at, w, m) for w in (weight, weight * angles[used]))
        unknown = (weights > 0.0) & (self.covariance.diagonal()[:m] > ITERATE_ABOVE)
        point = self.x.copy()
        point[:m][unknown] = weighted[unknown] / weights[unknown]
        return point

    def _apply(self, crossed: FloatArray, total: FloatArray, innovation: FloatArray) -> None:
        """Correct with P H^T (n, h), the covariance (h, h) of the innovation, and the innovation (..., h)."""
        n, h = crossed.shape
        root, _ = self._potrf(total, lower=1)
        runs = innovation.reshape(-1, h)
        sides = np.empty((h, n + len(runs)), dtype=self._dtype, order="F")  # as LAPACK wants it: solved in place
        sides[:, :n] = crossed.T
        sides[:, n:] = runs.T
        solved = self._trsm(1.0, root, sides, lower=1, overwrite_b=1)
        self._root, self._y, self._whitened = root, solved[:, :n], solved[:, n:]
        self.x += (self._whitened.T @ self._y).reshape(self.x.shape)
        self.covariance -= self._y.T @ self._y

    def _settle(self, before: FloatArray) -> None:
        """Keep the gain when the last step left the covariance as it was."""
        if np.abs(self.covariance - before).max() > _CONVERGED * np.abs(before).max():
            return
        whitening = np.linalg.inv(np.tril(self._root)).T
        self._settled = whitening @ self._y, whitening

    def _correct_settled(self, readings: FloatArray, used: NDArray[np.bool_]) -> None:
        assert self._settled is not None
        gain, whitening = self._settled
        innovation = readings[..., used] - self.x[..., self._coordinate[used]]
        self.x += innovation @ gain
        self._whitened = (innovation @ whitening).reshape(-1, len(gain)).T

    # ------------------------------------------------------------- results

    def rate_biases(self) -> FloatArray:
        """(..., m) biases of the rates, rad/s."""
        return self.x[..., self.m : self.m + self.d]

    @property
    def innovations(self) -> FloatArray:
        """Normalised innovations of the newest step (..., h); NaN: not used."""
        whole = np.full((*self.x.shape[:-1], len(self._used)), np.nan)
        if self._whitened.size:
            whole[..., self._used] = self._whitened.T.reshape(*self.x.shape[:-1], -1)
        return whole

    def get_state(self) -> dict[str, Any]:
        """All that changes."""
        earlier = [[x.tolist(), covariance.tolist()] for x, covariance in self._earlier]
        return {"x": self.x.tolist(), "covariance": self.covariance.tolist(), "earlier": earlier, "age": self._age}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from `get_state`."""
        self._unsettle()
        self._steep = True
        self.x = np.array(state["x"], dtype=self._dtype)
        self.covariance = np.array(state["covariance"], dtype=self._dtype)
        (x, p), (newer_x, newer_p) = state["earlier"]
        arrays: list[FloatArray] = [np.array(one, dtype=self._dtype) for one in (x, p, newer_x, newer_p)]
        self._earlier, self._age = ((arrays[0], arrays[1]), (arrays[2], arrays[3])), state["age"]
