"""What the sampled poses of a clearance search have shown: the nearest, the deepest, and the ones that refute."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from service.verify.look import Look
from service.verify.narrow import Narrow


@dataclass(frozen=True)
class Meeting:
    """A pair at one pose: signed distance [m] and the holder's closest point in the world."""

    couple: int
    s: float
    distance: float
    allowed: float
    position: Float[np.ndarray, "3"]


class Samples:
    """Signed distances at poses, from coal, and what is extreme among them.

    Attributes:
        nearest: smallest distance of a pair that may not touch, or the horizon [m].
        deepest: by pair and phase, the smallest distance of a pair allowed to touch [m].
        refuted: by pair and phase, the deepest pose that penetrates deeper than allowed.
    """

    def __init__(self, horizon: float, tolerance: float) -> None:
        """``horizon`` bounds what is of interest, ``tolerance`` is the excess that refutes [m]."""
        self.nearest = horizon
        self.deepest: dict[tuple[int, int], float] = {}
        self.refuted: dict[tuple[int, int], Meeting] = {}
        self._tolerance = tolerance
        self._narrow = Narrow()

    def measure(
        self, look: Look, rows: Int[np.ndarray, "R"], columns: Int[np.ndarray, "R"]
    ) -> tuple[Float[np.ndarray, "R"], Float[np.ndarray, "R 3"]]:
        """Distances and directions of these rows at one of their poses each."""
        distance, direction = look.closest(rows, columns, self._narrow)
        allowed = look.allowed[rows]
        may_touch = ~np.isnan(allowed)
        self.nearest = min(self.nearest, float(distance[~may_touch].min(initial=np.inf)))
        for k in np.flatnonzero(may_touch).tolist():
            key = look.key(int(rows[k]))
            self.deepest[key] = min(self.deepest.get(key, np.inf), float(distance[k]))
        for k in np.flatnonzero(distance < -np.nan_to_num(allowed) - self._tolerance).tolist():
            row, column = int(rows[k]), int(columns[k])
            key = look.key(row)
            if key not in self.refuted or distance[k] < self.refuted[key].distance:
                point = look.touching(row, column, self._narrow)
                s = float(look.s[row, column])
                self.refuted[key] = Meeting(key[0], s, float(distance[k]), float(allowed[k]), point)
        return distance, direction
