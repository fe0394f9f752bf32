"""Signed distances of convex solids at given poses, from coal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import coal
import numpy as np
from jaxtyping import Float

from costs.stopping import poll


def _request() -> coal.DistanceRequest:
    request = coal.DistanceRequest()
    request.enable_signed_distance = True
    return request


@dataclass(eq=False)
class Narrow:
    """coal's distance with the memory it reuses; one per verification."""

    _request: coal.DistanceRequest = field(default_factory=_request)
    _result: coal.DistanceResult = field(default_factory=coal.DistanceResult)
    _identity: coal.Transform3s = field(default_factory=coal.Transform3s)

    def closest(
        self,
        movers: Sequence[coal.Convex],
        rotation: Float[np.ndarray, "R 3 3"],
        translation: Float[np.ndarray, "R 3"],
        holders: Sequence[coal.Convex],
    ) -> tuple[Float[np.ndarray, "R"], Float[np.ndarray, "R 3"]]:
        """Signed distance [m] of every mover, placed in its holder's frame, from the holder, and the unit direction
        from the first to the second (not finite where coal has none: the two touch within rounding)."""
        distance, direction = np.empty(len(movers)), np.empty((len(movers), 3))
        result, request, identity = self._result, self._request, self._identity
        for row, (mover, turned, moved, holder) in enumerate(zip(movers, rotation, translation, holders, strict=True)):
            poll()
            result.clear()
            distance[row] = coal.distance(mover, coal.Transform3s(turned, moved), holder, identity, request, result)
            direction[row] = result.normal
        length = np.sqrt((direction * direction).sum(axis=1))
        length[~((length > 0.5) & (length < 2.0))] = np.nan
        return distance, direction / length[:, None]

    def nearest_point(
        self,
        mover: coal.Convex,
        rotation: Float[np.ndarray, "3 3"],
        translation: Float[np.ndarray, "3"],
        holder: coal.Convex,
    ) -> Float[np.ndarray, "3"]:
        """The holder's point nearest to the mover, or deepest in it, in the holder's frame [m]."""
        self._result.clear()
        placed = coal.Transform3s(rotation, translation)
        coal.distance(mover, placed, holder, self._identity, self._request, self._result)
        return np.array(self._result.getNearestPoint2())
