"""Cells of a grid that hold given points."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int


def number_cells(
    points: Float[np.ndarray, "*N 3"], lower: Float[np.ndarray, "3"], size: float, shape: tuple[int, ...]
) -> tuple[Int[np.ndarray, "*N"], Bool[np.ndarray, "*N"]]:
    """Return the number of each point's cell in a flattened grid, and whether the point is in the grid; else 0.

    Args:
        lower: (3,) corner of the grid [m].
        size: edge of a cell [m].
        shape: number of cells along each axis.
    """
    cells = np.floor((points - lower) / size).astype(np.int64)
    inside = ((cells >= 0) & (cells < shape)).all(axis=-1)
    flat = (cells[..., 0] * shape[1] + cells[..., 1]) * shape[2] + cells[..., 2]
    return np.where(inside, flat, 0), inside
