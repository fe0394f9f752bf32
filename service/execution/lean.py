"""Displacement of the body towards the middle of the feet, where a plan stands close to their border."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog

from service.execution.balance import PlannedBalance, find_support
from service.verify import Phase

DEEPEST_SHARE = 0.8  # of the way to the middle of a support that is narrower than twice the margin
PROJECTIONS = 200  # of Dykstra's method; polygons of feet have at most eight edges


@dataclass(frozen=True)
class PlannedLean:
    """How far a plan's centre of mass is to be displaced.

    Attributes:
        times: (S,) on the plan's clock [s].
        offset: (S, 2) of the centre of mass, world x and y [m].
    """

    times: Float[np.ndarray, "S"]
    offset: Float[np.ndarray, "S 2"]

    @staticmethod
    def of(balance: PlannedBalance, margin_m: float) -> PlannedLean:
        """Return the least displacements that give a plan a margin while it stands on its feet alone.

        Args:
            balance: of the plan.
            margin_m: of the centre of mass inside the feet; less where they are too narrow for it [m].
        """
        offset = np.zeros((len(balance.times), 2))
        for k, phase in enumerate(balance.phases):
            here = np.flatnonzero((balance.phase == k) & (balance.margin < margin_m))
            if len(here) and phase.contacts and not phase.loads and _stands_on(phase, balance.feet):
                offset[here] = _move_inside(find_support(phase), balance.com[here], margin_m) - balance.com[here]
        return PlannedLean(balance.times, offset)

    def at(self, time_s: float, lead_s: float) -> Float[np.ndarray, "3"]:
        """Return the displacement for a time: the larger one of now and ``lead_s`` later, in world axes [m]."""
        last = len(self.times) - 1
        ends = np.minimum(np.searchsorted(self.times, [time_s, time_s + lead_s]), last)
        both = self.offset[ends]
        return np.append(both[int(np.linalg.norm(both, axis=1).argmax())], 0.0)


def _stands_on(phase: Phase, feet: tuple[str, ...]) -> bool:
    return {contact.link for contact in phase.contacts} <= set(feet)


def _move_inside(
    polygon: Float[np.ndarray, "E 2"], points: Float[np.ndarray, "S 2"], margin_m: float
) -> Float[np.ndarray, "S 2"]:
    """Return the nearest points at least ``margin_m`` inside a convex polygon, by Dykstra's method."""
    along = np.roll(polygon, -1, axis=0) - polygon
    length = np.linalg.norm(along, axis=1)
    keep = length > 1e-9
    normal = np.stack([along[keep, 1], -along[keep, 0]], axis=1) / length[keep, None]
    bound = (normal * polygon[keep]).sum(axis=1)
    deepest = linprog([0.0, 0.0, -1.0], np.column_stack([normal, np.ones(len(bound))]), bound, bounds=(None, None))
    bound = bound - min(margin_m, DEEPEST_SHARE * -float(np.asarray(deepest.fun)))
    moved, corrections = points.copy(), np.zeros((len(bound), *points.shape))
    for _ in range(PROJECTIONS):
        for k, (direction, most) in enumerate(zip(normal, bound, strict=True)):
            before = moved + corrections[k]
            moved = before - np.maximum(before @ direction - most, 0.0)[:, None] * direction
            corrections[k] = before - moved
    return moved
