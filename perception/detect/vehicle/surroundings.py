"""Surroundings of a seat: the back behind its cushion and the vehicle's floor in front.

A vehicle's floor fills the footwell and ends ahead at a surface that rises from it.  The top of a box, a table or a
step ends in a drop: rays that pass its edge end below it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from costs.stopping import poll
from perception.detect.shared.arithmetic import rising, sum_about
from perception.detect.vehicle.level import filled_cells, is_inside

_BACK = (0.08, 0.6)
_OPEN_CELL = 0.06
# Seen shares of the back's cells from which a back is partly and fully known.
_KNOWN = (0.05, 0.2)
# Height of a cushion's top over the vehicle's floor [m].
SEAT_HEIGHT = (0.22, 0.68)
_AHEAD, _ASIDE = 0.6, 0.1
_LAYER, _CELL = 0.02, 0.04
_FEWEST = 20
_LEAST_FLOOR = 0.04  # [m^2]
_THICK = 0.03
# Depth below the floor at which a ray's crossing is located and depth it must reach; heights of risen points [m].
_UNDER = (0.05, 0.08)
_RISEN = (0.08, 0.6)
_WELL = (0.06, 0.3)
_REACH = 0.9
_NEXT = 3  # cells


@dataclass(frozen=True)
class Back:
    """Cells of the region of a seat's back.

    Attributes:
        solid: share of the seen cells that hold points.
        n_solid: number of cells that hold points.
        seen: share of the cells that hold points or that rays passed.
        reach_up: height over the cushion up to which points continue without a gap [m].
    """

    solid: float
    n_solid: int
    seen: float
    reach_up: float

    def evidence(self, unseen: float) -> float:
        """Return the score, 0 to 1, of a seat's back; ``unseen`` when the region was not seen."""
        known = rising(self.seen, *_KNOWN)
        sure = rising(self.solid, 0.3, 0.6) * rising(self.n_solid, 3.0, 10.0) * rising(self.reach_up, 0.35, 0.5)
        return known * sure * (1.0 - 0.8 * rising(self.reach_up, 1.15, 1.4)) + (1.0 - known) * unseen


def back_of(
    width: float,
    depth: float,
    local: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "R 3"],
    ends: Float[np.ndarray, "R 3"],
) -> Back:
    """Return the solid and open cells of the region behind a cushion.

    Args:
        width, depth: of the cushion [m].
        local: (N, 3) points in the seat's frame [m].
        starts, ends: (R, 3) of all rays, in the seat's frame [m].
    """
    poll()
    n_across = max(round((width - 0.04) / _OPEN_CELL), 1)
    n_up = round((_BACK[1] - _BACK[0]) / _OPEN_CELL)
    low = np.array([-0.5 * depth - 0.3, -0.5 * n_across * _OPEN_CELL, _BACK[0]])
    high = np.array([-0.5 * depth + 0.12, 0.5 * n_across * _OPEN_CELL, _BACK[0] + n_up * _OPEN_CELL])
    solid = np.zeros((n_across, n_up), dtype=bool)
    mine = local[is_inside(local, low, high)]
    cell = np.floor((mine[:, 1:] - low[1:]) / _OPEN_CELL).astype(int)
    solid[cell[:, 0], cell[:, 1]] = True
    # Rays that cross the whole back region, located at its middle plane.
    at = -0.5 * depth - 0.1
    through = (starts[:, 0] - low[0]) * (ends[:, 0] - low[0]) < 0.0
    through &= np.maximum(starts[:, 0], ends[:, 0]) > high[0]
    share = (at - starts[through, 0]) / (ends[through, 0] - starts[through, 0])
    crossing = starts[through, 1:] + share[:, None] * (ends[through, 1:] - starts[through, 1:])
    cell = np.floor((crossing - low[1:]) / _OPEN_CELL).astype(int)
    cell = cell[((cell >= 0) & (cell < solid.shape)).all(axis=1)]
    opened = np.zeros_like(solid)
    opened[cell[:, 0], cell[:, 1]] = True
    seen = solid | opened
    return Back(
        float(solid.sum() / max(seen.sum(), 1)), int(solid.sum()), float(seen.mean()), _reach_up(local, low, high)
    )


def _reach_up(local: Float[np.ndarray, "N 3"], low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> float:
    """Return the height up to which the back continues without a gap [m]; a wall ends far above seats."""
    tall = local[is_inside(local, np.array([low[0], low[1], 0.3]), np.array([high[0], high[1], 1.6])), 2]
    steps = np.bincount(np.floor((tall - 0.3) / 0.1).astype(int), minlength=14) >= 5
    return 0.3 + 0.1 * float(np.argmin(np.concatenate([steps, [False]])))


@dataclass(frozen=True)
class Footwell:
    """Floor in front of a seat.

    Attributes:
        height: z of the floor from the cushion's top, negative [m]; NaN when unseen.
        open_share: share of the cells just in front of the cushion in which rays passed below the floor, or, when
            unseen, below the lowest possible floor.
        drop_share: share of the rows with floor that end in a drop ahead.
    """

    height: float
    open_share: float
    drop_share: float

    @property
    def evidence(self) -> float:
        """Score, 0 to 1, of a vehicle's floor: closed footwell, and no drop at its end."""
        return (1.0 - 0.9 * rising(self.open_share, 0.15, 0.4)) * (1.0 - 0.9 * rising(self.drop_share, 0.1, 0.35))


def footwell_of(
    width: float,
    depth: float,
    local: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "R 3"],
    ends: Float[np.ndarray, "R 3"],
) -> Footwell:
    """Return the height of the floor in front of a cushion, and its open and drop shares.

    Args:
        width, depth: of the cushion [m].
        local: (N, 3) points in the seat's frame, floor included [m].
        starts, ends: (R, 3) of all rays, in the seat's frame [m].
    """
    front = 0.5 * depth
    height = _height(width, front, local)
    is_seen = not np.isnan(height)
    level = height if is_seen else -SEAT_HEIGHT[1]
    low, high = np.array([front - 0.1, -0.5 * width]), np.array([front + _REACH, 0.5 * width])
    shape = np.ceil((high - low) / _CELL).astype(int)
    opened = filled_cells(_passing(starts, ends, level), low, shape, _CELL)
    on = np.abs(local[:, 2] - level) < _THICK
    over = (local[:, 2] > level + _RISEN[0]) & (local[:, 2] < level + _RISEN[1])
    solid, risen = (filled_cells(local[some, :2], low, shape, _CELL) for some in (on, over))
    x = low[0] + (np.arange(shape[0]) + 0.5) * _CELL
    well = (x > front + _WELL[0]) & (x < front + _WELL[1])
    open_share = float((opened & ~solid)[well].mean())
    return Footwell(height, open_share, _drops(solid, opened, risen) if is_seen else 0.0)


def _height(width: float, front: float, local: Float[np.ndarray, "N 3"]) -> float:
    """Return z of the floor from the cushion's top, negative [m]; NaN: unseen."""
    poll()
    down = is_inside(
        local,
        np.array([front - 0.1, -0.5 * width - _ASIDE, -SEAT_HEIGHT[1]]),
        np.array([front + _AHEAD, 0.5 * width + _ASIDE, -SEAT_HEIGHT[0]]),
    )
    height, flat = local[down, 2], local[down, :2]
    if len(height) < _FEWEST:
        return np.nan
    # The height whose points cover most cells in plan; upright objects cover few.
    layer = np.floor((height + SEAT_HEIGHT[1]) / _LAYER).astype(int)
    cell = np.floor(flat / _CELL).astype(int)
    places = np.unique(np.column_stack([layer, cell]), axis=0)[:, 0]
    votes = sum_about(np.bincount(places, minlength=int(layer.max()) + 2), (1.0, 1.0, 1.0))
    best = int(np.argmax(votes))
    if votes[best] * _CELL**2 < _LEAST_FLOOR:
        return np.nan
    middle = (best + 0.5) * _LAYER - SEAT_HEIGHT[1]
    return float(np.median(height[np.abs(height - middle) < _THICK]))


def _passing(
    starts: Float[np.ndarray, "R 3"], ends: Float[np.ndarray, "R 3"], level: float
) -> Float[np.ndarray, "K 2"]:
    """Return x and y where rays that end below a level passed down through it [m]."""
    poll()
    at = level - _UNDER[0]
    down = (ends[:, 2] < level - _UNDER[1]) & (starts[:, 2] > at)
    start, end = starts[down], ends[down]
    share = (at - start[:, 2]) / (end[:, 2] - start[:, 2])
    return np.asarray(start[:, :2] + share[:, None] * (end - start)[:, :2])


def _drops(solid: Bool[np.ndarray, "A B"], opened: Bool[np.ndarray, "A B"], risen: Bool[np.ndarray, "A B"]) -> float:
    """Return the share of floor rows that end in a drop: rays pass below the floor just behind the last cell."""
    rows = np.flatnonzero(solid.any(axis=0))
    if not len(rows):
        return 0.0
    n = len(solid)
    last = n - 1 - np.argmax(solid[::-1, rows], axis=0)
    steps = last + np.arange(-1, _NEXT + 1)[:, None]
    inside = steps < n
    steps = steps.clip(0, n - 1)
    rises, goes_down = risen[steps, rows] & inside, opened[steps, rows] & inside
    # The last cell of the floor may also be open, so it does not count.
    goes_down[:2] = False
    return float((goes_down.any(axis=0) & ~rises.any(axis=0)).mean())
