"""Notes about a given mechanism whose moving bodies are deep inside those that stand still."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from service.demands.mechanism.given import GivenMechanism
from service.verify import DistanceQuery, make_coal_convex

DEEP = 0.01  # overlap at the start that no bearing and no rounding of a shape explains [m]
MOST_NOTES = 3  # the deepest first


def list_overlap_notes(given: GivenMechanism) -> Iterator[str]:
    """Yield a sentence for each pair of a moving and a still body that is deeper than a bearing at the start.

    The certificate lets neighbours overlap as much as they do at the start, so that nobody else would say so.
    """
    depths = []
    query = DistanceQuery()
    for name, points in given.place_named(given.mechanism.start):
        for other, still in given.read.still.items():
            if np.any(points.max(axis=0) < still.min(axis=0)) or np.any(still.max(axis=0) < points.min(axis=0)):
                continue
            depths.append((-query.measure(make_coal_convex(points), make_coal_convex(still)), name, other))
    for depth, name, other in sorted(depths, reverse=True)[:MOST_NOTES]:
        if depth > DEEP:
            yield (
                f"{name} is {1e3 * depth:.0f} mm inside {other} at the start and may pass through it; the shapes "
                "are read as they are (each counts as its convex hull)"
            )
