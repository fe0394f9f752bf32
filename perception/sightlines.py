"""The rays of a scan that pass a place: where each started, which way it went and where it ended."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.stopping import poll
from perception.cloud import Cloud

_MOST_ORIGINS = 12
_BLOCK = 50_000


@dataclass(frozen=True)
class Sightlines:
    """Rays of a scan.

    Attributes:
        length: (N,) where each ended, or up to where it met nothing [m].
    """

    start: Float[np.ndarray, "N 3"]
    direction: Float[np.ndarray, "N 3"]
    length: Float[np.ndarray, "N"]

    def __len__(self) -> int:
        return len(self.length)

    @property
    def ends(self) -> Float[np.ndarray, "N 3"]:
        """(N, 3) where the rays ended [m]."""
        return np.asarray(self.start + self.length[:, None] * self.direction)

    def select(self, keep: Bool[np.ndarray, "N"] | Int[np.ndarray, "K"]) -> Sightlines:
        """Keep only these."""
        if keep.dtype == np.bool_:
            keep = np.flatnonzero(keep)
        return Sightlines(self.start.take(keep, 0), self.direction.take(keep, 0), self.length.take(keep))

    def thin(self, most: int) -> Sightlines:
        """Keep every k-th, so that at most ``most`` are left."""
        return self if len(self) <= most else self.select(np.arange(0, len(self), -(-len(self) // most)))


@dataclass(frozen=True)
class SightIndex:
    """All rays of a scan, to ask for those that pass a place.

    Attributes:
        groups: rays that share a start: the start, their numbers and directions; empty when there are too many
            starts for that to pay.
    """

    rays: Sightlines
    groups: tuple[tuple[Float[np.ndarray, "3"], Int[np.ndarray, "K"], Float[np.ndarray, "K 3"]], ...]

    def passing(self, places: Float[np.ndarray, "K 3"], radius: float) -> Sightlines:
        """Return rays that pass a place within about ``radius`` and do not end well before it."""
        centre = places.mean(axis=0)
        size = radius + float(np.linalg.norm(places - centre, axis=1).max())
        if self.groups:
            parts = [self._of_group(group, places, radius, centre, size) for group in self.groups]
            return self.rays.select(np.concatenate(parts))
        along = ((centre - self.rays.start) * self.rays.direction).sum(axis=1)
        rays = self.rays.select((along > -size) & (self.rays.length > along - size))
        return rays.select(_nearest(rays, places) <= radius)

    def _of_group(
        self,
        group: tuple[Float[np.ndarray, "3"], Int[np.ndarray, "K"], Float[np.ndarray, "K 3"]],
        places: Float[np.ndarray, "K 3"],
        radius: float,
        centre: Float[np.ndarray, "3"],
        size: float,
    ) -> Int[np.ndarray, "M"]:
        """Return the numbers of the rays of a group."""
        start, numbers, directions = group
        inside = _in_cones(directions, places - start, radius)
        numbers = numbers[inside]
        along = directions.take(inside, 0) @ (centre - start)
        return np.asarray(numbers[(along > -size) & (self.rays.length.take(numbers) > along - size)])


def _in_cones(
    directions: Float[np.ndarray, "N 3"], offset: Float[np.ndarray, "K 3"], radius: float
) -> Int[np.ndarray, "M"]:
    """Return indices of directions that pass a place within ``radius``, pre-selected by one cone about all.

    Looking at every direction once is quicker than a tree, which answers with Python's lists.
    """
    poll()
    distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-6)
    towards = offset / distance[:, None]
    half = np.arcsin(np.minimum(radius / distance, 1.0))
    middle = towards.mean(axis=0)
    middle /= max(float(np.linalg.norm(middle)), 1e-9)
    widest = float((np.arccos(np.clip(towards @ middle, -1.0, 1.0)) + half).max())
    inside = np.flatnonzero(directions @ middle >= np.cos(min(widest, np.pi)))
    if len(offset) == 1:
        return inside
    near, least = directions.take(inside, 0), np.cos(half)
    # In blocks that stay in the processor's cache.
    size = max(1, _BLOCK // len(offset))
    blocks = []
    for i in range(0, len(near), size):
        poll()
        blocks.append((near[i : i + size] @ towards.T >= least).any(axis=1))
    return np.asarray(inside[np.concatenate([np.zeros(0, dtype=bool), *blocks])])


def _nearest(rays: Sightlines, places: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "N"]:
    """Return the distance of each ray's line to the nearest of the places [m]."""
    best = np.full(len(rays), np.inf)
    for place in places:
        offset = place - rays.start
        along = (offset * rays.direction).sum(axis=1)
        best = np.minimum(best, np.sqrt(np.maximum((offset**2).sum(axis=1) - along**2, 0.0)))
    return best


def sight_index(cloud: Cloud) -> SightIndex:
    """Prepare all rays of a cloud, those without a return included."""
    starts, ends = cloud.rays
    offset = ends - starts
    length = np.linalg.norm(offset, axis=1)
    keep = length > 1e-3
    return index_of(Sightlines(np.asarray(starts[keep]), offset[keep] / length[keep, None], length[keep]))


def index_of(rays: Sightlines) -> SightIndex:
    """Prepare rays for the search of those that pass a place."""
    if not len(rays):
        return SightIndex(rays, ())
    if (rays.start == rays.start[0]).all():
        origins, of_ray = rays.start[:1], np.zeros(len(rays), dtype=np.int64)
    else:
        origins, of_ray = np.unique(rays.start, axis=0, return_inverse=True)
    if len(origins) > _MOST_ORIGINS:
        return SightIndex(rays, ())
    groups = []
    for i, origin in enumerate(origins):
        numbers = np.flatnonzero(of_ray.reshape(-1) == i)
        groups.append((np.asarray(origin), numbers, rays.direction[numbers]))
    return SightIndex(rays, tuple(groups))
