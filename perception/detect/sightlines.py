"""The rays of a scan that pass a place: where each started, which way it went and where it ended."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from perception.cloud import Cloud

_MOST_ORIGINS = 12


@dataclass(frozen=True)
class Sightlines:
    """Rays of a scan.

    Attributes:
        start: (N, 3) [m].
        direction: (N, 3) unit.
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

    def selected(self, keep: Bool[np.ndarray, "N"] | Int[np.ndarray, "K"]) -> Sightlines:
        """Only these."""
        return Sightlines(self.start[keep], self.direction[keep], self.length[keep])

    def thinned(self, most: int) -> Sightlines:
        """Every k-th, so that at most ``most`` are left."""
        return self if len(self) <= most else self.selected(np.arange(0, len(self), -(-len(self) // most)))


@dataclass(frozen=True)
class SightIndex:
    """All rays of a scan, to ask for those that pass a place.

    Attributes:
        rays: all of them.
        groups: rays that share a start: the start, their numbers and a tree of their directions; empty when there
            are too many starts for trees to pay.
    """

    rays: Sightlines
    groups: tuple[tuple[Float[np.ndarray, "3"], Int[np.ndarray, "K"], cKDTree], ...]

    def passing(self, places: Float[np.ndarray, "K 3"], radius: float) -> Sightlines:
        """Rays that pass one of the places within ``radius`` (to a few percent) and do not end well before it."""
        found = [self._of_group(group, places, radius) for group in self.groups]
        candidates = np.concatenate(found) if self.groups else np.arange(len(self.rays))
        rays = self.rays.selected(candidates)
        if not len(rays):
            return rays
        centre = places.mean(axis=0)
        size = radius + float(np.linalg.norm(places - centre, axis=1).max())
        along = ((centre - rays.start) * rays.direction).sum(axis=1)
        keep = (along > -size) & (rays.length > along - size)
        if not self.groups:
            keep[keep] &= _nearest(rays.selected(keep), places) <= radius
        return rays.selected(keep)

    def _of_group(
        self,
        group: tuple[Float[np.ndarray, "3"], Int[np.ndarray, "K"], cKDTree],
        places: Float[np.ndarray, "K 3"],
        radius: float,
    ) -> Int[np.ndarray, "M"]:
        start, numbers, tree = group
        offset = places - start
        distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-6)
        chord = 2.0 * np.sin(np.arcsin(np.minimum(radius / distance, 1.0)) / 2.0)
        lists = tree.query_ball_point(offset / distance[:, None], chord)
        inside = np.unique(np.concatenate([np.asarray(one, dtype=np.int64) for one in lists]))
        return np.asarray(numbers[inside])


def _nearest(rays: Sightlines, places: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "N"]:
    """Distance of each ray's line to the nearest of the places [m]."""
    best = np.full(len(rays), np.inf)
    for place in places:
        offset = place - rays.start
        along = (offset * rays.direction).sum(axis=1)
        best = np.minimum(best, np.sqrt(np.maximum((offset**2).sum(axis=1) - along**2, 0.0)))
    return best


def sight_index(cloud: Cloud) -> SightIndex:
    """All rays of a cloud, those without a return included."""
    starts, ends = cloud.rays
    offset = ends - starts
    length = np.linalg.norm(offset, axis=1)
    keep = length > 1e-3
    return index_of(Sightlines(np.asarray(starts[keep]), offset[keep] / length[keep, None], length[keep]))


def index_of(rays: Sightlines) -> SightIndex:
    """These rays, made ready to be asked."""
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
        tree = cKDTree(rays.direction[numbers], balanced_tree=False, compact_nodes=False)
        groups.append((np.asarray(origin), numbers, tree))
    return SightIndex(rays, tuple(groups))
