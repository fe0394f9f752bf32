"""Test whether a new scan shows the floor levels of an earlier scan, which is quicker than a new search."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.cleaning.clean import Reach
from perception.convex.hulls import Hull
from perception.ground.extent import pierced_cells
from perception.ground.floor import FloorPlane, on_floor
from perception.ground.patches import PATCH, least_squares, patches_of

_BAND = 0.025
_MOVED = 0.003
_MOVED_FAR = 0.01
_CELL = 0.1
_LEAST_SEEN = 0.5
_SHARE_UNDER = 0.05
_BEYOND = 1.0
_INWARDS = 0.1
_FEWEST_HOLES = 12
_MOST_POINTS = 80_000
_HIGHEST = 0.4
_STEPPED_ON = 0.12  # [m^2]


def are_there(
    floors: Sequence[FloorPlane],
    points: Float[np.ndarray, "N 3"],
    rays: tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]],
    reach: Reach,
) -> bool:
    """Return whether the scan shows at least half of each level, unmoved, with no rays through it.

    The level under the robot also passes when less than half is seen but nothing below it: the sensor may look
    elsewhere.  Its tolerance is 3 mm where half is seen; otherwise, and for other levels, it is 1 cm.
    """
    points = points[:: -(-len(points) // _MOST_POINTS)]
    return len(floors) > 0 and all(_is_there(floor, i == 0, points, rays, reach) for i, floor in enumerate(floors))


def _is_there(
    floor: FloorPlane,
    is_stood_on: bool,
    points: Float[np.ndarray, "N 3"],
    rays: tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]],
    reach: Reach,
) -> bool:
    own = points[on_floor(points, floor, clearance=_BAND, depth=_BAND)]
    is_seen = _area(own[:, :2]) >= _LEAST_SEEN * floor.area
    if not is_seen and not (is_stood_on and _is_lowest(floor, own, points)):
        return False
    if _movement(floor, own) > (_MOVED if is_seen and is_stood_on else _MOVED_FAR):
        return False
    centre, extent = np.array([reach.x, reach.y]), reach.radius + _BEYOND
    holes = pierced_cells(floor.normal, floor.offset, rays, own[:, :2], centre, extent)
    if floor.outlines:
        holes = holes[_inside(holes, floor.outlines)]
    return len(holes) < _FEWEST_HOLES


def _is_lowest(floor: FloorPlane, own: Float[np.ndarray, "M 3"], points: Float[np.ndarray, "N 3"]) -> bool:
    """Return whether at most 5 % as many points lie under the level as on it."""
    return int((floor.above(points) < -_BAND).sum()) <= _SHARE_UNDER * len(own)


def _area(xy: Float[np.ndarray, "N 2"]) -> float:
    """Return the area of the 10 cm cells that contain at least one position [m^2]."""
    if not len(xy):
        return 0.0
    u, v = np.floor(xy / _CELL).astype(np.int64).T
    u, v = u - u.min(), v - v.min()
    picture = np.zeros((int(u.max()) + 1, int(v.max()) + 1), dtype=bool)
    picture[u, v] = True
    return float(picture.sum()) * _CELL**2


def _movement(floor: FloorPlane, own: Float[np.ndarray, "N 3"]) -> float:
    """Return the largest distance, over the points, between their plane and the level; 0 with few points [m]."""
    fitted = least_squares(own, floor.normal, floor.offset, (_BAND, _BAND))
    if fitted is None:
        return 0.0
    return float(np.abs(own @ (fitted[0] - floor.normal) - (fitted[1] - floor.offset)).max())


def _inside(xy: Float[np.ndarray, "N 2"], outlines: Sequence[Float[np.ndarray, "K 2"]]) -> Bool[np.ndarray, "N"]:
    """Return which positions lie more than 10 cm inside any outline (corners counter-clockwise)."""
    inside = np.zeros(len(xy), dtype=bool)
    for corners in outlines:
        sides = np.roll(corners, -1, axis=0) - corners
        inwards = np.column_stack([-sides[:, 1], sides[:, 0]])
        inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-9)
        inside |= (xy @ inwards.T - np.einsum("ij,ij->i", inwards, corners) > _INWARDS).all(axis=1)
    return inside


def may_be_level(
    points: Float[np.ndarray, "N 3"],
    floors: Sequence[FloorPlane],
    ground: Float[np.ndarray, "F 3"],
    known: Sequence[Hull] = (),
) -> bool:
    """Return whether new points show enough flat, low surface (0.12 m^2) to be a new floor level.

    A flat patch over more floor points than it has itself is noise: a real level would occlude the floor below.

    Args:
        ground: (F, 3) points of the known levels [m].
        known: hulls whose faces are not new levels.
    """
    low = np.zeros(len(points), dtype=bool)
    for floor in floors:
        low |= floor.above(points) < _HIGHEST
    if not low.any():
        return False
    patches = patches_of(points[low])
    centre, count = patches.centre[patches.is_upright], patches.count[patches.is_upright]
    is_new = np.ones(len(centre), dtype=bool)
    for hull in known:
        if is_new.sum() * PATCH**2 < _STEPPED_ON:
            return False
        is_new &= ~hull.is_within(centre, _BAND)
    is_new &= count > _seen_in_columns(centre, ground)
    return float(is_new.sum() * PATCH**2) >= _STEPPED_ON


def _seen_in_columns(places: Float[np.ndarray, "P 3"], ground: Float[np.ndarray, "F 3"]) -> Int[np.ndarray, "P"]:
    """Return the number of ground points in the vertical 12 cm column of each position."""
    if not len(places) or not len(ground):
        return np.zeros(len(places), dtype=np.int64)
    columns = np.floor(np.concatenate([places, ground])[:, :2] / PATCH).astype(np.int64)
    columns -= columns.min(axis=0)
    keys = columns[:, 0] * (columns[:, 1].max() + 1) + columns[:, 1]
    # Only columns of the positions are counted: with far ground, all columns could exceed the memory.
    wanted, column = np.unique(keys[: len(places)], return_inverse=True)
    at = np.searchsorted(wanted, keys[len(places) :]).clip(max=len(wanted) - 1)
    counts = np.bincount(at[wanted[at] == keys[len(places) :]], minlength=len(wanted))
    return np.asarray(counts[column])
