"""Convex slabs of planes: outlines cut so that no slab covers an opening, and extended by hulls beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from costs.stopping import poll
from perception.convex.freespace import FreeSpace
from perception.convex.hulls import Hull, make_hull
from perception.convex.planes import Plane

_CELL = 0.02
_BEHIND = 0.035
_PAD = 0.006
_MOST_PAD = 0.03
FRONT = 0.012
_BACK = 0.017
_WORTHWHILE = 0.05
_NOISE = 0.001
_MOST_CORNERS = 32
_BESIDE = 0.06
# Three times the range noise of a usual lidar [m].
_IN_PLANE = 0.03
_ASIDE = 0.12
_FEW = 1


@dataclass(frozen=True)
class Slab:
    """A convex patch of a plane with a thickness.

    Attributes:
        outline: (K, 2) corners in the plane's basis [m], counter-clockwise.
        vertices: (2 K, 3) front and back corners in the world [m].
        faces: (K, 3) half-planes ``a . u + b <= 0`` of the outline.
    """

    outline: Float[np.ndarray, "K 2"]
    vertices: Float[np.ndarray, "V 3"]
    faces: Float[np.ndarray, "K 3"]

    @property
    def area(self) -> float:
        """Area of the outline [m^2]."""
        return _measure_area(self.outline)


@dataclass(frozen=True)
class _Region:
    """Members in the plane's basis (``flat``) and a grid of openings from corner ``lower`` [m]."""

    flat: Float[np.ndarray, "N 2"]
    lower: Float[np.ndarray, "2"]
    pierced: Bool[np.ndarray, "U V"]


def make_slabs(
    plane: Plane,
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "*R 3"],
    ends: Float[np.ndarray, "R 3"],
    free: FreeSpace,
    apart: Float[np.ndarray, "N"] | None = None,
    gaps: Float[np.ndarray, "G 2"] | None = None,
) -> list[Slab]:
    """Return convex slabs that cover the plane's members and no opening.

    Args:
        points: (N, 3) cloud that the plane's members index [m].
        apart: (N,) distance of each point to its neighbours; slabs extend past their points by half of it [m].
        gaps: further positions that no slab may cover, in the plane's basis [m].
    """
    flat = points[plane.members] @ plane.basis.T
    openings = [
        _find_crossings(plane, starts, ends),
        _find_free_cells(plane, flat, free),
        *([] if gaps is None else [gaps]),
    ]
    region = _make_region(flat, np.concatenate(openings))
    parts: list[Int[np.ndarray, "K"]] = []
    todo = [np.arange(len(flat))]
    while todo:
        indices = todo.pop()
        open_cells = _find_open_cells(region, _make_outline(flat[indices]))
        if len(indices) < 4 or not len(open_cells):
            parts.append(indices)
        else:
            todo.extend(indices[side] for side in _cut(flat[indices], open_cells))
    parts = _merge_parts(region, parts)
    spacing = np.zeros(len(flat)) if apart is None else apart[plane.members]
    return [_make_slab(plane, region, part, float(np.median(spacing[part]))) for part in parts]


def _make_region(flat: Float[np.ndarray, "N 2"], opened: Float[np.ndarray, "H 2"]) -> _Region:
    """Mark cells that contain an opening, unless they or a neighbouring cell contain a member."""
    lower = flat.min(axis=0) - 2 * _CELL
    shape = np.ceil((flat.max(axis=0) + 2 * _CELL - lower) / _CELL).astype(int) + 1
    hit = ndimage.binary_dilation(_rasterise(flat, lower, shape), structure=np.ones((3, 3), dtype=bool))
    return _Region(flat, lower, _rasterise(opened, lower, shape) & ~hit)


def _find_crossings(
    plane: Plane, starts: Float[np.ndarray, "*R 3"], ends: Float[np.ndarray, "R 3"]
) -> Float[np.ndarray, "K 2"]:
    """Return where rays crossed the plane, in its basis [m]; both directions count, since a scan may be from behind."""
    poll()
    before, after = starts @ plane.normal - plane.offset, ends @ plane.normal - plane.offset
    through = np.flatnonzero((np.minimum(before, after) < -_BEHIND) & (np.maximum(before, after) > _BEHIND))
    first, last = starts, ends[through]
    if starts.ndim == 2:
        before, first = before[through], starts[through]
    t = before / (before - after[through])
    u, v = (first @ axis + t * (last @ axis - first @ axis) for axis in plane.basis)
    return np.stack([u, v], axis=1)


def _find_free_cells(plane: Plane, flat: Float[np.ndarray, "N 2"], free: FreeSpace) -> Float[np.ndarray, "K 2"]:
    """Return the free cells behind the plane in a slab over the whole region, where the surface bends away [m].

    Free cells before the plane do not count: rays that graze the surface always leave some.
    """
    low, high = flat.min(axis=0), flat.max(axis=0)
    corners = np.array([[u, v] for u in (low[0], high[0]) for v in (low[1], high[1])]) @ plane.basis
    corners = corners + plane.offset * plane.normal
    cells = free.list_cells(corners.min(axis=0) - FRONT, corners.max(axis=0) + FRONT)
    distance = cells @ plane.normal - plane.offset
    inside = (distance < -0.25 * free.size) & (distance > 0.25 * free.size - _BACK)
    return np.asarray(cells[inside] @ plane.basis.T)


def _rasterise(
    flat: Float[np.ndarray, "N 2"], lower: Float[np.ndarray, "2"], shape: np.ndarray
) -> Bool[np.ndarray, "U V"]:
    grid = np.zeros(shape, dtype=bool)
    u, v = (np.floor((column - low) / _CELL) for column, low in zip(flat.T, lower, strict=True))
    inside = (u >= 0) & (u < shape[0]) & (v >= 0) & (v < shape[1])
    grid[u[inside].astype(int), v[inside].astype(int)] = True
    return grid


def _make_outline(
    flat: Float[np.ndarray, "N 2"], pad: float = 0.0
) -> tuple[Float[np.ndarray, "K 2"], Float[np.ndarray, "F 3"]]:
    """Return corners, counter-clockwise, and half-planes of the convex hull, grown by ``pad`` [m] on all sides."""
    poll()
    if pad > 0.0:
        flat = _pad_points(flat, pad)
    try:
        hull = ConvexHull(flat)
    except (QhullError, ValueError):
        return _make_outline(flat, 0.002)
    return flat[hull.vertices], hull.equations


def _pad_points(flat: Float[np.ndarray, "N 2"], pad: float) -> Float[np.ndarray, "M 2"]:
    return np.asarray((flat[:, None, :] + pad * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])).reshape(-1, 2))


def _find_open_cells(
    region: _Region, outline: tuple[Float[np.ndarray, "K 2"], Float[np.ndarray, "F 3"]]
) -> Float[np.ndarray, "H 2"]:
    """Return centres of the openings inside the outline [m]; none if they cover at most 0.1 % of its area (noise)."""
    corners, faces = outline
    first = np.floor((corners.min(axis=0) - region.lower) / _CELL).astype(int).clip(0)
    last = np.ceil((corners.max(axis=0) - region.lower) / _CELL).astype(int)
    cells = np.argwhere(region.pierced[first[0] : last[0] + 1, first[1] : last[1] + 1]) + first
    centres = (cells + 0.5) * _CELL + region.lower
    inside = centres[(centres @ faces[:, :2].T + faces[:, 2] <= 0.0).all(axis=1)]
    return np.asarray(inside if len(inside) * _CELL**2 > _NOISE * _measure_area(corners) else inside[:0])


def _measure_area(corners: Float[np.ndarray, "K 2"]) -> float:
    x, y = corners.T
    return 0.5 * abs(float(x[:-1] @ y[1:] - y[:-1] @ x[1:] + x[-1] * y[0] - y[-1] * x[0]))


def _cut(
    flat: Float[np.ndarray, "N 2"], open_cells: Float[np.ndarray, "H 2"]
) -> tuple[Int[np.ndarray, "K"], Int[np.ndarray, "M"]]:
    """Cut the points into two groups: the largest that a straight line separates from all openings, and the rest.

    Lines touch the outermost openings, along the plane's basis or the points' principal axes.  If the group has
    less than 5 % of the points, they are halved across their longest axis.
    """
    frames = (np.eye(2), np.linalg.eigh(np.cov(flat.T))[1])
    best = np.zeros(len(flat), dtype=bool)
    for frame in frames:
        turned, cells = flat @ frame, open_cells @ frame
        for axis in range(2):
            for side in (turned[:, axis] < cells[:, axis].min(), turned[:, axis] > cells[:, axis].max()):
                best = side if side.sum() > best.sum() else best
    if best.sum() >= _WORTHWHILE * len(flat):
        return np.flatnonzero(best), np.flatnonzero(~best)
    longest = flat @ frames[1][:, 1]
    order = np.argsort(longest, kind="stable")
    return order[: len(flat) // 2], order[len(flat) // 2 :]


def _merge_parts(region: _Region, parts: list[Int[np.ndarray, "K"]]) -> list[Int[np.ndarray, "K"]]:
    """Merge parts, smallest first, with the neighbour that gives the least bounding area, if no opening is covered."""
    waiting = sorted((_Part.of(region, part) for part in parts), key=_Part.rank)
    kept: list[Int[np.ndarray, "K"]] = []
    while waiting:
        part = waiting.pop(0)
        options = []
        for i in map(int, part.find_beside(waiting)):
            joint = np.concatenate([part.members, waiting[i].members])
            outline = _make_outline(region.flat[joint])
            if not len(_find_open_cells(region, outline)):
                options.append((float(np.prod(np.ptp(outline[0], axis=0))), i, joint))
        if options:
            _, i, joint = min(options, key=lambda option: option[:2])
            waiting[i] = _Part.of(region, joint)
            waiting.sort(key=_Part.rank)
        else:
            kept.append(part.members)
    return kept


@dataclass(frozen=True)
class _Part:
    """Some members of a plane and the corners of their bounding rectangle in the plane's basis [m]."""

    members: Int[np.ndarray, "K"]
    lower: Float[np.ndarray, "2"]
    upper: Float[np.ndarray, "2"]

    @classmethod
    def of(cls, region: _Region, members: Int[np.ndarray, "K"]) -> _Part:
        flat = region.flat[members]
        return cls(members, flat.min(axis=0), flat.max(axis=0))

    def rank(self) -> tuple[int, int]:
        """Sort key: number of members, first member."""
        return len(self.members), int(self.members[0])

    def find_beside(self, others: list[_Part]) -> Int[np.ndarray, "J"]:
        """Return indices of the other parts whose bounding rectangles are at most 6 cm away."""
        lower = np.array([other.lower for other in others]).reshape(-1, 2)
        upper = np.array([other.upper for other in others]).reshape(-1, 2)
        near = (lower <= self.upper + _BESIDE) & (upper >= self.lower - _BESIDE)
        return np.flatnonzero(near.all(axis=1))


def join_slab(plane: Plane, slab: Slab, flat: Float[np.ndarray, "K 2"]) -> Slab:
    """Return a slab over the convex hull of a slab's outline and further positions in the plane's basis [m]."""
    corners, faces = _make_outline(np.concatenate([slab.outline, _pad_points(flat, _PAD)]))
    return _thicken_outline(plane, corners, faces)


def _make_slab(plane: Plane, region: _Region, part: Int[np.ndarray, "K"], apart: float) -> Slab:
    """Return the slab of some members, padded by half their spacing ``apart`` [m] unless it then covers an opening."""
    flat = region.flat[part]
    pad = min(0.5 * apart, _MOST_PAD)
    if pad > _PAD:
        outline = _make_outline(flat, pad)
        if not len(_find_open_cells(region, outline)):
            return _thicken_outline(plane, *outline)
    return _thicken_outline(plane, *_make_outline(flat, _PAD))


def _thicken_outline(plane: Plane, corners: Float[np.ndarray, "K 2"], faces: Float[np.ndarray, "F 3"]) -> Slab:
    """Return the slab of an outline, with at most 32 corners."""
    if len(corners) > _MOST_CORNERS:
        corners, faces = _drop_corners(corners)
    middle = corners @ plane.basis + plane.offset * plane.normal
    vertices = np.concatenate([middle + FRONT * plane.normal, middle - _BACK * plane.normal])
    return Slab(corners, vertices, faces)


def _drop_corners(corners: Float[np.ndarray, "K 2"]) -> tuple[Float[np.ndarray, "M 2"], Float[np.ndarray, "F 3"]]:
    """Return an outline of 32 corners around the given one; sides whose removal adds least area are removed first."""
    while len(corners) > _MOST_CORNERS:
        before, last, after = np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0), np.roll(corners, -2, axis=0)
        ahead, back, side = corners - before, last - after, last - corners
        turn = _cross(ahead, -back)
        meet = _cross(side, back) / np.where(turn > 0.0, -turn, 1.0)
        added = np.where((turn > 0.0) & (meet >= 0.0), _cross(ahead, side) * meet, np.inf)
        least = int(np.argmin(added))
        if not np.isfinite(added[least]):
            break
        corners = corners.copy()
        corners[least] += meet[least] * ahead[least]
        corners = np.delete(corners, (least + 1) % len(corners), axis=0)
    return _make_outline(corners)


def _cross(a: Float[np.ndarray, "K 2"], b: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "K"]:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def attach_hulls(
    slabs: Sequence[tuple[Plane, Slab]], hulls: Sequence[Hull], free: FreeSpace
) -> tuple[list[tuple[Plane, Slab]], list[Hull]]:
    """Return the slabs, extended by hulls that lie in their plane, and the remaining hulls.

    Where scan lines are far apart, the ends of a surface have too few points to be inliers of its plane.  A hull joins
    a slab if it lies in the slab's plane, at most 12 cm beside it, and the extended slab contains at most one more
    free cell; of several slabs, the one whose area grows least takes the hull.

    Args:
        hulls: hulls of the points on no plane, without skin.
    """
    grown, left = list(slabs), []
    free_before = [_count_free_cells(slab, free) for _, slab in slabs]
    lower = np.array([slab.vertices.min(axis=0) for _, slab in slabs]).reshape(-1, 3)
    upper = np.array([slab.vertices.max(axis=0) for _, slab in slabs]).reshape(-1, 3)
    for hull in sorted(hulls, key=lambda hull: hull.volume):
        options = []
        is_beside = (hull.lower <= upper + _ASIDE).all(axis=1) & (hull.upper >= lower - _ASIDE).all(axis=1)
        for i in map(int, np.flatnonzero(is_beside)):
            plane, slab = grown[i]
            if np.abs(hull.vertices @ plane.normal - plane.offset).max() > _IN_PLANE:
                continue
            joint = join_slab(plane, slab, hull.vertices @ plane.basis.T)
            if _count_free_cells(joint, free) <= free_before[i] + _FEW:
                options.append((joint.area - slab.area, i, joint))
        if options:
            _, i, joint = min(options, key=lambda option: option[:2])
            grown[i] = grown[i][0], joint
            lower[i], upper[i] = joint.vertices.min(axis=0), joint.vertices.max(axis=0)
        else:
            left.append(hull)
    return grown, left


def _count_free_cells(slab: Slab, free: FreeSpace) -> int:
    return free.count_inside(make_hull(slab.vertices).simplified)
