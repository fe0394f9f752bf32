"""Rays of a scan (start, direction, length), and a search for rays that pass near given positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.stopping import poll
from perception.cloud import Cloud

_MOST_ORIGINS = 12
_BLOCK = 50_000
_CELL = 0.03  # edge of the cells that sort unit directions
_ROUNDING = 1e-6  # of angles [rad]


@dataclass(frozen=True)
class Sightlines:
    """Rays of a scan.

    Attributes:
        length: (N,) distance to the return, or the free distance of a ray without a return [m].
    """

    start: Float[np.ndarray, "N 3"]
    direction: Float[np.ndarray, "N 3"]
    length: Float[np.ndarray, "N"]

    def __len__(self) -> int:
        return len(self.length)

    @property
    def ends(self) -> Float[np.ndarray, "N 3"]:
        """(N, 3) end points of the rays [m]."""
        return np.asarray(self.start + self.length[:, None] * self.direction)

    def select(self, keep: Bool[np.ndarray, "N"] | Int[np.ndarray, "K"]) -> Sightlines:
        """Return only these rays."""
        if keep.dtype == np.bool_:
            keep = np.flatnonzero(keep)
        return Sightlines(self.start.take(keep, 0), self.direction.take(keep, 0), self.length.take(keep))

    def thin(self, most: int) -> Sightlines:
        """Return every k-th ray, at most ``most`` in all."""
        return self if len(self) <= most else self.select(np.arange(0, len(self), -(-len(self) // most)))


@dataclass(frozen=True)
class RayGroup:
    """Rays with a common start, sorted by cells of their directions.

    Attributes:
        start: (3,) [m].
        numbers: (K,) indices of the rays, cell by cell.
        directions: (K, 3) unit, in the same order.
        borders: (C + 1,) position of each cell's first ray, and K.
        middles: (C, 3) unit, middle direction of each cell.
        spreads: (C,) largest angle between a cell's middle and its rays [rad].
    """

    start: Float[np.ndarray, "3"]
    numbers: Int[np.ndarray, "K"]
    directions: Float[np.ndarray, "K 3"]
    borders: Int[np.ndarray, "C1"]
    middles: Float[np.ndarray, "C 3"]
    spreads: Float[np.ndarray, "C"]

    @staticmethod
    def of(
        start: Float[np.ndarray, "3"], numbers: Int[np.ndarray, "K"], directions: Float[np.ndarray, "K 3"]
    ) -> RayGroup:
        """Return the rays of a start, sorted; ``directions`` in the order of ``numbers``."""
        cell = np.floor((directions + 1.0) / _CELL).astype(np.int64)
        side = int(2.0 / _CELL) + 2
        cell_number = (cell[:, 0] * side + cell[:, 1]) * side + cell[:, 2]
        order = np.argsort(cell_number, kind="stable")
        directions, cell_number = directions[order], cell_number[order]
        first = np.flatnonzero(np.concatenate([[True], cell_number[1:] != cell_number[:-1]]))
        middles = np.add.reduceat(directions, first, axis=0)
        middles /= np.maximum(np.linalg.norm(middles, axis=1), 1e-9)[:, None]
        borders = np.append(first, len(order))
        cosine = np.einsum("ki,ki->k", directions, np.repeat(middles, np.diff(borders), axis=0))
        spreads = np.arccos(np.clip(np.minimum.reduceat(cosine, first), -1.0, 1.0)) + _ROUNDING
        return RayGroup(start, numbers[order], directions, borders, middles, spreads)

    def list_rays(self, cells: Int[np.ndarray, "S"]) -> Int[np.ndarray, "M"]:
        """Return the positions of the rays of some cells."""
        if not len(cells):
            return np.zeros(0, dtype=np.int64)
        first, counts = self.borders[cells], (self.borders[1:] - self.borders[:-1])[cells]
        until = np.cumsum(counts)
        return np.asarray(np.repeat(first - until + counts, counts) + np.arange(int(until[-1])))


@dataclass(frozen=True)
class SightIndex:
    """Index of all rays of a scan for the search of rays near given positions.

    Attributes:
        groups: the rays with a common start; empty if there are too many starts for grouping to be faster.
    """

    rays: Sightlines
    groups: tuple[RayGroup, ...]

    def passing(self, places: Float[np.ndarray, "K 3"], radius: float, most: int | None = None) -> Sightlines:
        """Return rays that pass a position within about ``radius`` [m] and do not end well before it.

        Args:
            most: if there are more, every k-th of them is returned, at most this many in all.
        """
        centre = places.mean(axis=0)
        size = radius + float(np.linalg.norm(places - centre, axis=1).max())
        if self.groups:
            parts = [self._of_group(group, places, radius, centre, size) for group in self.groups]
            numbers = parts[0] if len(parts) == 1 else np.concatenate(parts)
            if most is not None and len(numbers) > most:
                numbers = numbers[:: -(-len(numbers) // most)]
            return self.rays.select(numbers)
        along = ((centre - self.rays.start) * self.rays.direction).sum(axis=1)
        rays = self.rays.select((along > -size) & (self.rays.length > along - size))
        rays = rays.select(_nearest(rays, places) <= radius)
        return rays if most is None else rays.thin(most)

    def _of_group(
        self,
        group: RayGroup,
        places: Float[np.ndarray, "K 3"],
        radius: float,
        centre: Float[np.ndarray, "3"],
        size: float,
    ) -> Int[np.ndarray, "M"]:
        """Return the indices of the rays of one group that pass a position, as ``passing`` does, in order."""
        inside = _in_cones(group, places - group.start, radius)
        numbers = group.numbers.take(inside)
        along = group.directions.take(inside, 0) @ (centre - group.start)
        return np.sort(numbers[(along > -size) & (self.rays.length.take(numbers) > along - size)])


def _in_cones(group: RayGroup, offset: Float[np.ndarray, "K 3"], radius: float) -> Int[np.ndarray, "M"]:
    """Return positions of the rays of a group that pass an offset from its start within ``radius`` [m].

    Cells of directions that lie in a cone whole, or outside of all cones, are decided without their rays.
    """
    poll()
    distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-6)
    towards = offset / distance[:, None]
    half = np.arcsin(np.minimum(radius / distance, 1.0))
    middle = towards.mean(axis=0)
    middle /= max(float(np.linalg.norm(middle)), 1e-9)
    widest = min(float((_angle(towards @ middle) + half).max()), np.pi)
    off = _angle(group.middles @ middle)
    cells = np.flatnonzero(off <= widest + group.spreads)
    if len(offset) == 1:
        is_within = off[cells] + group.spreads[cells] <= half
        is_open = ~is_within
    else:
        off, spreads = _angle(group.middles[cells] @ towards.T), group.spreads[cells, None]
        is_within = (off + spreads <= half).any(axis=1)
        is_open = (off <= half + spreads).any(axis=1) & ~is_within
    open_rays = group.list_rays(cells[is_open])
    near, least = group.directions.take(open_rays, 0), np.cos(half)
    # Blocks fit into the processor's cache.
    size = max(1, _BLOCK // len(offset))
    blocks = [np.zeros(0, dtype=bool)]
    for i in range(0, len(near), size):
        poll()
        is_near = near[i : i + size] @ towards.T >= least
        blocks.append(is_near[:, 0] if len(offset) == 1 else is_near.any(axis=1))
    return np.concatenate([group.list_rays(cells[is_within]), open_rays[np.concatenate(blocks)]])


def _angle(cosine: Float[np.ndarray, "*K"]) -> Float[np.ndarray, "*K"]:
    return np.asarray(np.arccos(np.minimum(np.maximum(cosine, -1.0), 1.0)))


def _nearest(rays: Sightlines, places: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "N"]:
    """Return the distance of each ray's line to the nearest position [m]."""
    best = np.full(len(rays), np.inf)
    for place in places:
        offset = place - rays.start
        along = (offset * rays.direction).sum(axis=1)
        best = np.minimum(best, np.sqrt(np.maximum((offset**2).sum(axis=1) - along**2, 0.0)))
    return best


def sight_rays(cloud: Cloud) -> Sightlines:
    """Return all rays of a cloud, including rays without a return."""
    starts, ends = cloud.rays
    offset = ends - starts
    length = np.linalg.norm(offset, axis=1)
    keep = length > 1e-3
    return Sightlines(np.asarray(starts[keep]), offset[keep] / length[keep, None], length[keep])


def sight_index(cloud: Cloud) -> SightIndex:
    """Index all rays of a cloud, including rays without a return."""
    return index_of(sight_rays(cloud))


def index_of(rays: Sightlines) -> SightIndex:
    """Index rays for the search of rays near given positions."""
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
        groups.append(RayGroup.of(np.asarray(origin), numbers, rays.direction[numbers]))
    return SightIndex(rays, tuple(groups))
