"""Foreground of a scan: the points that lie on no large closed plane."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from perception.cleaning.clean import voxel_downsample, voxel_index
from perception.convex.planes import Plane, PlaneSettings, find_planes
from perception.sightlines import SightIndex, Sightlines, sight_index
from perception.view import View

_VOXEL = 0.03
_WALL = PlaneSettings(min_size=0.45, min_points=150, max_planes=12, n_neighbours=20)
_NEAR = 0.05
_CLOSED = 0.6
_CELL = 0.1
_MOST_RAYS = 40_000


@dataclass(frozen=True)
class Foreground:
    """Points and rays from which valve detectors start, computed once per view.

    Attributes:
        points: (N, 3) obstacle points that lie on no wall [m].
        rng: generator in its state after the search for walls.
    """

    points: Float[np.ndarray, "N 3"]
    index: SightIndex
    rng: np.random.Generator

    @staticmethod
    def of(view: View, index: SightIndex | None = None) -> Foreground:
        """Return the foreground of a view; its rays are indexed anew when no index is given."""
        rng = np.random.default_rng(0)
        index = index or sight_index(view.cloud)
        return Foreground(view.obstacles[before_walls(view.obstacles, view.starts, index.rays, rng)], index, rng)

    def near(self, hint: Float[np.ndarray, "3"] | None, radius: float) -> Float[np.ndarray, "M 3"]:
        """Return the points within ``radius`` of a hint [m]; without a hint, all points."""
        return self.points if hint is None else self.points[np.linalg.norm(self.points - hint, axis=1) < radius]

    def generator(self) -> np.random.Generator:
        """Return a copy of the generator, so that each caller draws the same numbers."""
        return deepcopy(self.rng)


def before_walls(
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "N 3"],
    rays: Sightlines,
    rng: np.random.Generator,
) -> Bool[np.ndarray, "N"]:
    """Return (N,) points on no large closed plane; planes are fitted to means of large voxels, which scatter less.

    Planes that most rays pass through do not count: they lie in wheels, fences and heaps.

    Args:
        points: (N, 3) without the floor [m].
    """
    if not len(points):
        return np.zeros(0, dtype=bool)
    voxel, n_voxels = voxel_index(points, _VOXEL)
    means, counts = voxel_downsample(points, _VOXEL)
    from_where, _ = _voxel_means(starts, voxel, n_voxels)
    keep = np.ones(n_voxels, dtype=bool)
    some = rays.thin(_MOST_RAYS)
    for plane in find_planes(means, counts, from_where, rng, _WALL):
        members = np.concatenate([plane.members, plane.noise])
        share, about = closed_shares(plane, means, members, some)
        if share > _CLOSED:
            keep[members[about > _CLOSED]] = False
    return np.asarray(keep[voxel])


def closed_shares(
    plane: Plane, points: Float[np.ndarray, "N 3"], members: Int[np.ndarray, "M"], rays: Sightlines
) -> tuple[float, Float[np.ndarray, "M"]]:
    """Return the share of the rays reaching a plane that end there, within its outline and about each member, 0 to 1.

    A wheel may lie in one plane with a board beside it: the plane is closed there, and open about the wheel.  Where no
    rays reach the plane, the share is that of the whole outline; without any rays, 1.

    Args:
        members: (M,) indices of the points on the plane.
    """
    outline = points[plane.members] @ plane.basis.T
    try:
        edges = ConvexHull(outline).equations
    except QhullError:
        return 1.0, np.ones(len(members))
    slope = rays.direction @ plane.normal
    towards = slope < -0.05
    crossing = (plane.offset - rays.start[towards] @ plane.normal) / slope[towards]
    reaches = rays.length[towards] > crossing - _NEAR
    crossing, direction = crossing[reaches], rays.direction[towards][reaches]
    place = (rays.start[towards][reaches] + crossing[:, None] * direction) @ plane.basis.T
    ends = rays.length[towards][reaches] - crossing < _NEAR
    inside = (place @ edges[:, :2].T + edges[:, 2] <= 0.0).all(axis=1)
    if not inside.any():
        return 1.0, np.ones(len(members))
    share = float(ends[inside].mean())
    lower = np.floor(outline.min(axis=0) / _CELL).astype(np.int64) - 2
    shape = np.floor(outline.max(axis=0) / _CELL).astype(np.int64) + 3 - lower
    cells = np.floor(place / _CELL).astype(np.int64) - lower
    near = ((cells >= 0) & (cells < shape)).all(axis=1)
    flat = np.ravel_multi_index(tuple(cells[near].T), tuple(shape))
    counts = [np.bincount(flat, weights, int(shape.prod())).reshape(shape) for weights in (None, ends[near])]
    n_all, n_ending = (ndimage.uniform_filter(9.0 * count, size=3, mode="constant") for count in counts)
    own = np.floor(points[members] @ plane.basis.T / _CELL).astype(np.int64) - lower
    i, j = np.clip(own, 0, shape - 1).T
    return share, np.where(n_all[i, j] > 0.5, n_ending[i, j] / np.maximum(n_all[i, j], 0.5), share)


def _voxel_means(
    values: Float[np.ndarray, "N 3"], voxel: np.ndarray, n_voxels: int
) -> tuple[Float[np.ndarray, "M 3"], np.ndarray]:
    counts = np.bincount(voxel, minlength=n_voxels)
    sums = np.stack([np.bincount(voxel, weights=values[:, i], minlength=n_voxels) for i in range(3)], axis=1)
    return np.asarray(sums / counts[:, None]), counts
