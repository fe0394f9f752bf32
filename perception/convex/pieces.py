"""A cleaned cloud to convex pieces that cover what is there and leave free what was seen free."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.scene import ConvexPiece
from perception.convex.attach import attached
from perception.convex.coarse import Coarse, coarsened
from perception.convex.evidence import evidence_of
from perception.convex.freespace import Crossing, FreeSpace
from perception.convex.hulls import SKIN, Hull, hull_of, limited, thickened
from perception.convex.piece import Piece
from perception.convex.planes import Plane, PlaneSettings, find_planes
from perception.convex.refine import refined
from perception.convex.slabs import FRONT, Slab, slabs_of
from perception.convex.smooth import smoothed
from perception.convex.spacing import spacing_of
from perception.convex.split import clusters, merge, split
from perception.convex.standing import Ground, boxes_of, still_standing, unexplained

VOXEL = 0.015
_CELL = 0.02
_WITHIN = 0.01
_BEHIND = 0.02
_GAP = 0.06
_GAP_OF_RANGE = 0.06
_SKIN_OF_SPACING = 0.4
_MOST_SKIN = 0.02
_AROUND = 0.1
_UPRIGHT = 0.17
_WALL = (0.8, 1.2)


@dataclass(frozen=True)
class Pieces:
    """Convex pieces of a cloud.

    Attributes:
        pieces: ``plane/0`` ..., ``wall/0`` ... and ``clutter/0`` ...
        timings: seconds by step.
    """

    pieces: tuple[Piece, ...]
    timings: dict[str, float]


def make_pieces(
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "*N 3"],
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    seed: int = 0,
    plane_settings: PlaneSettings | None = None,
) -> Pieces:
    """Planes become thin slabs; what is left becomes hulls that hold no seen-free space.

    Args:
        points: (N, 3) obstacle points, cleaned [m].
        starts: (3,) or (N, 3), where their rays started [m].
        rays: starts, (3,) or (R, 3), and ends (R, 3) of all rays of the scan, those of the floor, of the robot and
            those that met nothing included: evidence of free space [m].
        seed: of the plane search; the same points, in any order, and the same seed give the same pieces.
        plane_settings: what counts as a plane.
    """
    if not len(points):
        return Pieces((), {})
    clock = _Clock()
    rays = _from_one_place(rays)
    coarse = coarsened(points, starts, VOXEL)
    free = _crossing(coarse, rays).seen_free(coarse.points)
    clock.lap("free space")
    bodies = _bodies(coarse, np.arange(len(coarse.points)), rays, free, seed, plane_settings, clock)
    kept = np.ones(len(points), dtype=bool)
    pieces = _assembled([], bodies, {}, points, kept, _Groups.of(coarse), coarse, free)
    clock.lap("evidence")
    return Pieces(pieces, clock.timings)


@dataclass(frozen=True)
class Updated(Pieces):
    """Convex pieces of a new scan.

    Attributes:
        is_surface: (N,) which points are no strays: explained by a piece, its noise, or part of a surface.
        is_left_off: whether it was left off without any piece.
    """

    is_surface: Bool[np.ndarray, "N"]
    is_left_off: bool = False


def updated_pieces(
    before: Sequence[Piece],
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "*N 3"],
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    seed: int = 0,
    ground: Ground | None = None,
    judge: Callable[[Int[np.ndarray, "K"]], Bool[np.ndarray, "K"]] | None = None,
    is_enough: Callable[[Float[np.ndarray, "K 3"]], bool] = lambda _: False,
) -> Updated:
    """The pieces of a new scan, of which those that it does not contradict keep their very shape and name.

    A piece goes when rays of the new scan pass through it; where the new scan cannot see it, it stays.  New pieces are
    made of the points that none of those left explains, noise about their surfaces taken as explained.

    Args:
        before: pieces of the scan before.
        points, starts, rays, seed: see ``make_pieces``; the points need not be cleaned if there is a judge.
        ground: what else explains points.
        judge: tells which of the points of these indices surfaces stand for; it is asked only about those that no
            piece explains.
        is_enough: told the points that new pieces would be made of, says whether to leave off without any piece.
    """
    clock, kept = _Clock(), np.ones(len(points), dtype=bool)
    if not len(points) and not len(before):
        return Updated((), {}, kept)
    rays = _from_one_place(rays)
    coarse = coarsened(points, starts, VOXEL)
    groups = _Groups.of(coarse)
    crossing = _crossing(coarse, rays, before)
    free = crossing.seen_free(coarse.points[:0], _boxes(before))
    clock.lap("free space")
    standing = still_standing(before, free.beside(coarse.points), coarse)
    clock.lap("contradicted")
    if judge is not None:
        # A mixed pixel in a piece that is gone hides that rays went through it.
        hidden = standing.hidden(free)
        asked = groups.members(standing.beside(hidden, free, coarse))
        kept[asked] = judge(asked)
        clock.lap("cleaning")
        again = still_standing(
            [standing.pieces[i] for i in hidden], free.beside(coarse.points[groups.hold(kept)]), coarse
        )
        standing = standing.without(hidden, again)
        clock.lap("contradicted")
    left = unexplained(standing, coarse, ground or Ground())
    clock.lap("unexplained")
    if judge is not None:
        asked = groups.members(left.members)
        kept[asked] = judge(asked)
        left = left.among(groups.hold(kept))
        clock.lap("cleaning")
    new = left.new(coarse)
    if is_enough(points[groups.members(new)]):
        return Updated((), clock.timings, kept, is_left_off=True)
    if len(new):
        boxes = boxes_of(coarse.points[new], coarse.starts[new], _AROUND)
        free = crossing.seen_free(coarse.points[groups.hold(kept)], boxes)
        clock.lap("free space")
    bodies = _bodies(coarse, new, rays, free, seed, None, clock)
    first = {kind: 1 + max(number for _, number in of_kind) for kind, of_kind in _numbers(before)}
    pieces = _assembled(standing.pieces, bodies, first, points, kept, groups, coarse, free)
    clock.lap("evidence")
    return Updated(pieces, clock.timings, kept)


def _numbers(pieces: Sequence[Piece]) -> Iterator[tuple[str, Iterator[tuple[str, int]]]]:
    """Kinds, and for each the kind and number in the names of its pieces."""
    named = sorted((piece.kind, int(piece.name.rpartition("/")[2])) for piece in pieces)
    return groupby(named, key=lambda name: name[0])


def _bodies(
    coarse: Coarse,
    left: Int[np.ndarray, "K"],
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    free: FreeSpace,
    seed: int,
    plane_settings: PlaneSettings | None,
    clock: _Clock,
) -> list[_Body]:
    """Slabs and hulls for the points that are left."""
    if not len(left):
        return []
    points, starts = coarse.points[left], coarse.starts[left]
    planes = find_planes(points, coarse.counts[left], starts, np.random.default_rng(seed), plane_settings)
    clock.lap("planes")
    apart = spacing_of(coarse.points, coarse.starts, left)
    slabs = [(plane, slab) for plane in planes for slab in slabs_of(plane, points, *rays, free, apart)]
    clock.lap("slabs")
    points = smoothed(coarse.points, coarse.counts, coarse.starts, left)
    rest = ~_covered(points, slabs)
    hulls = _clutter(points[rest], starts[rest], free)
    hulls = refined(hulls, points[rest], coarse.points, rays, _GAP)
    slabs, hulls = attached(slabs, hulls, free)
    bodies = [
        _Body(_kind_of(plane, slab), slab.vertices, np.append(plane.normal, plane.offset)) for plane, slab in slabs
    ]
    bodies += [_Body("clutter", _skinned(hull, apart[rest], free), None) for hull in hulls]
    clock.lap("clutter")
    return bodies


class _Clock:
    """Seconds by step; a step ends when the next begins."""

    def __init__(self) -> None:
        self.timings: dict[str, float] = {}
        self._since = time.perf_counter()

    def lap(self, step: str) -> None:
        now = time.perf_counter()
        self.timings[step] = self.timings.get(step, 0.0) + now - self._since
        self._since = now


def _from_one_place(
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
) -> tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]]:
    """The rays with their start told once, (3,), where it is the same for all."""
    starts, ends = rays
    return (starts[0] if starts.ndim == 2 and len(starts) and (starts == starts[0]).all() else starts), ends


def _crossing(
    coarse: Coarse,
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    before: Sequence[Piece] = (),
) -> Crossing:
    """The rays in a grid around points and pieces, whose cells are aligned with the world's origin."""
    held = np.concatenate([coarse.points, *(piece.shape.vertices for piece in before)])
    lower = _CELL * np.floor((held.min(axis=0) - _AROUND) / _CELL)
    return Crossing.of(*rays, lower, held.max(axis=0) + _AROUND, _CELL)


def _boxes(pieces: Sequence[Piece]) -> Float[np.ndarray, "B 2 3"]:
    return np.array([(piece.hull.lower, piece.hull.upper) for piece in pieces]).reshape(-1, 2, 3)


def _clutter(points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"], free: FreeSpace) -> list[Hull]:
    """Hulls of what no plane explains, merged while they stay free."""
    if not len(points):
        return []
    hulls = [hull for members in clusters(points, starts) for hull in split(points, members, free)]
    ranges = np.linalg.norm(points - starts, axis=1)
    gaps = np.array([max(_GAP, _GAP_OF_RANGE * float(np.median(ranges[hull.members]))) for hull in hulls])
    return merge(hulls, free, gaps)


def _covered(points: Float[np.ndarray, "N 3"], slabs: list[tuple[Plane, Slab]]) -> Bool[np.ndarray, "N"]:
    """Points that a slab stands for: within 1 cm of it, its noise, and what seems to lie up to 2 cm behind it."""
    covered = np.zeros(len(points), dtype=bool)
    for plane, slab in slabs:
        covered[plane.noise] = True
        distance = points @ plane.normal - plane.offset
        near = np.flatnonzero(~covered & (distance <= FRONT + _WITHIN) & (distance >= -_BEHIND))
        flat = points[near] @ plane.basis.T
        inside = (flat @ slab.faces[:, :2].T + slab.faces[:, 2] <= _WITHIN).all(axis=1)
        covered[near[inside]] = True
    return covered


def _skinned(hull: Hull, apart: Float[np.ndarray, "N"], free: FreeSpace) -> Float[np.ndarray, "V 3"]:
    """The hull with a skin, which covers the surface between points, and at most 64 vertices.

    The skin is 5 mm, or where points lie far apart two fifths of that if it holds no more seen-free space.

    Args:
        hull: of points that ``apart`` is told of.
        apart: (N,) distance of the points from those beside them [m].
        free: what was seen free.
    """
    skinned = hull_of(thickened(hull.vertices, SKIN), hull.members)
    skin = min(_SKIN_OF_SPACING * float(np.median(apart[hull.members])), _MOST_SKIN)
    if skin > SKIN:
        thick = hull_of(thickened(hull.vertices, skin), hull.members)
        if _free_cells(thick, free) <= _free_cells(skinned, free):
            skinned = thick
    return limited(skinned.vertices)


def _free_cells(hull: Hull, free: FreeSpace) -> int:
    return free.count_inside(hull.faces, hull.vertices, 0.25 * free.size)


def _kind_of(plane: Plane, slab: Slab) -> str:
    """``wall`` for what stands upright and is larger than a person is wide and half a person high."""
    width, height = np.ptp(slab.outline, axis=0)
    is_wall = abs(plane.normal[2]) < _UPRIGHT and width >= _WALL[0] and height >= _WALL[1]
    return "wall" if is_wall else "plane"


@dataclass(frozen=True)
class _Body:
    """A piece before it has a name."""

    kind: str
    vertices: Float[np.ndarray, "V 3"]
    plane: Float[np.ndarray, "4"] | None


def _assembled(
    standing: Sequence[Piece],
    bodies: Sequence[_Body],
    first: Mapping[str, int],
    points: Float[np.ndarray, "N 3"],
    kept: Bool[np.ndarray, "N"],
    groups: _Groups,
    coarse: Coarse,
    free: FreeSpace,
) -> tuple[Piece, ...]:
    """The standing pieces with those points of this scan that are kept, and new ones, numbered from ``first``."""
    serial = Counter(first)
    pieces = list(standing)
    for body in bodies:
        hull = hull_of(body.vertices, coarse.voxel[:0])
        shape = ConvexPiece(f"{body.kind}/{serial[body.kind]}", body.vertices, kind=body.kind)
        serial[body.kind] += 1
        pieces.append(Piece(shape, coarse.voxel[:0], evidence_of(hull, free), hull.simplified, body.plane))
    taken = ~kept
    assembled = []
    for piece in pieces:
        hull = piece.hull
        mine = groups.members(coarse.within(hull.lower - (_WITHIN + VOXEL), hull.upper + (_WITHIN + VOXEL)))
        mine = mine[~taken[mine]]
        mine = np.sort(mine[hull.is_within(points[mine], _WITHIN)])
        taken[mine] = True
        assembled.append(replace(piece, points=mine))
    return tuple(assembled)


@dataclass(frozen=True)
class _Groups:
    """Which points went into each voxel."""

    order: Int[np.ndarray, "N"]
    first: Int[np.ndarray, "M+1"]

    @classmethod
    def of(cls, coarse: Coarse) -> _Groups:
        order = np.argsort(coarse.voxel, kind="stable")
        return cls(order, np.concatenate([[0], np.cumsum(coarse.counts)]))

    def hold(self, kept: Bool[np.ndarray, "N"]) -> Bool[np.ndarray, "M"]:
        """Which voxels hold any of the points that are kept."""
        before = np.concatenate([[0], np.cumsum(kept[self.order])])
        return np.asarray(before[self.first[1:]] > before[self.first[:-1]])

    def members(self, voxels: Int[np.ndarray, "K"]) -> Int[np.ndarray, "L"]:
        """Indices of all points in these voxels."""
        counts = self.first[voxels + 1] - self.first[voxels]
        ahead = np.repeat(self.first[voxels] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)
        return np.asarray(self.order[ahead + np.arange(len(ahead))])
