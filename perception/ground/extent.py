"""Extent of a floor level as rectangles, and the holes where rays went through its plane."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

_CELL = 0.05
_AROUND = np.ones((3, 3), dtype=bool)
_BELOW = 0.05
_FEWEST_RAYS = 2
_FEWEST_CELLS = 12
_CLOSING = 3
_MOST_PATCHES = 12
_NARROWEST = 0.08
_LEFT = 0.04


def pierced_cells(
    normal: Float[np.ndarray, "3"],
    offset: float,
    rays: tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]],
    seen: Float[np.ndarray, "K 2"],
    centre: Float[np.ndarray, "2"],
    extent: float,
) -> Float[np.ndarray, "H 2"]:
    """Return centres (x, y) of 5 cm cells where rays went through a plane and none of its points were seen [m].

    Args:
        normal, offset: plane ``normal . x == offset``.
        rays: starts and ends (R, 3) [m].
        seen: (K, 2) x and y of the plane's inliers [m].
        centre, extent: centre and half side of the searched square [m].
    """
    starts, ends = rays
    before, behind = starts @ normal - offset, ends @ normal - offset
    through = np.flatnonzero((before > 0.0) & (behind < -_BELOW))
    t = before[through] / (before[through] - behind[through])
    crossing = starts[through, :2] + t[:, None] * (ends[through, :2] - starts[through, :2])
    lower = centre - extent
    n_cells = int(np.ceil(2 * extent / _CELL))
    count = _counts(crossing, lower, n_cells)
    own = ndimage.binary_dilation(_counts(seen, lower, n_cells) > 0, structure=_AROUND)
    holes = (count >= _FEWEST_RAYS) & ~own
    joined = ndimage.binary_closing(holes, structure=_AROUND, iterations=2) & ~own
    label, n_parts = ndimage.label(joined, structure=_AROUND)
    size = np.bincount(label.ravel(), weights=holes.ravel(), minlength=n_parts + 1)
    size[0] = 0.0
    return np.asarray((np.argwhere(size[label] >= _FEWEST_CELLS) + 0.5) * _CELL + lower)


def _counts(xy: Float[np.ndarray, "N 2"], lower: Float[np.ndarray, "2"], n_cells: int) -> np.ndarray:
    cells = np.floor((xy - lower) / _CELL).astype(int)
    cells = cells[((cells >= 0) & (cells < n_cells)).all(axis=1)]
    return np.bincount(cells @ [n_cells, 1], minlength=n_cells**2).reshape(n_cells, n_cells)


def convex_patches(
    seen: Float[np.ndarray, "K 2"], cell: float, holes: Float[np.ndarray, "H 2"] | None = None
) -> tuple[Float[np.ndarray, "4 2"], ...]:
    """Return rectangles, the largest first, that cover the seen positions and gaps of a hand's width.

    With holes, the rectangles also cover unseen positions inside the seen extent that are nearer to a seen position
    than to a hole: a floor continues in a shadow, but not beyond its edge.

    Returns:
        Corners (4, 2), counter-clockwise, of rectangles that do not overlap and lie along the main direction [m].
    """
    turn = _main_direction(seen)
    flat = seen @ turn
    lower, upper = flat.min(axis=0) - 4 * cell, flat.max(axis=0) + 4 * cell
    mask = _picture(flat, lower, upper, cell)
    if holes is None:
        mask = ndimage.binary_closing(mask, structure=_AROUND, iterations=_CLOSING)
    else:
        beyond = _picture(holes @ turn, lower, upper, cell) & ~mask
        mask = ndimage.distance_transform_edt(~mask) < ndimage.distance_transform_edt(~beyond)
    return tuple(corners @ turn.T for corners in _rectangles(mask, lower, cell, flat))


def _main_direction(xy: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "2 2"]:
    """Return the side directions, as columns, of the smallest rectangle around the positions."""
    try:
        corners = xy[ConvexHull(xy).vertices]
    except (QhullError, ValueError):
        return np.eye(2)
    sides = np.roll(corners, -1, axis=0) - corners
    angles = np.arctan2(sides[:, 1], sides[:, 0]) % (np.pi / 2)
    turns = np.stack([np.cos(angles), -np.sin(angles), np.sin(angles), np.cos(angles)], axis=1).reshape(-1, 2, 2)
    area = np.ptp(corners @ turns, axis=1).prod(axis=1)
    return np.asarray(turns[int(np.argmin(area))])


def _picture(
    flat: Float[np.ndarray, "N 2"], lower: Float[np.ndarray, "2"], upper: Float[np.ndarray, "2"], cell: float
) -> Bool[np.ndarray, "U V"]:
    mask = np.zeros(np.ceil((upper - lower) / cell).astype(int) + 1, dtype=bool)
    cells = np.floor((flat - lower) / cell).astype(int)
    mask[tuple(cells[((cells >= 0) & (cells < mask.shape)).all(axis=1)].T)] = True
    return mask


def _rectangles(
    mask: Bool[np.ndarray, "U V"], lower: Float[np.ndarray, "2"], cell: float, flat: Float[np.ndarray, "K 2"]
) -> list[Float[np.ndarray, "4 2"]]:
    """Return the largest rectangles of marked cells, one after the other, each shrunk to the points inside [m]."""
    mask, whole = mask.copy(), mask.sum()
    rectangles: list[Float[np.ndarray, "4 2"]] = []
    for _ in range(_MOST_PATCHES):
        if mask.sum() <= _LEFT * whole:
            break
        first, last = _largest(mask)
        mask[first[0] : last[0], first[1] : last[1]] = False
        low, high = lower + first * cell, lower + last * cell
        inside = flat[((flat >= low) & (flat <= high)).all(axis=1)]
        if not len(inside):
            continue
        low, high = np.maximum(low, inside.min(axis=0)), np.minimum(high, inside.max(axis=0))
        if (high - low).min() >= _NARROWEST:
            rectangles.append(np.array([low, [high[0], low[1]], high, [low[0], high[1]]]))
    return rectangles


def _largest(mask: Bool[np.ndarray, "U V"]) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and last-plus-one cell of the largest rectangle of marked cells."""
    best, corners = 0, (np.zeros(2, dtype=int), np.zeros(2, dtype=int))
    columns = np.arange(mask.shape[1])
    for top in range(mask.shape[0]):
        if mask[top].sum() * (mask.shape[0] - top) <= best:
            continue
        solid = np.logical_and.accumulate(mask[top:], axis=0)
        run = columns - np.maximum.accumulate(np.where(solid, -1, columns), axis=1)
        area = run * np.arange(1, len(solid) + 1)[:, None]
        at = int(np.argmax(area))
        if area.flat[at] > best:
            row, column = divmod(at, mask.shape[1])
            best = int(area.flat[at])
            corners = (
                np.array([top, column + 1 - run[row, column]]),
                np.array([top + row + 1, column + 1]),
            )
    return corners
