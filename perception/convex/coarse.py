"""Downsampling to one point per voxel, and smoothing of points along their rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.cleaning.beside import STARTS_APART, depth_noise
from perception.cleaning.clean import nearest, row_keys

_QUANTUM = 1e-6
_NEIGHBOURS = 24
# Length along the ray over width of the region in which neighbours are searched.
_LENGTHWISE = 2.5
_ASIDE = 0.008
_FAR_ASIDE = 0.02
_AHEAD = 1.5
_APART = 1e3
_RIDGE = 0.003
_FOURTH = 4
_MOST_OF_RANGE = 0.025
_MOST_CELLS = 4_000_000
_MANY = 0.5


@dataclass(frozen=True)
class Coarse:
    """Mean of the points in each occupied voxel, in order of the voxels' coordinates.

    Attributes:
        counts: (M,) number of points in each voxel.
        starts: (M, 3) start of the shortest ray to each voxel [m].
        voxel: (N,) index of each point's voxel mean.
        column: (M,) cell index of each voxel along x, ascending.
    """

    points: Float[np.ndarray, "M 3"]
    counts: Int[np.ndarray, "M"]
    starts: Float[np.ndarray, "M 3"]
    voxel: Int[np.ndarray, "N"]
    column: Int[np.ndarray, "M"]
    size: float

    def select_within(self, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> Int[np.ndarray, "K"]:
        """Return indices of the points in an axis-aligned box."""
        # Integers: a float would make numpy convert the whole column to floats.
        first = int(np.searchsorted(self.column, int(np.floor((lower[0] - _QUANTUM) / self.size))))
        last = int(np.searchsorted(self.column, int(np.floor((upper[0] + _QUANTUM) / self.size)), side="right"))
        columns = self.points[first:last].T
        inside = np.flatnonzero((columns[1] >= lower[1]) & (columns[1] <= upper[1]))
        for axis in (0, 2):
            column = columns[axis][inside]
            inside = inside[(column >= lower[axis]) & (column <= upper[axis])]
        return np.asarray(first + inside)


def coarsen(points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "*N 3"], size: float) -> Coarse:
    """Return the mean of the points in each occupied voxel; the order of the points does not matter.

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
    # Sums of integers do not depend on the order of the points; sums of fractions do, in the last digit.
    sums = [np.bincount(voxel, weights=np.rint(column / _QUANTUM), minlength=len(distinct)) for column in points.T]
    means = np.stack(sums, axis=1) * _QUANTUM / counts[:, None]
    return Coarse(means, counts, _find_nearest_starts(points, starts, voxel, len(distinct)), voxel, along_x, size)


def _find_nearest_starts(
    points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "*N 3"], voxel: Int[np.ndarray, "N"], n_voxels: int
) -> Float[np.ndarray, "M 3"]:
    """Return the start of the shortest ray that ended in each voxel [m]."""
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
    """Point indices of voxel i: ``order[first[i]:first[i + 1]]``."""

    order: Int[np.ndarray, "N"]
    first: Int[np.ndarray, "M+1"]

    @classmethod
    def of(cls, coarse: Coarse) -> Groups:
        order = np.argsort(coarse.voxel, kind="stable")
        return cls(order, np.concatenate([[0], np.cumsum(coarse.counts)]))

    def find_holding(self, kept: Bool[np.ndarray, "N"]) -> Bool[np.ndarray, "M"]:
        """Return which voxels contain at least one kept point."""
        before = np.concatenate([[0], np.cumsum(kept[self.order])])
        return np.asarray(before[self.first[1:]] > before[self.first[:-1]])

    def list_members(self, voxels: Int[np.ndarray, "K"]) -> Int[np.ndarray, "L"]:
        """Return indices of all points in these voxels."""
        counts = self.first[voxels + 1] - self.first[voxels]
        ahead = np.repeat(self.first[voxels] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)
        return np.asarray(self.order[ahead + np.arange(len(ahead))])


def smooth_points(
    points: Float[np.ndarray, "N 3"],
    counts: Int[np.ndarray, "N"],
    starts: Float[np.ndarray, "N 3"],
    chosen: Int[np.ndarray, "C"],
) -> Float[np.ndarray, "C 3"]:
    """Return the chosen points, each moved along its ray onto the plane fitted to its neighbours [m].

    Neighbours lie at most 2 cm beside the ray and differ in depth by no more than range noise; their weight is a
    Gaussian of 8 mm in the distance from the ray.

    Args:
        counts: (N,) measured points per point.
    """
    if len(points) < 2 or not len(chosen):
        return np.asarray(points[chosen])
    near = select_nearby(points, chosen, _find_reach(points[chosen] - starts[chosen]))
    points, counts, starts, chosen = points[near], counts[near], starts[near], np.searchsorted(near, chosen)
    rays = points - starts
    ranges = np.maximum(np.linalg.norm(rays, axis=1), 1e-9)
    along = rays / ranges[:, None]
    neighbours = _find_beside(along, ranges, starts, chosen)
    poll()
    mine, along = points[chosen], along[chosen]
    apart = np.append(points, points[:1], axis=0)[neighbours] - mine[:, None]
    right = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
    right /= np.maximum(np.linalg.norm(right, axis=1, keepdims=True), 1e-9)
    poll()
    ahead, u, v = (np.einsum("nki,ni->nk", apart, axis) for axis in (along, right, np.cross(along, right)))
    aside = u * u + v * v
    poll()
    weight = np.append(counts, 0)[neighbours] * np.exp(-0.5 * aside / _ASIDE**2)
    weight *= (aside <= _FAR_ASIDE**2) & (np.abs(ahead) <= _AHEAD * depth_noise(ranges[chosen])[:, None])
    weight /= weight.sum(axis=1, keepdims=True)

    def mean(values: Float[np.ndarray, "C K"]) -> Float[np.ndarray, "C"]:
        poll()
        return np.asarray(np.einsum("nk,nk->n", weight, values))

    # Least squares of the depth over (u, v); the ridge keeps a single scan line from tilting sideways.
    mean_u, mean_v, depth = mean(u), mean(v), mean(ahead)
    uu, vv = mean(u * u) - mean_u**2 + _RIDGE**2, mean(v * v) - mean_v**2 + _RIDGE**2
    uv, ud, vd = mean(u * v) - mean_u * mean_v, mean(u * ahead) - mean_u * depth, mean(v * ahead) - mean_v * depth
    determinant = uu * vv - uv * uv
    slope_u, slope_v = (vv * ud - uv * vd) / determinant, (uu * vd - uv * ud) / determinant
    return np.asarray(mine + (depth - slope_u * mean_u - slope_v * mean_v)[:, None] * along)


def _find_reach(rays: Float[np.ndarray, "C 3"]) -> float:
    """Return the largest distance at which a point can be a neighbour of a ray's end [m]."""
    ahead = _AHEAD * depth_noise(np.linalg.norm(rays, axis=1)).max()
    return float(_LENGTHWISE * np.hypot(_FAR_ASIDE, ahead / _LENGTHWISE)) + _FAR_ASIDE


def _find_beside(
    along: Float[np.ndarray, "N 3"],
    ranges: Float[np.ndarray, "N"],
    starts: Float[np.ndarray, "N 3"],
    chosen: Int[np.ndarray, "C"],
) -> Int[np.ndarray, "C K"]:
    """Return the nearest points to each chosen one, itself included, from the same sensor; N where there are fewer."""
    # This scaling shortens distances along the ray relative to distances beside it.
    places = along * (ranges ** (1.0 / _LENGTHWISE))[:, None]
    sensors = row_keys(np.floor(starts / STARTS_APART))
    if (sensors != sensors[0]).any():
        places[:, 0] += _APART * np.unique(sensors, return_inverse=True)[1]
    k = np.arange(1, min(_NEIGHBOURS, len(along)) + 1)
    tree = cKDTree(places, balanced_tree=False, compact_nodes=False)
    return nearest(tree, places[chosen], k, within=0.5 * _APART)[1]


def measure_spacing(
    points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"], chosen: Int[np.ndarray, "C"]
) -> Float[np.ndarray, "C"]:
    """Return the distance of each chosen point to its fourth nearest neighbour, at most 2.5 % of its range [m]."""
    if len(points) <= _FOURTH:
        return np.zeros(len(chosen))
    mine = points[chosen]
    most = _MOST_OF_RANGE * np.linalg.norm(mine - starts[chosen], axis=1)
    near = points[select_nearby(points, chosen, float(most.max(initial=0.0)) + 1e-6)]
    tree = cKDTree(near, balanced_tree=False, compact_nodes=False)
    fourth = nearest(tree, mine, [_FOURTH + 1])[0][:, 0]
    return np.asarray(np.minimum(fourth, most))


def select_nearby(points: Float[np.ndarray, "N 3"], chosen: Int[np.ndarray, "C"], reach: float) -> Int[np.ndarray, "K"]:
    """Return ascending indices of points that include all within ``reach`` [m] of a chosen point.

    All points are returned where a closer search would take longer.
    """
    if not len(chosen) or len(chosen) > _MANY * len(points):
        return np.arange(len(points))
    lower, upper = points[chosen].min(axis=0), points[chosen].max(axis=0)
    shape = np.floor((upper - lower) / reach).astype(np.int64) + 5
    if np.prod(shape.astype(float)) > _MOST_CELLS:
        return np.arange(len(points))
    # Points outside the grid go into its outermost cells, which are not next to any chosen point's cell.
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
