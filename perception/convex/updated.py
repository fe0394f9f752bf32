"""Pieces of a new scan; earlier pieces that it does not contradict keep their shape and name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.convex.clock import Clock
from perception.convex.coarse import Coarse, Groups, coarsen
from perception.convex.freespace import Crossing, FreeSpace
from perception.convex.piece import Piece
from perception.convex.pieces import (
    AROUND,
    VOXEL,
    Pieces,
    assign_points,
    make_bodies,
    make_crossing,
    name_bodies,
    share_start,
)
from perception.convex.standing import Ground, Standing, find_standing, find_unexplained, make_boxes
from perception.convex.towards import Bearings

_MOST = 0.7

Judge = Callable[[Int[np.ndarray, "K"]], Bool[np.ndarray, "K"]]


@dataclass(frozen=True)
class Updated(Pieces):
    """Convex pieces of a new scan.

    Attributes:
        is_surface: (N,) False for points that the judge rejected, such as strays and mixed pixels.
        is_left_off: whether the update stopped without making pieces.
    """

    is_surface: Bool[np.ndarray, "N"]
    is_left_off: bool = False


def update_pieces(
    before: Sequence[Piece],
    points: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "*N 3"],
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    seed: int = 0,
    ground: Ground | None = None,
    judge: Judge | None = None,
    is_enough: Callable[[Float[np.ndarray, "K 3"]], bool] = lambda _: False,
) -> Updated:
    """Return the pieces of a new scan; earlier ones that it does not contradict keep their shape and name.

    A piece is removed when rays of the new scan pass through it; an occluded piece stays.  New pieces are made of the
    points that are neither in a remaining piece nor its noise.

    Args:
        points, starts, rays, seed: see ``make_pieces``; the points need not be cleaned if there is a judge.
        ground: floor, whose points and noise make no pieces.
        judge: returns which of the points with the given indices lie on surfaces; called only for points outside all
            pieces and for points in pieces that rays passed through.
        is_enough: given the points of new pieces, whether to stop without making pieces.
    """
    if not len(points) and not len(before):
        return Updated((), {}, np.ones(0, dtype=bool))
    clock = Clock()
    scan = _Scan.of(points, starts, rays, before)
    passed, crossing = scan.passed_by(before)
    clock.lap("free space")
    standing, kept = _judge_standing(before, scan, passed, judge, clock)
    left = find_unexplained(standing, scan.coarse, ground or Ground())
    clock.lap("unexplained")
    if judge is not None:
        kept = _judge_points(kept, judge, scan.groups.list_members(left.members))
        left = left.keep(scan.groups.find_holding(kept))
        clock.lap("cleaning")
    new = left.find_new(scan.coarse)
    if is_enough(points[scan.groups.list_members(new)]):
        return Updated((), clock.timings, kept, is_left_off=True)
    pieces = [*standing.pieces, *_make_new_pieces(scan, new, kept, crossing, _number_kinds(before), seed, clock)]
    made = assign_points(pieces, points, kept, scan.groups, scan.coarse)
    clock.lap("evidence")
    return Updated(made, clock.timings, kept)


@dataclass(frozen=True)
class _Scan:
    """A new scan.

    Attributes:
        coarse: its downsampled points.
        groups: indices of the points of each voxel.
        rays: starts, (3,) or (R, 3), and ends (R, 3) [m].
        bearings: directions of the rays, if they have a common start.
        held: (H, 3) positions that the free-space grid must contain [m].
    """

    coarse: Coarse
    groups: Groups
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]]
    bearings: Bearings | None
    held: Float[np.ndarray, "H 3"]

    @classmethod
    def of(
        cls,
        points: Float[np.ndarray, "N 3"],
        starts: Float[np.ndarray, "*N 3"],
        rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
        before: Sequence[Piece],
    ) -> _Scan:
        coarse = coarsen(points, starts, VOXEL)
        rays = share_start(rays)
        bearings = Bearings.of(*rays) if rays[0].ndim == 1 else None
        held = np.concatenate([coarse.points, *(piece.shape.vertices for piece in before)])
        return cls(coarse, Groups.of(coarse), rays, bearings, held)

    def rays_towards(
        self, boxes: Float[np.ndarray, "B 2 3"]
    ) -> tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "K 3"]]:
        """Return rays that may pass through any of the boxes; all if most do."""
        if self.bearings is None:
            return self.rays
        chosen = self.bearings.may_pass(boxes)
        most = int(chosen.sum()) > _MOST * len(chosen)
        return self.rays if most else (self.rays[0], self.rays[1][chosen])

    def passed_by(self, pieces: Sequence[Piece]) -> tuple[FreeSpace, Crossing | None]:
        """Return cells near the pieces that rays passed through, also beside points, and the rays if all were used."""
        boxes = np.array([(piece.hull.lower, piece.hull.upper) for piece in pieces]).reshape(-1, 2, 3)
        rays = self.rays_towards(boxes)
        crossing = make_crossing(self.held, rays)
        return crossing.mark_free(self.coarse.points[:0], boxes), crossing if rays is self.rays else None


def _judge_standing(
    before: Sequence[Piece], scan: _Scan, passed: FreeSpace, judge: Judge | None, clock: Clock
) -> tuple[Standing, Bool[np.ndarray, "N"]]:
    """Return the pieces that are not contradicted, and which points the judge kept in pieces that rays passed."""
    coarse, kept = scan.coarse, np.ones(len(scan.coarse.voxel), dtype=bool)
    standing = find_standing(before, passed.clear_beside(coarse.points), coarse)
    clock.lap("contradicted")
    if judge is None:
        return standing, kept
    # A mixed pixel in a removed piece hides the free cells around it.
    hidden = standing.find_hidden(passed)
    kept = _judge_points(kept, judge, scan.groups.list_members(standing.select_beside(hidden, passed, coarse)))
    clock.lap("cleaning")
    seen = coarse.points[scan.groups.find_holding(kept)]
    again = find_standing([standing.pieces[i] for i in hidden], passed.clear_beside(seen), coarse)
    clock.lap("contradicted")
    return standing.drop(hidden, again), kept


def _judge_points(kept: Bool[np.ndarray, "N"], judge: Judge, chosen: Int[np.ndarray, "K"]) -> Bool[np.ndarray, "N"]:
    """Return ``kept`` without the chosen points that the judge rejects."""
    kept = kept.copy()
    kept[chosen] = judge(chosen)
    return kept


def _make_new_pieces(
    scan: _Scan,
    new: Int[np.ndarray, "K"],
    kept: Bool[np.ndarray, "N"],
    whole: Crossing | None,
    first: Mapping[str, int],
    seed: int,
    clock: Clock,
) -> list[Piece]:
    """Return pieces, without points yet, of the new points."""
    if not len(new):
        return []
    boxes = make_boxes(scan.coarse.points[new], scan.coarse.starts[new], AROUND)
    rays = scan.rays_towards(boxes)
    crossing = make_crossing(scan.held, rays) if whole is None else whole
    free = crossing.mark_free(scan.coarse.points[scan.groups.find_holding(kept)], boxes)
    clock.lap("free space")
    return name_bodies(make_bodies(scan.coarse, new, rays, free, seed, clock), first, free)


def _number_kinds(before: Sequence[Piece]) -> dict[str, int]:
    """Return the number of the first new piece of each kind."""
    named = sorted((piece.kind, int(piece.name.rpartition("/")[2])) for piece in before)
    return {
        kind: 1 + max(number for _, number in of_kind) for kind, of_kind in groupby(named, key=lambda name: name[0])
    }
