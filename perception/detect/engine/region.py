"""Rays about a place, thinned evenly, with the noise of their ends and what their ends lie on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from perception.sightlines import SightIndex, Sightlines

_NOISE_POINTS, _NOISE_NEIGHBOURS = 80, 10
_NOISE = (0.0015, 0.02)  # limits of the noise [m]


@dataclass(frozen=True)
class Mounting:
    """Plane that an object stands on or hangs on.

    Attributes:
        frame: (3, 3) unit rows, the third its normal towards the object.
        point: (3,) on the plane [m].
        sigma: standard deviation of its points [m].
        noise: least noise of what is seen on it, where its own points say so [m].
    """

    frame: Float[np.ndarray, "3 3"]
    point: Float[np.ndarray, "3"]
    sigma: float
    noise: float = 0.0

    def height(self, points: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N"]:
        """Return heights over the plane [m]."""
        return np.asarray((points - self.point) @ self.frame[2])


@dataclass(frozen=True)
class Region:
    """Rays that pass a place.

    Attributes:
        start, way, ends: (N, 3) starts, unit directions and ends of the rays [m].
        length: (N,) [m].
        is_other: (N,) whether a ray ended on what holds the object, or beyond it.
        sigma: noise of the ends [m].
        place, radius: centre and radius of the region [m].
        pitch: distance between neighbouring rays there [m].
        n_rays: number of rays before thinning.
    """

    start: Float[np.ndarray, "N 3"]
    way: Float[np.ndarray, "N 3"]
    ends: Float[np.ndarray, "N 3"]
    length: Float[np.ndarray, "N"]
    is_other: Bool[np.ndarray, "N"]
    sigma: float
    place: Float[np.ndarray, "3"]
    radius: float
    pitch: float
    n_rays: int

    def __len__(self) -> int:
        return len(self.length)

    def thin(self, most: int) -> Region:
        """Return the region with at most about ``most`` rays, evenly spread."""
        if len(self) <= most:
            return self
        return self.select(_spread(self.start, self.way, self.place, self.radius, most))

    def balance(self, most: int) -> Region:
        """Return the region with at most about ``most`` rays, half of them such that ended on the object or beside."""
        loose, other = np.flatnonzero(~self.is_other), np.flatnonzero(self.is_other)
        some = [
            these if len(these) <= n else these[_spread(self.start[these], self.way[these], self.place, self.radius, n)]
            for these, n in ((loose, most // 2), (other, most // 2))
        ]
        return self.select(np.concatenate(some))

    def loose_share(self, thinned: Region) -> float:
        """Return how many rays that ended on no mount there are for each of a thinned region."""
        scale = max(1.0, self.n_rays / max(len(self), 1)) * max(int((~self.is_other).sum()), 1)
        return float(np.sqrt(scale / max(int((~thinned.is_other).sum()), 1)))

    def select(self, keep: Int[np.ndarray, "K"]) -> Region:
        """Return only these rays."""
        return Region(
            self.start[keep],
            self.way[keep],
            self.ends[keep],
            self.length[keep],
            self.is_other[keep],
            self.sigma,
            self.place,
            self.radius,
            self.pitch,
            self.n_rays,
        )


def gather(
    index: SightIndex, place: Float[np.ndarray, "3"], radius: float, mounting: Mounting | None, most: int
) -> Region:
    """Return the rays that pass a place within a radius [m], at most about ``most`` of them."""
    rays = index.passing(place[None], radius)
    if not len(rays):
        nothing = np.zeros((0, 3))
        return Region(nothing, nothing, nothing, np.zeros(0), np.zeros(0, dtype=bool), _NOISE[0], place, radius, 1.0, 0)
    n_rays = len(rays)
    pitch = radius * np.sqrt(np.pi / n_rays)
    if n_rays > most:
        rays = rays.select(_spread(rays.start, rays.direction, place, radius, most))
    ends = rays.ends
    sigma = measure_noise(ends[np.linalg.norm(ends - place, axis=1) < radius])
    other = np.zeros(len(rays), dtype=bool)
    if mounting is not None:
        # Neighbours that err together look smooth; the whole face shows by how much.
        sigma = max(sigma, mounting.noise)
        other = mounting.height(ends) < 2.5 * max(mounting.sigma, sigma)
    return Region(rays.start, rays.direction, ends, rays.length, other, sigma, place, radius, float(pitch), n_rays)


def measure_noise(points: Float[np.ndarray, "N 3"]) -> float:
    """Return the noise of points on surfaces: the thickness of neighbours about their common plane [m]."""
    if len(points) < 2 * _NOISE_NEIGHBOURS:
        return _NOISE[1] / 2.0
    tree = cKDTree(points)
    some = points[:: max(1, len(points) // _NOISE_POINTS)]
    near = points[tree.query(some, _NOISE_NEIGHBOURS)[1]]
    near = near - near.mean(axis=1, keepdims=True)
    least = np.linalg.eigvalsh(near.transpose(0, 2, 1) @ near / (_NOISE_NEIGHBOURS - 3.0))[:, 0]
    return float(np.clip(np.sqrt(max(float(np.median(least)), 0.0)), *_NOISE))


def _spread(
    start: Float[np.ndarray, "N 3"],
    way: Float[np.ndarray, "N 3"],
    place: Float[np.ndarray, "3"],
    radius: float,
    most: int,
) -> Int[np.ndarray, "K"]:
    """Return one ray per cell of where rays pass a place: the one nearest to the cell's middle.

    A choice by rank or hash would change as a whole with the order of the points or their last digit.
    """
    offset = place - start
    passing = start + np.einsum("ni,ni->n", offset, way)[:, None] * way - place
    cell = radius * np.sqrt(np.pi / most)
    number = np.floor(passing / cell)
    away = np.linalg.norm(passing - (number + 0.5) * cell, axis=1)
    key = number.astype(np.int64) - number.astype(np.int64).min(axis=0)
    size = key.max(axis=0) + 1
    flat = (key[:, 0] * size[1] + key[:, 1]) * size[2] + key[:, 2]
    order = np.lexsort((away, flat))
    first = np.concatenate([[True], flat[order][1:] != flat[order][:-1]])
    return np.asarray(order[first])


def rays_of(region: Region) -> Sightlines:
    """Return the region's rays."""
    return Sightlines(region.start, region.way, region.length)
