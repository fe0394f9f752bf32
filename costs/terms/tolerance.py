"""Turns a residual that should vanish into rows that may be off by a tolerance."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from scopt import AffineRows, Residual
from scopt.residual import StateT


class WithinTolerance(Residual[StateT]):
    """``r - tolerance`` and ``-r - tolerance`` for each row ``r``: at most zero where ``|r| <= tolerance``."""

    def __init__(self, residual: Residual[StateT], tolerance: Float[np.ndarray, "k"] | float) -> None:
        """
        Args:
            residual: what should be near zero.
            tolerance: one number for all rows, or ``(k,)`` repeated over the rows (k rows per waypoint).
        """
        self._residual = residual
        self._tolerance = np.atleast_1d(np.asarray(tolerance, dtype=float))

    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        value = self._residual.value(state)
        tolerance = self._rows_of(value)
        return np.concatenate([value - tolerance, -value - tolerance])

    def linearize(self, state: StateT) -> AffineRows:
        rows = self._residual.linearize(state)
        tolerance = self._rows_of(rows.value)
        return AffineRows.stack(
            [AffineRows(rows.value - tolerance, rows.jacobian), AffineRows(-rows.value - tolerance, -rows.jacobian)]
        )

    def _rows_of(self, value: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
        return np.tile(self._tolerance, len(value) // len(self._tolerance))
