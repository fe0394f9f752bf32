"""Swept contacts, which the collision terms measure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class Contacts:
    """Pairs closer than their query distance, one row per pair and interval.

    The signed distance is that of the swept hull of ``body`` over the interval from the other convex, which is a piece
    of the scene or, for self-collision, another body in whose frame the sweep was made.

    Attributes:
        first, second: (m,) waypoints at the interval's ends (equal for a single pose).
        body: (m,) index of the swept body.
        other: (m,) index of the piece, or of the other body.
        is_self: (m,) whether ``other`` is a body.
        distance: (m,) signed, negative in penetration [m].
        margin: (m,) required clearance [m].
        share: (m,) weight of the second waypoint in the gradient, 0 to 1.
        normal: (m, 2, 3) unit, from the other convex to the body, in the world at both waypoints.
        point: (m, 2, 3) supporting point of the body at both waypoints, in the world [m].
    """

    first: Int[np.ndarray, "m"]
    second: Int[np.ndarray, "m"]
    body: Int[np.ndarray, "m"]
    other: Int[np.ndarray, "m"]
    is_self: np.ndarray
    distance: Float[np.ndarray, "m"]
    margin: Float[np.ndarray, "m"]
    share: Float[np.ndarray, "m"]
    normal: Float[np.ndarray, "m 2 3"]
    point: Float[np.ndarray, "m 2 3"]

    def __len__(self) -> int:
        return len(self.distance)

    def where(self, rows: np.ndarray) -> Contacts:
        """Return the rows of a mask or of indices."""
        return Contacts(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})

    @staticmethod
    def join(parts: list[Contacts]) -> Contacts:
        """Return the rows of all parts."""
        names = Contacts.__dataclass_fields__
        return Contacts(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})

    @staticmethod
    def none() -> Contacts:
        """Return no contacts."""
        index, number = np.zeros(0, dtype=int), np.zeros(0)
        vector = np.zeros((0, 2, 3))
        return Contacts(index, index, index, index, np.zeros(0, dtype=bool), number, number, number, vector, vector)
