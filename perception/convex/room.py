"""Pieces cut where they enter space that holds nothing of them, such as the leaf of a door in its wall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from perception.convex.hulls import limit_vertices, make_hull
from perception.convex.piece import Piece

_EXPLAINED = 0.01  # from a part, of the points that it takes over [m]


def make_room(
    pieces: Sequence[Piece], boxes: Sequence[Float[np.ndarray, "F 4"]], points: Float[np.ndarray, "N 3"]
) -> tuple[Piece, ...]:
    """Return the pieces, each that enters a box replaced by parts that cover the rest of it.

    The first part has the name of the piece, the others further numbers of its kind; all have its evidence.

    Args:
        boxes: (F, 4) half-spaces of each box, ``a . x + b <= 0``, in which the pieces have no points.
        points: (N, 3) that the pieces' indices count [m].
    """
    for sides in boxes:
        numbers: dict[str, int] = {}
        for piece in pieces:
            numbers[piece.kind] = max(numbers.get(piece.kind, 0), 1 + int(piece.name.rpartition("/")[2]))
        cut: list[Piece] = []
        for piece in pieces:
            parts = subtract_box(piece.shape.vertices, sides)
            if parts is None:
                cut.append(piece)
                continue
            for index, vertices in enumerate(parts):
                name = piece.name
                if index:
                    name = f"{piece.kind}/{numbers[piece.kind]}"
                    numbers[piece.kind] += 1
                cut.append(_take_part(piece, name, vertices, points))
        pieces = cut
    return tuple(pieces)


def _take_part(piece: Piece, name: str, vertices: Float[np.ndarray, "W 3"], points: Float[np.ndarray, "N 3"]) -> Piece:
    """Return a part of a piece with those of its points that are within 1 cm."""
    hull = make_hull(limit_vertices(vertices)).simplified
    own = piece.points[hull.is_within(points[piece.points], _EXPLAINED)]
    return replace(piece, shape=replace(piece.shape, name=name, vertices=hull.vertices), points=own, hull=hull)


def subtract_box(
    vertices: Float[np.ndarray, "V 3"], sides: Float[np.ndarray, "F 4"]
) -> tuple[Float[np.ndarray, "W 3"], ...] | None:
    """Return hulls that together cover what a hull has outside a box; None if it does not enter the box.

    Every point of the hull outside the box is in one of the parts, and no part enters the box.  Parts overlap beside
    the box's edges; parts without volume are left out.

    Args:
        vertices: (V, 3) of the hull [m].
        sides: (F, 4) half-spaces ``a . x + b <= 0`` whose intersection is the box.
    """
    beyond = vertices @ sides[:, :3].T + sides[:, 3]
    if (beyond >= 0.0).all(axis=0).any():
        return None
    parts = []
    for side in beyond.T:
        part = clip_hull(vertices, side)
        try:
            parts.append(part[ConvexHull(part).vertices])
        except (QhullError, ValueError):
            continue  # it touches the side at most
    return tuple(parts)


def clip_hull(vertices: Float[np.ndarray, "V 3"], beyond: Float[np.ndarray, "V"]) -> Float[np.ndarray, "W 3"]:
    """Return points whose hull is the part of a hull beyond a plane.

    Args:
        vertices: (V, 3) of the hull [m].
        beyond: (V,) signed distances from the plane, positive in the part that stays [m].
    """
    stays = beyond >= 0.0
    if not stays.any() or stays.all():
        return vertices[stays]
    high, low = beyond[stays][:, None], beyond[~stays][None]
    share = (high / (high - low))[:, :, None]
    crossing = (1.0 - share) * vertices[stays][:, None] + share * vertices[~stays][None]
    return np.concatenate([vertices[stays], crossing.reshape(-1, 3)])
