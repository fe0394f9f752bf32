"""What the rays have seen to be free: a grid of cells that rays passed through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

_END_MARGIN = 0.05
_MAX_CELLS = 40_000_000


@dataclass(frozen=True)
class FreeSpace:
    """Cells seen to be free and not beside a measured point.

    Attributes:
        lower: (3,) lower corner of the grid [m].
        size: edge of a cell [m].
        free: (X, Y, Z) which cells are free.
    """

    lower: Float[np.ndarray, "3"]
    size: float
    free: Bool[np.ndarray, "X Y Z"]

    def cells_in(self, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> Float[np.ndarray, "M 3"]:
        """Centres of the free cells in an axis-aligned box [m]."""
        first = np.maximum(np.ceil((lower - self.lower) / self.size - 0.5), 0).astype(int)
        last = np.minimum(np.floor((upper - self.lower) / self.size - 0.5), np.array(self.free.shape) - 1).astype(int)
        if (last < first).any():
            return np.empty((0, 3))
        block = self.free[first[0] : last[0] + 1, first[1] : last[1] + 1, first[2] : last[2] + 1]
        return np.asarray((np.argwhere(block) + first + 0.5) * self.size + self.lower)

    def count_inside(self, faces: Float[np.ndarray, "F 4"], corners: Float[np.ndarray, "V 3"], margin: float) -> int:
        """How many free cell centres lie deeper than ``margin`` behind all faces."""
        cells = self.cells_in(corners.min(axis=0), corners.max(axis=0))
        if not len(cells):
            return 0
        return int((cells @ faces[:, :3].T + faces[:, 3] <= -margin).all(axis=1).sum())


def carve(
    origin: Float[np.ndarray, "3"],
    ends: Float[np.ndarray, "N 3"],
    surface: Float[np.ndarray, "M 3"],
    lower: Float[np.ndarray, "3"],
    upper: Float[np.ndarray, "3"],
    size: float = 0.02,
) -> FreeSpace:
    """March all rays in step through the grid.

    Args:
        origin: (3,) where the rays start [m].
        ends: (N, 3) where they ended; the last 5 cm of a ray are no evidence (range noise).
        surface: (M, 3) points whose cells and their six neighbours are never free.
        lower, upper: (3,) corners of the grid [m].
        size: edge of a cell [m].
    """
    while np.prod(np.ceil((upper - lower) / size)) > _MAX_CELLS:
        size *= 1.26
    shape = np.maximum(np.ceil((upper - lower) / size).astype(int), 1)
    free = np.zeros(int(np.prod(shape)), dtype=bool)
    start, stop, direction = _clip(origin, ends, lower, upper)
    step = 0.8 * size
    order = np.argsort(-stop, kind="stable")
    start, stop, direction = start[order], stop[order], direction[order].astype(np.float32)
    base = ((origin - lower) / size).astype(np.float32)
    limit = (shape - 1).astype(np.int32)
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    for t in np.arange(step / 2, float(stop[0]) if len(stop) else 0.0, step):
        # Rays are sorted by where they stop: those still under way come first.
        alive = int(np.searchsorted(-stop, -t))
        going = np.flatnonzero(start[:alive] <= t)
        cells = (base + direction[going] * np.float32(t / size)).astype(np.int32)
        np.clip(cells, 0, limit, out=cells)
        free[cells @ strides] = True
    grid = free.reshape(shape)
    grid &= ~_beside(surface, lower, size, shape)
    return FreeSpace(lower, size, grid)


def _clip(
    origin: Float[np.ndarray, "3"],
    ends: Float[np.ndarray, "N 3"],
    lower: Float[np.ndarray, "3"],
    upper: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"], Float[np.ndarray, "K 3"]]:
    """Distances at which each ray enters and leaves the box (or ends), and its direction; slab method."""
    rays = ends - origin
    length = np.linalg.norm(rays, axis=1)
    keep = length > 1e-6
    length, direction = length[keep], rays[keep] / length[keep, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (lower - origin) / direction, (upper - origin) / direction
    enter = np.nan_to_num(np.minimum(a, b), nan=-np.inf).max(axis=1).clip(0.0)
    leave = np.nan_to_num(np.maximum(a, b), nan=np.inf).min(axis=1)
    stop = np.minimum(leave, length - _END_MARGIN)
    crossing = stop > enter
    return enter[crossing], stop[crossing], direction[crossing]


def _beside(
    surface: Float[np.ndarray, "M 3"], lower: Float[np.ndarray, "3"], size: float, shape: np.ndarray
) -> Bool[np.ndarray, "X Y Z"]:
    """Cells that hold a surface point, and their six neighbours."""
    mask = np.zeros(shape, dtype=bool)
    cells = np.floor((surface - lower) / size).astype(int)
    cells = cells[((cells >= 0) & (cells < shape)).all(axis=1)]
    mask[tuple(cells.T)] = True
    return np.asarray(ndimage.binary_dilation(mask))
