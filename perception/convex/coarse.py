"""Points thinned to one for each voxel of a grid that is fixed in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

_QUANTUM = 1e-6


@dataclass(frozen=True)
class Coarse:
    """Means of the points in each occupied voxel, in order of the voxels' coordinates.

    Attributes:
        counts: (M,) how many points each stands for.
        starts: (M, 3) where the nearest sensor stood that saw one of them [m].
        voxel: (N,) number of the mean that each point went into.
        column: (M,) which voxel along x each is in, ascending.
    """

    points: Float[np.ndarray, "M 3"]
    counts: Int[np.ndarray, "M"]
    starts: Float[np.ndarray, "M 3"]
    voxel: Int[np.ndarray, "N"]
    column: Int[np.ndarray, "M"]
    size: float

    def select_within(self, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> Int[np.ndarray, "K"]:
        """Return indices of the points in an axis-aligned box."""
        # Whole numbers: a float would have numpy turn all columns into floats.
        first = int(np.searchsorted(self.column, int(np.floor((lower[0] - _QUANTUM) / self.size))))
        last = int(np.searchsorted(self.column, int(np.floor((upper[0] + _QUANTUM) / self.size)), side="right"))
        columns = self.points[first:last].T
        inside = np.flatnonzero((columns[1] >= lower[1]) & (columns[1] <= upper[1]))
        for axis in (0, 2):
            column = columns[axis][inside]
            inside = inside[(column >= lower[axis]) & (column <= upper[axis])]
        return np.asarray(first + inside)


def coarsen(points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "*N 3"], size: float) -> Coarse:
    """Make one point for each voxel of edge ``size`` [m]; the order of the points does not matter.

    Args:
        size: edge of a voxel; voxels are aligned with the world's origin [m].
    """
    keys = np.zeros(len(points), dtype=np.int64)
    if not len(points):
        return Coarse(points, keys, points, keys, keys, size)
    cells = [np.floor(column / size).astype(np.int64) for column in points.T]
    lowest = [int(column.min()) for column in cells]
    spans = [int(column.max()) - low + 1 for column, low in zip(cells, lowest, strict=True)]
    for column, low, span in zip(cells, lowest, spans, strict=True):
        keys = keys * span + (column - low)
    distinct, voxel = np.unique(keys, return_inverse=True)
    along_x = distinct // (spans[1] * spans[2]) + lowest[0]
    counts = np.bincount(voxel, minlength=len(distinct))
    # Sums of whole numbers do not depend on their order; sums of fractions would, in the last digit.
    sums = [np.bincount(voxel, weights=np.rint(column / _QUANTUM), minlength=len(distinct)) for column in points.T]
    means = np.stack(sums, axis=1) * _QUANTUM / counts[:, None]
    return Coarse(means, counts, _find_nearest_starts(points, starts, voxel, len(distinct)), voxel, along_x, size)


def _find_nearest_starts(
    points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "*N 3"], voxel: Int[np.ndarray, "N"], n_voxels: int
) -> Float[np.ndarray, "M 3"]:
    """Return for each voxel the start, of all its points, of the shortest ray."""
    if starts.ndim == 1:
        return np.broadcast_to(starts, (n_voxels, 3))
    if starts.strides[0] == 0 or (starts == starts[0]).all():
        return np.broadcast_to(starts[0], (n_voxels, 3))
    distance = np.linalg.norm(points - starts, axis=1)
    order = np.lexsort((*starts.T, distance, voxel))
    first = order[np.searchsorted(voxel[order], np.arange(n_voxels))]
    return np.asarray(starts[first])


@dataclass(frozen=True)
class Groups:
    """Points of each voxel."""

    order: Int[np.ndarray, "N"]
    first: Int[np.ndarray, "M+1"]

    @classmethod
    def of(cls, coarse: Coarse) -> Groups:
        order = np.argsort(coarse.voxel, kind="stable")
        return cls(order, np.concatenate([[0], np.cumsum(coarse.counts)]))

    def find_holding(self, kept: Bool[np.ndarray, "N"]) -> Bool[np.ndarray, "M"]:
        """Find the voxels that hold any of the points that are kept."""
        before = np.concatenate([[0], np.cumsum(kept[self.order])])
        return np.asarray(before[self.first[1:]] > before[self.first[:-1]])

    def list_members(self, voxels: Int[np.ndarray, "K"]) -> Int[np.ndarray, "L"]:
        """Return indices of all points in these voxels."""
        counts = self.first[voxels + 1] - self.first[voxels]
        ahead = np.repeat(self.first[voxels] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)
        return np.asarray(self.order[ahead + np.arange(len(ahead))])
