"""Places in a cloud that are part of something slim: a bar, a rim, the edge of what stands alone."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from costs.stopping import poll

_SLIM, _SPREAD, _FEWEST = 0.3, 0.018, 5


def slim_places(
    points: Float[np.ndarray, "N 3"], tree: cKDTree, ball: float
) -> tuple[Int[np.ndarray, "K"], Float[np.ndarray, "K 3"]]:
    """Points about which others spread in one direction only: their indices, and that direction.

    Args:
        points: (N, 3) thinned evenly [m].
        tree: of them.
        ball: radius about each within which others count [m].
    """
    poll()
    pairs = tree.query_pairs(ball, output_type="ndarray")
    n = len(points)
    poll()
    of, offset = pairs.T.reshape(-1), points[pairs[:, 1]] - points[pairs[:, 0]]
    offset = np.concatenate([offset, -offset])
    # With the point itself, whose offset is nought.
    count = np.bincount(of, minlength=n) + 1.0
    mean = np.stack([np.bincount(of, offset[:, i], n) for i in range(3)], axis=1) / count[:, None]
    covariance = -mean[:, :, None] * mean[:, None, :]
    poll()
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        poll()
        second = np.bincount(of, offset[:, i] * offset[:, j], n) / count
        covariance[:, i, j] += second
        covariance[:, j, i] += second * (i != j)
    poll()
    variances, ways = np.linalg.eigh(covariance)
    is_slim = (count >= _FEWEST) & (variances[:, 1] < _SLIM * variances[:, 2]) & (variances[:, 2] > _SPREAD**2)
    return np.flatnonzero(is_slim), np.asarray(ways[is_slim, :, 2])
