"""A floor level: its plane and extent, its points, and its convex pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from costs.scene import ConvexPiece
from perception.cleaning.clean import Reach

SOLE_MARGIN = 0.03
_CLEARANCE = 0.02
_BELOW = 0.03
_EDGE = 0.03
_EXTENSION = 1.0
_THICKNESS = 0.2
_TREAD_THICKNESS = 0.05
# Of noise above a floor: its largest height, how many standard deviations it may reach, the height up to which points
# count as the floor's, edges of the cells in which deviations and neighbours are counted [m], and the fewest points.
_MOST_NOISE = 0.055
_DEVIATIONS = 3.5
_LEVEL = 0.01
_WIDE, _NEAR = 0.1, 0.03
_FEWEST = 20


@dataclass(frozen=True)
class FloorPlane:
    """The plane ``normal . x == offset``.

    Attributes:
        normal: (3,) unit, upwards.
        rms: standard deviation of its inliers from the plane [m].
        area: seen area [m^2].
        outlines: corners (K, 2), counter-clockwise, of convex patches that together are its extent, in the world [m];
            empty for an unlimited floor.
    """

    normal: Float[np.ndarray, "3"]
    offset: float
    rms: float
    area: float
    outlines: tuple[Float[np.ndarray, "K 2"], ...] = ()

    @property
    def slope_deg(self) -> float:
        """Angle to the horizontal [deg]."""
        return float(np.degrees(np.arccos(min(1.0, float(self.normal[2])))))

    def height(self, xy: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N"]:
        """Return world z of the floor at the given x and y [m]."""
        return np.asarray((self.offset - xy @ self.normal[:2]) / self.normal[2])

    def above(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N"]:
        """Return the signed distance of points above the plane [m]."""
        return np.asarray(points @ self.normal - self.offset)


def on_floor(
    points: Float[np.ndarray, "N 3"],
    floor: FloorPlane,
    soles: Sequence[Float[np.ndarray, "S 3"]] = (),
    clearance: float = _CLEARANCE,
    depth: float = np.inf,
) -> Bool[np.ndarray, "N"]:
    """Return which points in the floor's extent are below it, up to ``clearance`` above it, or 3 cm under a sole.

    Args:
        soles: corners (S, 3) of each convex sole, in any order, in the world [m].
        depth: largest distance of points below the floor [m].
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
    """Return which points belong to any of the levels.

    All points below the first level, on which the robot stands, are its noise; points far below another level are
    not, since objects may stand under a step.
    """
    mask = np.zeros(len(points), dtype=bool)
    for i, floor in enumerate(floors):
        mask |= on_floor(points, floor, soles) if i == 0 else on_floor(points, floor, depth=_BELOW)
    return mask


def find_floor_points(
    points: Float[np.ndarray, "N 3"], floors: Sequence[FloorPlane], soles: Sequence[Float[np.ndarray, "S 3"]] = ()
) -> Bool[np.ndarray, "N"]:
    """Return which points of a scan belong to any of the levels, or are above one by no more than its noise there.

    A depth camera's floor reaches farther above its plane than ``on_floors`` allows; where two standard deviations do
    not, nothing more is the floor's.  Noise reaches as far above the plane as below it; what is on the floor, however
    thin, hides the floor behind it.

    Args:
        points: (N, 3) all points of the scan in reach [m].
    """
    mask = on_floors(points, floors, soles)
    for i, floor in enumerate(floors):
        above = floor.above(points)
        close = np.flatnonzero((np.abs(above) <= _MOST_NOISE) & (mask | (above > 0.0)))
        if not (above[close] > _CLEARANCE).any():
            continue
        height = above[close]
        xy, below = points[close, :2], height < 0.0
        n_below = _sum_around(xy, below.astype(float), _WIDE)
        noise = np.sqrt(_sum_around(xy, np.where(below, height**2, 0.0), _WIDE).clip(0.0) / n_below.clip(1.0))
        level = _sum_around(xy, np.where(height <= _LEVEL, 1.0, -1.0), _NEAR)
        likely = (height <= _DEVIATIONS * noise) & (2.0 * noise > _CLEARANCE) & (n_below >= _FEWEST) & (level >= 0.0)
        depth = np.inf if i == 0 else _BELOW
        likely &= on_floor(points[close], floor, clearance=_MOST_NOISE, depth=depth)
        mask[close[likely]] = True
    return mask


def _sum_around(xy: Float[np.ndarray, "N 2"], values: Float[np.ndarray, "N"], size: float) -> Float[np.ndarray, "N"]:
    """Return the sum of the values in the 3 x 3 cells of an edge [m] around each position."""
    cells = np.floor((xy - xy.min(axis=0)) / size).astype(int)
    shape = cells.max(axis=0) + 1
    index = cells @ [shape[1], 1]
    sums = np.bincount(index, weights=values, minlength=int(shape.prod())).reshape(shape)
    for axis in range(2):
        sums = ndimage.convolve1d(sums, np.ones(3), axis=axis, mode="constant")
    return np.asarray(sums.reshape(-1)[index])


def _within(xy: Float[np.ndarray, "N 2"], outlines: Sequence[Float[np.ndarray, "K 2"]]) -> Bool[np.ndarray, "N"]:
    """Return which positions lie in any of the outlines or up to 3 cm outside; all if there is no outline."""
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
    """Return which positions lie inside the convex polygon or at most ``margin`` [m] outside it."""
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
    """Return a box ``floor``, 0.2 m thick, whose top face is the plane and extends 1 m beyond the reach."""
    half = reach.radius + _EXTENSION
    xy = np.array([(reach.x + sx * half, reach.y + sy * half) for sx in (-1, 1) for sy in (-1, 1)])
    return _slab("floor", floor, xy, _THICKNESS)


def floor_pieces(floors: Sequence[FloorPlane], reach: Reach) -> list[ConvexPiece]:
    """Return pieces of kind ``floor`` for all levels: ``floor`` under the robot, then ``floor/1``, ``floor/2`` ...

    A level without outlines extends 1 m beyond the reach; the others have their seen extent.  The level under the
    robot is 0.2 m thick, the others, which may be treads or plates, 5 cm.
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
