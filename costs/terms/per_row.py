"""Numbers that repeat over the rows of a residual: one for all, or one for each of the k rows of a waypoint."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def per_row(values: Float[np.ndarray, "k"] | float) -> Float[np.ndarray, "k"]:
    """The numbers as an array, also when one stands for all."""
    return np.atleast_1d(np.asarray(values, dtype=float))


def tiled(values: Float[np.ndarray, "k"], rows: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
    """The numbers repeated over all rows; fewer than the rows when they do not divide them."""
    return np.tile(values, len(rows) // len(values))
