"""Slender objects in a cloud: masks of points on slender and on flat objects, and axes of slim ones."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.spatial import cKDTree

from costs.stopping import poll

_MOST_WIDE = 0.5  # share of the second variance
_CELL = 0.075
_MOST_CELLS = 3_000_000
_FLAT_WIDE, _FLAT_THICK = 0.25, 3e-4
_SLIM, _SPREAD, _FEWEST = 0.3, 0.018, 5


def is_slender(points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
    """Return which points have neighbours that spread much more along one direction than along a second.

    Criterion: second largest over largest variance of the points in the 3 x 3 x 3 cells of 7.5 cm around a point, at
    most 0.5.  The ratio is 1 in the middle of a wall, 0.3 at its edge, below 0.25 on a board up to 15 cm wide.

    Args:
        points: (N, 3) thinned evenly [m].
    """
    variances = variances_about(points)
    if variances is None:
        return np.ones(len(points), dtype=bool)
    return np.asarray(variances[:, 1] <= _MOST_WIDE * np.maximum(variances[:, 2], 1e-9))


def is_flat(points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
    """Return which points are on a wide object less than about 6 cm thick, noise included, also near its edge.

    Args:
        points: (N, 3) thinned evenly [m].
    """
    variances = variances_about(points)
    if variances is None:
        return np.zeros(len(points), dtype=bool)
    return np.asarray((variances[:, 1] > _FLAT_WIDE * variances[:, 2]) & (variances[:, 0] < _FLAT_THICK))


def variances_about(points: Float[np.ndarray, "N 3"], cell: float = _CELL) -> Float[np.ndarray, "N 3"] | None:
    """Return ascending variances (N, 3) of each point's neighbours [m^2]; None: too large an extent for a grid.

    Args:
        cell: edge of a cell; neighbours are the points in 3 x 3 x 3 cells about the point's own [m].
    """
    if not len(points):
        return None
    cells = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    shape = tuple(int(n) for n in cells.max(axis=0) + 1)
    if np.prod(np.array(shape, dtype=float)) > _MOST_CELLS:
        return None
    flat = np.ravel_multi_index(tuple(cells.T), shape)
    # All points of a cell have the same neighbours.
    occupied, of_point = np.unique(flat, return_inverse=True)
    # Moments about the points' mean, summed over the neighbourhood: count, sums, products.
    local = points - points.mean(axis=0)
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    terms = [np.ones(len(points)), *local.T, *(local[:, i] * local[:, j] for i, j in pairs)]
    moments = np.stack([_sum_around(flat, term, shape, occupied) for term in terms])
    n = np.maximum(moments[0], 1.0)
    mean = moments[1:4] / n
    covariance = np.zeros((len(occupied), 3, 3))
    for (i, j), products in zip(pairs, moments[4:], strict=True):
        covariance[:, i, j] = covariance[:, j, i] = products / n - mean[i] * mean[j]
    poll()
    return np.asarray(np.linalg.eigvalsh(covariance)[of_point])


def _sum_around(
    cell: Int[np.ndarray, "N"], weight: Float[np.ndarray, "N"], shape: tuple[int, ...], about: Int[np.ndarray, "C"]
) -> Float[np.ndarray, "C"]:
    """Return the sum of the points' weights in the 3 x 3 x 3 cells about some cells."""
    poll()
    total = np.bincount(cell, weight, minlength=int(np.prod(shape))).reshape(shape)
    return np.asarray(ndimage.uniform_filter(total, size=3, mode="constant").reshape(-1)[about] * 27.0)


def slim_places(
    points: Float[np.ndarray, "N 3"], tree: cKDTree, ball: float
) -> tuple[Int[np.ndarray, "K"], Float[np.ndarray, "K 3"]]:
    """Return indices of points whose neighbours spread along one direction only, and that direction, unit (K, 3).

    Args:
        points: (N, 3) thinned evenly [m].
        ball: radius of the neighbourhood [m].
    """
    poll()
    first, second = np.ascontiguousarray(tree.query_pairs(ball, output_type="ndarray").T)
    n = len(points)
    poll()
    offset = [column.take(second) - column.take(first) for column in np.ascontiguousarray(points.T)]
    # The point itself counts too, with offset 0.
    count = np.bincount(first, minlength=n) + np.bincount(second, minlength=n) + 1.0
    mean = [(np.bincount(first, way, n) - np.bincount(second, way, n)) / count for way in offset]
    covariance = np.empty((n, 3, 3))
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        poll()
        product = offset[i] * offset[j]
        moment = (np.bincount(first, product, n) + np.bincount(second, product, n)) / count
        covariance[:, i, j] = covariance[:, j, i] = moment - mean[i] * mean[j]
    poll()
    # No variance is larger than their sum.
    likely = np.flatnonzero((count >= _FEWEST) & (np.trace(covariance, axis1=1, axis2=2) > _SPREAD**2))
    variances, ways = np.linalg.eigh(covariance[likely])
    is_slim = (variances[:, 1] < _SLIM * variances[:, 2]) & (variances[:, 2] > _SPREAD**2)
    return likely[is_slim], np.asarray(ways[is_slim, :, 2])
