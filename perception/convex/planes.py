"""Plane detection: one-point RANSAC over normals, refit, and largest connected region."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.spatial import cKDTree

from costs.progress import tell
from costs.stopping import poll
from perception.cleaning.clean import nearest

_CELL = 0.04
_AT_A_TIME = 16


@dataclass(frozen=True)
class PlaneSettings:
    """Criteria of the plane search.

    Attributes:
        distance: largest distance of an inlier from the plane [m].
        normal_dot: least cosine between an inlier's normal and the plane's.
        min_points: fewest inliers.
        min_size: least extent of a region along its second axis [m].
        max_planes: largest number of planes.
        n_candidates: hypotheses per plane.
        n_refined: number of best hypotheses that are refitted.
        n_refits: most refits of a hypothesis.
        n_neighbours: number of points used for a normal.
        absorb: largest distance of noise from its plane [m].
        noise_share: points are noise when fewer than this share of the inliers around them.
        covered: largest distance from the plane that its slab covers [m].
        tail_share: beyond ``covered``, points on one side are noise if fewer than this share of the inliers,
        tail_points: or fewer than this number,
        tail_ratio: or fewer than this multiple of the points on the other side.
        bias: largest distance from the plane of the mean of the points around an inlier [m].
    """

    distance: float = 0.02
    normal_dot: float = 0.88
    min_points: int = 60
    min_size: float = 0.08
    max_planes: int = 60
    n_candidates: int = 160
    n_refined: int = 4
    n_refits: int = 10
    n_neighbours: int = 16
    absorb: float = 0.06
    noise_share: float = 0.5
    covered: float = 0.027
    tail_share: float = 0.05
    tail_points: int = 4
    tail_ratio: float = 3.0
    bias: float = 0.01


@dataclass(frozen=True)
class Plane:
    """A plane and its points.

    Attributes:
        normal: (3,) unit, towards the sensor.
        offset: ``normal . x == offset`` on the plane [m].
        members: indices of its inliers.
        noise: indices of its noise, which does not count for its outline.
    """

    normal: Float[np.ndarray, "3"]
    offset: float
    members: Int[np.ndarray, "K"]
    noise: Int[np.ndarray, "L"]

    @property
    def basis(self) -> Float[np.ndarray, "2 3"]:
        """Two unit axes (2, 3) in the plane, the second as vertical as possible."""
        x, y, z = map(float, self.normal)
        # Cross product with z, or with x where the normal is near z; numpy's cross is slow for a single vector.
        a, b, c = (-y, x, 0.0) if abs(z) < 0.9 else (0.0, -z, y)
        length = np.sqrt(a * a + b * b + c * c)
        a, b, c = a / length, b / length, c / length
        return np.array([[a, b, c], [y * c - z * b, z * a - x * c, x * b - y * a]])


def estimate_normals(
    points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "*N 3"], n_neighbours: int
) -> Float[np.ndarray, "N 3"]:
    """Return unit normals from the principal components of the nearest neighbours, facing the ray starts."""
    k = min(n_neighbours, len(points))
    _, neighbours = nearest(cKDTree(points), points, k)
    poll()
    near = points[np.reshape(neighbours, (len(points), k))]
    near = near - near.mean(axis=1, keepdims=True)
    poll()
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))[1][:, :, 0]
    away = ((starts - points) * normals).sum(axis=1) < 0.0
    normals[away] *= -1.0
    return np.asarray(normals)


def find_planes(
    points: Float[np.ndarray, "N 3"],
    counts: Int[np.ndarray, "N"],
    starts: Float[np.ndarray, "*N 3"],
    rng: np.random.Generator,
    settings: PlaneSettings | None = None,
) -> tuple[Plane, ...]:
    """Return planes with connected inliers, in order of search; no point belongs to two planes.

    Args:
        points: (N, 3) downsampled [m].
        counts: (N,) measured points per point.
    """
    settings = settings or PlaneSettings()
    planes: list[Plane] = []
    if len(points) < settings.min_points:
        return ()
    starts = np.broadcast_to(starts, points.shape)
    normals = estimate_normals(points, starts, settings.n_neighbours)
    left = np.arange(len(points))
    misses = 0
    while len(planes) < settings.max_planes and len(left) >= settings.min_points and misses < 4:
        tell("find planes", 1.0 - len(left) / len(points))
        members = _find_best_region(points, counts, normals, starts, left, rng, settings)
        if members is None:
            misses += 1
            continue
        misses = 0
        plane = Plane(*_fit(points[members], starts[members]), members, members[:0])
        left = np.setdiff1d(left, members, assume_unique=True)
        noise = find_noise(plane, points, counts, left, settings)
        distance = np.abs(points[left] @ plane.normal - plane.offset)
        # Noise this close to the plane is part of the surface, whatever its normal, and counts for the outline.
        grown = np.concatenate([members, left[noise & (distance < settings.distance)]])
        planes.append(replace(plane, members=grown, noise=left[noise & (distance >= settings.distance)]))
        left = left[~noise]
    return tuple(planes)


def _find_best_region(
    points: Float[np.ndarray, "N 3"],
    counts: Int[np.ndarray, "N"],
    normals: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "N 3"],
    left: Int[np.ndarray, "K"],
    rng: np.random.Generator,
    settings: PlaneSettings,
) -> Int[np.ndarray, "M"] | None:
    """Return the connected inliers of the plane with most support; None when they are too few or too narrow."""
    poll()
    sample = left if len(left) <= 3000 else rng.choice(left, 3000, replace=False)
    seeds = rng.choice(left, min(settings.n_candidates, len(left)), replace=False)
    agree = _find_agreeing(points, normals, sample, seeds, settings)
    best = np.argsort(-np.count_nonzero(agree, axis=1), kind="stable")[: settings.n_refined]
    settled = [_refit(points, normals, starts, sample[agree[i]], sample, settings) for i in best]
    region = _refit(points, normals, starts, max(settled, key=len), left, settings)
    if len(region) < 10:
        return None
    normal, offset = _fit(points[region], starts[region])
    aligned = left[normals[left] @ normal > 0.5]
    region = _drop_biased(points, counts, aligned, Plane(normal, offset, region, region[:0]), settings)
    region = _select_largest(points, region, Plane(normal, offset, region, region[:0]), starts)
    if len(region) < settings.min_points:
        return None
    flat = points[region] @ Plane(normal, offset, region, region[:0]).basis.T
    if np.sqrt(12.0 * np.linalg.eigvalsh(np.cov(flat.T))[0]) < settings.min_size:
        return None
    return region


def _find_agreeing(
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    sample: Int[np.ndarray, "K"],
    seeds: Int[np.ndarray, "S"],
    settings: PlaneSettings,
) -> Bool[np.ndarray, "S K"]:
    """Return which sample points are inliers of the plane through each seed, by distance and normal."""
    places, directions = np.ascontiguousarray(points[sample].T), np.ascontiguousarray(normals[sample].T)
    through, offsets = normals[seeds], (points[seeds] * normals[seeds]).sum(axis=1)
    agree = np.zeros((len(seeds), len(sample)), dtype=bool)
    # A few seeds at a time, so that the arrays stay in the cache of one core.
    for first in range(0, len(seeds), _AT_A_TIME):
        poll()
        some = slice(first, first + _AT_A_TIME)
        distance = through[some] @ places
        distance -= offsets[some, None]
        np.abs(distance, out=distance)
        agree[some] = (distance < settings.distance) & (through[some] @ directions > settings.normal_dot)
    return agree


def _refit(
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "N 3"],
    region: Int[np.ndarray, "K"],
    among: Int[np.ndarray, "L"],
    settings: PlaneSettings,
) -> Int[np.ndarray, "M"]:
    """Return the inliers of the plane fitted to a region, refitted until their number stops growing.

    A single normal can be off by many degrees, and its plane then has only a strip of the true inliers.
    """
    poll()
    count = 0
    places, directions = points[among], normals[among]
    for _ in range(settings.n_refits):
        if len(region) < 10:
            break
        normal, offset = _fit(points[region], starts[region])
        near = np.abs(places @ normal - offset) < settings.distance
        region = among[near & (directions @ normal > settings.normal_dot)]
        if len(region) <= 1.01 * count:
            break
        count = len(region)
    return region


def _drop_biased(
    points: Float[np.ndarray, "N 3"],
    counts: Int[np.ndarray, "N"],
    around: Int[np.ndarray, "K"],
    plane: Plane,
    settings: PlaneSettings,
) -> Int[np.ndarray, "M"]:
    """Return members around which all points are, on average, within ``settings.bias`` of the plane.

    Half of the noise of a face 3 cm behind the plane lies within 2 cm of it; only the mean reveals that face.
    """
    poll()
    if not len(plane.members):
        return plane.members
    distance = points[around] @ plane.normal - plane.offset
    around, distance = around[np.abs(distance) < settings.absorb], distance[np.abs(distance) < settings.absorb]
    raster = _Raster.over(points[plane.members] @ plane.basis.T)
    weights, cells = counts[around], raster.cells(points[around] @ plane.basis.T)
    inside = ((cells >= 0) & (cells < raster.shape)).all(axis=1)
    total = _count_cells(cells[inside], weights[inside], raster.shape)
    mean = _count_cells(cells[inside], (weights * distance)[inside], raster.shape) / np.maximum(total, 1e-9)
    mine = raster.cells(points[plane.members] @ plane.basis.T)
    return np.asarray(plane.members[np.abs(mean[tuple(mine.T)]) < settings.bias])


def _fit(points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, "3"], float]:
    """Return normal and offset of the least-squares plane; the normal faces most of the ray starts."""
    poll()
    centre = points.mean(axis=0)
    relative = points - centre
    normal = np.linalg.eigh(relative.T @ relative)[1][:, 0]
    offset = float(normal @ centre)
    is_behind = starts @ normal < offset
    return (-normal, -offset) if 2 * np.count_nonzero(is_behind) > len(is_behind) else (normal, offset)


def find_noise(
    plane: Plane,
    points: Float[np.ndarray, "N 3"],
    counts: Int[np.ndarray, "N"],
    left: Int[np.ndarray, "K"],
    settings: PlaneSettings,
) -> Bool[np.ndarray, "K"]:
    """Return which of the points ``left`` are noise of the plane: near it, and few or evenly spread over both sides.

    Points beyond the slab's thickness are noise only where those on their side are few compared with the inliers or
    with the other side (``settings.tail_*``).

    Without this, the tails of the range noise become further planes before a wall.  A real object on the plane
    occludes it: there the plane has no inliers, and the object's points are kept.
    """
    near = np.flatnonzero(np.abs(points[left] @ plane.normal - plane.offset) < settings.absorb)
    mine = points[plane.members] @ plane.basis.T
    raster = _Raster.over(mine)
    cells = raster.cells(points[left[near]] @ plane.basis.T)
    valid = ((cells >= 0) & (cells < raster.shape)).all(axis=1)
    near, cells = near[valid], cells[valid]
    weights = counts[left[near]]
    others = _count_cells(cells, weights, raster.shape)
    members = _count_cells(raster.cells(mine), counts[plane.members], raster.shape)
    distance = points[left[near]] @ plane.normal - plane.offset
    bias = _count_cells(cells, weights * distance, raster.shape) / np.maximum(members + others, 1e-9)
    few = (others < settings.noise_share * members) | (np.abs(bias) < settings.bias / 2)
    few &= members > 0.0
    is_noise = few[tuple(cells.T)]
    most = np.maximum(settings.tail_share * members, settings.tail_points / 9)
    sides = [distance > settings.covered, distance < -settings.covered]
    tails = [_count_cells(cells[side], weights[side], raster.shape) for side in sides]
    for side, tail, opposite in zip(sides, tails, tails[::-1], strict=True):
        # The counts are averages with rounding errors; the margin keeps equal counts from passing.
        is_tail = tail < np.maximum(most, settings.tail_ratio * opposite) - 1e-9
        is_noise[side] &= is_tail[tuple(cells[side].T)]
    noise = np.zeros(len(left), dtype=bool)
    noise[near] = is_noise
    return noise


@dataclass(frozen=True)
class _Raster:
    """Grid of square cells over a region of a plane, from corner ``lower`` [m]."""

    lower: Float[np.ndarray, "2"]
    shape: Int[np.ndarray, "2"]

    @classmethod
    def over(cls, flat: Float[np.ndarray, "N 2"]) -> _Raster:
        lower = flat.min(axis=0) - _CELL
        return cls(lower, np.ceil((flat.max(axis=0) - lower) / _CELL).astype(int) + 1)

    def cells(self, flat: Float[np.ndarray, "N 2"]) -> Int[np.ndarray, "N 2"]:
        return np.asarray(np.floor((flat - self.lower) / _CELL).astype(int))


def _count_cells(
    cells: Int[np.ndarray, "N 2"], weights: np.ndarray, shape: Int[np.ndarray, "2"]
) -> Float[np.ndarray, "U V"]:
    """Return the sum of weights per cell, averaged over the cell and its eight neighbours."""
    poll()
    flat = np.ravel_multi_index(tuple(cells.T), tuple(shape))
    counts = np.bincount(flat, weights, minlength=int(np.prod(shape))).reshape(shape)
    return np.asarray(ndimage.uniform_filter(counts, size=3, mode="constant"))


def _select_largest(
    points: Float[np.ndarray, "N 3"], region: Int[np.ndarray, "K"], plane: Plane, starts: Float[np.ndarray, "N 3"]
) -> Int[np.ndarray, "M"]:
    """Return the points of the largest connected patch; gaps up to max(5 cm, 4.5 % of range) connect."""
    poll()
    if not len(region):
        return region
    flat = points[region] @ plane.basis.T
    link = max(0.05, 0.045 * float(np.median(np.linalg.norm(points[region] - starts[region], axis=1))))
    cells = np.floor((flat - flat.min(axis=0)) / (link / 2)).astype(int)
    grid = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    grid[tuple(cells.T)] = True
    labels, _ = ndimage.label(ndimage.binary_dilation(grid), structure=np.ones((3, 3)))
    of_point = labels[tuple(cells.T)]
    return np.asarray(region[of_point == np.bincount(of_point).argmax()])
