"""Convex hulls of points: split until no hull contains free space, then merged while they contain none."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage, sparse
from scipy.spatial import cKDTree

from costs.progress import tell
from costs.stopping import poll
from perception.cleaning.clean import nearest
from perception.convex.freespace import FreeSpace, carve
from perception.convex.hulls import SKIN, Hull, make_hull, thicken
from perception.convex.towards import Sheaf

_SMALLEST = 0.03
_NEIGHBOURS = 10
_MOST_FREE_CELLS = 2
_PROBES = 12
_CELL = 0.01
_CLOSE = 2
_AROUND = 0.03
_FEW = 3
# Merging fewer is one step of a longer one.
_MANY_HULLS = 50
# Smaller hulls consist of noise and skin only; free space in them is noise and is not refined [m^3].
_LEAST_VOLUME = 5e-5


@dataclass(frozen=True)
class SplitAllowance:
    """Free space that a hull may contain because of noise.

    Attributes:
        volume: largest free volume [m^3].
        share: largest share of the hull (both limits apply).
        skin: growth of the hull before the test [m].
    """

    volume: float = 2.4e-5
    share: float = 0.02
    skin: float = 0.0


_DEFAULT = SplitAllowance()
_REFINED = SplitAllowance(share=0.03, skin=SKIN)


def find_clusters(points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "*N 3"]) -> list[Int[np.ndarray, "K"]]:
    """Return the indices of each cluster of points; gaps up to max(5 cm, 4.5 % of range) connect."""
    if len(points) == 1:
        return [np.array([0])]
    k = min(_NEIGHBOURS, len(points))
    distance, neighbour = nearest(cKDTree(points), points, np.arange(1, k + 1))
    link = np.maximum(0.05, 0.045 * np.linalg.norm(points - starts, axis=1))
    row, column = np.nonzero(distance <= link[:, None])
    links = np.ones(len(row), dtype=bool), (row, neighbour[row, column])
    graph = sparse.csr_matrix(links, shape=(len(points), len(points)))
    _, labels = sparse.csgraph.connected_components(graph, directed=False)
    order = np.argsort(labels, kind="stable")
    return list(np.split(order, np.flatnonzero(np.diff(labels[order])) + 1))


def split(
    points: Float[np.ndarray, "N 3"],
    members: Int[np.ndarray, "K"],
    free: FreeSpace,
    allowed: SplitAllowance = _DEFAULT,
) -> list[Hull]:
    """Return hulls of the members, cut in two until each contains no free space or is at most 3 cm long."""
    done: list[Hull] = []
    todo = [members]
    while todo:
        indices = todo.pop()
        hull = make_hull(points[indices], indices)
        if len(indices) < 4 or (hull.upper - hull.lower).max() <= _SMALLEST or is_free_of(hull, free, allowed):
            done.append(hull)
        else:
            todo.extend(indices[side] for side in _cut(points[indices]))
    return done


def is_free_of(hull: Hull, free: FreeSpace, allowed: SplitAllowance = _DEFAULT) -> bool:
    """Return whether the hull contains no more free space than ``allowed``."""
    if allowed.skin > 0.0:
        hull = make_hull(thicken(hull.vertices, allowed.skin), hull.members)
    most = int(min(allowed.volume, allowed.share * hull.volume) / free.size**3 + 1e-6)
    return free.count_inside(hull, most) <= most


def _may_be_free(hull: Hull, free: FreeSpace, allowed: SplitAllowance) -> bool:
    """Return False if ``is_free_of`` is certain to be False; quicker, since it ignores the skin."""
    most = int(allowed.volume / free.size**3 + 1e-6)
    return free.count_inside(hull, most) <= most


def _cut(points: Float[np.ndarray, "N 3"]) -> tuple[Int[np.ndarray, "K"], Int[np.ndarray, "M"]]:
    """Cut the points in two across a principal or world axis, minimising the summed volume of both bounding boxes."""
    axes = np.linalg.eigh(np.cov((points - points.mean(axis=0)).T))[1]
    best: tuple[float, Int[np.ndarray, "K"], int] | None = None
    for frame in (axes, np.eye(3)):
        turned = points @ frame
        for axis in range(3):
            order = np.argsort(turned[:, axis], kind="stable")
            cost = _sweep_cost(turned[order])
            at = int(np.argmin(cost))
            if best is None or cost[at] < best[0]:
                best = (float(cost[at]), order, at + 1)
    if best is None:
        raise AssertionError("three axes always give a cut")
    _, order, at = best
    return order[:at], order[at:]


def _sweep_cost(ordered: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N-1"]:
    """Return the summed volume of the bounding boxes of the first i + 1 and the other points, each 1 cm larger."""
    skin = 0.01
    low, high = np.minimum.accumulate(ordered), np.maximum.accumulate(ordered)
    low_r, high_r = np.minimum.accumulate(ordered[::-1])[::-1], np.maximum.accumulate(ordered[::-1])[::-1]
    first = np.prod(high[:-1] - low[:-1] + skin, axis=1)
    second = np.prod(high_r[1:] - low_r[1:] + skin, axis=1)
    return np.asarray(first + second)


def merge(
    hulls: Sequence[Hull],
    free: FreeSpace,
    gap: float | Float[np.ndarray, "H"],
    allowed: SplitAllowance = _DEFAULT,
    most_left: int = 1,
) -> list[Hull]:
    """Merge neighbouring hulls, least added volume first, while the merged hull contains no free space.

    Args:
        gap: largest distance between the bounding boxes of neighbours; per hull, the smaller of both counts [m].
        allowed: free space that a merged hull may contain.
        most_left: number of hulls at which merging ends.
    """
    merger = _Merger(list(hulls), free, np.broadcast_to(gap, len(hulls)), allowed)
    for i in range(len(hulls)):
        merger.propose(i, i)
    n_tried = n_merged = 0
    while merger.queue and len(hulls) - n_merged > most_left:
        poll()
        n_tried += 1
        if len(hulls) > _MANY_HULLS:
            tell("merge hulls", n_tried / (n_tried + len(merger.queue)))
        _, i, j, joint = heapq.heappop(merger.queue)
        if merger.is_alive[i] and merger.is_alive[j] and is_free_of(joint, free, allowed):
            merger.replace(i, j, joint)
            n_merged += 1
    return [hull for hull, is_alive in zip(merger.hulls, merger.is_alive, strict=True) if is_alive]


class _Merger:
    """Hulls, which of them are not merged yet (``is_alive``), and a queue of candidate merges."""

    def __init__(
        self, hulls: list[Hull], free: FreeSpace, gap: Float[np.ndarray, "H"], allowed: SplitAllowance
    ) -> None:
        self.hulls = hulls
        self.queue: list[tuple[float, int, int, Hull]] = []
        self.is_alive = np.ones(len(hulls), dtype=bool)
        self._free, self._gap, self._allowed = free, gap, allowed
        self._lower = np.array([hull.lower for hull in hulls]).reshape(-1, 3)
        self._upper = np.array([hull.upper for hull in hulls]).reshape(-1, 3)

    def replace(self, i: int, j: int, joint: Hull) -> None:
        """Replace both hulls by the merged one and queue merges with its neighbours."""
        self.is_alive[[i, j]] = False
        self.hulls.append(joint)
        self.is_alive = np.append(self.is_alive, True)
        self._lower = np.concatenate([self._lower, joint.lower[None]])
        self._upper = np.concatenate([self._upper, joint.upper[None]])
        self._gap = np.append(self._gap, self._gap[[i, j]].max())
        self.propose(len(self.hulls) - 1, len(self.hulls) - 1)

    def propose(self, i: int, before: int) -> None:
        """Queue merges of hull ``i`` with its neighbours among the first ``before`` hulls."""
        gap = np.minimum(self._gap[i], self._gap[:before])[:, None]
        near = (self._lower[:before] <= self._upper[i] + gap) & (self._upper[:before] >= self._lower[i] - gap)
        hull = self.hulls[i]
        for j in np.flatnonzero(near.all(axis=1) & self.is_alive[:before]):
            other = self.hulls[j]
            if _is_open_between(hull, other, self._free):
                continue
            members = np.concatenate([hull.members, other.members])
            joint = make_hull(np.concatenate([hull.vertices, other.vertices]), members)
            if _may_be_free(joint, self._free, self._allowed):
                heapq.heappush(self.queue, (joint.volume - hull.volume - other.volume, i, int(j), joint))


def _is_open_between(hull: Hull, other: Hull, free: FreeSpace) -> bool:
    """Return whether free cells half-way between two hulls already rule out a merge."""
    a, b = (hull.vertices[:: -(-len(hull.vertices) // _PROBES)] for hull in (hull, other))
    centre = 0.5 * (a.mean(axis=0) + b.mean(axis=0))
    halfway = 0.5 * (a[:, None] + b).reshape(-1, 3)
    # Moved towards the centre, so that none lies on the surface of the merged hull.
    halfway = centre + 0.9 * (halfway - centre)
    hits = halfway[free.contains(halfway)]
    if len(hits) <= _MOST_FREE_CELLS:
        return False
    cells = np.floor((hits - free.lower) / free.size).astype(np.int64)
    return len(np.unique(np.ravel_multi_index(tuple(cells.T), free.free.shape))) > _MOST_FREE_CELLS


def refine_hulls(
    hulls: Sequence[Hull],
    points: Float[np.ndarray, "N 3"],
    surface: Float[np.ndarray, "M 3"],
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    gap: float,
    doubt: float = 0.0,
) -> list[Hull]:
    """Split hulls until they contain, skin included, no free space more than 2 cm from any point.

    The hull of a single scan line around a corner has no volume, but with its skin it is a sheet through the free
    space inside the corner.

    Args:
        points: (N, 3) points that the hulls' members index [m].
        surface: (M, 3) all surface points of the scan [m].
        gap: parts whose bounding boxes are farther apart are not merged again [m].
        doubt: distance from points within which no space counts as free [m].
    """
    is_large = [make_hull(thicken(hull.vertices, SKIN), hull.members).volume >= _LEAST_VOLUME for hull in hulls]
    passing = _Passing.of(*rays, sum(is_large))
    done: list[Hull] = []
    for i, (hull, is_split) in enumerate(zip(hulls, is_large, strict=True)):
        tell("refine hulls", i / len(hulls))
        if not is_split:
            done.append(hull)
            continue
        lower = _CELL * np.floor((hull.lower - _AROUND) / _CELL)
        fine = _carve_fine(passing, surface, lower, hull.upper + _AROUND, doubt)
        if is_free_of(hull, fine, _REFINED):
            done.append(hull)
        else:
            done += merge(split(points, hull.members, fine, _REFINED), fine, gap, _REFINED)
    return done


def _carve_fine(
    passing: _Passing,
    surface: Float[np.ndarray, "M 3"],
    lower: Float[np.ndarray, "3"],
    upper: Float[np.ndarray, "3"],
    doubt: float,
) -> FreeSpace:
    """Return the 1 cm cells in a box that rays passed through, more than about 2 cm and ``doubt`` from any point."""
    near = passing.near(lower, upper)
    inside = surface
    for axis in range(3):
        inside = inside[(inside[:, axis] >= lower[axis]) & (inside[:, axis] <= upper[axis])]
    free = carve(passing.starts[near], passing.ends[near], inside, lower, upper, _CELL)
    held = np.zeros(free.free.shape, dtype=bool)
    cells = np.floor((inside - lower) / free.size).astype(int)
    held[tuple(cells[(cells < held.shape).all(axis=1)].T)] = True
    return FreeSpace(
        free.lower, free.size, free.free & ~ndimage.binary_dilation(held, iterations=max(_CLOSE, round(doubt / _CELL)))
    )


@dataclass(frozen=True)
class _Passing:
    """Rays of a scan, prepared to find those that pass near a box.

    Attributes:
        starts, ends: (R, 3) [m].
        sheaf: the rays sorted by direction, if they share one start and many boxes are searched.
    """

    starts: Float[np.ndarray, "R 3"]
    ends: Float[np.ndarray, "R 3"]
    sheaf: Sheaf | None

    @classmethod
    def of(cls, starts: Float[np.ndarray, "*R 3"], ends: Float[np.ndarray, "R 3"], n_places: int) -> _Passing:
        """Prepare the rays for ``n_places`` searches."""
        sheaf = Sheaf.of(starts, ends) if starts.ndim == 1 and n_places > _FEW else None
        return cls(np.broadcast_to(starts, ends.shape), ends, sheaf)

    def near(self, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> Int[np.ndarray, "K"]:
        """Return indices of rays through the bounding sphere of a box."""
        centre, radius = 0.5 * (lower + upper), 0.5 * float(np.linalg.norm(upper - lower))
        chosen = slice(None) if self.sheaf is None else self.sheaf.select_about(centre, radius)
        starts, along = self.starts[chosen], self.ends[chosen] - self.starts[chosen]
        length = np.maximum(np.sqrt(np.einsum("ij,ij->i", along, along)), 1e-9)
        along /= length[:, None]
        ahead = np.einsum("ij,ij->i", centre - starts, along).clip(0.0, length)
        apart = starts + ahead[:, None] * along - centre
        near = np.flatnonzero(np.einsum("ij,ij->i", apart, apart) <= radius**2 + 1e-9)
        return near if isinstance(chosen, slice) else chosen[near]
