"""Removal of outliers: strays far from all other points, and mixed pixels that float between two surfaces.

Points that continue a surface seen at a grazing angle are kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.cleaning.beside import RADIUS, RADIUS_SHARE, STARTS_APART, depth_noise, spacing_radius, support
from perception.cleaning.clean import nearest, row_keys, voxel_index

_LEAST_NEIGHBOURS = 5
_WIDE = 0.7
_DEEP = 3.0
# Depth alone cannot distinguish a steeper surface from mixed pixels [m depth per m aside].
_MOST_STEEP = 4.0
_THIN_SUPPORT = 4
_LEAST_SUPPORT = 3
_NEIGHBOURS = 24
_MOST_OFF = 0.005
_ON_PLANE = 0.008
_SHARE_ON_PLANE = 0.8
# Points at this distance from a plane have a quarter of the weight in its fit; other surfaces have almost none [m].
_ROBUST = 0.004
_FITS = 4
# Largest sine of a grazing angle; ``support`` covers larger angles.
_STEEP = 0.12
# Mixed pixels at an edge lie in a plane through the sensor; surfaces miss it by this [m].
_ASIDE = 0.02
# Most rounds of growth over a grazed surface.
_MOST_ROUNDS = 24


def inliers(points: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "*N 3"]) -> Bool[np.ndarray, "N"]:
    """Return which points have at least five others within 3 cm plus 2 % of their range.

    Args:
        origin: (3,) or (N, 3) starts of the rays [m].
    """
    if len(points) <= _LEAST_NEIGHBOURS:
        return np.zeros(len(points), dtype=bool)
    radius = spacing_radius(np.linalg.norm(points - origin, axis=1))
    voxel, counts = _voxels(points, radius)
    kept = counts[voxel] > _LEAST_NEIGHBOURS
    rest = np.flatnonzero(~kept)
    if len(rest):
        most = float(radius[rest].max()) * (1.0 + 1e-9)
        distance, _ = nearest(_tree(points), points[rest], [_LEAST_NEIGHBOURS + 1], within=most)
        kept[rest] = distance[:, 0] <= radius[rest]
    return np.asarray(kept)


def surface_points(
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "N 3"],
    candidates: Bool[np.ndarray, "N"] | None = None,
    known: Bool[np.ndarray, "N"] | None = None,
) -> Bool[np.ndarray, "N"]:
    """Return which points lie on a surface, thin objects such as pipes and wires included.

    A point needs neighbours (:func:`inliers`) or a row of points at its depth, as on a wire; and some neighbouring
    rays must end at its depth, which a mixed pixel between two surfaces lacks.  On a surface seen at a grazing angle
    the neighbours differ in depth but lie in one plane.

    Args:
        candidates: points to judge; the others (the floor's) only support them and are False in the result.
        known: candidates that are known to lie on surfaces.
    """
    chosen = np.flatnonzero(np.ones(len(points), dtype=bool) if candidates is None else candidates)
    kept = np.zeros(len(points), dtype=bool)
    if not len(chosen):
        return kept
    mine, behind = points[chosen], starts[chosen]
    crowded = inliers(mine, behind)
    doubtful = ~crowded | ~_on_smooth_depth(mine, behind)
    if known is not None:
        doubtful &= ~known[chosen]
    kept[chosen[~doubtful]] = True
    queries, is_thin = chosen[doubtful], ~crowded[doubtful]
    # Noise of the floor may form a row like a wire, so only candidates support thin objects.
    like = np.ones(len(points), dtype=bool) if candidates is None else candidates
    kept[queries] = support(points, starts, queries, like, is_thin) >= np.where(is_thin, _THIN_SUPPORT, _LEAST_SUPPORT)
    left = queries[~kept[queries]]
    rays = points[left] - starts[left]
    apart = 2.0 * spacing_radius(np.linalg.norm(rays, axis=1))
    kept[left[on_grazed_surface(points[left], rays, points[kept], apart)]] = True
    return kept


def _tree(points: Float[np.ndarray, "N 3"]) -> cKDTree:
    return cKDTree(points, balanced_tree=False, compact_nodes=False)


def _voxels(
    points: Float[np.ndarray, "N 3"], radius: Float[np.ndarray, "N"]
) -> tuple[Int[np.ndarray, "N"], Int[np.ndarray, "V"]]:
    """Return the voxel number of each point and the counts; points of one voxel lie within each other's radius."""
    level = np.floor(np.log(radius) / np.log(1.3)).astype(np.int64)
    size = 1.3**level / np.sqrt(3.0)
    # Voxels of each size are shifted away from the others, so that one call numbers all.
    shifted = points / size[:, None]
    shifted -= shifted.min(axis=0)
    span = np.ceil(shifted[:, 0].max()) + 2.0
    shifted[:, 0] += span * (level - level.min())
    voxel, n_voxels = voxel_index(shifted, 1.0)
    return voxel, np.bincount(voxel, minlength=n_voxels)


def _cones(
    rays: Float[np.ndarray, "N 3"], ranges: Float[np.ndarray, "N"], starts: Float[np.ndarray, "N 3"]
) -> tuple[Int[np.ndarray, "N"], Int[np.ndarray, "V"]]:
    """Return the number of each point's cone section, 0.7 search radii wide and three deep, and the counts."""
    # Number of sections, each _DEEP radii deep, between sensor and point; the radius grows with the range.
    poll()
    before = np.log1p(ranges * (RADIUS_SHARE / RADIUS)) / (_DEEP * RADIUS_SHARE)
    level = np.floor(before)
    middle = (RADIUS / RADIUS_SHARE) * np.expm1((level + 0.5) * (_DEEP * RADIUS_SHARE))
    width = _WIDE * spacing_radius(middle) / middle
    face = np.argmax(np.abs(rays), axis=1)
    rows = np.arange(len(rays))
    ahead = rays[rows, face]
    tangents = [rays[rows, (face + turn) % 3] / (ahead * width) for turn in (1, 2)]
    corner = np.floor(starts / STARTS_APART).T
    cells = np.stack([level, face + 3.0 * (ahead < 0.0), *np.floor(tangents), *corner], axis=1)
    _, voxel, counts = np.unique(row_keys(cells), return_inverse=True, return_counts=True)
    return voxel, counts


def _on_smooth_depth(points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
    """Return which points lie on the plane of their cone section, if that plane fits well and is not too steep."""
    poll()
    rays = points - starts
    ranges = np.linalg.norm(rays, axis=1)
    voxel, counts = _cones(rays, ranges, starts)
    n_voxels = len(counts)

    def mean(values: Float[np.ndarray, "N"]) -> Float[np.ndarray, "V"]:
        return np.asarray(np.bincount(voxel, weights=values, minlength=n_voxels) / counts)

    along = np.stack([mean(column) for column in (rays / np.maximum(ranges, 1e-9)[:, None]).T], axis=1)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    aside = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
    aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-9)
    upright = np.cross(along, aside)
    relative = points - np.stack([mean(column) for column in points.T], axis=1)[voxel]
    depth, u, v = (np.einsum("ij,ij->i", relative, axis[voxel]) for axis in (along, aside, upright))
    # Least squares of depth over (u, v); the ridge keeps a single scan line from tilting sideways.
    uu, vv, uv = mean(u * u) + 1e-6, mean(v * v) + 1e-6, mean(u * v)
    ud, vd = mean(u * depth), mean(v * depth)
    determinant = uu * vv - uv * uv
    slope_u, slope_v = (vv * ud - uv * vd) / determinant, (uu * vd - uv * ud) / determinant
    off = depth - slope_u[voxel] * u - slope_v[voxel] * v
    tolerance = depth_noise(ranges)
    smooth = (np.hypot(slope_u, slope_v) < _MOST_STEEP) & (mean((off / tolerance) ** 2) < 0.25)
    return np.asarray(smooth[voxel] & (np.abs(off) < tolerance))


def on_grazed_surface(
    points: Float[np.ndarray, "K 3"],
    rays: Float[np.ndarray, "K 3"],
    surface: Float[np.ndarray, "N 3"],
    apart: Float[np.ndarray, "K"],
) -> Bool[np.ndarray, "K"]:
    """Return which points lie within 5 mm of the plane of their 24 nearest surface points, seen at a grazing angle.

    Returns of a grazed surface are as far apart as mixed pixels, but they lie in one plane, and that plane misses the
    sensor.  Accepted points become surface points for their neighbours.

    Args:
        points: (K, 3) points to judge [m].
        rays: (K, 3) vectors from the ray starts to the points [m].
        surface: (N, 3) known surface points [m].
        apart: (K,) largest accepted distance to the nearest surface point [m].
    """
    reached = np.zeros(len(points), dtype=bool)
    if len(surface) < _NEIGHBOURS or not len(points):
        return reached
    near = _Nearest.of(points, surface)
    queries = np.arange(len(points))
    for _ in range(_MOST_ROUNDS):
        queries = queries[near.distance[queries, 0] < apart[queries]]
        new = queries[_goes_on(points[queries], rays[queries], near.among(queries))]
        if not len(new):
            break
        reached[new] = True
        queries = near.join(points, np.flatnonzero(~reached), points[new])
    return reached


@dataclass
class _Nearest:
    """The 24 nearest surface points of each of K points, nearest first.

    Attributes:
        distance: (K, 24) distances [m].
        place: (K, 24, 3) positions [m].
    """

    distance: Float[np.ndarray, "K M"]
    place: Float[np.ndarray, "K M 3"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "K 3"], surface: Float[np.ndarray, "N 3"]) -> _Nearest:
        tree = cKDTree(surface, balanced_tree=False, compact_nodes=False)
        distance, index = nearest(tree, points, np.arange(1, _NEIGHBOURS + 1))
        return cls(distance, surface[index])

    def among(self, chosen: Int[np.ndarray, "C"]) -> _Nearest:
        """Return the neighbours of the chosen points only."""
        return _Nearest(self.distance[chosen], self.place[chosen])

    def join(
        self, points: Float[np.ndarray, "K 3"], chosen: Int[np.ndarray, "C"], new: Float[np.ndarray, "M 3"]
    ) -> Int[np.ndarray, "D"]:
        """Add new surface points, and return those of the chosen points whose nearest neighbours changed."""
        k = np.arange(1, min(_NEIGHBOURS, len(new)) + 1)
        distance, index = nearest(cKDTree(new), points[chosen], k)
        nearer = distance[:, 0] < self.distance[chosen, -1]
        chosen = chosen[nearer]
        all_distances = np.concatenate([self.distance[chosen], distance[nearer]], axis=1)
        all_places = np.concatenate([self.place[chosen], new[index[nearer]]], axis=1)
        order = np.argsort(all_distances, axis=1, kind="stable")[:, :_NEIGHBOURS]
        self.distance[chosen] = np.take_along_axis(all_distances, order, axis=1)
        self.place[chosen] = np.take_along_axis(all_places, order[:, :, None], axis=1)
        return chosen


def _goes_on(points: Float[np.ndarray, "K 3"], rays: Float[np.ndarray, "K 3"], near: _Nearest) -> Bool[np.ndarray, "K"]:
    """Return which points lie on the plane of their nearest surface points, if their rays graze that plane."""
    if not len(points):
        return np.zeros(0, dtype=bool)
    around = near.place - points[:, None]
    weight = 1.0 / (1.0 + 4.0 * (near.distance / np.maximum(near.distance[:, -1:], 1e-9)) ** 2) ** 2
    for _ in range(_FITS):
        share = weight / weight.sum(axis=1, keepdims=True)
        centre = np.einsum("nk,nki->ni", share, around)
        relative = around - centre[:, None]
        normal = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", share, relative, relative))[1][:, :, 0]
        off = np.einsum("nki,ni->nk", relative, normal)
        weight = 1.0 / (1.0 + (off / _ROBUST) ** 2) ** 2
    aside = np.abs(np.einsum("ni,ni->n", rays, normal))
    is_grazed = (aside < _STEEP * np.linalg.norm(rays, axis=1)) & (aside > _ASIDE)
    is_plane = (np.abs(off) < _ON_PLANE).mean(axis=1) >= _SHARE_ON_PLANE
    is_on = np.abs(np.einsum("ni,ni->n", centre, normal)) < _MOST_OFF
    return np.asarray(is_grazed & is_plane & is_on)
