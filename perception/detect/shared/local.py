"""Choices that depend only on what is near: samples of points per cell, the best candidates about each place.

A sample of a whole scan, or a limit on the candidates of a whole scan, makes an object's detection depend on everything
else in the crop, and on the seed.  These choices are fixed by the points themselves.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from perception.cleaning.clean import row_keys


def pick_per_cell(points: Float[np.ndarray, "N 3"], cell: float, most: int) -> Int[np.ndarray, "K"]:
    """Return indices of at most ``most`` points of each cubic cell of the world, in order.

    Which ones is decided by a hash of their coordinates: other cells and the order of the points have no influence.

    Args:
        cell: edge of a cell [m].
    """
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    cells = row_keys(np.floor(points / cell))
    order = np.lexsort((row_keys(points), cells))
    cells = cells[order]
    first = np.concatenate([[0], np.flatnonzero(cells[1:] != cells[:-1]) + 1])
    rank = np.arange(len(cells)) - np.repeat(first, np.diff(np.append(first, len(cells))))
    return np.asarray(np.sort(order[rank < most]))


def best_about(places: Float[np.ndarray, "N d"], apart: float, most: int) -> Int[np.ndarray, "K"]:
    """Return indices of the items with fewer than ``most`` better ones within ``apart`` of them, in order.

    Args:
        places: (N, d) position of each item, best first [m].
    """
    if not len(places):
        return np.zeros(0, dtype=np.int64)
    pairs = cKDTree(places).query_pairs(apart, output_type="ndarray")
    return np.flatnonzero(np.bincount(pairs.max(axis=1), minlength=len(places)) < most)
