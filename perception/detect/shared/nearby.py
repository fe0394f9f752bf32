"""Points of a cloud near many places at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.cleaning.clean import row_keys

_CELL = 0.1  # [m]
_CORNER = 0.5 * np.sqrt(3.0) * _CELL  # from the middle of a cell to its corner [m]
_AT_ONCE = 300_000  # pairs of place and point


@dataclass(frozen=True)
class Neighbours:
    """Points near each of some places.

    Attributes:
        first, last: numbers of the first place and of the one after the last.
        counts: (K,) number of points near each of these places.
        points: (M,) indices of the points, place by place.
    """

    first: int
    last: int
    counts: Int[np.ndarray, "K"]
    points: Int[np.ndarray, "M"]


@dataclass(frozen=True)
class Nearby:
    """Points sorted by cubic cells of the world.

    Attributes:
        points: (N, 3) [m].
        order: (N,) indices of the points, cell by cell.
        borders: (C + 1,) position of each cell's first point in ``order``, and N.
        cells: tree of the cells' middles.
    """

    points: Float[np.ndarray, "N 3"]
    order: Int[np.ndarray, "N"]
    borders: Int[np.ndarray, "C1"]
    cells: cKDTree

    @staticmethod
    def of(points: Float[np.ndarray, "N 3"]) -> Nearby:
        """Return the points sorted by cells; the order within a cell is that of a hash of their coordinates."""
        cell = np.floor(points / _CELL)
        order = np.lexsort((row_keys(points), *cell.T))
        cell = cell[order]
        first = np.flatnonzero(np.concatenate([[True], (cell[1:] != cell[:-1]).any(axis=1)]))
        return Nearby(points, order, np.append(first, len(points)), cKDTree((cell[first] + 0.5) * _CELL))

    def list_near(self, places: Float[np.ndarray, "P 3"], radii: Float[np.ndarray, "P"]) -> Iterator[Neighbours]:
        """Yield all points within each radius of its place [m], and some just beyond, for some places at a time."""
        if not len(places):
            return
        poll()
        near = self.cells.query_ball_point(places, radii + _CORNER, return_sorted=True)
        sizes = np.diff(self.borders)
        n_cells = np.array([len(cells) for cells in near])
        cells = np.concatenate([np.asarray(these, dtype=np.int64) for these in near])
        ends = np.concatenate([[0], np.cumsum(n_cells)])
        counts = np.diff(np.concatenate([[0], np.cumsum(sizes[cells])])[ends])
        batch = np.cumsum(counts) // _AT_ONCE
        starts = np.flatnonzero(np.concatenate([[True], batch[1:] != batch[:-1]]))
        for first, last in zip(starts, np.append(starts[1:], len(places)), strict=True):
            poll()
            yield Neighbours(
                int(first), int(last), counts[first:last], self._points_of(cells[ends[first] : ends[last]])
            )

    def list_along(
        self, place: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"], radius: float
    ) -> Int[np.ndarray, "M"]:
        """Return all points within ``radius`` of a line through a place [m], and some just beyond, in order."""
        poll()
        offset = self.cells.data - place
        apart = (offset**2).sum(axis=1) - (offset @ axis) ** 2
        return np.sort(self._points_of(np.flatnonzero(apart < (radius + _CORNER) ** 2)))

    def _points_of(self, cells: Int[np.ndarray, "S"]) -> Int[np.ndarray, "M"]:
        """Return the points of some cells, cell by cell."""
        sizes = np.diff(self.borders)[cells]
        first = np.repeat(self.borders[cells] - (np.cumsum(sizes) - sizes), sizes)
        return np.asarray(self.order[first + np.arange(len(first))])
