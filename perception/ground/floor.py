"""A level of the floor: its plane and extent, what belongs to it, and the pieces that stand for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from costs.scene import ConvexPiece
from perception.cleaning.clean import Reach

SOLE_MARGIN = 0.03
_CLEARANCE = 0.02
_BELOW = 0.03
_EDGE = 0.03
_EXTENSION = 1.0
_THICKNESS = 0.2
_TREAD_THICKNESS = 0.05


@dataclass(frozen=True)
class FloorPlane:
    """The plane ``normal . x == offset``.

    Attributes:
        normal: (3,) unit, upwards.
        rms: scatter of its points about it [m].
        area: seen area [m^2].
        outlines: (K, 2) corners in the world, counter-clockwise, of convex patches that together are its extent;
            none: it goes on as far as it matters.
    """

    normal: Float[np.ndarray, "3"]
    offset: float
    rms: float
    area: float
    outlines: tuple[Float[np.ndarray, "K 2"], ...] = ()

    @property
    def slope_deg(self) -> float:
        """Angle to the horizontal."""
        return float(np.degrees(np.arccos(min(1.0, float(self.normal[2])))))

    def height(self, xy: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N"]:
        """Return world z of the floor at the given places [m]."""
        return np.asarray((self.offset - xy @ self.normal[:2]) / self.normal[2])

    def above(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N"]:
        """Return the distance over the plane [m], negative below."""
        return np.asarray(points @ self.normal - self.offset)


def on_floor(
    points: Float[np.ndarray, "N 3"],
    floor: FloorPlane,
    soles: Sequence[Float[np.ndarray, "S 3"]] = (),
    clearance: float = _CLEARANCE,
    depth: float = np.inf,
) -> Bool[np.ndarray, "N"]:
    """Return points of the floor's extent below it, up to ``clearance`` over it, and up to 3 cm over it under a sole.

    Args:
        soles: corners (S, 3) of each convex sole, any order, world [m].
        depth: how far below it points may lie [m].
    """
    above = floor.above(points)
    mask = (above <= clearance) & (above >= -depth)
    if len(soles):
        low = np.flatnonzero(above <= SOLE_MARGIN)
        for sole in soles:
            mask[low[_under(points[low, :2], np.asarray(sole)[:, :2])]] = True
    if floor.outlines:
        low = np.flatnonzero(mask)
        mask[low] = _within(points[low, :2], floor.outlines)
    return np.asarray(mask)


def on_floors(
    points: Float[np.ndarray, "N 3"], floors: Sequence[FloorPlane], soles: Sequence[Float[np.ndarray, "S 3"]] = ()
) -> Bool[np.ndarray, "N"]:
    """Return points that belong to any of the levels.

    What lies below the first, on which the robot stands, is its noise; of the others only what is near their planes
    belongs to them, for things may stand under a step.
    """
    mask = np.zeros(len(points), dtype=bool)
    for i, floor in enumerate(floors):
        mask |= on_floor(points, floor, soles) if i == 0 else on_floor(points, floor, depth=_BELOW)
    return mask


def _within(xy: Float[np.ndarray, "N 2"], outlines: Sequence[Float[np.ndarray, "K 2"]]) -> Bool[np.ndarray, "N"]:
    """Return which places lie in any of the outlines or up to 3 cm outside; all of them where there is no outline."""
    if not outlines:
        return np.ones(len(xy), dtype=bool)
    mask = np.zeros(len(xy), dtype=bool)
    left = np.arange(len(xy))
    for outline in outlines:
        inside = _under(xy[left], outline, _EDGE)
        mask[left[inside]] = True
        left = left[~inside]
    return mask


def _under(
    xy: Float[np.ndarray, "N 2"], polygon: Float[np.ndarray, "S 2"], margin: float = 0.0
) -> Bool[np.ndarray, "N"]:
    """Return which places lie inside the convex polygon, or at most ``margin`` outside it."""
    centre = polygon.mean(axis=0)
    order = np.argsort(np.arctan2(*(polygon - centre).T[::-1]))
    corners = polygon[order]
    edges = np.roll(corners, -1, axis=0) - corners
    slack = margin * np.linalg.norm(edges, axis=1) + 1e-12
    inside = np.ones(len(xy), dtype=bool)
    x, y = xy.T
    for (cx, cy), (ex, ey), most in zip(corners, edges, slack, strict=True):
        inside &= ex * (y - cy) - ey * (x - cx) >= -most
    return inside


def floor_piece(floor: FloorPlane, reach: Reach) -> ConvexPiece:
    """Return a box ``floor`` 0.2 m thick whose top face is the plane, reaching 1 m beyond the reach."""
    half = reach.radius + _EXTENSION
    xy = np.array([(reach.x + sx * half, reach.y + sy * half) for sx in (-1, 1) for sy in (-1, 1)])
    return _slab("floor", floor, xy, _THICKNESS)


def floor_pieces(floors: Sequence[FloorPlane], reach: Reach) -> list[ConvexPiece]:
    """Return pieces of kind ``floor`` for all levels: ``floor``, under the robot, then ``floor/1`` and on.

    A level without outlines reaches 1 m beyond the reach; the others are as large as they were seen.  The level under
    the robot is 0.2 m thick, the others, which may be treads or plates, 5 cm.
    """
    slabs: list[tuple[FloorPlane, Float[np.ndarray, "K 2"] | None, float]] = []
    for i, floor in enumerate(floors):
        thickness = _THICKNESS if i == 0 else _TREAD_THICKNESS
        slabs += [(floor, outline, thickness) for outline in floor.outlines or (None,)]
    names = ["floor" if i == 0 else f"floor/{i}" for i in range(len(slabs))]
    return [
        floor_piece(floor, reach) if outline is None else _slab(name, floor, outline, thickness)
        for name, (floor, outline, thickness) in zip(names, slabs, strict=True)
    ]


def _slab(name: str, floor: FloorPlane, outline: Float[np.ndarray, "K 2"], thickness: float) -> ConvexPiece:
    top = np.column_stack([outline, floor.height(outline)])
    return ConvexPiece(name, np.concatenate([top, top - [0.0, 0.0, thickness]]), kind="floor")
