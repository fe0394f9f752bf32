"""Residuals made of another residual: scaled, bounded from both sides, without some coordinates, or beside forces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy import sparse

from costs.state import LoadedState, MotionState
from scopt import AffineRows, Residual
from scopt.residual import StateT, linearize_residual


class Scaled(Residual[StateT]):
    """``gain * (r - target)`` for each row ``r`` [unit of gain times unit of r].

    Gain and target are numbers for all rows, or (k,) repeated over the rows (k rows per waypoint).
    """

    def __init__(
        self,
        residual: Residual[StateT],
        gain: Float[np.ndarray, "k"] | float,
        target: Float[np.ndarray, "k"] | float = 0.0,
    ) -> None:
        self._residual = residual
        self.is_smooth = residual.is_smooth
        self._gain = _as_rows(gain)
        self._target = _as_rows(target)

    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        value = self._residual.value(state)
        return np.asarray(_tile(self._gain, value) * (value - _tile(self._target, value)))

    def linearize(self, state: StateT) -> AffineRows:
        rows = self._residual.linearize(state)
        gain = _tile(self._gain, rows.value)
        value = gain * (rows.value - _tile(self._target, rows.value))
        return AffineRows(value, sparse.csr_array(sparse.diags_array(gain) @ rows.jacobian))


class Masked(Residual[StateT]):
    """Rows of a residual without derivatives by coordinates that do not move; ``moves`` is (n,), per waypoint."""

    def __init__(self, residual: Residual[StateT], moves: Bool[np.ndarray, "n"]) -> None:
        self._residual = residual
        self.is_smooth = residual.is_smooth
        self._moves = np.asarray(moves, dtype=float)

    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        return self._residual.value(state)

    def linearize(self, state: StateT) -> AffineRows:
        rows = self._residual.linearize(state)
        n_waypoints = rows.jacobian.shape[1] // len(self._moves)
        kept = sparse.diags_array(np.tile(self._moves, n_waypoints))
        return AffineRows(rows.value, sparse.csr_array(rows.jacobian @ kept))


class Widened(Residual[LoadedState]):
    """Rows of a residual of configurations in a problem whose waypoints also have contact forces.

    The Jacobian has ``T (n + 3 C)`` columns, those of the forces without entries.
    """

    def __init__(self, residual: Residual[MotionState]) -> None:
        self._residual = residual
        self.is_smooth = residual.is_smooth

    def value(self, state: LoadedState) -> Float[np.ndarray, "m"]:
        return self._residual.value(state.motion)

    def linearize(self, state: LoadedState) -> AffineRows:
        rows = linearize_residual(self._residual, state.motion, type(self._residual).__name__)
        n_waypoints, n_points, _ = state.forces.shape
        jacobian = rows.jacobian
        n = jacobian.shape[1] // n_waypoints
        indices = jacobian.indices + 3 * n_points * (jacobian.indices // n)
        shape = (jacobian.shape[0], n_waypoints * (n + 3 * n_points))
        return AffineRows(rows.value, sparse.csr_array((jacobian.data, indices, jacobian.indptr), shape=shape))


class Between(Residual[StateT]):
    """``r - upper`` and ``lower - r`` for each row ``r``: at most zero where ``lower <= r <= upper``.

    Bounds are numbers for all rows, or (k,) repeated over the rows (k rows per waypoint).
    """

    def __init__(
        self,
        residual: Residual[StateT],
        lower: Float[np.ndarray, "k"] | float,
        upper: Float[np.ndarray, "k"] | float,
    ) -> None:
        self._residual = residual
        self.is_smooth = residual.is_smooth
        self._lower, self._upper = _as_rows(lower), _as_rows(upper)

    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        value = self._residual.value(state)
        return np.concatenate([value - _tile(self._upper, value), _tile(self._lower, value) - value])

    def linearize(self, state: StateT) -> AffineRows:
        rows = self._residual.linearize(state)
        return AffineRows.stack(
            [
                AffineRows(rows.value - _tile(self._upper, rows.value), rows.jacobian),
                AffineRows(_tile(self._lower, rows.value) - rows.value, -rows.jacobian),
            ]
        )


class WithinTolerance(Between[StateT]):
    """``r - tolerance`` and ``-r - tolerance`` for each row ``r``, as in ``Between``."""

    def __init__(self, residual: Residual[StateT], tolerance: Float[np.ndarray, "k"] | float) -> None:
        tolerances = _as_rows(tolerance)
        super().__init__(residual, -tolerances, tolerances)


class Joined(Residual[StateT]):
    """Rows of several residuals, one after another, as one term."""

    def __init__(self, residuals: Sequence[Residual[StateT]]) -> None:
        self._residuals = tuple(residuals)
        self.is_smooth = all(residual.is_smooth for residual in self._residuals)

    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        return np.concatenate([residual.value(state) for residual in self._residuals])

    def linearize(self, state: StateT) -> AffineRows:
        return AffineRows.stack([residual.linearize(state) for residual in self._residuals])


class Positive(Residual[StateT]):
    """``max(r, 0)`` of each row ``r``: as a squared cost zero on one side and quadratic on the other.

    Eq. 2 of Liu et al., Humanoids 2015, up to the sign of ``r``.
    """

    def __init__(self, residual: Residual[StateT]) -> None:
        self.is_smooth = residual.is_smooth
        self._residual = residual

    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        return np.asarray(np.maximum(self._residual.value(state), 0.0))

    def linearize(self, state: StateT) -> AffineRows:
        rows = self._residual.linearize(state)
        return rows.scale_rows((rows.value > 0.0).astype(float))


class NormWithin(Residual[StateT]):
    """``|r| - limit`` of the ``k`` rows of each waypoint, one row per waypoint: at most zero inside a ball.

    It is as smooth as its residual where it binds.
    """

    def __init__(self, residual: Residual[StateT], k: int, limit: float) -> None:
        self.is_smooth = residual.is_smooth
        self._residual, self._k, self._limit = residual, k, limit

    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        rows = self._residual.value(state).reshape(-1, self._k)
        return np.asarray(np.linalg.norm(rows, axis=1) - self._limit)

    def linearize(self, state: StateT) -> AffineRows:
        rows = self._residual.linearize(state)
        vectors = rows.value.reshape(-1, self._k)
        norms = np.linalg.norm(vectors, axis=1)
        # At the centre the norm has no derivative, and no step from there leaves a ball at once.
        directions = vectors / np.maximum(norms, 1e-12)[:, None]
        count = len(vectors)
        places = np.arange(count * self._k)
        sums = sparse.csr_array((directions.ravel(), (places // self._k, places)), shape=(count, count * self._k))
        return AffineRows(norms - self._limit, sparse.csr_array(sums @ rows.jacobian))


class PairWithin(Residual[StateT]):
    """``d . r - limit cos(pi / 8)`` for each pair ``r`` of rows and eight directions ``d``: an octagon in a disc.

    Small discs need it in place of ``NormWithin``: a step that crosses a disc leaves it on the other side, where its
    one tangent sees nothing.
    """

    _SIDES = 8

    def __init__(self, residual: Residual[StateT], limit: float) -> None:
        """
        Args:
            residual: of two rows per waypoint.
            limit: radius of the disc.
        """
        self.is_smooth = residual.is_smooth
        self._residual = residual
        angles = 2.0 * np.pi / self._SIDES * np.arange(self._SIDES)
        self._directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        self._most = limit * np.cos(np.pi / self._SIDES)

    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        return self._measure(self._residual.value(state))

    def linearize(self, state: StateT) -> AffineRows:
        rows = self._residual.linearize(state)
        each = sparse.kron(sparse.eye_array(len(rows.value) // 2), self._directions, format="csr")
        return AffineRows(self._measure(rows.value), sparse.csr_array(each @ rows.jacobian))

    def _measure(self, value: Float[np.ndarray, "p"]) -> Float[np.ndarray, "m"]:
        return np.asarray((value.reshape(-1, 2) @ self._directions.T).ravel() - self._most)


def _as_rows(values: Float[np.ndarray, "k"] | float) -> Float[np.ndarray, "k"]:
    """Return the numbers as an array, also a single one."""
    return np.atleast_1d(np.asarray(values, dtype=float))


def _tile(values: Float[np.ndarray, "k"], rows: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
    """Repeat the numbers over all rows, as often as they fit."""
    return np.tile(values, len(rows) // len(values))
