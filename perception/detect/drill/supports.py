"""Level surfaces, the clusters that stand on them, and the share of rays that the surface stops beside each foot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.cleaning.clean import nearest, voxel_downsample
from perception.detect.engine.supports import level_heights
from perception.sightlines import SightIndex
from perception.view import View

_VOXEL = 0.012
_CELL = 0.03
_OVER = (0.018, 0.36)
_LINK, _LINK_UP = 0.025, 0.12
_WIDE = 0.5
_LEAST_POINTS = 15
_FOOT_HEIGHT = 0.05
_LEAST_NEIGHBOURS = (9, 6, 4, 0)
_FOOTING_HEIGHT = 0.05
_BESIDE = (0.015, 0.06)
_OVER_LEVEL, _UNDER = 0.018, 0.03
_LEAST_FALL = 0.05
_FEWEST = 4


@dataclass(frozen=True)
class StandingCluster:
    """Cluster of points that stands on a level surface.

    Attributes:
        points: (N, 3) thinned, without the surface's own [m].
        level: world z of the surface [m].
    """

    points: Float[np.ndarray, "N 3"]
    level: float


def standing_clusters(view: View) -> list[StandingCluster]:
    """Return clusters of points that stand on boards, tables or the floor, largest first."""
    points, _ = voxel_downsample(view.obstacles, _VOXEL)
    levels = level_heights(points)
    if view.floor is not None:
        levels = [float(view.floor.height(points[:, :2].mean(axis=0, keepdims=True))[0]), *levels]
    on_board = np.zeros(len(points), dtype=bool)
    for level in levels:
        on_board |= _on_board(points, level)
    standing = points[~on_board]
    clusters: list[StandingCluster] = []
    for level in levels:
        layer = standing[(standing[:, 2] > level + _OVER[0]) & (standing[:, 2] < level + _OVER[1])]
        clusters += [StandingCluster(foot, level) for foot in _on_foot(_link(layer), level)]
    return sorted(clusters, key=lambda cluster: -len(cluster.points))


def _on_board(points: Float[np.ndarray, "N 3"], level: float) -> Bool[np.ndarray, "N"]:
    """Return which points are on the level surface itself: near its height, where it is wide."""
    poll()
    near = np.flatnonzero(np.abs(points[:, 2] - level) < _OVER[0])
    mask = np.zeros(len(points), dtype=bool)
    if not len(near):
        return mask
    cells = np.floor(points[near, :2] / _CELL).astype(np.int64)
    cells -= cells.min(axis=0)
    grid = np.zeros(cells.max(axis=0) + 1)
    grid[tuple(cells.T)] = 1.0
    wide = ndimage.uniform_filter(grid, size=5, mode="constant") > _WIDE
    mask[near] = wide[tuple(cells.T)]
    return mask


def _link(points: Float[np.ndarray, "N 3"]) -> list[Float[np.ndarray, "K 3"]]:
    """Return groups of points linked within 2.5 cm, or 12 cm in height, since overhangs hide points below."""
    poll()
    if len(points) < _LEAST_POINTS:
        return []
    pairs = _pairs(points)
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    n_groups, of_point = connected_components(graph, directed=False)
    sizes = np.bincount(of_point, minlength=n_groups)
    return [points[of_point == i] for i in np.flatnonzero(sizes >= _LEAST_POINTS).tolist()]


def _pairs(points: Float[np.ndarray, "N 3"]) -> Int[np.ndarray, "P 2"]:
    """Return index pairs of the points that are linked."""
    poll()
    return np.asarray(cKDTree(points * (1.0, 1.0, _LINK / _LINK_UP)).query_pairs(_LINK, output_type="ndarray"))


def dense_parts(cluster: StandingCluster) -> list[list[StandingCluster]]:
    """Return the parts of a cluster without its points of few neighbours, for falling thresholds, all points last.

    Mixed pixels and noise link objects a hand apart, but by few points.
    """
    pairs = _pairs(cluster.points)
    n_neighbours = np.bincount(pairs.ravel(), minlength=len(cluster.points))
    levels = [_link(cluster.points[n_neighbours >= least]) for least in _LEAST_NEIGHBOURS]
    return [[StandingCluster(part, cluster.level) for part in _on_foot(parts, cluster.level)] for parts in levels]


def _on_foot(groups: list[Float[np.ndarray, "K 3"]], level: float) -> list[Float[np.ndarray, "K 3"]]:
    """Keep the groups that reach down to the surface."""
    return [group for group in groups if group[:, 2].min() < level + _FOOT_HEIGHT]


def support_share(index: SightIndex, cluster: StandingCluster) -> float:
    """Return the share of rays beside a cluster's foot that ended at its level; 1 with few rays.

    Rays beside a leg or a post pass below the level.
    """
    foot = cluster.points[cluster.points[:, 2] < cluster.level + _FOOTING_HEIGHT, :2]
    centre = foot.mean(axis=0)
    reach = float(np.linalg.norm(foot - centre, axis=1).max()) + _BESIDE[1]
    rays = index.passing(np.append(centre, cluster.level)[None], reach)
    rays = rays.select(rays.direction[:, 2] < -_LEAST_FALL)
    height = rays.ends[:, 2] - cluster.level
    rays, height = rays.select(height < _OVER_LEVEL), height[height < _OVER_LEVEL]
    if not len(rays):
        return 1.0
    crossing = (cluster.level - rays.start[:, 2]) / rays.direction[:, 2]
    beside, _ = nearest(cKDTree(foot), rays.start[:, :2] + crossing[:, None] * rays.direction[:, :2], 1)
    height = height[(beside > _BESIDE[0]) & (beside < _BESIDE[1])]
    return float((height > -_UNDER).mean()) if len(height) >= _FEWEST else 1.0
