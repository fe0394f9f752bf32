"""Which pieces of an earlier scan a new one leaves standing, and which of its points they do not explain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.convex.coarse import Coarse
from perception.convex.freespace import FreeSpace
from perception.convex.hulls import Hull
from perception.convex.piece import Piece
from perception.convex.planes import Plane, PlaneSettings, noise_of
from perception.convex.smooth import smoothed
from perception.convex.split import clusters

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
_NEAR = 0.1
_LEAST_POINTS = 4


def still_standing(pieces: Sequence[Piece], free: FreeSpace, coarse: Coarse) -> list[Piece]:
    """Pieces that the new rays do not pass through.

    Rays may graze a piece about as much as they did before, but hardly any may pass deep inside: of a thing that is
    gone, a sparse scan sees no more than some cells.  What is so small that it holds only some, as what noise had
    left, is gone when most of them are free and nothing of it is seen.
    """
    standing = []
    for piece in pieces:
        hull = piece.hull
        n_cells = hull.volume / free.size**3
        grazed = piece.evidence.free_cells + max(1, min(_FREE_CELLS, int(0.4 * n_cells)), int(_FREE_SHARE * n_cells))
        deep = max(_DEEP_CELLS, int(_DEEP_SHARE * n_cells))
        if (
            free.count_inside(hull.faces, hull.vertices, 0.25 * free.size, grazed) <= grazed
            and free.count_inside(hull.faces, hull.vertices, _DEEP, deep) <= deep
            and (len(_held(hull, coarse)) or not _is_passed(hull, free, grazed))
        ):
            standing.append(piece)
    return standing


def _is_passed(hull: Hull, free: FreeSpace, grazed: int) -> bool:
    """Whether rays pass through a piece of which nothing is seen, and which may be thinner than the cells tell."""
    heights = hull.faces[:, :3] @ hull.vertices.T
    thickness = float(np.ptp(heights, axis=1).min())
    margin = 0.25 * free.size * float(np.clip(thickness / free.size - 1.0, 0.0, 1.0))
    if free.count_inside(hull.faces, hull.vertices, margin, grazed) > grazed:
        return True
    return bool(free.contains(_within(hull)).mean() > _FREE_WITHIN)


def _held(hull: Hull, coarse: Coarse) -> Int[np.ndarray, "K"]:
    """Points at most 1 cm before each of its faces."""
    near = coarse.within(hull.lower - _AROUND, hull.upper + _AROUND)
    return np.asarray(near[hull.is_within(coarse.points[near], _WITHIN)])


def _within(hull: Hull) -> Float[np.ndarray, "V 3"]:
    """Places half-way between the hull's middle and its vertices."""
    return np.asarray(0.5 * (hull.vertices + hull.vertices.mean(axis=0)))


def unexplained(standing: Sequence[Piece], coarse: Coarse) -> Int[np.ndarray, "K"]:
    """Points of clusters that are more than noise about the pieces that stand.

    Pieces are made of points whose noise along their rays is averaged out, and are held against such points: what is
    as thin as the noise of single points would be missed otherwise.
    """
    left = np.flatnonzero(~_explained(standing, coarse))
    for piece in standing:
        if piece.plane is not None and len(left):
            left = left[~_noise_about(piece.plane, piece.hull, coarse, left)]
    if not len(left):
        return left
    distance = _distance(standing, smoothed(coarse.points, coarse.counts, coarse.starts, left))
    is_far = distance > _FUZZ + _FUZZ_OF_RANGE * np.linalg.norm(coarse.points[left] - coarse.starts[left], axis=1)
    left, is_far = left[distance > _WITHIN], is_far[distance > _WITHIN]
    if not is_far.any():
        return left[:0]
    # A cluster counts when part of it lies beyond the noise.
    groups = clusters(coarse.points[left], coarse.starts[left])
    new = [left[group] for group in groups if _is_new(is_far[group], coarse, left[group])]
    return np.sort(np.concatenate(new)) if new else left[:0]


def _explained(standing: Sequence[Piece], coarse: Coarse) -> Bool[np.ndarray, "M"]:
    """Which points lie in a piece or at most 1 cm before it."""
    explained = np.zeros(len(coarse.points), dtype=bool)
    for hull in (piece.hull for piece in standing):
        near = coarse.within(hull.lower - _AROUND, hull.upper + _AROUND)
        near = near[~explained[near]]
        explained[near[hull.is_within(coarse.points[near], _WITHIN)]] = True
    return explained


def _distance(standing: Sequence[Piece], points: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K"]:
    """How far before the nearest piece each point lies, negative inside, infinite where none is near [m]."""
    distance = np.full(len(points), np.inf)
    for hull in (piece.hull for piece in standing):
        near = np.flatnonzero(((points >= hull.lower - _NEAR) & (points <= hull.upper + _NEAR)).all(axis=1))
        before = (hull.faces[:, :3] @ points[near].T + hull.faces[:, 3:]).max(axis=0, initial=-np.inf)
        distance[near] = np.minimum(distance[near], before)
    return distance


def _is_new(is_far: Bool[np.ndarray, "K"], coarse: Coarse, group: Int[np.ndarray, "K"]) -> bool:
    return bool(is_far.any() and coarse.counts[group].sum() >= _LEAST_POINTS)


def _noise_about(
    plane: Float[np.ndarray, "4"], hull: Hull, coarse: Coarse, left: Int[np.ndarray, "K"]
) -> Bool[np.ndarray, "K"]:
    """Which of the points left are the noise of a slab's plane."""
    settings = PlaneSettings()
    members = _held(hull, coarse)
    if len(members) < settings.min_points:
        return np.zeros(len(left), dtype=bool)
    slab = Plane(plane[:3], float(plane[3]), members, members[:0])
    return noise_of(slab, coarse.points, coarse.counts, left, settings)
