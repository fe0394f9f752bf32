"""Takes some coordinates not to move, in the derivative of a residual."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy import sparse

from scopt import AffineRows, Residual
from scopt.residual import StateT


class Masked(Residual[StateT]):
    """The rows of a residual, with no derivative by coordinates that do not move."""

    def __init__(self, residual: Residual[StateT], moves: Bool[np.ndarray, "n"]) -> None:
        """
        Args:
            residual: what is measured.
            moves: (n,) whether each coordinate of a waypoint moves.
        """
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
