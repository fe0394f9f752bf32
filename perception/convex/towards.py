"""Fast search, by direction and length, for the rays of a scan that may pass near given boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

_WIDTH = 0.05  # edge of a direction cell
_N_CELLS = int(np.ceil(2.0 / _WIDTH)) + 1
_BLOCK = 0.08
# Rays up to this far beside a box count as passing it [m].
_AROUND = 0.06
_NEAREST = 0.3
_SHELL = 1.6
_AT_A_TIME = 16_384


@dataclass(frozen=True)
class Bearings:
    """Directions and lengths of rays with a common start.

    Attributes:
        start: (3,) common start [m].
        cell: (R,) number of the direction cell of each ray.
    """

    start: Float[np.ndarray, "3"]
    cell: Int[np.ndarray, "R"]
    length: Float[np.ndarray, "R"]

    @classmethod
    def of(cls, start: Float[np.ndarray, "3"], ends: Float[np.ndarray, "R 3"]) -> Bearings:
        """Compute directions and lengths of rays from ``start`` to ``ends`` [m]."""
        cell, length = np.empty(len(ends), dtype=np.int32), np.empty(len(ends), dtype=np.float32)
        for first in range(0, len(ends), _AT_A_TIME):
            some = slice(first, first + _AT_A_TIME)
            ahead = np.subtract(ends[some].T, start[:, None], dtype=np.float32, casting="same_kind", order="C")
            length[some] = np.sqrt(ahead[0] ** 2 + ahead[1] ** 2 + ahead[2] ** 2)
            cell[some] = _number_cells(ahead / np.maximum(length[some], np.float32(1e-6)))
        return cls(start, cell, length)

    def may_pass(self, boxes: Float[np.ndarray, "B 2 3"]) -> Bool[np.ndarray, "R"]:
        """Return which rays may pass through any box (lower and upper corner [m]) or within 6 cm of it.

        No such ray is missed; some of the returned ones pass farther away.
        """
        if not len(boxes):
            return np.zeros(len(self.cell), dtype=bool)
        ahead = _find_blocks(boxes) - self.start
        distance = np.sqrt(np.einsum("ij,ij->i", ahead, ahead))
        radius = 0.5 * np.sqrt(3.0) * _BLOCK + _AROUND
        if distance.min() < _NEAREST:
            return np.ones(len(self.cell), dtype=bool)
        cell = _number_cells((ahead / distance[:, None]).astype(np.float32).T)
        shell = np.floor(np.log(distance / _NEAREST) / np.log(_SHELL)).astype(int)
        nearest = np.full(_N_CELLS**3, np.inf, dtype=np.float32)
        for number in np.unique(shell):
            mine = shell == number
            near = float(distance[mine].min())
            picture = np.zeros(_N_CELLS**3, dtype=np.uint8)
            picture[cell[mine]] = 1
            # Cells between two directions whose angle has a sine of radius / near.
            steps = int(1.1 * radius / near / _WIDTH) + 1
            seen = _grow(picture.reshape(3 * (_N_CELLS,)), steps).ravel() > 0
            nearest[seen] = np.minimum(nearest[seen], near - radius)
        return np.asarray(self.length >= nearest[self.cell])


def _number_cells(directions: Float[np.ndarray, "3 N"]) -> Int[np.ndarray, "N"]:
    """Return the direction cell number of each unit vector."""
    x, y, z = ((directions + np.float32(1.0)) * np.float32(1.0 / _WIDTH)).astype(np.int32)
    return np.asarray((x * _N_CELLS + y) * _N_CELLS + z)


def _grow(picture: np.ndarray, steps: int) -> np.ndarray:
    """Return the picture with its marked cells dilated by ``steps`` cells on all sides."""
    for axis in range(3):
        picture = ndimage.maximum_filter1d(picture, 2 * steps + 1, axis=axis, mode="constant")
    return picture


def _find_blocks(boxes: Float[np.ndarray, "B 2 3"]) -> Float[np.ndarray, "K 3"]:
    """Return centres of the 8 cm grid cells that intersect any of the boxes [m]."""
    cells = np.floor(boxes / _BLOCK).astype(int)
    lowest = cells[:, 0].min(axis=0)
    cells -= lowest
    picture = np.zeros(cells[:, 1].max(axis=0) + 1, dtype=bool)
    for low, high in cells:
        picture[low[0] : high[0] + 1, low[1] : high[1] + 1, low[2] : high[2] + 1] = True
    return np.asarray((np.argwhere(picture) + lowest + 0.5) * _BLOCK)


@dataclass(frozen=True)
class Sheaf:
    """Rays with a common start, sorted by direction cell.

    Attributes:
        bearings: directions and lengths of the rays.
        order: (R,) indices of the rays, sorted by direction cell.
        first: (C + 1,) index in ``order`` of each cell's first ray.
    """

    bearings: Bearings
    order: Int[np.ndarray, "R"]
    first: Int[np.ndarray, "C"]

    @classmethod
    def of(cls, start: Float[np.ndarray, "3"], ends: Float[np.ndarray, "R 3"]) -> Sheaf:
        """Sort the rays from ``start`` to ``ends`` [m] by direction cell."""
        bearings = Bearings.of(start, ends)
        counts = np.bincount(bearings.cell, minlength=_N_CELLS**3)
        return cls(bearings, np.argsort(bearings.cell), np.concatenate([[0], np.cumsum(counts)]))

    def select_about(self, centre: Float[np.ndarray, "3"], radius: float) -> Int[np.ndarray, "K"]:
        """Return ascending indices of rays that may pass through a sphere; no ray that does is missed."""
        ahead = centre - self.bearings.start
        distance = float(np.linalg.norm(ahead))
        if distance < 2.0 * radius:
            return np.arange(len(self.order))
        # Unit vectors are at most 1.1 times the sine of their angle apart, for sines up to a half.
        around = 1.1 * radius / distance
        lower, upper = (np.floor((ahead / distance + sign * around + 1.0) / _WIDTH).astype(int) for sign in (-1, 1))
        lower, upper = lower.clip(0), upper.clip(max=_N_CELLS - 1)
        x, y = np.ogrid[lower[0] : upper[0] + 1, lower[1] : upper[1] + 1]
        row = ((x * _N_CELLS + y) * _N_CELLS).ravel()
        begin, end = self.first[row + lower[2]], self.first[row + upper[2] + 1]
        chosen = np.concatenate([self.order[a:b] for a, b in zip(begin, end, strict=True)])
        return np.sort(chosen[self.bearings.length[chosen] >= distance - radius - 1e-3])
