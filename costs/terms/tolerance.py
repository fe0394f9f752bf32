"""Turns a residual that should vanish, or stay between two values, into rows that are at most zero where it does."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from costs.terms.per_row import per_row, tiled
from scopt import AffineRows, Residual
from scopt.residual import StateT


class Between(Residual[StateT]):
    """``r - upper`` and ``lower - r`` for each row ``r``: at most zero where ``lower <= r <= upper``."""

    def __init__(
        self,
        residual: Residual[StateT],
        lower: Float[np.ndarray, "k"] | float,
        upper: Float[np.ndarray, "k"] | float,
    ) -> None:
        """
        Args:
            residual: what should stay between.
            lower, upper: one number for all rows, or ``(k,)`` repeated over the rows (k rows per waypoint).
        """
        self._residual = residual
        self.is_smooth = residual.is_smooth
        self._lower, self._upper = per_row(lower), per_row(upper)

    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        value = self._residual.value(state)
        return np.concatenate([value - tiled(self._upper, value), tiled(self._lower, value) - value])

    def linearize(self, state: StateT) -> AffineRows:
        rows = self._residual.linearize(state)
        return AffineRows.stack(
            [
                AffineRows(rows.value - tiled(self._upper, rows.value), rows.jacobian),
                AffineRows(tiled(self._lower, rows.value) - rows.value, -rows.jacobian),
            ]
        )


class WithinTolerance(Between[StateT]):
    """``r - tolerance`` and ``-r - tolerance`` for each row ``r``: at most zero where ``|r| <= tolerance``."""

    def __init__(self, residual: Residual[StateT], tolerance: Float[np.ndarray, "k"] | float) -> None:
        """
        Args:
            residual: what should be near zero.
            tolerance: one number for all rows, or ``(k,)`` repeated over the rows (k rows per waypoint).
        """
        tolerances = per_row(tolerance)
        super().__init__(residual, -tolerances, tolerances)
