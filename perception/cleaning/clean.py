"""Basic operations on points: crop, voxels, duplicates, robot hulls and nearest neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, QhullError, cKDTree

from costs.stopping import poll
from costs.threads import thread_count
from perception.errors import PerceptionError

SELF_MARGIN = 0.025
_FEW_VOXELS = 4
# Neighbours that one thread finds between two polls, about 30 ms.
_AT_ONCE = 50_000


@dataclass(frozen=True)
class Reach:
    """A vertical cylinder of interest.

    Attributes:
        x, y: axis in the world [m].
        radius: horizontal radius [m].
        top: world z of the upper end [m].
        bottom: world z of the lower end [m].
    """

    x: float = 0.0
    y: float = 0.0
    radius: float = 3.0
    top: float = 3.0
    bottom: float = -0.5

    def __post_init__(self) -> None:
        if not (np.isfinite([self.x, self.y, self.radius, self.top, self.bottom]).all() and self.radius > 0.0):
            raise PerceptionError(f"reach {self} must be finite with a positive radius")
        if self.top <= self.bottom:
            raise PerceptionError(f"reach.top {self.top} must lie above reach.bottom {self.bottom}")

    def contains(self, points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Return which points lie in the cylinder."""
        near = (points[:, 0] - self.x) ** 2 + (points[:, 1] - self.y) ** 2 <= self.radius**2
        return np.asarray(near & (points[:, 2] <= self.top) & (points[:, 2] >= self.bottom))


def voxel_index(points: Float[np.ndarray, "N 3"], size: float) -> tuple[Int[np.ndarray, "N"], int]:
    """Return the voxel number of each point, from 0 in order of coordinates, and the number of occupied voxels."""
    keys = np.zeros(len(points), dtype=np.int64)
    n_keys = 1
    for column in points.T:
        cells = np.floor((column - column.min()) / size).astype(np.int64)
        span = int(cells.max()) + 1
        keys *= span
        keys += cells
        n_keys *= span
    if n_keys <= _FEW_VOXELS * len(points):  # counting is faster than sorting
        is_there = np.zeros(n_keys, dtype=bool)
        is_there[keys] = True
        number = np.cumsum(is_there)
        return number[keys] - 1, int(number[-1])
    distinct, index = np.unique(keys, return_inverse=True)
    return index, len(distinct)


def voxel_downsample(
    points: Float[np.ndarray, "N 3"], size: float
) -> tuple[Float[np.ndarray, "M 3"], Int[np.ndarray, "M"]]:
    """Return the mean and the number of the points in each occupied voxel of edge ``size`` [m]."""
    if not len(points):
        return points, np.zeros(0, dtype=int)
    index, n_voxels = voxel_index(points, size)
    counts = np.bincount(index, minlength=n_voxels)
    sums = np.stack([np.bincount(index, weights=points[:, axis], minlength=n_voxels) for axis in range(3)], axis=1)
    return np.asarray(sums / counts[:, None]), counts


def row_keys(rows: Float[np.ndarray, "N K"]) -> Int[np.ndarray, "N"]:
    """Return a 64-bit hash of each row; equal rows have equal hashes, and collisions are negligible."""
    poll()
    words = (np.ascontiguousarray(rows, dtype=np.float64) + 0.0).view(np.uint64)  # + 0.0 turns -0.0 into 0.0
    keys = np.full(len(rows), 0x9E3779B97F4A7C15, dtype=np.uint64)
    for column in words.T:
        keys = (keys ^ column) * np.uint64(0xBF58476D1CE4E5B9)
        keys ^= keys >> np.uint64(31)
        keys *= np.uint64(0x94D049BB133111EB)
        keys ^= keys >> np.uint64(29)
    return np.asarray(keys.view(np.int64))


def first_of_equals(points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
    """Return which points are not exact duplicates, ray start included, of an earlier point."""
    constant = starts.strides[0] == 0 or bool((starts == starts[:1]).all())
    keys = row_keys(points if constant else np.hstack([points, starts]))
    ordered = np.sort(keys)
    if (ordered[1:] != ordered[:-1]).all():
        return np.ones(len(points), dtype=bool)
    is_first = np.zeros(len(points), dtype=bool)
    is_first[np.unique(keys, return_index=True)[1]] = True
    return is_first


def inside_hulls(
    points: Float[np.ndarray, "N 3"], hulls: Sequence[Float[np.ndarray, "V 3"]], margin: float = SELF_MARGIN
) -> Bool[np.ndarray, "N"]:
    """Return which points lie inside any hull or within ``margin`` [m] outside it.

    Edges and corners have a slightly larger margin (a tenth more at a right-angled edge), so that doubtful
    points count as the robot's.

    Args:
        hulls: vertices (V, 3) of each hull, in the frame of the points [m].
    """
    poll()
    inside = np.zeros(len(points), dtype=bool)
    if not len(hulls) or not len(points):
        return inside
    boxes = [(vertices.min(axis=0) - margin, vertices.max(axis=0) + margin) for vertices in hulls]
    around = np.flatnonzero(
        _in_box(points, np.min([lower for lower, _ in boxes], axis=0), np.max([upper for _, upper in boxes], axis=0))
    )
    candidates = points[around]
    for vertices, (lower, upper) in zip(hulls, boxes, strict=True):
        bounds = _add_roundings(vertices)
        near = np.flatnonzero(_in_box(candidates, lower, upper))
        inside[around[near]] |= (candidates[near] @ bounds[:, :3].T + bounds[:, 3] <= margin).all(axis=1)
    return inside


def _in_box(
    points: Float[np.ndarray, "N 3"], lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]
) -> Bool[np.ndarray, "N"]:
    mask = np.ones(len(points), dtype=bool)
    for axis in range(3):
        column = points[:, axis]
        mask &= (column >= lower[axis]) & (column <= upper[axis])
    return mask


def _add_roundings(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "F 4"]:
    """Return the hull's half-spaces plus bevels at its edges and corners, so that a margin adds no spikes."""
    hull = _convex_hull(vertices)
    faces, neighbours = hull.equations[:, :3], hull.neighbors
    between = faces[:, None, :] + faces[neighbours]
    length = np.linalg.norm(between, axis=2, keepdims=True)
    between = (between / np.maximum(length, 1e-9))[length[..., 0] > 0.1]
    corners = np.zeros_like(vertices)
    np.add.at(corners, hull.simplices.ravel(), np.repeat(faces, 3, axis=0))
    length = np.linalg.norm(corners, axis=1)
    corners = corners[length > 0.1] / length[length > 0.1, None]
    normals = np.unique(np.round(np.concatenate([faces, between, corners]), 9), axis=0)
    return np.column_stack([normals, -(normals @ vertices.T).max(axis=1)])


def _convex_hull(vertices: Float[np.ndarray, "V 3"]) -> ConvexHull:
    try:
        return ConvexHull(vertices)
    except (QhullError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise PerceptionError(f"a hull of {len(vertices)} vertices spans no volume: {reason}") from None


def nearest(
    tree: cKDTree,
    points: Float[np.ndarray, "N d"],
    k: int | list[int] | Int[np.ndarray, "K"],
    within: float = np.inf,
) -> tuple[Float[np.ndarray, "N *K"], Int[np.ndarray, "N *K"]]:
    """Return distances and indices of neighbours like ``tree.query``: infinite and ``tree.n`` beyond ``within``.

    The number of threads comes from ``costs.threads``; all have ended when the function returns or raises.

    Raises:
        Stopped: the caller cancelled (``costs.stopping``).
    """
    n_neighbours, n_threads = k if isinstance(k, int) else int(np.max(k, initial=1)), thread_count()
    step = max(1, n_threads * _AT_ONCE // max(n_neighbours, 4))
    parts = []
    for first in range(0, max(len(points), 1), step):
        poll()
        parts.append(tree.query(points[first : first + step], k=k, distance_upper_bound=within, workers=n_threads))
    if len(parts) == 1:
        return np.asarray(parts[0][0]), np.asarray(parts[0][1])
    return np.concatenate([distance for distance, _ in parts]), np.concatenate([index for _, index in parts])
