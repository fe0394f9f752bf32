"""Weighs the rows of a residual one by one, and moves what they measure from."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy import sparse

from costs.terms.per_row import per_row, tiled
from scopt import AffineRows, Residual
from scopt.residual import StateT


class Scaled(Residual[StateT]):
    """``gain * (r - target)`` for each row ``r`` [unit of gain times unit of r]."""

    def __init__(
        self,
        residual: Residual[StateT],
        gain: Float[np.ndarray, "k"] | float,
        target: Float[np.ndarray, "k"] | float = 0.0,
    ) -> None:
        """
        Args:
            residual: what is measured.
            gain: one number for all rows, or ``(k,)`` repeated over the rows (k rows per waypoint).
            target: likewise; what each row is measured from.
        """
        self._residual = residual
        self.is_smooth = residual.is_smooth
        self._gain = per_row(gain)
        self._target = per_row(target)

    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        value = self._residual.value(state)
        return np.asarray(tiled(self._gain, value) * (value - tiled(self._target, value)))

    def linearize(self, state: StateT) -> AffineRows:
        rows = self._residual.linearize(state)
        gain = tiled(self._gain, rows.value)
        value = gain * (rows.value - tiled(self._target, rows.value))
        return AffineRows(value, sparse.csr_array(sparse.diags_array(gain) @ rows.jacobian))
