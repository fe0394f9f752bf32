"""Whether the floor of an earlier scan is what a new one shows, which is sooner told than found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from perception.clean import Reach
from perception.extent import pierced_cells
from perception.floor import FloorPlane, on_floor
from perception.patches import PATCH, least_squares, patches_of

_BAND = 0.025
_MOVED = 0.003
_CELL = 0.1
_LEAST_SEEN = 0.5
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
    """Whether all levels are seen within 3 mm of where they were, at least half of each, and no rays go through.

    Args:
        floors: of the scan before.
        points: (N, 3) in reach, without the robot's own [m].
        rays: starts and ends (R, 3) of all rays [m].
        reach: what matters.
    """
    points = points[:: -(-len(points) // _MOST_POINTS)]
    return len(floors) > 0 and all(_is_there(floor, points, rays, reach) for floor in floors)


def _is_there(
    floor: FloorPlane,
    points: Float[np.ndarray, "N 3"],
    rays: tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]],
    reach: Reach,
) -> bool:
    own = points[on_floor(points, floor, clearance=_BAND, depth=_BAND)]
    fitted = least_squares(own, floor.normal, floor.offset, (_BAND, _BAND))
    if fitted is None or np.abs(own @ (fitted[0] - floor.normal) - (fitted[1] - floor.offset)).max() > _MOVED:
        return False
    cells = np.unique(np.floor(own[:, :2] / _CELL).astype(int), axis=0)
    if len(cells) * _CELL**2 < _LEAST_SEEN * floor.area:
        return False
    centre, extent = np.array([reach.x, reach.y]), reach.radius + _BEYOND
    holes = pierced_cells(floor.normal, floor.offset, rays, own[:, :2], centre, extent)
    if floor.outlines:
        holes = holes[_inside(holes, floor.outlines)]
    return len(holes) < _FEWEST_HOLES


def _inside(xy: Float[np.ndarray, "N 2"], outlines: Sequence[Float[np.ndarray, "K 2"]]) -> Bool[np.ndarray, "N"]:
    """Which places lie more than 10 cm inside of any outline, corners counter-clockwise."""
    inside = np.zeros(len(xy), dtype=bool)
    for corners in outlines:
        sides = np.roll(corners, -1, axis=0) - corners
        inwards = np.column_stack([-sides[:, 1], sides[:, 0]])
        inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-9)
        inside |= (xy @ inwards.T - np.einsum("ij,ij->i", inwards, corners) > _INWARDS).all(axis=1)
    return inside


def may_be_level(points: Float[np.ndarray, "N 3"], floors: Sequence[FloorPlane]) -> bool:
    """Whether points that are new show so much that is flat, and low enough, that it may be a level of the floor."""
    low = np.zeros(len(points), dtype=bool)
    for floor in floors:
        low |= floor.above(points) < _HIGHEST
    if not low.any():
        return False
    return float(patches_of(points[low]).is_upright.sum() * PATCH**2) >= _STEPPED_ON
