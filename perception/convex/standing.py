"""Pieces of an earlier scan that a new scan does not contradict, and points of the new scan outside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from perception.convex.coarse import Coarse, coarsen, smooth_points
from perception.convex.freespace import FreeSpace
from perception.convex.hulls import Hull
from perception.convex.piece import Piece
from perception.convex.split import find_clusters

_WITHIN = 0.01
_FUZZ = 0.015
_FUZZ_OF_RANGE = 0.003
_FREE_CELLS = 12
_FREE_SHARE = 0.06
_DEEP = 0.03
_DEEP_CELLS = 6
_DEEP_SHARE = 0.003
_FREE_WITHIN = 0.5
_AROUND = 0.02
_FACES = 8
_LOW = 0.05
_APART = 0.4
_APART_OF_RANGE = 0.08
_LEAST_POINTS = 4
_CELLS_OF_POINT = 0.25


@dataclass(frozen=True)
class Ground:
    """Floor whose noise is not an obstacle.

    Attributes:
        hulls: hulls of its pieces.
    """

    hulls: tuple[Hull, ...] = ()
    points: Float[np.ndarray, "F 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    starts: Float[np.ndarray, "F 3"] = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass(frozen=True)
class Standing:
    """Pieces that the new scan does not contradict.

    Attributes:
        pieces: the unchanged pieces.
        held: indices of the points in each piece or at most 1 cm outside it.
    """

    pieces: list[Piece]
    held: list[Int[np.ndarray, "K"]]

    def find_hidden(self, passed: FreeSpace) -> list[int]:
        """Return indices of pieces that rays passed through but a few points, maybe mixed pixels, seem to confirm.

        Args:
            passed: cells that rays passed through, cells beside points included.
        """
        hidden = []
        for i, (piece, held) in enumerate(zip(self.pieces, self.held, strict=True)):
            most = max(_count_grazed(piece, passed), int(_CELLS_OF_POINT * len(held)))
            if passed.count_inside(piece.hull, most) > most:
                hidden.append(i)
        return hidden

    def select_beside(self, chosen: Sequence[int], passed: FreeSpace, coarse: Coarse) -> Int[np.ndarray, "K"]:
        """Return indices of points in cells that rays passed through, in or within two cells of the chosen pieces."""
        is_there = np.zeros(len(coarse.points), dtype=bool)
        for hull in (self.pieces[i].hull for i in chosen):
            is_there[coarse.select_within(hull.lower - 2.0 * passed.size, hull.upper + 2.0 * passed.size)] = True
        there = np.flatnonzero(is_there)
        return np.asarray(there[passed.contains(coarse.points[there])])

    def drop(self, chosen: Sequence[int], but: Standing) -> Standing:
        """Return the pieces without the chosen ones; chosen ones that are in ``but`` stay."""
        gone = {id(self.pieces[i]) for i in chosen} - {id(piece) for piece in but.pieces}
        left = [(piece, held) for piece, held in zip(self.pieces, self.held, strict=True) if id(piece) not in gone]
        return Standing([piece for piece, _ in left], [held for _, held in left])


@dataclass(frozen=True)
class Left:
    """Points that are, after smoothing, more than 1 cm outside all pieces.

    Attributes:
        members: (K,) indices of the points.
        is_far: (K,) whether each is farther from the pieces than range noise.
    """

    members: Int[np.ndarray, "K"]
    is_far: Bool[np.ndarray, "K"]

    def keep(self, kept: Bool[np.ndarray, "M"]) -> Left:
        """Return the points that are True in ``kept``."""
        mine = kept[self.members]
        return Left(self.members[mine], self.is_far[mine])

    def find_new(self, coarse: Coarse) -> Int[np.ndarray, "L"]:
        """Return indices of the points in clusters with at least one point beyond range noise."""
        left = self.members
        if not self.is_far.any():
            return left[:0]
        groups = find_clusters(coarse.points[left], coarse.starts[left])
        new = [left[group] for group in groups if _is_new(self.is_far[group], coarse, left[group])]
        return np.sort(np.concatenate(new)) if new else left[:0]


def find_standing(pieces: Sequence[Piece], free: FreeSpace, coarse: Coarse) -> Standing:
    """Return the pieces that the new rays do not pass through, with their points.

    Rays may graze a piece about as much as in the earlier scan, but may pass through few cells deep inside it: a
    sparse scan through a removed object frees only a few cells.  A piece of only a few cells is removed when most of
    them are free and it has no points.
    """
    standing = Standing([], [])
    for piece in pieces:
        hull = piece.hull
        n_cells = hull.volume / free.size**3
        grazed = _count_grazed(piece, free)
        deep = max(_DEEP_CELLS, int(_DEEP_SHARE * n_cells))
        count = free.count_inside(hull, grazed)
        # The cells deep inside are a subset of those counted.
        if count <= grazed and (count <= deep or free.count_inside(hull, deep, _DEEP) <= deep):
            held = _find_held(hull, coarse)
            if len(held) or not _is_passed(hull, free, grazed):
                standing.pieces.append(piece)
                standing.held.append(held)
    return standing


def _count_grazed(piece: Piece, free: FreeSpace) -> int:
    """Return how many free cells a piece may contain because rays graze it."""
    n_cells = piece.hull.volume / free.size**3
    return piece.evidence.free_cells + max(1, min(_FREE_CELLS, int(0.4 * n_cells)), int(_FREE_SHARE * n_cells))


def _is_passed(hull: Hull, free: FreeSpace, grazed: int) -> bool:
    """Return whether rays pass through a piece without points; the piece may be thinner than a cell."""
    heights = hull.faces[:, :3] @ hull.vertices.T
    thickness = float(np.ptp(heights, axis=1).min())
    margin = 0.25 * free.size * float(np.clip(thickness / free.size - 1.0, 0.0, 1.0))
    if free.count_inside(hull, grazed, margin) > grazed:
        return True
    return bool(free.contains(_probe_inside(hull)).mean() > _FREE_WITHIN)


def _find_held(hull: Hull, coarse: Coarse) -> Int[np.ndarray, "K"]:
    """Return indices of the points in the hull or at most 1 cm outside it."""
    near = coarse.select_within(hull.lower - _AROUND, hull.upper + _AROUND)
    return np.asarray(near[hull.is_within(coarse.points[near], _WITHIN)])


def _probe_inside(hull: Hull) -> Float[np.ndarray, "V 3"]:
    """Return positions half-way between the hull's centre and its vertices [m]."""
    return np.asarray(0.5 * (hull.vertices + hull.vertices.mean(axis=0)))


def find_unexplained(standing: Standing, coarse: Coarse, ground: Ground) -> Left:
    """Return the points that are not in a standing piece, not on the floor and not noise of either.

    The points are smoothed along their rays before the test, as for making pieces: otherwise an object as thin as
    the noise of single points would be missed.
    """
    is_explained = np.zeros(len(coarse.points), dtype=bool)
    for held in standing.held:
        is_explained[held] = True
    left = np.flatnonzero(~is_explained)
    if not len(left):
        return Left(left, left > 0)
    hulls = [*(piece.hull for piece in standing.pieces), *ground.hulls]
    fuzz = _FUZZ + _FUZZ_OF_RANGE * np.linalg.norm(coarse.points[left] - coarse.starts[left], axis=1)
    distance = _measure_distance(hulls, _smooth_with(ground, coarse, left), float(fuzz.max()))
    is_far, is_left = distance > fuzz, distance > _WITHIN
    return Left(left[is_left], is_far[is_left])


def _smooth_with(ground: Ground, coarse: Coarse, left: Int[np.ndarray, "K"]) -> Float[np.ndarray, "K 3"]:
    """Return the points ``left``, smoothed along their rays; nearby floor points count as neighbours [m]."""
    points, counts, starts = coarse.points, coarse.counts, coarse.starts
    low = np.zeros(len(left), dtype=bool)
    for hull in ground.hulls:
        low |= hull.is_within(points[left], _LOW)
    if low.any():
        beside = _select_beside(ground.points[:, :2], points[left[low], :2])
        floor = coarsen(ground.points[beside], ground.starts[beside], coarse.size)
        points, starts = np.concatenate([points, floor.points]), np.concatenate([starts, floor.starts])
        counts = np.concatenate([counts, floor.counts])
    return smooth_points(points, counts, starts, left)


def _select_beside(places: Float[np.ndarray, "N 2"], others: Float[np.ndarray, "K 2"]) -> Bool[np.ndarray, "N"]:
    """Return which positions are in the same or a neighbouring 5 cm cell of one of the others."""
    lower = np.floor(others.min(axis=0) / _LOW).astype(int) - 1
    cells = np.floor(others / _LOW).astype(int) - lower
    picture = np.zeros(cells.max(axis=0) + 2, dtype=bool)
    picture[tuple(cells.T)] = True
    picture = ndimage.binary_dilation(picture, structure=np.ones((3, 3), dtype=bool))
    cells = np.floor(places / _LOW).astype(int) - lower
    inside = ((cells >= 0) & (cells < picture.shape)).all(axis=1)
    inside[inside] = picture[tuple(cells[inside].T)]
    return np.asarray(inside)


def _measure_distance(hulls: Sequence[Hull], points: Float[np.ndarray, "K 3"], most: float) -> Float[np.ndarray, "K"]:
    """Return the distance of each point outside the nearest hull, negative inside; infinite beyond ``most`` [m]."""
    distance, columns = np.full(len(points), np.inf), np.ascontiguousarray(points.T)
    for hull in hulls:
        near = np.arange(len(points))
        for column, low, high in zip(columns, hull.lower - most, hull.upper + most, strict=True):
            mine = column if len(near) == len(points) else column[near]
            near = near[(mine >= low) & (mine <= high)]
        before = np.full(len(near), -np.inf)
        for first in range(0, len(hull.faces), _FACES):
            some = hull.faces[first : first + _FACES]
            before = np.maximum(before, (some[:, :3] @ points[near].T + some[:, 3:]).max(axis=0))
            is_near = before <= most
            near, before = near[is_near], before[is_near]
        distance[near] = np.minimum(distance[near], before)
    return distance


def _is_new(is_far: Bool[np.ndarray, "K"], coarse: Coarse, group: Int[np.ndarray, "K"]) -> bool:
    return bool(is_far.any() and coarse.counts[group].sum() >= _LEAST_POINTS)


def make_boxes(
    points: Float[np.ndarray, "K 3"], starts: Float[np.ndarray, "K 3"], around: float
) -> Float[np.ndarray, "B 2 3"]:
    """Return a box (lower, upper corner) around each group of points; no piece can span two groups [m].

    Args:
        around: margin of a box around its points [m].
    """
    apart = max(_APART, _APART_OF_RANGE * float(np.linalg.norm(points - starts, axis=1).max(initial=0.0)))
    cells = np.floor(points / apart).astype(int)
    cells -= cells.min(axis=0)
    picture = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    picture[tuple(cells.T)] = True
    number, n_groups = ndimage.label(picture, structure=np.ones((3, 3, 3), dtype=bool))
    group = number[tuple(cells.T)]
    boxes = [(points[group == i + 1].min(axis=0), points[group == i + 1].max(axis=0)) for i in range(n_groups)]
    return np.asarray(np.array(boxes) + np.array([[-around], [around]]))
