"""The points thinned to one for each voxel of a grid that is fixed in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

_QUANTUM = 1e-6


@dataclass(frozen=True)
class Coarse:
    """Means of the points in each occupied voxel, in order of the voxels' coordinates.

    Attributes:
        points: (M, 3) [m].
        counts: (M,) how many points each stands for.
        starts: (M, 3) where the nearest sensor stood that saw one of them [m].
        voxel: (N,) number of the mean that each point went into.
    """

    points: Float[np.ndarray, "M 3"]
    counts: Int[np.ndarray, "M"]
    starts: Float[np.ndarray, "M 3"]
    voxel: Int[np.ndarray, "N"]


def coarsened(points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "*N 3"], size: float) -> Coarse:
    """One point for each voxel of edge ``size`` [m]; the order of the points does not matter.

    Args:
        points: (N, 3) [m], at least one.
        starts: (3,) or (N, 3), where their rays started [m].
        size: edge of a voxel; voxels are aligned with the world's origin [m].
    """
    keys = np.zeros(len(points), dtype=np.int64)
    for column in points.T:
        cells = np.floor(column / size).astype(np.int64)
        cells -= cells.min()
        keys *= cells.max() + 1
        keys += cells
    distinct, voxel = np.unique(keys, return_inverse=True)
    counts = np.bincount(voxel, minlength=len(distinct))
    # Sums of whole numbers do not depend on their order; sums of fractions would, in the last digit.
    sums = [np.bincount(voxel, weights=np.rint(column / _QUANTUM), minlength=len(distinct)) for column in points.T]
    means = np.stack(sums, axis=1) * _QUANTUM / counts[:, None]
    return Coarse(means, counts, _nearest_starts(points, starts, voxel, len(distinct)), voxel)


def _nearest_starts(
    points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "*N 3"], voxel: Int[np.ndarray, "N"], n_voxels: int
) -> Float[np.ndarray, "M 3"]:
    """For each voxel the start, of all its points, of the shortest ray."""
    if starts.ndim == 1:
        return np.broadcast_to(starts, (n_voxels, 3))
    if starts.strides[0] == 0 or (starts == starts[0]).all():
        return np.broadcast_to(starts[0], (n_voxels, 3))
    distance = np.linalg.norm(points - starts, axis=1)
    order = np.lexsort((*starts.T, distance, voxel))
    first = order[np.searchsorted(voxel[order], np.arange(n_voxels))]
    return np.asarray(starts[first])
