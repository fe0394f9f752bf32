"""What the rays have seen to be free: a grid of cells that rays passed through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

_END_MARGIN = 0.05
_MAX_CELLS = 40_000_000
_STEP = 0.8
_BLOCK = 0.4
_BIN = 0.6
_FUZZ = 1e-4
_CHUNK = 400
_FACES = 12


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

    def contains(self, points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Which points lie in a free cell."""
        cells = np.floor((points - self.lower) / self.size).astype(int)
        known = ((cells >= 0) & (cells < self.free.shape)).all(axis=1)
        inside = np.zeros(len(points), dtype=bool)
        inside[known] = self.free[tuple(cells[known].T)]
        return inside

    def count_inside(
        self, faces: Float[np.ndarray, "F 4"], corners: Float[np.ndarray, "V 3"], margin: float, most: int | None = None
    ) -> int:
        """How many free cell centres lie deeper than ``margin`` behind all faces.

        Args:
            faces: half-spaces ``a . x + b <= 0``.
            corners: of the body.
            margin: [m].
            most: the count may end as soon as it is above this.
        """
        cells = self.cells_in(corners.min(axis=0), corners.max(axis=0))
        count = 0
        # A body that holds many free cells shows it in any few of them.
        n_parts = -(-len(cells) // _CHUNK)
        for part in range(n_parts):
            inside = cells[part::n_parts]
            for first in range(0, len(faces), _FACES):
                some = faces[first : first + _FACES]
                inside = inside[(inside @ some[:, :3].T <= -margin - some[:, 3]).all(axis=1)]
            count += len(inside)
            if most is not None and count > most:
                break
        return count


def carve(
    starts: Float[np.ndarray, "*R 3"],
    ends: Float[np.ndarray, "R 3"],
    surface: Float[np.ndarray, "M 3"],
    lower: Float[np.ndarray, "3"],
    upper: Float[np.ndarray, "3"],
    size: float = 0.02,
) -> FreeSpace:
    """March all rays in step through the grid.

    Args:
        starts: (3,) or (R, 3) where the rays start [m].
        ends: (R, 3) where they ended; the last 5 cm of a ray are no evidence (range noise).
        surface: (M, 3) points whose cells and their six neighbours are never free.
        lower, upper: (3,) corners of the grid [m].
        size: edge of a cell [m].
    """
    while np.prod(np.ceil((upper - lower) / size)) > _MAX_CELLS:
        size *= 1.26
    shape = np.maximum(np.ceil((upper - lower) / size).astype(int), 1)
    free = np.zeros(int(np.prod(shape)), dtype=bool)
    rays = _Rays.within(np.broadcast_to(starts, ends.shape), ends, lower, upper, size)
    for near in np.arange(0.0, float(rays.leave.max(initial=0.0)), _BLOCK):
        _march(rays.thinned(near, near + _BLOCK, size), near, size, shape, free)
    grid = free.reshape(shape)
    grid &= ~_beside(surface, lower, size, shape)
    return FreeSpace(lower, size, grid)


@dataclass(frozen=True)
class _Rays:
    """Rays that cross the grid, the farthest last.

    Attributes:
        start: (3, R) in cells from the grid's corner.
        direction: (3, R) unit, in cells per metre.
        enter, leave: (R,) distances between which each is in the grid and evidence [m].
        bundle: (R,) number of the group of rays that start in the same place.
        facing: (R,) side of a cube about its start that each ray leaves it by.
        across: (2, R) where on that side, -1 to 1.
    """

    start: Float[np.ndarray, "3 R"]
    direction: Float[np.ndarray, "3 R"]
    enter: Float[np.ndarray, "R"]
    leave: Float[np.ndarray, "R"]
    bundle: Int[np.ndarray, "R"]
    facing: Int[np.ndarray, "R"]
    across: Float[np.ndarray, "2 R"]

    @classmethod
    def within(
        cls,
        starts: Float[np.ndarray, "N 3"],
        ends: Float[np.ndarray, "N 3"],
        lower: Float[np.ndarray, "3"],
        upper: Float[np.ndarray, "3"],
        size: float,
    ) -> _Rays:
        """The rays clipped to the grid (slab method), without the last 5 cm of each."""
        rays = ends - starts
        length = np.sqrt(np.einsum("ni,ni->n", rays, rays))
        keep = length > _END_MARGIN
        starts, length = starts[keep], length[keep]
        direction = rays[keep] / length[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (lower - starts) / direction, (upper - starts) / direction
        enter = np.nan_to_num(np.minimum(a, b), nan=-np.inf).max(axis=1).clip(0.0) + _FUZZ
        leave = np.minimum(np.nan_to_num(np.maximum(a, b), nan=np.inf).min(axis=1) - _FUZZ, length - _END_MARGIN)
        crossing = np.flatnonzero(leave > enter)
        crossing = crossing[np.argsort(leave[crossing], kind="stable")]
        direction, starts = direction[crossing], starts[crossing]
        places = np.floor(starts / (_BIN * size)).astype(np.int64)
        if len(places) and (places == places[0]).all():
            bundle = np.zeros(len(places), dtype=np.int64)
        else:
            bundle = np.unique(places, axis=0, return_inverse=True)[1].reshape(-1)
        axis = np.argmax(np.abs(direction), axis=1)
        along = np.take_along_axis(direction, axis[:, None], axis=1)
        others = np.array([[1, 2], [0, 2], [0, 1]])[axis]
        return cls(
            np.ascontiguousarray(((starts - lower) / size).T, dtype=np.float32),
            np.ascontiguousarray(direction.T / size, dtype=np.float32),
            enter[crossing].astype(np.float32),
            leave[crossing].astype(np.float32),
            bundle,
            2 * axis + (along[:, 0] > 0.0),
            np.ascontiguousarray((np.take_along_axis(direction, others, axis=1) / np.abs(along)).T),
        )

    def thinned(self, near: float, far: float, size: float) -> _Rays:
        """The rays under way between two distances, of those less than a cell apart there only the longest."""
        first = int(np.searchsorted(self.leave, np.float32(near), side="right"))
        under_way = np.arange(first, len(self.leave))
        under_way = under_way[self.enter[first:] < far]
        n_bins = int(np.ceil(2.0 * far / (_BIN * size)))
        n_bundles = int(self.bundle.max(initial=0)) + 1
        if 6 * n_bins**2 * n_bundles < 4 * len(under_way):
            u, v = np.minimum(((self.across[:, under_way] + 1.0) * (n_bins / 2)).astype(np.int64), n_bins - 1)
            bins = ((self.bundle[under_way] * 6 + self.facing[under_way]) * n_bins + u) * n_bins + v
            # Of several writes to one place the last stays: the ray that goes farthest.
            longest = np.full(6 * n_bins**2 * n_bundles, -1)
            longest[bins] = under_way
            under_way = longest[longest >= 0]
        return _Rays(
            self.start[:, under_way], self.direction[:, under_way], self.enter[under_way], self.leave[under_way],
            self.bundle[under_way], self.facing[under_way], self.across[:, under_way],
        )  # fmt: skip


def _march(rays: _Rays, near: float, size: float, shape: Int[np.ndarray, "3"], free: Bool[np.ndarray, "C"]) -> None:
    """Mark the cells that the rays pass in one block of distances."""
    _, ny, nz = (int(n) for n in shape)
    step = _STEP * size
    for t in np.arange(near + step / 2, near + _BLOCK, step):
        at = np.clip(np.float32(t), rays.enter, rays.leave)
        x, y, z = ((rays.start[i] + rays.direction[i] * at).astype(np.int32) for i in range(3))
        free[(x * ny + y) * nz + z] = True


def _beside(
    surface: Float[np.ndarray, "M 3"], lower: Float[np.ndarray, "3"], size: float, shape: np.ndarray
) -> Bool[np.ndarray, "X Y Z"]:
    """Cells that hold a surface point, and their six neighbours."""
    mask = np.zeros(shape, dtype=bool)
    cells = np.floor((surface - lower) / size).astype(int)
    cells = cells[((cells >= 0) & (cells < shape)).all(axis=1)]
    mask[tuple(cells.T)] = True
    return np.asarray(ndimage.binary_dilation(mask))
