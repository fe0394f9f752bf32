"""Which of some points surfaces stand for, judged by nothing but the rays beside theirs."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.beside import STARTS_APART
from perception.clean import row_keys
from perception.outliers import surface_points

_NARROWEST = 0.008  # of a bin of directions [rad]
_LEAST_RAYS = 5  # in a bin, as a median: within two bins there are then twice the 32 that are looked at
_STEPS = np.arange(-2, 3)
_MOST_STARTS = 8
_MOST_SHARE = 0.4
_WIDEST = 0.5


def surface_among(
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "N 3"],
    candidates: Bool[np.ndarray, "N"],
    asked: Int[np.ndarray, "K"],
) -> Bool[np.ndarray, "K"]:
    """Which of the points that are asked about a surface stands for; all other candidates are known to be of surfaces.

    Args:
        points: (N, 3) all points that were seen [m].
        starts: (N, 3) where their rays started [m].
        candidates: which are not the floor's.
        asked: some of the candidates.
    """
    if not len(asked):
        return np.zeros(0, dtype=bool)
    known = candidates.copy()
    known[asked] = False
    beside = _beside(points, starts, asked)
    kept = surface_points(points[beside], starts[beside], candidates[beside], known[beside])
    return np.asarray(kept[np.searchsorted(beside, asked)])


def _beside(
    points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"], asked: Int[np.ndarray, "K"]
) -> Int[np.ndarray, "M"]:
    """Points whose rays pass beside those of the points that are asked about, ascending; all where most do."""
    everyone = np.arange(len(points))
    corners = np.floor(starts / STARTS_APART)
    sensor = np.zeros(len(points), dtype=np.int64)
    if starts.strides[0] != 0 and (corners != corners[0]).any():
        sensor = np.unique(row_keys(corners), return_inverse=True)[1]
    n_sensors = int(sensor.max()) + 1
    if n_sensors > _MOST_STARTS or len(asked) > _MOST_SHARE * len(points):
        return everyone
    rays = points - starts
    ranges = np.maximum(np.sqrt(np.einsum("ij,ij->i", rays, rays)), 1e-9)
    rays /= ranges[:, None]
    width = _NARROWEST
    while width < _WIDEST:
        # Two cells to all sides of those that directions of unit length may lie in are there, too.
        n_cells = int(np.ceil(2.0 / width)) + 5
        u, v, w = (np.floor((column + 1.0) / width).astype(np.int64) + 2 for column in rays.T)
        cells = ((sensor * n_cells + u) * n_cells + v) * n_cells + w
        chosen = np.zeros(n_sensors * n_cells**3, dtype=bool)
        chosen[cells[asked]] = True
        own = np.unique(cells[asked])
        if chosen[cells].sum() >= _LEAST_RAYS * len(own):
            for ahead in (n_cells**2, n_cells, 1):
                own = np.unique(own[:, None] + ahead * _STEPS)
            chosen[own] = True
            return np.flatnonzero(chosen[cells])
        width *= 1.5
    return everyone
