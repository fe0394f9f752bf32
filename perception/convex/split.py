"""Points to convex hulls: split while a hull holds space that was seen free, then merge neighbours that need not be."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.spatial import cKDTree

from perception.convex.freespace import FreeSpace
from perception.convex.hulls import Hull, hull_of

_SMALLEST = 0.03
_NEIGHBOURS = 10
_MOST_FREE_CELLS = 2


def clusters(
    points: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "3"], floor_of_link: float = 0.05
) -> list[Int[np.ndarray, "K"]]:
    """Indices of connected points, linked over max(5 cm, 4.5 % of range)."""
    if len(points) == 1:
        return [np.array([0])]
    k = min(_NEIGHBOURS, len(points))
    distance, neighbour = cKDTree(points).query(points, k=np.arange(1, k + 1), workers=-1)
    link = np.maximum(floor_of_link, 0.045 * np.linalg.norm(points - origin, axis=1))
    row, column = np.nonzero(np.asarray(distance) <= link[:, None])
    links = np.ones(len(row), dtype=bool), (row, np.asarray(neighbour)[row, column])
    graph = sparse.csr_matrix(links, shape=(len(points), len(points)))
    _, labels = sparse.csgraph.connected_components(graph, directed=False)
    order = np.argsort(labels, kind="stable")
    return list(np.split(order, np.flatnonzero(np.diff(labels[order])) + 1))


def split(points: Float[np.ndarray, "N 3"], members: Int[np.ndarray, "K"], free: FreeSpace) -> list[Hull]:
    """Hulls of the members, cut in two until none holds seen-free space (or is as small as the noise)."""
    done: list[Hull] = []
    todo = [members]
    while todo:
        indices = todo.pop()
        hull = hull_of(points[indices], indices)
        if len(indices) < 4 or (hull.upper - hull.lower).max() <= _SMALLEST or is_free_of(hull, free):
            done.append(hull)
        else:
            todo.extend(indices[side] for side in _cut(points[indices]))
    return done


def is_free_of(hull: Hull, free: FreeSpace) -> bool:
    """Whether the hull holds no more seen-free cells than noise explains."""
    inside = free.count_inside(hull.faces, hull.vertices, 0.25 * free.size)
    return inside <= _MOST_FREE_CELLS and inside * free.size**3 <= 0.01 * hull.volume


def _cut(points: Float[np.ndarray, "N 3"]) -> tuple[Int[np.ndarray, "K"], Int[np.ndarray, "M"]]:
    """The cut whose two boxes have the smallest volume together, along the points' principal or the world's axes."""
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
    """Summed volume of the boxes of the first i + 1 and the remaining points, each 1 cm larger all round."""
    skin = 0.01
    low, high = np.minimum.accumulate(ordered), np.maximum.accumulate(ordered)
    low_r, high_r = np.minimum.accumulate(ordered[::-1])[::-1], np.maximum.accumulate(ordered[::-1])[::-1]
    first = np.prod(high[:-1] - low[:-1] + skin, axis=1)
    second = np.prod(high_r[1:] - low_r[1:] + skin, axis=1)
    return np.asarray(first + second)


def merge(hulls: Sequence[Hull], may_merge: Callable[[Hull], bool], gap: float) -> list[Hull]:
    """Join neighbours, least added volume first, while ``may_merge`` accepts the joint hull.

    Args:
        hulls: what to join.
        may_merge: whether a joint hull may stand.
        gap: boxes farther apart than this are not neighbours [m].
    """
    alive: dict[int, Hull] = dict(enumerate(hulls))
    queue: list[tuple[float, int, int, Hull]] = []
    for i in alive:
        _push_pairs(queue, alive, i, [j for j in alive if j < i], may_merge, gap)
    serial = len(hulls)
    while queue:
        _, i, j, joint = heapq.heappop(queue)
        if i not in alive or j not in alive:
            continue
        del alive[i], alive[j]
        alive[serial] = joint
        _push_pairs(queue, alive, serial, [k for k in alive if k != serial], may_merge, gap)
        serial += 1
    return list(alive.values())


def _push_pairs(
    queue: list[tuple[float, int, int, Hull]],
    alive: dict[int, Hull],
    i: int,
    others: list[int],
    may_merge: Callable[[Hull], bool],
    gap: float,
) -> None:
    """Queue the acceptable joints of hull ``i`` with its neighbours."""
    if not others:
        return
    one = alive[i]
    lower = np.array([alive[j].lower for j in others])
    upper = np.array([alive[j].upper for j in others])
    near = ((lower <= one.upper + gap) & (upper >= one.lower - gap)).all(axis=1)
    for j in np.flatnonzero(near):
        other = alive[others[j]]
        joint = hull_of(np.concatenate([one.vertices, other.vertices]), np.concatenate([one.members, other.members]))
        if may_merge(joint):
            added = joint.volume - one.volume - other.volume
            heapq.heappush(queue, (added, i, others[j], joint))
