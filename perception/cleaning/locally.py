"""Surface test for a few points of a scan, from their neighbouring rays only."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.cleaning.beside import STARTS_APART
from perception.cleaning.clean import row_keys
from perception.cleaning.outliers import surface_points

_NARROWEST = 0.008  # width of a bin of directions [rad]
_LEAST_RAYS = 5  # mean per bin; bins up to two away then contain twice the 32 neighbours that are used
_WIDER = 1.5
_STEPS = range(-2, 3)
_MOST_STARTS = 8
_MOST_SHARE = 0.4
_WIDEST = 0.5


@dataclass(frozen=True)
class LocalJudge:
    """Scan prepared for surface tests of a few points.

    Attributes:
        candidates: which points are not on the floor.
        directions: (3, N) unit vectors of the rays.
        sensor: (N,) sensor position number of each ray; None for a single one.
    """

    points: Float[np.ndarray, "N 3"]
    starts: Float[np.ndarray, "N 3"]
    candidates: Bool[np.ndarray, "N"]
    directions: Float[np.ndarray, "3 N"]
    sensor: Int[np.ndarray, "N"] | None

    @classmethod
    def of(
        cls, points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"], candidates: Bool[np.ndarray, "N"]
    ) -> LocalJudge:
        """Compute ray directions and sensor numbers; arguments as the attributes."""
        directions = np.subtract(points.T, starts.T, order="C").astype(np.float32)
        lengths = np.sqrt(directions[0] ** 2 + directions[1] ** 2 + directions[2] ** 2)
        directions /= np.maximum(lengths, np.float32(1e-9))
        sensor = None
        if len(starts) and starts.strides[0] != 0:
            keys = row_keys(np.floor(starts / STARTS_APART))
            sensor = np.unique(keys, return_inverse=True)[1] if (keys != keys[0]).any() else None
        return cls(points, starts, candidates, directions, sensor)

    def surface_among(self, queries: Int[np.ndarray, "K"]) -> Bool[np.ndarray, "K"]:
        """Return which of the queried points lie on a surface.

        All queries must be candidates; all other candidates are assumed to lie on surfaces.
        """
        if not len(queries):
            return np.zeros(0, dtype=bool)
        known = self.candidates.copy()
        known[queries] = False
        beside = self._beside(queries)
        if len(beside) == len(self.points):
            return np.asarray(surface_points(self.points, self.starts, self.candidates, known)[queries])
        kept = surface_points(self.points[beside], self.starts[beside], self.candidates[beside], known[beside])
        return np.asarray(kept[np.searchsorted(beside, queries)])

    def _beside(self, queries: Int[np.ndarray, "K"]) -> Int[np.ndarray, "M"]:
        """Return ascending indices of points with rays close to those of the queries; all points if most are close."""
        everyone = np.arange(len(self.points))
        n_sensors = 1 if self.sensor is None else int(self.sensor.max()) + 1
        if n_sensors > _MOST_STARTS or len(queries) > _MOST_SHARE * len(everyone):
            return everyone
        width = _NARROWEST
        while width < _WIDEST:
            cells, n_cells = self._cells(width)
            chosen = np.zeros(n_sensors * n_cells**3, dtype=bool)
            chosen[cells[queries]] = True
            own = np.unique(cells[queries])
            if np.count_nonzero(chosen[cells]) >= _LEAST_RAYS * len(own):
                for u, v, w in product(_STEPS, repeat=3):
                    chosen[own + ((u * n_cells + v) * n_cells + w)] = True
                return np.flatnonzero(chosen[cells])
            width *= _WIDER
        return everyone

    def _cells(self, width: float) -> tuple[Int[np.ndarray, "N"], int]:
        """Return the number of each ray's direction bin, and the number of bins along each axis."""
        # Two more cells on every side, so that the neighbours of all unit directions are in the grid.
        n_cells = int(np.ceil(2.0 / width)) + 5
        u, v, w = (((column + 1.0) * (1.0 / width)).astype(np.int32) + 2 for column in self.directions)
        cells = (u * n_cells + v) * n_cells + w
        return cells if self.sensor is None else cells + n_cells**3 * self.sensor, n_cells
