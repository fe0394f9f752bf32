"""Free space of a scan: a grid of cells that rays passed through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from costs.stopping import poll
from perception.cleaning.clean import row_keys
from perception.convex.cells import number_cells
from perception.convex.hulls import Hull

_END_MARGIN = 0.05
_MAX_CELLS = 40_000_000
_STEP = 0.8
_BLOCK = 0.4
_BIN = 0.6
_FUZZ = 1e-4
_CHUNK = 400
_FACES = 12
# Rays processed at a time, so that the arrays stay in the cache of one core.
_MARCHING = 1024
_MEETING = 16_384
# Edge in cells of the blocks in which rays near the boxes are found.
_CELLS_OF_BLOCK = 4


@dataclass(frozen=True)
class FreeSpace:
    """Grid of cells, of edge ``size`` [m], that a ray passed through and that are not beside a measured point."""

    lower: Float[np.ndarray, "3"]
    size: float
    free: Bool[np.ndarray, "X Y Z"]

    def list_cells(self, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]) -> Float[np.ndarray, "M 3"]:
        """Return centres (M, 3) of the free cells in an axis-aligned box [m]."""
        poll()
        first = np.maximum(np.ceil((lower - self.lower) / self.size - 0.5), 0).astype(int)
        last = np.minimum(np.floor((upper - self.lower) / self.size - 0.5), np.array(self.free.shape) - 1).astype(int)
        if (last < first).any():
            return np.empty((0, 3))
        block = self.free[first[0] : last[0] + 1, first[1] : last[1] + 1, first[2] : last[2] + 1]
        return np.asarray((np.argwhere(block) + first + 0.5) * self.size + self.lower)

    def contains(self, points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        """Return which points lie in a free cell."""
        poll()
        cell, inside = number_cells(points, self.lower, self.size, self.free.shape)
        return np.asarray(self.free.reshape(-1)[cell] & inside)

    def clear_beside(self, surface: Float[np.ndarray, "M 3"]) -> FreeSpace:
        """Return a copy in which the cells of these points and their six neighbours are not free."""
        free = self.free.copy()
        _clear_beside(surface, self.lower, self.size, free)
        return FreeSpace(self.lower, self.size, free)

    def count_inside(self, hull: Hull, most: int | None = None, margin: float | None = None) -> int:
        """Count the free cells whose centre lies deeper than ``margin`` inside a hull.

        Args:
            most: counting may stop once the count exceeds this.
            margin: by default a quarter of a cell [m].
        """
        poll()
        margin = 0.25 * self.size if margin is None else margin
        cells = self.list_cells(hull.lower, hull.upper)
        count = 0
        # Every n-th cell at a time: a few of them show a hull with many free cells.
        n_parts = -(-len(cells) // _CHUNK)
        for part in range(n_parts):
            inside = cells[part::n_parts]
            for first in range(0, len(hull.faces), _FACES):
                some = hull.faces[first : first + _FACES]
                inside = inside[(some[:, :3] @ inside.T <= -margin - some[:, 3:]).all(axis=0)]
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
    """Return the cells that rays passed through, in a grid from ``lower`` to ``upper``.

    Args:
        ends: (R, 3) ray ends; the last 5 cm of a ray are not used (range noise) [m].
        surface: (M, 3) points whose cells and their six neighbours are never free [m].
    """
    return Crossing.of(starts, ends, lower, upper, size).mark_free(surface)


@dataclass(frozen=True)
class Crossing:
    """Rays clipped to a grid, to be marched through all of it, as ``carve`` does, or through some boxes in it.

    Attributes:
        rays: rays clipped to the grid.
    """

    rays: _Rays
    lower: Float[np.ndarray, "3"]
    size: float
    shape: Int[np.ndarray, "3"]

    @classmethod
    def of(
        cls,
        starts: Float[np.ndarray, "*R 3"],
        ends: Float[np.ndarray, "R 3"],
        lower: Float[np.ndarray, "3"],
        upper: Float[np.ndarray, "3"],
        size: float,
    ) -> Crossing:
        """Clip rays to the grid; arguments as for ``carve``."""
        while np.prod(np.ceil((upper - lower) / size)) > _MAX_CELLS:
            size *= 1.26
        shape = np.maximum(np.ceil((upper - lower) / size).astype(int), 1)
        rays = _Rays.clip(np.broadcast_to(starts, ends.shape), ends, lower, upper, size)
        return cls(rays, lower, size, shape)

    def mark_free(
        self, surface: Float[np.ndarray, "M 3"], boxes: Float[np.ndarray, "B 2 3"] | None = None, doubt: float = 0.0
    ) -> FreeSpace:
        """Return the cells that the rays passed through.

        Args:
            surface: (M, 3) points whose cells and their six neighbours are never free [m].
            boxes: (B, 2, 3) lower and upper corners of boxes; cells outside them may be left unmarked [m].
            doubt: distance from these points up to which cells are never free, either [m].
        """
        free = np.zeros(int(np.prod(self.shape)), dtype=bool)
        blocks = None if boxes is None else _mark_blocks(boxes, self.lower, self.size, self.shape)
        nearest = float(self.rays.enter.min(initial=np.inf))
        for near in np.arange(0.0, float(self.rays.leave.max(initial=0.0)), _BLOCK):
            poll()
            if nearest >= near + _BLOCK:
                continue
            chosen = self.rays.select_under_way(near, near + _BLOCK, self.size)
            if blocks is not None:
                chosen = chosen[_meet(self.rays, chosen, near, blocks)]
            _march(self.rays, chosen, near, self.size, self.shape, free)
        grid = free.reshape(self.shape)
        _clear_beside(surface, self.lower, self.size, grid)
        if doubt > self.size and len(surface):
            held = np.zeros(grid.shape, dtype=bool)
            cells = np.floor((surface - self.lower) / self.size).astype(int)
            held[tuple(cells[((cells >= 0) & (cells < held.shape)).all(axis=1)].T)] = True
            grid &= ndimage.distance_transform_edt(~held) * self.size > doubt
        return FreeSpace(self.lower, self.size, grid)


@dataclass(frozen=True)
class _Rays:
    """Rays that cross the grid, sorted by ``leave``.

    Attributes:
        start: (3, R), or (3, 1) for a common start, in cells from the grid's lower corner.
        direction: (3, R) unit vectors divided by the cell size [cells/m].
        enter, leave: (R,) distances between which each ray is in the grid and shows free space [m].
        bundle: (R,) group number of rays with the same start.
        facing: (R,) face by which each ray leaves a cube around its start.
        across: (2, R) coordinates on that face, 0 to 2.
    """

    start: Float[np.ndarray, "3 *R"]
    direction: Float[np.ndarray, "3 R"]
    enter: Float[np.ndarray, "R"]
    leave: Float[np.ndarray, "R"]
    bundle: Int[np.ndarray, "R"]
    facing: Int[np.ndarray, "R"]
    across: Float[np.ndarray, "2 R"]

    @classmethod
    def clip(
        cls,
        starts: Float[np.ndarray, "N 3"],
        ends: Float[np.ndarray, "N 3"],
        lower: Float[np.ndarray, "3"],
        upper: Float[np.ndarray, "3"],
        size: float,
    ) -> _Rays:
        """Clip the rays to the grid (slab method) and drop the last 5 cm of each."""
        poll()
        is_one_start = bool(len(starts)) and (starts.strides[0] == 0 or bool((starts == starts[0]).all()))
        start = starts[:1].T if is_one_start else starts.T
        direction = np.subtract(ends.T, start, order="C")
        length = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
        enter, beyond = np.zeros(len(length)), np.full(len(length), np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            direction /= length
            for axis in range(3):
                a, b = (lower[axis] - start[axis]) / direction[axis], (upper[axis] - start[axis]) / direction[axis]
                # A ray in a side plane of the grid gives NaN, which fmax and fmin ignore.
                np.fmax(enter, np.minimum(a, b), out=enter)
                np.fmin(beyond, np.maximum(a, b), out=beyond)
        enter += _FUZZ
        leave = np.minimum(beyond - _FUZZ, length - _END_MARGIN)
        crossing = np.flatnonzero(leave > enter)
        crossing = crossing[_sort_ascending(leave[crossing])]
        direction, start = np.take(direction, crossing, axis=1), start if is_one_start else start[:, crossing]
        facing, across = _project_on_cube(direction)
        return cls(
            ((start - lower[:, None]) / size).astype(np.float32),
            (direction / size).astype(np.float32),
            enter[crossing].astype(np.float32),
            leave[crossing].astype(np.float32),
            np.zeros(len(crossing), dtype=np.int64) if is_one_start else _number_bundles(start, size),
            facing,
            across,
        )

    def select_under_way(self, near: float, far: float, size: float) -> Int[np.ndarray, "K"]:
        """Return rays in the grid between two distances [m]; of rays less than a cell apart only the longest."""
        poll()
        first = int(np.searchsorted(self.leave, np.float32(near), side="right"))
        chosen = first + np.flatnonzero(self.enter[first:] < far)
        n_bins = int(np.ceil(2.0 * far / (_BIN * size)))
        n_bundles = int(self.bundle.max(initial=0)) + 1
        if 6 * n_bins**2 * n_bundles >= 4 * len(chosen):
            return chosen
        u, v = (np.minimum((side[chosen] * (n_bins / 2)).astype(np.int64), n_bins - 1) for side in self.across)
        bins = ((self.bundle[chosen] * 6 + self.facing[chosen]) * n_bins + u) * n_bins + v
        # Of several writes to one bin the last stays, which is the longest ray.
        longest = np.full(6 * n_bins**2 * n_bundles, -1)
        longest[bins] = chosen
        return np.asarray(longest[longest >= 0])


def _sort_ascending(values: Float[np.ndarray, "N"]) -> Int[np.ndarray, "N"]:
    """Return the indices that sort positive numbers (stable); 16 bits at a time, which numpy sorts in linear time."""
    bits = np.ascontiguousarray(values, dtype=np.float64).view(np.uint64)
    order = np.arange(len(bits))
    for shift in range(0, 64, 16):
        order = order[np.argsort((bits >> np.uint64(shift)).astype(np.uint16)[order], kind="stable")]
    return order


def _number_bundles(start: Float[np.ndarray, "3 R"], size: float) -> Int[np.ndarray, "R"]:
    """Return the group number of each ray; a group starts in one small cell."""
    keys = row_keys(np.floor(start / (_BIN * size)).T)
    if (keys == keys[:1]).all():
        return np.zeros(len(keys), dtype=np.int64)
    return np.unique(keys, return_inverse=True)[1]


def _project_on_cube(direction: Float[np.ndarray, "3 R"]) -> tuple[Int[np.ndarray, "R"], Float[np.ndarray, "2 R"]]:
    """Return the face by which each ray leaves a cube of edge 2 around its start, and the coordinates there, 0 to 2."""
    x, y, z = direction
    size_x, size_y, size_z = np.abs(direction)
    along_y = size_y > size_x
    along_z = size_z > np.maximum(size_x, size_y)
    along = np.where(along_z, z, np.where(along_y, y, x))
    axis = np.where(along_z, 2, along_y)
    across = np.stack([np.where(along_z | along_y, x, y), np.where(along_z, y, z)])
    across /= np.abs(along)
    across += 1.0
    return 2 * axis + (along > 0.0), across


def _mark_blocks(
    boxes: Float[np.ndarray, "B 2 3"], lower: Float[np.ndarray, "3"], size: float, shape: Int[np.ndarray, "3"]
) -> Bool[np.ndarray, "X Y Z"]:
    """Mark blocks of cells within half a marching distance (0.2 m) of any box."""
    blocks = np.zeros(-(-shape // _CELLS_OF_BLOCK), dtype=bool)
    cells = (boxes - lower) / size
    reach = 0.5 * _BLOCK / size
    first = ((cells[:, 0] - reach) / _CELLS_OF_BLOCK).astype(int).clip(0)
    last = ((cells[:, 1] + reach) / _CELLS_OF_BLOCK).astype(int)
    for low, high in zip(first, last, strict=True):
        blocks[tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))] = True
    return blocks


def _meet(
    rays: _Rays, chosen: Int[np.ndarray, "K"], near: float, blocks: Bool[np.ndarray, "X Y Z"]
) -> Bool[np.ndarray, "K"]:
    """Return which chosen rays are in a marked block at the middle of the distance interval that starts at ``near``."""
    poll()
    is_there = np.zeros(len(chosen), dtype=bool)
    middle = np.float32(near + _BLOCK / 2)
    _, ny, nz = blocks.shape
    flat = blocks.ravel()
    for first in range(0, len(chosen), _MEETING):
        poll()
        some = chosen[first : first + _MEETING]
        start = rays.start if rays.start.shape[1] == 1 else rays.start[:, some]
        at = np.minimum(np.maximum(rays.enter[some], middle), rays.leave[some])
        x, y, z = (
            (rays.direction[axis][some] * at + start[axis]).astype(np.int32) // _CELLS_OF_BLOCK for axis in range(3)
        )
        np.take(flat, (x * ny + y) * nz + z, out=is_there[first : first + _MEETING])
    return is_there


def _march(
    rays: _Rays,
    chosen: Int[np.ndarray, "K"],
    near: float,
    size: float,
    shape: Int[np.ndarray, "3"],
    free: Bool[np.ndarray, "C"],
) -> None:
    """Mark the cells that the chosen rays pass in the 0.4 m from distance ``near`` on."""
    poll()
    _, ny, nz = (int(n) for n in shape)
    step = _STEP * size
    distances = np.arange(near + step / 2, near + _BLOCK, step).astype(np.float32)[:, None]
    for first in range(0, len(chosen), _MARCHING):
        poll()
        some = chosen[first : first + _MARCHING]
        start = rays.start if rays.start.shape[1] == 1 else rays.start[:, some]
        at = np.minimum(np.maximum(rays.enter[some], distances), rays.leave[some])
        x, y, z = ((rays.direction[axis][some] * at + start[axis]).astype(np.int32) for axis in range(3))
        free[((x * ny + y) * nz + z).astype(np.intp)] = True


def _clear_beside(
    surface: Float[np.ndarray, "M 3"], lower: Float[np.ndarray, "3"], size: float, free: Bool[np.ndarray, "X Y Z"]
) -> None:
    """Mark the cells of the surface points, and their six neighbours, as not free."""
    cells = [np.floor((column - low) / size).astype(np.int64) for column, low in zip(surface.T, lower, strict=True)]
    inside = np.ones(len(surface), dtype=bool)
    for column, length in zip(cells, free.shape, strict=True):
        inside &= (column >= 0) & (column < length)
    cells = [column[inside] for column in cells]
    strides = (free.shape[1] * free.shape[2], free.shape[2], 1)
    at = sum(column * stride for column, stride in zip(cells, strides, strict=True))
    flat = free.reshape(-1)
    flat[at] = False
    for column, length, stride in zip(cells, free.shape, strides, strict=True):
        flat[at - stride * (column > 0)] = False
        flat[at + stride * (column < length - 1)] = False
