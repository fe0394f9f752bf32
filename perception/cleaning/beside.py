"""Support of a point: the number of neighbouring rays that ended on the same surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.cleaning.clean import nearest, row_keys

STARTS_APART = 0.1
RADIUS = 0.03
RADIUS_SHARE = 0.02
# Range noise of a surface is less than this plus the share of the range; mixed pixels may have any depth.
_DEPTH = 0.02
_DEPTH_SHARE = 0.01
_NEIGHBOURS = 32
# Ray spacing is the distance of the 8th nearest ray divided by the square root of two (exact on a square grid).
_EIGHTH = 7
_FAR_ASIDE = 1.5
_SLANT = 3.0
# Number of nearest neighbours whose slope from the point is tried.
_SLOPES = 8
_STEEPEST = 10.0
_ON_SLOPE = 4
_FAR_ON_SLOPE = 2
_MOST = 0.8


def spacing_radius(ranges: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
    """Return the search radius for neighbours: 3 cm plus 2 % of the range [m]."""
    return np.asarray(RADIUS + RADIUS_SHARE * ranges)


def depth_noise(ranges: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
    """Return the depth tolerance of a point along its ray: 2 cm plus 1 % of the range [m]."""
    return np.asarray(_DEPTH + _DEPTH_SHARE * ranges)


def support(
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "N 3"],
    queries: Int[np.ndarray, "K"],
    like: Bool[np.ndarray, "N"],
    is_thin: Bool[np.ndarray, "K"],
) -> Int[np.ndarray, "K"]:
    """Return how many of the 32 rays nearest to each queried point's ray ended on the same surface as the point.

    A ray counts if it ends at the point's depth (within three ray spacings where rays are sparse), or on a slope
    through the point that continues: a mixed pixel has a slope towards either surface, but the slope ends there.

    Args:
        like: points that may support a thin object; other points do not count for it.
        is_thin: which of the queried points are treated as thin objects.
    """
    counts = np.zeros(len(queries), dtype=np.int64)
    if not len(queries):
        return counts
    if (starts == starts[:1]).all():
        return _support_in(points, starts, queries, like, is_thin)
    groups = row_keys(np.floor(starts / STARTS_APART))
    order = np.argsort(groups[queries], kind="stable")
    for keys in np.split(order, np.flatnonzero(np.diff(groups[queries[order]])) + 1):
        members = np.flatnonzero(groups == groups[queries[keys[0]]])
        if len(members) > 1:
            mine = np.searchsorted(members, queries[keys])
            counts[keys] = _support_in(points[members], starts[members], mine, like[members], is_thin[keys])
    return counts


def _support_in(
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "N 3"],
    queries: Int[np.ndarray, "K"],
    like: Bool[np.ndarray, "N"],
    is_thin: Bool[np.ndarray, "K"],
) -> Int[np.ndarray, "K"]:
    if len(points) < 2:
        return np.zeros(len(queries), dtype=np.int64)
    rays = points - starts
    ranges = np.linalg.norm(rays, axis=1)
    directions = rays / np.maximum(ranges, 1e-9)[:, None]
    k = min(_NEIGHBOURS + 1, len(points))
    tree = cKDTree(directions, balanced_tree=False, compact_nodes=False)
    neighbours = nearest(tree, directions[queries], np.arange(2, k + 1))[1]
    poll()
    around = _Around.of(directions, ranges, queries, neighbours)
    poll()
    eighth = around.aside[:, min(_EIGHTH, k - 2)]
    reach = np.maximum(2.0 * spacing_radius(ranges[queries]), _FAR_ASIDE * eighth)
    counted = (like[neighbours] | ~is_thin[:, None]) & (around.aside <= reach[:, None])
    poll()
    noise = depth_noise(ranges[queries])
    level = np.maximum(noise, _SLANT / np.sqrt(2.0) * eighth)
    count = (counted & (np.abs(around.depth) <= level[:, None])).sum(axis=1)
    for neighbour in range(min(_SLOPES, k - 1)):
        count = np.maximum(count, _on_slope(around, counted, neighbour, noise))
    return np.asarray(count)


@dataclass(frozen=True)
class _Around:
    """Neighbouring rays of K points, nearest first.

    Attributes:
        u, v: (K, 32) lateral offsets of each neighbour, along two axes perpendicular to the point's ray [m].
        depth: (K, 32) range of each neighbour minus the point's range [m].
    """

    u: Float[np.ndarray, "K M"]
    v: Float[np.ndarray, "K M"]
    depth: Float[np.ndarray, "K M"]

    @classmethod
    def of(
        cls,
        directions: Float[np.ndarray, "N 3"],
        ranges: Float[np.ndarray, "N"],
        queries: Int[np.ndarray, "K"],
        neighbours: Int[np.ndarray, "K M"],
    ) -> _Around:
        along = directions[queries]
        right = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
        right /= np.maximum(np.linalg.norm(right, axis=1, keepdims=True), 1e-9)
        up = np.cross(along, right)
        offset = (directions[neighbours] - along[:, None]) * ranges[queries, None, None]
        u, v = (np.einsum("kmi,ki->km", offset, axis) for axis in (right, up))
        return cls(u, v, ranges[neighbours] - ranges[queries, None])

    @property
    def aside(self) -> Float[np.ndarray, "K M"]:
        """Lateral distance of each neighbour from the point's ray [m]."""
        return np.asarray(np.hypot(self.u, self.v))


def _on_slope(
    around: _Around, counted: Bool[np.ndarray, "K M"], neighbour: int, noise: Float[np.ndarray, "K"]
) -> Int[np.ndarray, "K"]:
    """Count rays that ended on the plane through each point and one neighbour; 0 where that plane ends there."""
    poll()
    u, v, depth = around.u, around.v, around.depth
    flat = np.maximum(u[:, neighbour] ** 2 + v[:, neighbour] ** 2, 1e-12)
    slope = depth[:, neighbour] / flat
    expected = slope[:, None] * (u[:, neighbour, None] * u + v[:, neighbour, None] * v)
    on = (counted & (np.abs(depth - expected) <= noise[:, None])).astype(float)
    # Least-squares plane of the inliers, through the point; the ridge keeps a single scan line from tilting sideways.
    uu, vv, uv = (on * u * u).sum(axis=1) + 1e-6, (on * v * v).sum(axis=1) + 1e-6, (on * u * v).sum(axis=1)
    poll()
    ud, vd = (on * u * depth).sum(axis=1), (on * v * depth).sum(axis=1)
    determinant = uu * vv - uv * uv
    slope_u, slope_v = (vv * ud - uv * vd) / determinant, (uu * vd - uv * ud) / determinant
    expected = slope_u[:, None] * u + slope_v[:, None] * v
    is_on = counted & (np.abs(depth - expected) <= noise[:, None])
    goes_on = np.zeros(len(u), dtype=bool)
    for towards in (expected, -expected):
        poll()
        side = counted & (towards > 0.0)
        mine = is_on & side
        beyond = (mine & (towards > noise[:, None])).cumsum(axis=1)
        far_beyond = (mine & (towards > 2.0 * noise[:, None])).cumsum(axis=1)
        is_most = mine.cumsum(axis=1) >= _MOST * side.cumsum(axis=1)
        goes_on |= ((beyond >= _ON_SLOPE) & (far_beyond >= _FAR_ON_SLOPE) & is_most).any(axis=1)
    goes_on &= np.hypot(slope_u, slope_v) <= _STEEPEST
    return np.asarray(np.where(goes_on, is_on.sum(axis=1), 0))
