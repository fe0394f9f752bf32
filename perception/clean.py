"""Cleaning of points: crop to a reach, downsample, outliers, the robot's own points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, QhullError, cKDTree

from perception.errors import PerceptionError

SELF_MARGIN = 0.025


@dataclass(frozen=True)
class Reach:
    """A vertical cylinder of interest.

    Attributes:
        x, y: its axis in the world [m].
        radius: horizontal radius [m].
        top: upper end [m above zero].
        bottom: lower end [m above zero].
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
        """Which points lie in the cylinder."""
        near = (points[:, 0] - self.x) ** 2 + (points[:, 1] - self.y) ** 2 <= self.radius**2
        return np.asarray(near & (points[:, 2] <= self.top) & (points[:, 2] >= self.bottom))


def voxel_index(points: Float[np.ndarray, "N 3"], size: float) -> tuple[Int[np.ndarray, "N"], int]:
    """Number of the voxel of each point, counted 0, 1, ... in order of the voxels' coordinates, and how many."""
    cells = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    spans = cells.max(axis=0) + 1
    keys = (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2]
    distinct, index = np.unique(keys, return_inverse=True)
    return index, len(distinct)


def voxel_downsample(
    points: Float[np.ndarray, "N 3"], size: float
) -> tuple[Float[np.ndarray, "M 3"], Int[np.ndarray, "M"]]:
    """The mean of the points in each occupied voxel of edge ``size`` [m], and how many they are."""
    if not len(points):
        return points, np.zeros(0, dtype=int)
    index, n_voxels = voxel_index(points, size)
    counts = np.bincount(index, minlength=n_voxels)
    sums = np.stack([np.bincount(index, weights=points[:, axis], minlength=n_voxels) for axis in range(3)], axis=1)
    return np.asarray(sums / counts[:, None]), counts


def inliers(
    points: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "3"], n_neighbours: int = 5
) -> Bool[np.ndarray, "N"]:
    """Points with at least ``n_neighbours`` others within 3 cm plus 2 % of their range.

    A scanner's points thin out with range, so a fixed radius would eat the far ones.
    """
    if len(points) <= n_neighbours:
        return np.zeros(len(points), dtype=bool)
    radius = 0.03 + 0.02 * np.linalg.norm(points - origin, axis=1)
    distance, _ = cKDTree(points).query(
        points, k=[n_neighbours + 1], distance_upper_bound=float(radius.max()) + 1e-9, workers=-1
    )
    return np.asarray(np.asarray(distance)[:, 0] <= radius)


def inside_hulls(
    points: Float[np.ndarray, "N 3"], hulls: Sequence[Float[np.ndarray, "V 3"]], margin: float = SELF_MARGIN
) -> Bool[np.ndarray, "N"]:
    """Points that lie within ``margin`` of every face plane's inner side of any hull.

    Near an edge this reaches a little farther than ``margin``, on the side of taking a point for the robot's own.

    Args:
        points: (N, 3) [m].
        hulls: (V, 3) vertices each, in the frame of the points.
        margin: [m].
    """
    inside = np.zeros(len(points), dtype=bool)
    for vertices in hulls:
        near = np.flatnonzero(
            ((points >= vertices.min(axis=0) - margin) & (points <= vertices.max(axis=0) + margin)).all(axis=1)
        )
        if not len(near):
            continue
        faces = half_spaces(vertices)
        inside[near] |= (points[near] @ faces[:, :3].T + faces[:, 3] <= margin).all(axis=1)
    return inside


def half_spaces(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "F 4"]:
    """Faces (a, b) of the hull with ``a . x + b <= 0`` inside, ``a`` of length one.

    Raises:
        PerceptionError: the vertices are flat.
    """
    try:
        faces = ConvexHull(vertices).equations
    except (QhullError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise PerceptionError(f"a hull of {len(vertices)} vertices spans no volume: {reason}") from None
    # Triangulated faces repeat their plane.
    return np.asarray(np.unique(np.round(faces, 9), axis=0))
