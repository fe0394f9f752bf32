"""Points that lie near some others, so that few are searched where few are asked about."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

_MOST_CELLS = 4_000_000
_MANY = 0.5


def nearby(points: Float[np.ndarray, "N 3"], chosen: Int[np.ndarray, "C"], reach: float) -> Int[np.ndarray, "K"]:
    """Indices, ascending, of points among which are all that lie at most ``reach`` [m] from any of the chosen ones.

    All points are told where it would not pay to look closer.
    """
    if not len(chosen) or len(chosen) > _MANY * len(points):
        return np.arange(len(points))
    lower, upper = points[chosen].min(axis=0), points[chosen].max(axis=0)
    shape = np.floor((upper - lower) / reach).astype(np.int64) + 5
    if np.prod(shape.astype(float)) > _MOST_CELLS:
        return np.arange(len(points))
    # The outermost cells to each side take in all that lies beyond, and are nobody's neighbours.
    cells = [
        (np.floor((column - low) / reach) + 2.0).clip(0, n - 1).astype(np.int64)
        for column, low, n in zip(points.T, lower, shape, strict=True)
    ]
    cell = (cells[0] * shape[1] + cells[1]) * shape[2] + cells[2]
    picture = np.zeros(shape, dtype=np.uint8)
    picture.reshape(-1)[cell[chosen]] = 1
    for axis in range(3):
        picture = ndimage.maximum_filter1d(picture, 3, axis=axis, mode="constant")
    return np.flatnonzero(picture.reshape(-1)[cell])
